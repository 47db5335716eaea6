"""Two-axis tilt sensors among the columns of a foreign file, by the angle that they follow."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.recordings.proposal.channels import ANGLES, Channel
from tiltcal.recordings.proposal.rests import is_measured

PARTS = 8  # of a recording that are judged by themselves: a sensor may be remounted
LEAST = 50  # rows of a part
TURNED = 0.05  # rad that the angle has to span in a part
FOLLOWS = 0.9  # share of the variance of a reading that its angle explains
RAW = ("", "LSB", "V", "mV", "mA")


def find_pairs(channels: Sequence[Channel]) -> list[tuple[Channel, Channel]]:
    """Columns x and y of one name without a z that are measured.

    Args:
        channels: that are nothing else.
    """
    groups: dict[str, dict[str, Channel]] = {}
    for c in channels:
        known = c.meaning.role in ("", "incl", "accel", "angle") and c.unit in (*RAW, *ANGLES)
        if c.numeric and c.meaning.axis and known:
            groups.setdefault(c.meaning.group, {}).setdefault(c.meaning.axis, c)
    pairs = [(g["x"], g["y"]) for g in groups.values() if set(g) == {"x", "y"}]
    return [p for p in pairs if is_measured(np.column_stack([c.values for c in p]))]


def follows(pair: Sequence[Channel], angle: Channel, unit: str) -> bool:
    """Whether one of two axes follows an angle, in most parts of the recording in which it turns.

    Args:
        pair: the axes.
        angle: readout of a table.
        unit: of the angle.
    """
    turned = angle.values * COLUMN_UNITS[unit].factor
    shares = []
    for rows in np.array_split(np.arange(len(turned)), PARTS):
        a = turned[rows]
        known = np.isfinite(a) & np.all([np.isfinite(c.values[rows]) for c in pair], axis=0)
        if known.sum() < LEAST or np.ptp(a[known]) < TURNED:
            continue
        design = np.column_stack([np.ones(known.sum()), np.sin(a[known]), np.cos(a[known])])
        shares.append(max(_share(design, c.values[rows][known]) for c in pair))
    return bool(shares) and float(np.median(shares)) > FOLLOWS


def _share(design: Array, values: Array) -> float:
    """Share of the variance of values, (n,), that columns, (n, p), explain."""
    total = float(np.var(values))
    if total == 0:
        return 0.0
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return 1 - float(np.var(left)) / total


def is_readout(angle: Channel) -> bool:
    """Whether an angle stands still without noise, as the readout of a table does."""
    known = angle.values[np.isfinite(angle.values)]
    return len(known) > LEAST and float(np.mean(np.diff(known, 2) == 0)) > 1 / 2
