"""What the checks of the data find in a recording, and which methods it allows."""

import inspect as python_inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tiltcal.api.calibrating import estimate
from tiltcal.calibration.methods.registry import METHODS, Method
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Progress, silent
from tiltcal.data_quality.check import Finding
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.quality import inspect_recording
from tiltcal.recordings.recording import Recording, is_reading
from tiltcal.recordings.segmentation import Segment


def inspect(recording: Recording, scenario: Scenario | None = None) -> Sequence[Finding]:
    """Faults of the data: of stamps, readings, angles and temperature.

    Args:
        recording: to look at.
        scenario: whose sensors are looked at, with their ranges and rates; None: all columns.
    """
    sensors = None if scenario is None else scenario.sensor
    return inspect_recording(recording, sensors).findings


def residual(measured: Recording, predicted: Recording) -> Recording:
    """What a recording reads beyond a prediction of it: the difference of the readings that both
    have.

    Args:
        measured: the recording.
        predicted: of the same rows, as ``Scenario.predict`` makes it.

    Raises:
        TiltcalError: the rows are others, or no reading is in both.
    """
    names = [n for n in measured.column_names if is_reading(n) and n in predicted.column_names]
    if len(measured) != len(predicted) or not names:
        raise TiltcalError(
            f"residual of {measured.source}",
            found=f"{len(predicted)} predicted rows with {len(names)} of its readings",
            need=f"{len(measured)} rows and at least one reading",
            do="predict it with `tiltcal simulate amended.toml --motion REC --noise off`",
        )
    return measured.rewritten({n: measured.column(n) - predicted.column(n) for n in names})


@dataclass(frozen=True)
class MethodTrial:
    """A method on a recording.

    Args:
        method: its name.
        about: what it does, one sentence.
        options: that it takes.
        calibration: its result; None where it refuses the recording.
        reason: why it refuses; empty where it does not.
    """

    method: str
    about: str
    options: tuple[str, ...]
    calibration: Calibration | None
    reason: str

    @property
    def verdict(self) -> str:
        """Of the calibration; ``refused`` without one."""
        return "refused" if self.calibration is None else self.calibration.verdict

    def to_json(self) -> dict[str, Any]:
        """For machines."""
        return {
            "method": self.method,
            "does": self.about,
            "options": ", ".join(self.options),
            "verdict": self.verdict,
            "reason": self.reason,
        }


def about_method(method: Callable[..., Any]) -> str:
    """What a method does, the first line of its docstring."""
    return (python_inspect.getdoc(method) or " ").splitlines()[0].strip()


def options_of(method: Callable[..., Any]) -> tuple[str, ...]:
    """The options that a method takes, but the dwells."""
    parameters = python_inspect.signature(method).parameters.values()
    return tuple(p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.name != "segments")


def try_methods(
    scenario: Scenario,
    recording: Recording,
    dwells: Sequence[Segment] | None = None,
    progress: Progress = silent,
) -> list[MethodTrial]:
    """Every built-in method on a recording, with its default options: its result, or why it
    refuses.

    Args:
        scenario: site, rig and sensors.
        recording: to calibrate from.
        dwells: of it; found if not given.
        progress: receives what is being done.
    """
    options = {} if dwells is None else {"segments": dwells}
    found: list[MethodTrial] = []
    for name, method in METHODS.items():
        progress(f"method {name}")
        found.append(_trial(name, method, scenario, recording, options))
    return found


def _trial(
    name: str,
    method: Method,
    scenario: Scenario,
    recording: Recording,
    options: dict[str, Any],
) -> MethodTrial:
    taken = {k: v for k, v in options.items() if k in python_inspect.signature(method).parameters}
    about = (name, about_method(method), options_of(method))
    try:
        return MethodTrial(*about, estimate(name, recording, scenario, taken)[0], "")
    except TiltcalError as error:
        return MethodTrial(*about, None, f"found {error.found}, need {error.need}; {error.do}")
