"""How far a learned curve was seen: beyond that range nothing in the recording supports it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tiltcal.diagnosis.conclusions.one_recording import is_history
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.hypotheses.coordinate_ranges import range_felt_late, ranges_of
from tiltcal.effects.curve_coordinates import INPUTS, coordinate_named
from tiltcal.effects.learned import Learned
from tiltcal.effects.spans import SpectralLines
from tiltcal.setup.tables import axis_of

Beyond = Literal["holds", "repeats", "continues", "left_out"]


@dataclass(frozen=True)
class SeenRange:
    """The range of its coordinate over which a curve was learned.

    Args:
        low, high: in ``unit``; a temperature is about its mean.
        beyond: whether the curve ``holds`` its last value there, ``repeats`` or ``continues``; or
            that it is ``left_out`` of any other recording.
    """

    low: float
    high: float
    unit: str
    beyond: Beyond

    def to_json(self) -> dict[str, object]:
        """As the file has it."""
        return {"low": self.low, "high": self.high, "unit": self.unit, "beyond": self.beyond}

    @property
    def words(self) -> str:
        """For the statement."""
        unit = self.unit.replace("_s2", "/s2").replace("_s", "/s")
        mean = " about the mean" if self.unit == "degC" else ""
        digits = max(2 - int(np.floor(np.log10(max(self.high - self.low, 1e-99)))), 0)
        low, high = (round(x, digits) + 0.0 for x in (self.low, self.high))
        seen = f" It was seen from {low:g} to {high:g} {unit}{mean}."
        if self.beyond == "left_out":
            return (
                f"{seen} Another recording need not repeat it: of one only its mean is predicted."
            )
        beyond = {"holds": "it holds its last value"}.get(self.beyond, f"it {self.beyond}")
        return f"{seen} Beyond that {beyond}, and no reading confirms it."


def seen_range(effect: Learned, observations: Observations) -> SeenRange | None:
    """The range in which a curve was seen; None where its coordinate has none, or for a product of
    two angles or the state of a play.
    """
    if effect.beside or effect.play:
        return None
    name = effect.coordinate
    key = f"{effect.sensor}_{name}" if name in ("input", "turned") else name
    ends = (
        range_felt_late(name, effect.lag, observations) if effect.lag and name in INPUTS else None
    )
    ends = ends or ranges_of(observations, SpectralLines()).ranges.get(key)
    if ends is None:
        return None
    unit, size = _unit(effect, observations)
    return SeenRange(ends[0] / size, ends[1] / size, unit, _beyond(effect, observations))


def _beyond(effect: Learned, observations: Observations) -> Beyond:
    if is_history(effect, observations):
        return "left_out"
    if effect.extrapolates or effect.power:
        return "continues"
    return "holds" if effect.knots and not effect.period else "repeats"


def _unit(effect: Learned, observations: Observations) -> tuple[str, float]:
    name = effect.coordinate
    if (axis := axis_of(name)) is not None:
        table = observations.scenario.rig.kind
        return table.unit(axis), table.size(axis)
    of_rate = effect.sensor and observations.scenario.named(effect.sensor).quantity == "rate"
    shown = coordinate_named(f"rate_{effect.axis}" if name == "input" and of_rate else name)
    return shown.unit, shown.size
