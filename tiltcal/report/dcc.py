"""The certificate as a digital calibration certificate (DCC) of PTB: XML, schema 3.2.1, units in
D-SI 2.1.0. Written with the standard library.

Units of parameters are in D-SI, the form that digital certificates use: SI without prefixes.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiltcal import __version__
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_text
from tiltcal.core.units import DEG, G0, PARAMETER_UNITS
from tiltcal.report.certificate import Certificate
from tiltcal.report.certificate_scope import not_tested, procedure, validity
from tiltcal.report.stated import NO_COUNTRY, NOT_STATED, Stated, clean
from tiltcal.validation.uncertainty_budget import COVERAGE

_TEMPERATURE = re.compile(r"^(?P<unit>.+)_degC(?P<power>\d*)$")
_DIMENSIONS: dict[str, dict[str, int]] = {
    "ratio": {},
    "time": {"second": 1},
    "length": {"metre": 1},
    "frequency": {"hertz": 1},
    "angle": {"radian": 1},
    "rate": {"radian": 1, "second": -1},
    "acceleration": {"metre": 1, "second": -2},
    "temperature": {"degreecelsius": 1},
    # coefficients of powers of the specific force: their unit g is divided out
    "g/g2": {"metre": -1, "second": 2},
    "g/g3": {"metre": -2, "second": 4},
    "angle/g": {"radian": 1, "metre": -1, "second": 2},
    "rate/g": {"radian": 1, "metre": -1, "second": 1},
    "rate/g2": {"radian": 1, "metre": -2, "second": 3},
}
_PER_G = {"g/g2": G0, "g/g3": G0**2, "angle/g": G0, "rate/g": G0, "rate/g2": G0**2}


@dataclass(frozen=True)
class SiUnit:
    r"""A unit of ours in SI.

    Args:
        factor: SI value of one of it.
        text: D-SI, such as ``\metre\second\tothe{-2}``.
    """

    factor: float
    text: str


def si_unit(unit: str) -> SiUnit | None:
    """The D-SI form of a parameter's unit, such as ``m_s2``, ``1``, ``ug_g2`` or ``m_s2_degC2``.

    None where it has none, or is not known.
    """
    name = {"1": "unitless"}.get(unit, unit)
    known = PARAMETER_UNITS.get(name)
    if known is not None and known.quantity in _DIMENSIONS:
        factor = known.factor / _PER_G.get(known.quantity, 1.0)
        return SiUnit(factor, _unit_text(_DIMENSIONS[known.quantity]))
    match = _TEMPERATURE.match(unit)
    if match is None:
        return None
    per = si_unit(match["unit"])
    if per is None:
        return None
    power = int(match["power"] or 1)
    kelvin = f"\\kelvin\\tothe{{-{power}}}"
    return SiUnit(per.factor, kelvin if per.text == "\\one" else per.text + kelvin)


def _unit_text(powers: dict[str, int]) -> str:
    parts = [f"\\{u}" if p == 1 else f"\\{u}\\tothe{{{p}}}" for u, p in powers.items()]
    return "".join(parts) or "\\one"


VERSION = "3.2.1"
DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
PROBABILITY = 0.95
LANGUAGE = "en"


def write_dcc(certificate: Certificate, path: Path) -> None:
    """Write the XML, whole or not at all.

    Raises:
        TiltcalError: no day of measurement is stated, or the file cannot be written.
    """
    write_text(path, dcc_text(certificate))


def require_date(stated: Stated) -> None:
    """Refuse statements without what a DCC cannot go without.

    Raises:
        TiltcalError: no day of measurement is stated.
    """
    if stated.date is None:
        raise TiltcalError(
            "digital calibration certificate",
            found="no day of the measurement",
            need="one: the schema requires it, and no recording contains it",
            do="add --date YYYY-MM-DD",
        )


def dcc_text(certificate: Certificate) -> str:
    """The DCC as text.

    Raises:
        TiltcalError: no day of measurement is stated: the schema requires it.
    """
    require_date(certificate.stated)
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=VERSION)
    _administrative(_add(root, "administrativeData"), certificate)
    _results(_add(root, "measurementResults"), certificate)
    ET.indent(root)
    body = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


def _add(parent: ET.Element, tag: str, text: str | None = None, space: str = DCC) -> ET.Element:
    child = ET.SubElement(parent, f"{{{space}}}{tag}")
    if text is not None:
        child.text = clean(text) or NOT_STATED
    return child


def _text(parent: ET.Element, tag: str, *lines: str) -> ET.Element:
    """A ``textType`` or ``richContentType`` with one content a line."""
    child = _add(parent, tag)
    for line in lines:
        _add(child, "content", line).set("lang", LANGUAGE)
    return child


# ---- administrative data


def _administrative(parent: ET.Element, c: Certificate) -> None:
    _software(_add(parent, "dccSoftware"))
    _core(_add(parent, "coreData"), c)
    _item(_add(_add(parent, "items"), "item"), c)
    _contact(_add(_add(parent, "calibrationLaboratory"), "contact"), c.stated, "laboratory")
    person = _add(_add(_add(parent, "respPersons"), "respPerson"), "person")
    _text(person, "name", c.stated.text("person"))
    _contact(_add(parent, "customer"), c.stated, "customer")
    statements = _add(parent, "statements")
    _statement(statements, "traceability", c.references)
    _statement(statements, "validity", validity(c.calibration, c.setup, c.temperature))
    _statement(statements, "not tested", not_tested(c.calibration))
    if c.calibration.warnings:
        _statement(statements, "notes", c.calibration.warnings)
    if c.simulated:
        text = "The recording was simulated: this certificate certifies no instrument."
        _statement(statements, "simulated", [text])


def _software(parent: ET.Element) -> None:
    software = _add(parent, "software")
    _text(software, "name", "tiltcal")
    _add(software, "release", __version__)
    _add(software, "type", "application")


def _core(parent: ET.Element, c: Certificate) -> None:
    _add(parent, "countryCodeISO3166_1", c.stated.country or NO_COUNTRY)
    _add(parent, "usedLangCodeISO639_1", LANGUAGE)
    _add(parent, "mandatoryLangCodeISO639_1", LANGUAGE)
    _add(parent, "uniqueIdentifier", c.number)
    identifications = _add(parent, "identifications")
    _identification(identifications, "other", c.digest, "SHA-256 of the calibration's data")
    _add(parent, "beginPerformanceDate", c.stated.date)
    _add(parent, "endPerformanceDate", c.stated.date)
    # laboratory, customer ... or other: the recording does not state where it was made
    _add(parent, "performanceLocation", "other")
    if c.stated.issued:
        _add(parent, "issueDate", c.stated.issued)


def _item(parent: ET.Element, c: Certificate) -> None:
    sensors = [c.setup.named(n) for n in c.calibration.sensors()]
    _text(parent, "name", c.stated.text("instrument"))
    kinds = [f"{s.name}: {s.kind}, axes {', '.join(s.axes)}" for s in sensors]
    _text(parent, "description", *(kinds or ["no sensor of its own"]))
    _text(_add(parent, "manufacturer"), "name", c.stated.text("manufacturer"))
    _add(parent, "model", c.stated.text("model"))
    serial = c.stated.text("serial")
    _identification(_add(parent, "identifications"), "manufacturer", serial, "serial number")


def _identification(parent: ET.Element, issuer: str, value: str, name: str) -> None:
    child = _add(parent, "identification")
    _add(child, "issuer", issuer)
    _add(child, "value", value)
    _text(child, "name", name)


def _contact(parent: ET.Element, stated: Stated, role: str) -> None:
    """Name and address stand in one text; the schema asks for a location of its own."""
    name, _, address = stated.text(role).partition(",")
    _text(parent, "name", name)
    _text(_add(parent, "location"), "further", address or NOT_STATED)


def _statement(parent: ET.Element, name: str, lines: Sequence[str]) -> None:
    child = _add(parent, "statement")
    _text(child, "name", name)
    _text(child, "declaration", *lines)


# ---- results


def _results(parent: ET.Element, c: Certificate) -> None:
    result = _add(parent, "measurementResult")
    _text(result, "name", f"calibration by {c.calibration.method}")
    _text(result, "description", c.basis, *_budget_lines(c))
    method = _add(_add(result, "usedMethods"), "usedMethod")
    _text(method, "name", c.calibration.method)
    model = [f"Model: {c.calibration.equation}"] if c.calibration.equation else []
    inverse = [f"Correction: {c.calibration.inverse}"] if c.calibration.inverse else []
    frames = f"Frames: {c.calibration.frames}"
    _text(method, "description", procedure(c.calibration), *model, *inverse, frames)
    equipment = _add(_add(result, "measuringEquipments"), "measuringEquipment")
    _text(equipment, "name", f"table: {c.setup.rig.table}")
    _conditions(_add(result, "influenceConditions"), c)
    results = _add(result, "results")
    if c.calibration.parameters:
        _parameters(_add(results, "result"), c)
    for name, entries in c.calibration.bias_tables.items():
        _bias_table(_add(results, "result"), name, entries)


def _budget_lines(c: Certificate) -> list[str]:
    lines = c.budget.lines if c.budget else ()
    return [
        f"Type {line.kind}: {line.name}"
        + (f", {line.size:g} {line.unit}, {line.distribution}" if line.kind == "B" else "")
        for line in lines
    ]


def _conditions(parent: ET.Element, c: Certificate) -> None:
    gravity = _condition(parent, "local gravity")
    _real(gravity, "local gravity", c.setup.site.gravity, "m_s2", None)
    for name, value in zip(("lowest", "highest"), c.temperature or (), strict=False):
        data = _condition(parent, f"{name} temperature")
        _real(data, f"{name} temperature", value, "degC", None)


def _condition(parent: ET.Element, name: str) -> ET.Element:
    child = _add(parent, "influenceCondition")
    _text(child, "name", name)
    return _add(child, "data")


def _parameters(parent: ET.Element, c: Certificate) -> None:
    _text(parent, "name", "parameters")
    data = _add(parent, "data")
    for name, e in c.calibration.parameters.items():
        _real(data, name, e.value, e.unit, c.expanded[name] or None)


def _real(parent: ET.Element, name: str, value: float, unit: str, U: float | None) -> None:
    """A quantity in SI; where its unit has no SI form, as text."""
    quantity = _add(parent, "quantity")
    _text(quantity, "name", name)
    si = si_unit(unit)
    if si is None:
        spread = "" if U is None else f" ± {U!r} (k = 2)"
        _text(quantity, "noQuantity", f"{value!r}{spread} {unit}")
        return
    real = _add(quantity, "real", space=SI)
    _add(real, "label", name, SI)
    _add(real, "value", _number(value * si.factor), SI)
    _add(real, "unit", si.text, SI)
    if U is not None:
        expanded = _add(real, "expandedUnc", space=SI)
        _add(expanded, "uncertainty", _number(U * si.factor), SI)
        _add(expanded, "coverageFactor", _number(COVERAGE), SI)
        _add(expanded, "coverageProbability", _number(PROBABILITY), SI)
        _add(expanded, "distribution", "normal", SI)


def _bias_table(parent: ET.Element, name: str, entries: Sequence[Mapping[str, Any]]) -> None:
    _text(parent, "name", f"placing-angle table of {name}")
    columns = _add(_add(parent, "data"), "list")
    _text(columns, "name", f"bias of {name} over the placing angle")
    angles = [e["angle_deg"] * DEG for e in entries]
    _real_list(columns, "placing angle", angles, si_unit("rad"), None)
    si = si_unit(entries[0]["unit"]) or SiUnit(1.0, "\\one")
    values = [e["value"] * si.factor for e in entries]
    spread = [COVERAGE * e["sigma"] * si.factor for e in entries]
    _real_list(columns, f"{name} bias", values, si, spread)


def _real_list(
    parent: ET.Element,
    name: str,
    values: Sequence[float],
    si: SiUnit | None,
    U: Sequence[float] | None,
) -> None:
    quantity = _add(parent, "quantity")
    _text(quantity, "name", name)
    real = _add(quantity, "realListXMLList", space=SI)
    _add(real, "valueXMLList", " ".join(map(_number, values)), SI)
    _add(real, "unitXMLList", si.text if si else "\\one", SI)
    if U is not None:
        expanded = _add(real, "expandedUncXMLList", space=SI)
        _add(expanded, "uncertaintyXMLList", " ".join(map(_number, U)), SI)
        _add(expanded, "coverageFactorXMLList", _number(COVERAGE), SI)
        _add(expanded, "coverageProbabilityXMLList", _number(PROBABILITY), SI)


def _number(value: float) -> str:
    """A decimal number that reads back exactly."""
    return repr(float(value))
