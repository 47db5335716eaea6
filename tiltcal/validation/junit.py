"""JUnit XML of a verification, for continuous integration."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from tiltcal.core.files import replacing
from tiltcal.validation.acceptance import MethodResult, ScenarioResult, Verification
from tiltcal.validation.limit import Limit


def write_junit(verification: Verification, path: Path) -> None:
    """JUnit XML: a suite a scenario, a case a limit."""
    seconds = f"{verification.seconds:.3f}"
    root = ElementTree.Element("testsuites", name="tiltcal verify", time=seconds)
    for result in verification.results:
        suite = ElementTree.SubElement(root, "testsuite", name=_printable(result.scenario.name))
        for method in result.methods:
            _add_cases(suite, result, method)
        suite.set("tests", str(len(suite)))
        suite.set("failures", str(sum(len(case) for case in suite)))
    ElementTree.indent(root)
    with replacing(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _add_cases(suite: ElementTree.Element, result: ScenarioResult, method: MethodResult) -> None:
    """One case a limit; one for the calibration where there is none."""
    name, seconds = f"{result.source}.{method.title}", f"{method.seconds:.3f}"
    for limit in method.limits or (Limit("calibration", np.nan, method.error or "", False),):
        words = {"classname": _printable(name), "name": _printable(limit.name), "time": seconds}
        case = ElementTree.SubElement(suite, "testcase", words)
        if not limit.passed or method.error:
            where = f" ({limit.where})" if limit.where else ""
            reached = f"reached {limit.reached:.6g}{where}, allowed {limit.allowed}"
            text = method.error or reached
            text = _printable(text)
            ElementTree.SubElement(case, "failure", message=text).text = text


def _printable(text: str) -> str:
    """Without the control characters that XML cannot hold."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
