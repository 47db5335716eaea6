"""What a guide says at an instant: plain values that any interface can draw."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from tiltcal.core.arrays import Array

Manner = Literal["hand", "head", "table"]
"""How poses are set: by hand, on a dividing head whose angles are typed in, or on a table whose
readout is in the stream.
"""
Action = Literal["wait", "turn", "hold", "type", "done"]
"""What the operator does now: nothing is read yet, turn to the next pose, hold still, type the
angles of this dwell, or nothing more.
"""


def triple(vector: Array) -> tuple[float, float, float]:
    """A vector as plain numbers. vector: (3,)."""
    x, y, z = (float(v) for v in vector)
    return x, y, z


@dataclass(frozen=True)
class NextPose:
    """The pose that adds the most information.

    Args:
        up: up in the body frame, a unit vector.
        label: of the pose, ``+x`` or ``[0.707107, 0, 0.707107]``.
        angles_deg: angle of each table axis that turns to it, by axis; empty by hand.
        instruction: what to do, one sentence.
        gain_nats: information that a dwell there adds.
        off_deg: angle between the present and this direction of up; None where none is known.
    """

    up: tuple[float, float, float]
    label: str
    angles_deg: Mapping[str, float]
    instruction: str
    gain_nats: float
    off_deg: float | None


@dataclass(frozen=True)
class ParameterState:
    """A parameter on its way to its goal, in the unit in which it is shown.

    Args:
        value: estimated; None while only expected uncertainties are known.
        sigma: standard uncertainty: of the fit, or expected of the dwells so far.
        goal: for sigma.
        unit: of all three.
        fitted: whether sigma is that of a fit.
    """

    value: float | None
    sigma: float
    goal: float
    unit: str
    fitted: bool

    @property
    def reached(self) -> bool:
        """Whether the fit has reached the goal."""
        return self.fitted and self.sigma <= self.goal


@dataclass(frozen=True)
class Dwell:
    """A dwell that was taken.

    Args:
        start_s, end_s: in the time of the recording.
        up: up in the body frame; None where the angles are not typed yet.
        label: of the nearest face or direction; empty where up is not known.
        angles_deg: of the table axes; empty by hand.
        used: False where it was rejected, by the guide or by the operator, or its angles are not
            typed.
        reason: why it was rejected; else empty.
    """

    start_s: float
    end_s: float
    up: tuple[float, float, float] | None
    label: str
    angles_deg: Mapping[str, float]
    used: bool
    reason: str


@dataclass(frozen=True)
class Notice:
    """Something to mend.

    Args:
        kind: name of the check or test that found it, or ``sign``, ``saturation``, ``pose``,
            ``stamps``, ``connection``.
        statement: one sentence.
        since_s: in the time of the recording.
    """

    kind: str
    statement: str
    since_s: float


@dataclass(frozen=True)
class GuideState:
    """What a guide says at an instant.

    Args:
        manner: how poses are set.
        action: what the operator does now.
        instruction: the same as a sentence.
        time_s: of the last sample; None before the first.
        rows: of the recording.
        rate_hz: of the samples.
        reading: each channel of the sensor, mean over the last half second, by column name.
        up: up in the body frame by the reading; None where it does not determine it.
        standing: whether the sensor stands still.
        held_s: how long it has.
        hold_s: how long a dwell has to last.
        dwells: taken so far, in order.
        expected_dwells: how many the goals need, by the noise and the poses still to come, and at
            least as many as the fit is tested by.
        next: the most useful pose; None when done.
        parameters: each parameter by its name.
        notices: what to mend, the last first.
        verdict: of the calibration so far; None where there is none yet.
        reached: whether every sigma has reached its goal.
        done: whether nothing more is needed.
    """

    manner: Manner
    action: Action
    instruction: str
    time_s: float | None
    rows: int
    rate_hz: float | None
    reading: Mapping[str, float]
    up: tuple[float, float, float] | None
    standing: bool
    held_s: float
    hold_s: float
    dwells: tuple[Dwell, ...]
    expected_dwells: int | None
    next: NextPose | None
    parameters: Mapping[str, ParameterState]
    notices: tuple[Notice, ...]
    verdict: str | None
    reached: bool
    done: bool

    def to_json(self) -> dict[str, Any]:
        """The state as plain values; ``reached`` of each parameter included."""
        found = asdict(self)
        for name, parameter in self.parameters.items():
            found["parameters"][name]["reached"] = parameter.reached
        return found
