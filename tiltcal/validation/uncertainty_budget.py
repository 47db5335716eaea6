"""The uncertainty budget in the form of the GUM: the uncertainty of a calibration split by source.

The estimate is linear in observations and references near the result, and each method keeps what
one standard uncertainty of each reference changes. Stated references are part of the covariance
already; what is left of it is the type A line. Assumed ones, a usual laboratory's where nothing is
stated, are added. Combined: root sum of squares; expanded: k = 2.

Source: JCGM 100:2008 (GUM), 5.1.2; JCGM 101 (the Monte Carlo that checks it).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiltcal.calibration.methods.registry import Method, calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.table.geometry import AxisWobble, TableLevelling
from tiltcal.effects.table.readout import SettingScatter
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Setup
from tiltcal.setup.sources import SourceTable

COVERAGE = 2.0  # k of the expanded uncertainty
MEASURED = {"base.roll": TableLevelling.id, "base.azimuth": "heading"}
"""Parameters that are what a source is an error of: it is assumed of no one who measures it."""


@dataclass(frozen=True)
class Line:
    """What a source contributes.

    Args:
        name, kind: as text; A (from the record's own noise) or B.
        size, unit, distribution, standard: as stated; of the type A line text only.
        contributions: parameter -> standard uncertainty it contributes, in the parameter's unit.
    """

    name: str
    kind: str
    size: float
    unit: str
    distribution: str
    standard: float
    contributions: dict[str, float]

    def sensitivity(self, parameter: str) -> float:
        """Change of a parameter per unit of the source; of several stops, their root sum of
        squares.
        """
        return self.contributions[parameter] / self.standard if self.standard else 1.0


@dataclass(frozen=True)
class UncertaintyBudget:
    """All lines; ``units``: of each parameter."""

    lines: tuple[Line, ...]
    units: dict[str, str]

    @property
    def combined(self) -> dict[str, float]:
        """Combined standard uncertainty of each parameter."""
        return {
            n: float(np.sqrt(sum(line.contributions[n] ** 2 for line in self.lines)))
            for n in self.units
        }

    @property
    def expanded(self) -> dict[str, float]:
        """Expanded uncertainty, k = 2."""
        return {n: COVERAGE * u for n, u in self.combined.items()}

    def to_json(self) -> dict[str, Any]:
        """For CAL.json's reader and for machines."""
        return {
            "lines": [{**vars(line)} for line in self.lines],
            "combined": self.combined,
            "expanded": self.expanded,
            "coverage_factor": COVERAGE,
            "units": self.units,
        }


def usual_sources(setup: Setup) -> tuple[SourceTable, ...]:
    """The usual sources: a table of 3 arcsec, gravity to 10 ppm, heading to 0.1 deg."""
    tables = _table_sources(setup)
    if setup.sensors("accelerometer", "inclinometer"):
        tables.append({"id": "gravity", "gravity_ppm": 10.0})
    tables += [
        {"id": "fog_axis", "sensor": s.name, "axis_u_arcsec": 60.0, "axis_v_arcsec": 60.0}
        for s in setup.sensors("fog")
    ]
    if setup.sensors("gyro", "fog") and setup.site.latitude_deg is not None and setup.rig.axes:
        tables.append({"id": "latitude", "latitude_deg": 0.01})
        tables.append({"id": "heading", "heading_deg": 0.1})
    return tuple(SourceTable.model_validate({**t, "assumed": True}) for t in tables)


def _table_sources(setup: Setup) -> list[dict[str, Any]]:
    """Levelling, index errors and wobble of a table, 3 arcsec each, rectangular."""
    tables: list[dict[str, Any]] = []
    if setup.rig.axes:
        sizes = {"tilt_east_arcsec": 3.0, "tilt_north_arcsec": 3.0}
        tables.append({"id": TableLevelling.id, **sizes})
    for axis in setup.rig.axis_names if setup.rig.axes else ():
        tables.append({"id": SettingScatter.id, "axis": axis, "sigma_arcsec": 3.0})
        sizes = {"m1c_arcsec": 3.0, "m1s_arcsec": 3.0}
        tables.append({"id": AxisWobble.id, "axis": axis, **sizes})
    return [{**table, "distribution": "rectangular"} for table in tables]


def make_budget(
    method: str | Method, recording: Recording, setup: Setup, **options: Any
) -> tuple[Calibration, UncertaintyBudget]:
    """A calibration and its budget; where the set-up states no sources, with a laboratory's usual
    ones (``usual_sources``).

    Args:
        method: its name, or a function.
        recording, setup: what it is called with.
        options: of the method.

    Raises:
        TiltcalError: a source is unknown or does not fit the set-up, or the method gives no
            contributions.
    """
    stated = setup.budget or usual_sources(setup)
    found = calibrate(method, recording, setup.model_copy(update={"budget": stated}), **options)
    measured = [id for name, id in MEASURED.items() if name in found.parameters]
    kept = [r for r in found.references if not (r.assumed and r.name.startswith(tuple(measured)))]
    if measured:
        found = replace(found, references=kept, assumed_covariance=None)
    return found, budget_of(found)


def budget_of(calibration: Calibration) -> UncertaintyBudget:
    """The covariance of a calibration split by source.

    Raises:
        TiltcalError: the calibration has no uncertain references.
    """
    if not calibration.references:
        raise TiltcalError(
            f"budget of the calibration by {calibration.method}",
            found="no uncertain references in its result",
            need="a built-in method, or one that returns Calibration.references",
            do="state [[budget]] tables, and calibrate again",
        )
    references = calibration.references
    noise = {}
    for name, e in calibration.parameters.items():
        stated = sum(r.contributions[name] ** 2 for r in references if not r.assumed)
        noise[name] = float(np.sqrt(max(e.sigma**2 - stated, 0.0)))
    first = Line("noise of the record", "A", 0.0, "", "normal", 0.0, noise)
    others = [
        Line(r.name, "B", r.size, r.unit, r.distribution, r.standard, dict(r.contributions))
        for r in references
    ]
    units = {name: e.unit for name, e in calibration.parameters.items()}
    return UncertaintyBudget((first, *others), units)
