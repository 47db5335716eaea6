"""What recordings span, and which lines stand out of their residuals: what the shapes of an effect
depend on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Wave:
    """A line in the reading of a channel over a coordinate.

    Args:
        sensor, axis: of the channel.
        coordinate: its own ``input``, ``temperature``, or a table angle.
        period: SI.
        times: what its amplitude is in proportion to: ``speed``, the rate of that angle
            (``turn_rate_<axis>``) or ``input``; empty where it is constant.
    """

    sensor: str
    axis: str
    coordinate: str
    period: float
    times: str = ""


@dataclass(frozen=True)
class SpectralLines:
    """Lines that stand out of a residual.

    Args:
        tones: Hz, in the readings.
        shakes: Hz, in the world.
        echoes: Hz, restarted by each move.
        late: Hz, in the delay of stamps.
        base_tilts: Hz, of the base.
        scales: Hz, in scale factors.
        ripples: a turn of an axis.
        waves: over the input of a channel, temperature or a table angle.
    """

    tones: tuple[float, ...] = ()
    shakes: tuple[float, ...] = ()
    echoes: tuple[float, ...] = ()
    late: tuple[float, ...] = ()
    base_tilts: tuple[float, ...] = ()
    scales: tuple[float, ...] = ()
    ripples: tuple[int, ...] = ()
    waves: tuple[Wave, ...] = ()

    def without(self, known: "SpectralLines", width: float) -> "SpectralLines":
        """Those lines, but for echoes, that are not among the known ones; width: Hz, of a line in
        time.
        """

        def new(mine: Sequence[float], theirs: Sequence[float]) -> tuple[float, ...]:
            return tuple(f for f in mine if all(abs(f - g) > 2 * width for g in theirs))

        ripples = tuple(n for n in self.ripples if n not in known.ripples)
        waves = tuple(wave for wave in self.waves if wave not in known.waves)
        return SpectralLines(
            new(self.tones, known.tones),
            new(self.shakes, known.shakes),
            (),
            new(self.late, known.late),
            new(self.base_tilts, known.base_tilts),
            new(self.scales, known.scales),
            ripples,
            waves,
        )


ROUNDING = 1e-9  # of a coordinate: what varies by less is constant


@dataclass(frozen=True)
class CoordinateRanges:
    """What recordings span.

    Args:
        duration: s.
        rate_hz: samples a second.
        lines: that stand out of the residual.
        ranges: least and largest value of each coordinate, SI; that of a sensor's own input under
            ``<sensor>_input``.
        gears: ratios of the gears of a user's own model.
    """

    duration: float
    rate_hz: float
    lines: SpectralLines = SpectralLines()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    gears: tuple[float, ...] = ()
