"""Calibrating: several recordings as one, the method with or without a budget, what is noted."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tiltcal.calibration.methods.registry import Method
from tiltcal.calibration.methods.registry import calibrate as run_method
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.joining import joined
from tiltcal.recordings.recording import Recording
from tiltcal.validation.uncertainty_budget import Budget, make_budget


def one_recording(scenario: Scenario, recordings: Sequence[Recording]) -> Recording:
    """Recordings of one set-up, one after the other.

    Raises:
        TiltcalError: time runs back in one of them, or tables of means are among several.
    """
    return joined([r.require_increasing() for r in recordings], scenario.rig.mount)


def estimate(
    method: str | Method,
    recording: Recording,
    scenario: Scenario,
    options: dict[str, Any],
    with_budget: bool = False,
) -> tuple[Calibration, Budget | None]:
    """A calibration, and its uncertainty budget where it is wanted; columns that belong to no
    sensor are noted.

    Raises:
        TiltcalError: the method, an option or the recording is not usable.
    """
    budget: Budget | None = None
    if with_budget:
        calibration, budget = make_budget(method, recording, scenario, scenario.budget, **options)
    else:
        calibration = run_method(method, recording, scenario, **options)
    unknown = recording.unknown(scenario.sensor)
    if unknown:
        note = "columns that belong to no sensor of the scenario are ignored: " + ", ".join(unknown)
        calibration = replace(calibration, warnings=[*calibration.warnings, note])
    return calibration, budget


def estimate_for_certificate(
    method: str | Method, recording: Recording, scenario: Scenario, options: dict[str, Any]
) -> tuple[Calibration, Budget | None]:
    """The same with a budget; where that cannot be evaluated, a warning says why.

    Raises:
        TiltcalError: as ``estimate`` without a budget does.
    """
    try:
        return estimate(method, recording, scenario, options, with_budget=True)
    except TiltcalError as error:
        calibration, _ = estimate(method, recording, scenario, options)
        note = f"the uncertainty budget could not be evaluated: {error}"
        return replace(calibration, warnings=[*calibration.warnings, note]), None
