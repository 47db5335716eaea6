"""A fault of the data."""

from dataclasses import dataclass, field

from tiltcal.data_quality.log import CHANCE
from tiltcal.effects.base import Effect


@dataclass(frozen=True)
class Fault:
    """A fault of the data.

    Args:
        effect: what the file does, at its size; it goes into the amended scenario.
        sensors, axes: where.
        interval: s from the first stamp.
        names: ids that could be meant as well, itself first.
        words: what was seen.
        sigma: standard uncertainty of the sizes, by name, SI.
        p_value: of the test that found it; CHANCE where it has none of its own.
    """

    effect: Effect
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    words: str
    interval: tuple[float, float | None] | None = None
    names: tuple[str, ...] = ()
    sigma: dict[str, float] = field(default_factory=dict)
    p_value: float = CHANCE

    @property
    def ids(self) -> set[str]:
        """What it may be."""
        return {self.effect.id, *self.names}
