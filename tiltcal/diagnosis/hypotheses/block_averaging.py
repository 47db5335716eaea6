"""How many samples of a long record are averaged into one without losing what it shows."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.block_grid import SampleBlocks
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.hypotheses.coordinate_ranges import fastest
from tiltcal.effects.spans import SpectralLines

MOST_ROWS, MOST_READINGS = 12000, 36000
"""Of a channel and of all together: a longer record is averaged, whatever its spectral lines."""
ROWS, READINGS = 3000, 9000
"""At least as many are left of one without such lines."""
SURVIVES = 0.8
"""Share of the power of a line, and of an axis' rate, that a block leaves, as long as MOST_ROWS
allows it.
"""
HALF = 0.5  # period


def block_of(observations: Observations, lines: SpectralLines) -> int:
    """Samples in a block: as many as leave ROWS and READINGS and keep the motion and every spectral
    line; at least as many as MOST_ROWS and MOST_READINGS demand.
    """
    longest, readings = max(len(c.values) for c in observations.channels), observations.samples
    least = max(-(-longest // MOST_ROWS), -(-readings // MOST_READINGS))
    most = max(longest // ROWS, readings // READINGS, least)
    if most == 1:
        return 1
    step = _step(observations)
    beats = _frequencies(observations, lines, least)
    rates = _rates(observations)
    left = {
        block: min(_least_share(beats, step, block), _least_rate_share(rates, block))
        for block in range(least, most + 1)
    }
    return max((b for b in left if left[b] > SURVIVES), default=max(left, key=lambda b: left[b]))


def survives(observations: Observations, lines: SpectralLines, block: int) -> bool:
    """Whether means over blocks keep every spectral line."""
    beats = _frequencies(observations, lines, block)
    return _least_share(beats, _step(observations), block) > SURVIVES


def _rates(observations: Observations) -> list[Array]:
    """Rate of every axis that moves, rad/s, (n,) each."""
    drives = [course.drive(course.time) for course in observations.courses]
    rates = [np.asarray(jet.v) for drive in drives for jet in drive.axes.values()]
    return [rate for rate in rates if rate.any()]


def _least_rate_share(rates: Sequence[Array], block: int) -> float:
    """The least share of a rate's power that is left in means over blocks."""
    kept = []
    for rate in rates:
        blocks = SampleBlocks.of(np.arange(len(rate)), block, len(rate))
        means = blocks.means(rate)
        kept.append(float(blocks.counts @ means**2) / float(np.sum(rate**2)))
    return min(kept, default=1.0)


def _step(observations: Observations) -> float:
    """Between samples, s."""
    return max(float(np.median(np.diff(r.time))) for r in observations.recordings)


def _frequencies(observations: Observations, lines: SpectralLines, block: int) -> list[float]:
    """Of the lines, Hz, but those that a quick turn blurs within a block anyway."""
    ripples = [n * fastest(observations) / (2 * np.pi) for n in lines.ripples]
    slow = [f for f in ripples if f * _step(observations) * block < HALF]
    modulated = [*lines.late, *lines.base_tilts, *lines.scales]
    return [*lines.tones, *lines.shakes, *lines.echoes, *modulated, *slow]


def _least_share(beats: Sequence[float], step: float, block: int) -> float:
    """The least share of a line's power that is left in means over blocks."""
    return min((_survives(f * step, block) for f in beats), default=1.0)


def _survives(turns: float, block: int) -> float:
    """Share of a line's power that is left in means over blocks. turns: periods between samples."""
    one = np.sin(np.pi * turns)
    return float((np.sin(np.pi * turns * block) / (block * one)) ** 2) if abs(one) > 1e-9 else 1.0
