"""Calibrating and checking: several recordings as one, the method with or without a budget,
notes, and whether the result is valid on another recording.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tiltcal.calibration.methods.registry import Method
from tiltcal.calibration.methods.registry import calibrate as run_method
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.numerical import determining, one_thread
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.joining import joined
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.rig_fit import suspected_rig
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.span_means import averaging_note
from tiltcal.validation.cross_check import Check, Limits, check
from tiltcal.validation.uncertainty_budget import UncertaintyBudget, make_budget


def one_recording(scenario: Scenario, recordings: Sequence[Recording]) -> Recording:
    """Recordings of one set-up, one after the other.

    Raises:
        TiltcalError: time runs back in one of them, or tables of means are among several.
    """
    return joined([r.require_increasing() for r in recordings], scenario.rig.mount)


@one_thread()
def estimate(
    method: str | Method,
    recording: Recording,
    scenario: Scenario,
    options: dict[str, Any],
    with_budget: bool = False,
) -> tuple[Calibration, UncertaintyBudget | None]:
    """A calibration, and its uncertainty budget where it is wanted; columns that belong to no
    sensor are noted.

    Raises:
        TiltcalError: the method, an option or the recording is not usable.
    """
    budget: UncertaintyBudget | None = None
    if with_budget:
        calibration, budget = make_budget(method, recording, scenario, **options)
    else:
        calibration = run_method(method, recording, scenario, **options)
    if note := recording.ignored_columns(scenario.sensor):
        calibration = replace(calibration, warnings=[*calibration.warnings, note])
    if averaging := averaging_note(recording):
        calibration = replace(calibration, warnings=[*calibration.warnings, averaging])
    if calibration.verdict != "good" and (suspicion := suspected_rig(recording, scenario)):
        calibration = replace(calibration, warnings=[*calibration.warnings, suspicion])
    return calibration, budget


def estimate_for_certificate(
    method: str | Method,
    recording: Recording,
    scenario: Scenario,
    options: dict[str, Any],
) -> tuple[Calibration, UncertaintyBudget | None]:
    """The same with a budget; where that cannot be evaluated, a warning states the cause.

    Raises:
        TiltcalError: as ``estimate`` without a budget does.
    """
    try:
        return estimate(method, recording, scenario, options, True)
    except TiltcalError as error:
        calibration, _ = estimate(method, recording, scenario, options)
        note = f"the uncertainty budget could not be evaluated: {error}"
        return replace(calibration, warnings=[*calibration.warnings, note]), None


def judged(
    calibration: Calibration,
    recording: Recording,
    scenario: Scenario,
    limits: Limits | None = None,
    dwells: Sequence[Segment] | None = None,
) -> Check:
    """Whether a calibration is good on another recording.

    Args:
        calibration: to judge.
        recording: that it has not seen.
        scenario: the set-up of the recording.
        limits: largest accepted rms errors; without any the errors have to agree with their own
            uncertainty.
        dwells: of the recording; found in it if not given.

    Raises:
        TiltcalError: the recording lacks the calibrated sensor, or time runs back in it.
    """
    with determining(recording.source, "whether this calibration is good on it"):
        return check(calibration, recording.require_increasing(), scenario, limits, dwells)
