"""Files of runs: one row a run as a table for Parquet and CSV, and JUnit XML of a verification for
continuous integration.
"""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from pydantic import TypeAdapter

from tiltcal.core.files import replacing
from tiltcal.core.safe_text import cell_of
from tiltcal.core.units import ARCSEC
from tiltcal.validation.acceptance import MethodResult, ScenarioResult, Verification
from tiltcal.validation.limits import Limit
from tiltcal.validation.runs import Row

if TYPE_CHECKING:
    import pyarrow as pa

_ROW = TypeAdapter(Row)


def row_of(stored: Any) -> Row:
    """A row as a file has it, checked.

    Raises:
        ValueError: it is none.
    """
    return _ROW.validate_python(stored)


TEXT = ("scenario", "method", "verdict", "error", "matrix")
WHOLE = ("seed", "nees_dof", "point", "replicate")


def record_of(row: Row) -> dict[str, Any]:
    """A row as plain values by column name; None where there is none.

    A parameter has three columns: ``<name>_<unit>``, ``<name>_sigma_<unit>`` and
    ``<name>_truth_<unit>``. A ratio has the unit ``unitless``.
    """
    record: dict[str, Any] = {
        "scenario": row.scenario,
        "method": row.method,
        "seed": row.seed,
        "verdict": row.shown_verdict,
        "nees": row.nees if row.nees_dof else None,
        "nees_dof": row.nees_dof,
        "tilt_before_arcsec": _arcsec(row.tilt_before),
        "tilt_after_arcsec": _arcsec(row.tilt_after),
        "tilt_bound_arcsec": _arcsec(row.tilt_bound),
        "tilt_dof": None if row.tilt_after is None else row.tilt_dof,
        "seconds": row.seconds,
        "error": row.error,
    }
    for p in row.parameters:
        unit = "unitless" if p.unit in ("1", "") else p.unit
        record |= {
            f"{p.name}_{unit}": p.value,
            f"{p.name}_sigma_{unit}": p.sigma,
            f"{p.name}_truth_{unit}": p.truth,
        }
    return record


def table_of(records: Sequence[dict[str, Any]]) -> "pa.Table":
    """Records as one table; a column that a record does not have is null there.

    Returns:
        Columns as ``schema_of``: the fixed ones first, then the parameters in the order in which
        they appear.
    """
    import pyarrow as pa

    return pa.Table.from_pylist(list(records), schema_of(names_of(records)))


def names_of(records: Iterable[dict[str, Any]]) -> list[str]:
    """The columns of some records, in the order in which they appear."""
    return list(dict.fromkeys(name for record in records for name in record))


def schema_of(names: Sequence[str], text: Collection[str] = ()) -> "pa.Schema":
    """Text, int64 and float64 columns by name; ``text``: further ones that are text."""
    import pyarrow as pa

    kinds = {n: pa.string() for n in (*TEXT, *text)} | {n: pa.int64() for n in WHOLE}
    return pa.schema([(n, kinds.get(n, pa.float64())) for n in names])


def write_runs(rows: Sequence[Row], folder: Path) -> None:
    """Write ``runs.parquet`` and ``runs.csv`` into a folder, each whole or not at all.

    Raises:
        TiltcalError: the folder cannot be written.
    """
    from pyarrow import csv, parquet

    records = [record_of(row) for row in rows]
    table = table_of(records)
    with replacing(folder / "runs.parquet") as temporary:
        parquet.write_table(table, temporary)
    shown = [{k: cell_of(v) if isinstance(v, str) else v for k, v in r.items()} for r in records]
    with replacing(folder / "runs.csv") as temporary:
        csv.write_csv(table_of(shown), temporary)


def _arcsec(angle: float | None) -> float | None:
    return None if angle is None else angle / ARCSEC


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
        suite.set("time", f"{sum(method.seconds for method in result.methods):.3f}")
    ElementTree.indent(root)
    with replacing(path) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _add_cases(suite: ElementTree.Element, result: ScenarioResult, method: MethodResult) -> None:
    """One case a limit, with its share of the time; one for the calibration where there is none."""
    limits = method.limits or (Limit("calibration", np.nan, method.error or "", False),)
    name, seconds = f"{result.source}.{method.title}", f"{method.seconds / len(limits):.3f}"
    for limit in limits:
        labels = {"classname": _printable(name), "name": _printable(limit.name), "time": seconds}
        case = ElementTree.SubElement(suite, "testcase", labels)
        if not limit.passed or method.error:
            where = f" ({limit.where})" if limit.where else ""
            reached = f"reached {limit.reached:.6g}{where}, allowed {limit.allowed}"
            text = method.error or reached
            text = _printable(text)
            ElementTree.SubElement(case, "failure", message=text).text = text


def _printable(text: str) -> str:
    """Without the control characters that XML does not allow."""
    return "".join(c if c.isprintable() or c == "\n" else "?" for c in text)
