"""Where the axes of a rig may stand: the one place that every plan asks.

A position is allowed that lies inside the range of the joint and inside the limits that the rig
states. The ends are rounded inwards to what a sequence file holds, so that a plan that is written
down keeps to them too. A move is a straight line in the readouts: it stays inside where its ends
do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.setup.tables import Table

DECIMALS = 6  # of a degree or a millimetre in a sequence
ROUNDING = 1e-9  # deg or mm: of sums of such numbers
TIE = 1e-6  # of the last digit: a number of that many digits is kept
Ends = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Reach:
    """Where the axes of a rig may stand, and where they stand before the first move.

    Args:
        table: table or model with the axes.
        low, high: of each readout, deg, or mm where it slides; infinite where it has no limit,
            (axes,).
        start: before the first move, deg or mm, (axes,).
    """

    table: Table
    low: Array
    high: Array
    start: Array

    @classmethod
    def of(cls, table: Table, limits: Mapping[str, Ends], start: Mapping[str, float]) -> "Reach":
        """The range of every joint, narrowed to the limits.

        Args:
            table: table or model with the axes.
            limits: lowest and highest readout by axis, deg or mm.
            start: readout before the first move by axis, deg or mm; of other axes zero, or the
                allowed readout nearest to it.

        Raises:
            TiltcalError: there is no such axis, the limits are outside the range of the joint, or
                the start is outside either.
        """
        for axis in (*limits, *start):
            if axis not in table.axis_names:
                raise TiltcalError(
                    "limits of the rig",
                    found=f"axis {axis}",
                    need=f"an axis of this table: {', '.join(table.axis_names) or 'none'}",
                    do="correct the name",
                )
        joints = {} if table.chain is None else table.chain.ranges
        everywhere = (-np.inf, np.inf)
        ends = []
        for axis in table.axis_names:
            (low, high), (least, most) = joints.get(axis, everywhere), limits.get(axis, everywhere)
            if max(low, least) > min(high, most):
                raise TiltcalError(
                    _named(table, axis),
                    found=f"limits {_words((least, most), table.unit(axis))}",
                    need=f"lowest <= highest, within {_words((low, high), table.unit(axis))}",
                    do="correct the limits (--angles, or limits under [rig])",
                )
            ends.append((_up(max(low, least)), -_up(-min(high, most))))
        lows, highs = np.array(ends).reshape(-1, 2).T
        nearest = np.clip(np.zeros(len(lows)), lows, highs)
        names = zip(table.axis_names, nearest, strict=True)
        found = cls(table, lows, highs, np.array([start.get(axis, at) for axis, at in names]))
        found.require(found.start, "start of the rig")
        return found

    @property
    def sizes(self) -> Array:
        """One deg or mm of each axis, rad or m, (axes,)."""
        return np.array([self.table.size(axis) for axis in self.table.axis_names])

    def limits(self, axis: str) -> Ends | None:
        """Lowest and highest readout of an axis, deg or mm; None where it has no limit."""
        k = self.table.axis_names.index(axis)
        ends = float(self.low[k]), float(self.high[k])
        return ends if np.isfinite(ends).any() else None

    def holds(self, positions: Array) -> bool:
        """Whether all these are allowed. positions: deg or mm, (..., axes)."""
        return bool(
            ((positions >= self.low - ROUNDING) & (positions <= self.high + ROUNDING)).all()
        )

    def require(self, positions: Array, subject: str) -> None:
        """Refuse positions that are not allowed.

        Args:
            positions: deg or mm, (..., axes).
            subject: of the message.

        Raises:
            TiltcalError: naming the joint, where it would be, and its limits.
        """
        if self.holds(positions):
            return
        flat = np.reshape(positions, (-1, len(self.low)))
        beyond = np.maximum(self.low - flat, flat - self.high)
        row, k = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        axis = self.table.axis_names[k]
        unit = self.table.unit(axis)
        raise TiltcalError(
            f"{subject}, {_named(self.table, axis)}",
            found=f"{flat[row, k]:.9g} {unit}",
            need=_words((self.low[k], self.high[k]), unit),
            do="stay inside the range of the joint and the stated limits, or correct them",
        )


def _up(value: float) -> float:
    """The next number upwards that a sequence holds."""
    scale = 10**DECIMALS
    return float(np.ceil(value * scale - TIE) / scale)


def _named(table: Table, axis: str) -> str:
    link = None if table.chain is None else table.chain.links[axis]
    return (
        f"axis {axis} (joint {link.joint})" if link is not None and link.joint else f"axis {axis}"
    )


def _words(ends: Sequence[float], unit: str) -> str:
    if not np.isfinite(ends).any():
        return "any position"
    return f"{ends[0]:.9g} to {ends[1]:.9g} {unit}"
