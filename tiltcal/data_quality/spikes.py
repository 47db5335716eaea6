"""Single values far from their neighbours."""

from collections.abc import Iterator

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.quantisation import lsb_width
from tiltcal.data_quality.check import Emptying, Finding, in_rows
from tiltcal.data_quality.log import Log
from tiltcal.statistics.dwell_noise import MAD_TO_SIGMA, second_difference_noise

GROSS = 8.0  # sigma: nearer in, a heavy tail is no fault
TAIL = 4.0  # sigma: a tail as heavy as that of 1/x has as many beyond GROSS as between
FEW = 3  # of so few nothing says whether they recur
STRETCH = 51  # rows whose median tells the local deviation
BRIEF = 15  # of them, within a move
MIN_ROWS = 32  # rows that tell one at all
TINY = 1e-15  # of a reading, in its unit: a column without noise
ISOLATED = 0.3  # share of its distance that its neighbours may be off as well


class Spikes(Emptying):
    """Single values far from their neighbours, more of them than the tail of a noise has."""

    name = "spikes"
    test = "without spikes"
    answer = "note"
    repair = "empty_spikes"
    is_certain = False
    looks_at = "readings"
    finds = "six single values 20 sigma from their neighbours, in 4000 rows"

    def _find(self, log: Log) -> Iterator[Finding]:
        for channel in log.readings:
            if channel.is_coarse or not _may_have_some(channel.read, channel.noise):
                continue
            off = off_neighbours(channel.read)
            far = _at_one_level(channel.read, np.flatnonzero(off > GROSS))
            if len(far) > FEW + np.count_nonzero((off > TAIL) & (off <= GROSS)):
                rows = channel.rows[far]
                words = (
                    f"{channel.name}: single values lie about {np.median(off[far]):.0f} sigma from"
                    f" their neighbours, {in_rows(rows)}"
                )
                yield self.finding((channel.name,), rows, words)


def _at_one_level(values: Array, rows: Index) -> Index:
    """Those of the rows, (m,), whose neighbours are at one level: the corner of a move is none."""
    rows = rows[(rows > 1) & (rows < len(values) - 2)]
    beside = values[rows[:, None] + np.array([-2, -1, 1, 2])]
    off = np.abs(values[rows] - np.median(beside, axis=1))
    return rows[np.ptp(beside, axis=1) < ISOLATED * off]


def _may_have_some(values: Array, noise: float) -> bool:
    """Whether some values are far off neighbours that are at one level. values: (n,)."""
    if len(values) < 2 * MIN_ROWS:
        return False
    # a value at GROSS sigma is off the next one by at least that less what neighbours may be apart
    off = np.abs(values[1:-1] - values[2:]) > (1 - ISOLATED) * GROSS * noise
    return len(_at_one_level(values, np.flatnonzero(off) + 1)) > FEW


def off_neighbours(values: Array, speed: Array | None = None) -> Array:
    """Distance of each value from the median of its neighbourhood, in local standard deviations; 0
    unless it is a single value, (n,).

    Local is a stretch of rows, and where the table turns no less than the rows of like ``speed``,
    rad/s, (n,), nor than the nearest that turn: noise may grow with the rate, and from move to
    move, within a move that is shorter than a stretch.
    """
    from scipy.ndimage import median_filter

    if len(values) < 2 * MIN_ROWS:
        return np.zeros(len(values))
    off = np.abs(values - median_filter(values, 5, mode="nearest"))
    bent = np.zeros(len(values))  # off the cubic through two neighbours on each side
    bent[2:-2] = values[2:-2] - (4 * (values[1:-3] + values[3:-1]) - (values[:-4] + values[4:])) / 6
    # the crest of a quick turn is where its flanks say
    off[2:-2] = np.minimum(off, np.abs(bent))[2:-2]
    local = MAD_TO_SIGMA * median_filter(off, STRETCH, mode="nearest")
    if speed is not None and (speed > 0).sum() > MIN_ROWS:
        turning = np.flatnonzero(speed > 0)
        alike = turning[np.argsort(speed[turning], kind="stable")]
        for rows, width in ((alike, STRETCH), (turning, BRIEF)):
            usual = MAD_TO_SIGMA * median_filter(off[rows], width, mode="nearest")
            local[rows] = np.maximum(local[rows], usual)
    beside = np.maximum(np.concatenate([[0.0], off[:-1]]), np.concatenate([off[1:], [0.0]]))
    alone = beside < ISOLATED * off  # the corner of a move drags its neighbours along
    # how far the neighbours are off theirs once a value is put where they say
    mended = np.zeros(len(values))
    mended[1:-1] = np.maximum(
        np.abs(bent[:-2] + bent[1:-1] / 1.5), np.abs(bent[2:] + bent[1:-1] / 1.5)
    )
    # a knock is quick, and still some samples wide
    alone &= mended < np.maximum(ISOLATED * off, 4 * local)
    least = max(
        second_difference_noise(values), lsb_width(values), TINY
    )  # of coarse codes most differences are none
    return np.asarray(np.where(alone, off / np.maximum(local, least), 0.0))
