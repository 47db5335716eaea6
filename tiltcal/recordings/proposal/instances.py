"""Instruments that share one table: a column that tells their rows apart."""

import re
from collections.abc import Sequence

import numpy as np

from tiltcal.recordings.proposal.channels import Channel
from tiltcal.recordings.proposal.time_axis import TimeGuess

_NAMES = re.compile(r"^(i|id|instance|inst|imu|unit|sensor|device)(_?(id|no|num|index|nr))?$", re.I)
_MOST = 8  # instruments in one table: more values are labels or counts
_IN_TURN = 0.9  # share of rows after which the same value comes again as many rows later


def find_instances(
    channels: Sequence[Channel], time: TimeGuess
) -> tuple[Channel, Sequence[int]] | None:
    """The column whose whole numbers alternate from row to row, and its values; None where there is
    none.

    A flag may alternate as well: only where stamps stay for one round, or the name means an
    instance, are the rows those of several instruments.

    Args:
        channels: of one table.
        time: of that table.
    """
    for c in channels:
        if c is time.channel or c.raw.dtype.kind not in "if" or not c.whole:
            continue
        values = c.values
        found = np.unique(values)
        k = len(found)
        if not 2 <= k <= _MOST or len(values) < 2 * k or not np.isfinite(values).all():
            continue
        in_turn = np.mean(values[k:] == values[:-k]) > _IN_TURN
        moves = np.mean(np.diff(values) != 0) > _IN_TURN
        if in_turn and moves and (_NAMES.match(c.name) or _stamps_stay(time, k)):
            return c, [int(v) for v in found]
    return None


def _stamps_stay(time: TimeGuess, rows: int) -> bool:
    """Whether a stamp stays for so many rows, mostly."""
    if time.channel is None or not time.channel.numeric:
        return False
    repeated = float(np.mean(np.diff(time.channel.values) == 0))
    return abs(repeated - (1 - 1 / rows)) < 1 - _IN_TURN
