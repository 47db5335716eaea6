"""The uncertainty budget in the form of the GUM: each source is propagated through the method
itself.

A source of standard uncertainty u changes the recording (an effect of the catalogue, by the
difference that it makes to the predicted readings) or the set-up (gravity, latitude, heading, the
FOG's axis) by +u and by -u, and the method runs on both: half the difference of each parameter is
its contribution. The covariance of the method, from the noise of the record, is the type A line.
Combined: root sum of squares; expanded: k = 2.

Source: JCGM 100:2008 (GUM), 5.1.3 note 2 (numerical sensitivities); JCGM 101 (the Monte Carlo that
checks it).
"""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiltcal.calibration.methods.registry import Method, calibrate, find_method
from tiltcal.calibration.result import Calibration
from tiltcal.core.progress import Progress, Rate, silent
from tiltcal.laboratory.scenario_tables import SourceTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import dwells, find_segments
from tiltcal.setup.setup import Setup
from tiltcal.validation.uncertainty_sources import Source, sources, usual_sources

COVERAGE = 2.0  # k of the expanded uncertainty


@dataclass(frozen=True)
class Line:
    """What a source contributes.

    Args:
        name, kind: in words; A (from the record's own noise) or B.
        size, unit, distribution, standard: as in ``Source``; of the type A line nothing but words.
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
class Budget:
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


def make_budget(
    method: str | Method,
    recording: Recording,
    setup: Setup,
    tables: Sequence[SourceTable] = (),
    *,
    progress: Progress = silent,
    **options: Any,
) -> tuple[Calibration, Budget]:
    """A calibration and its budget; without ``tables`` a laboratory's usual ones
    (``usual_sources``).

    Args:
        method: its name, or a function.
        recording, setup: what it is called with.
        tables: the stated sources.
        progress: is told how many runs of the method are left, and how long they take.
        options: of the method.

    Raises:
        TiltcalError: a source is unknown, or does not fit the set-up.
    """
    if "segments" in inspect.signature(find_method(method)).parameters:
        # the same dwells whatever is changed
        options.setdefault("segments", find_segments(recording))
    found = calibrate(method, recording, setup, **options)
    stops = dwells(options.get("segments") or ())
    lines = [_type_a(found)]
    wanted = list(sources(tables or usual_sources(setup, found), setup, stops))
    rate = Rate(2 * sum(len(source.shifts) for source in wanted))

    def run(changed: Recording, under: Setup) -> Calibration:
        again = calibrate(method, changed, under, **options)
        progress(f"uncertainty budget: {rate.after_one(0)}")
        return again

    lines += [_propagated(source, found, run, recording, setup) for source in wanted]
    return found, Budget(tuple(lines), {n: e.unit for n, e in found.parameters.items()})


def _type_a(found: Calibration) -> Line:
    sigmas = {n: e.sigma for n, e in found.parameters.items()}
    return Line("noise of the record", "A", 0.0, "", "normal", 0.0, sigmas)


def _propagated(
    source: Source,
    found: Calibration,
    run: Callable[[Recording, Setup], Calibration],
    recording: Recording,
    setup: Setup,
) -> Line:
    total = dict.fromkeys(found.parameters, 0.0)
    u = source.standard
    for shift in source.shifts:
        up, down = (run(*shift(size, recording, setup)) for size in (u, -u))
        for name in total:
            total[name] += ((up.value(name) - down.value(name)) / 2) ** 2
    contributions = {n: float(np.sqrt(v)) for n, v in total.items()}
    return Line(source.name, "B", source.size, source.unit, source.distribution, u, contributions)
