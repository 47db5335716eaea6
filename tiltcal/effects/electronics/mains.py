"""Tones from outside."""

from collections.abc import Mapping
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import TermEffect
from tiltcal.effects.electronics.converter import ANALOG
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense
from tiltcal.effects.spans import CoordinateRanges

WANDER = 0.05  # Hz, of the mains about its frequency; further off is another tone
GRIDS = (50.0, 60.0)  # Hz
OFF = 0.5  # Hz, of a grid from its frequency, a weak one or by a clock that is not right
OTHER = (
    0.3  # share of tones at any alias: generators, converters, sampling inside at a rate not stated
)


def _folded_density(frequency: float, grid: float, rate: float) -> float:
    """Density of the alias of a grid's frequency, 1/Hz: uniform about the grid's before it is
    folded.
    """
    fold = np.arange(np.ceil(2 * grid / rate) + 1) * rate
    images = np.concatenate([fold + frequency, fold - frequency])
    return float(np.count_nonzero(np.abs(images - grid) < OFF) / (2 * OFF))


class MainsPickup(TermEffect):
    row_wise = True
    id = "mains_pickup"
    needs = "any"
    stage = "electronics"
    kinds = ANALOG
    order = 62
    title = "mains tone or its alias"
    parameters = (
        Parameter("pickup_{axis}", "ug", (10, 300, 3000)),
        Parameter("frequency", "hz", (50, 50, 50), positive=True, default=50.0),
        Parameter("phase", "deg", (180, 180, 180), shape=True),
    )
    physics = "Mains couples into the wiring; sampled, it appears at its alias |f - n fs|."
    equation = "reading_i += A_i sin(2 pi f t + phase), t from the first stamp"
    source = "Oppenheim and Schafer 2010; Physics: Electronics"
    excited_by = "any recording"
    look = "a line that does not turn with the pose"
    linear = False
    spectral_line = "time"
    wander = WANDER
    leaves_nothing = True
    follows = "frequency"

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        phases = (0.0, np.pi / 3, 2 * np.pi / 3)
        return [{"frequency": f, "phase": p} for f, p in product(span.lines.tones, phases)]

    @classmethod
    def shape_odds(cls, shape: Mapping[str, float], span: CoordinateRanges) -> float:
        """By the density of its frequency, a grid's as the sampling folds it, over that of a cycle
        of anything else: its logarithm is uniform from one cycle in the recording to half the
        sampling rate.
        """
        half = span.rate_hz / 2
        folded = abs(shape["frequency"] - span.rate_hz * round(shape["frequency"] / span.rate_hz))
        other = 1 / (max(folded, 1 / span.duration) * np.log(half * span.duration))
        grid = np.mean([_folded_density(folded, grid, span.rate_hz) for grid in GRIDS])
        return float(np.log(((1 - OTHER) * grid + OTHER / half) / other))

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        return self.channel_of(name[-1], sense), np.sin(
            2 * np.pi * self.value("frequency") * sense.elapsed + self.value("phase")
        )
