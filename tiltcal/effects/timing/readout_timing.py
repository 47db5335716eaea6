"""A readout that lags, or written less often than the sensors: what the reference does to the
comparison.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.effects.base import AngleEffect, WritingEffect
from tiltcal.effects.parameter import Parameter
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Drive, Jet, sampled_jet
from tiltcal.statistics.dwell_noise import ARITHMETIC, MAD_TO_SIGMA

GROSS = 8.0  # sigma of the updates' own noise: beyond it the rate changes from one to the next
AROUND = 2
"""Updates to either side of a change of the rate: the error of a cubic spline falls by 0.27 from
one to the next.
"""


class ReadoutAverage(AngleEffect):
    id = "readout_average"
    needs = "motion"
    stage = "timing"
    title = "the readout is a moving average"
    parameters = (Parameter("window", "ms", (1, 20, 200), positive=True),)
    physics = (
        "The encoder's electronics average the angle over a window, so that the readout lags by"
        " half of it and rounds off every move."
    )
    equation = "readout(t) = mean of the true angle from t - window to t"
    source = "Physics: Timing and data"
    excited_by = "moves"
    look = "all sensors early by half the window, and sharper than the readout where it accelerates"
    axis_wise = False
    on_table = True
    shows_against_table = True
    distinguished_by = {"data_latency": "record moves of several accelerations"}

    @classmethod
    def shows_on(cls, rig: Rig) -> bool:
        """Only where the columns are the readout, not the command."""
        return super().shows_on(rig) and rig.readout == "encoder"

    def acts_on(self, axis: str, rig: Rig) -> bool:
        return axis in rig.axis_names

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        half, square = self.value("window") / 2, self.value("window") ** 2 / 12
        jet = drive.axes[axis]
        bend = np.broadcast_to(np.asarray(jet.a, float), drive.time.shape)
        jerk = sampled_jet(drive.time, bend).v
        return Jet(half * jet.v + square * bend, half * bend + square * jerk, half * jerk)


class ReadoutRate(WritingEffect):
    id = "readout_rate"
    needs = "motion"
    stage = "timing"
    title = "the readout is written less often than it stands in the file"
    parameters = (Parameter("interval", "ms", (20, 100, 200), positive=True),)
    physics = "The controller sends its angle at a low rate; the recorder repeats the last one."
    equation = "written(t) = readout at the last multiple of the interval"
    source = "Oppenheim and Schafer 2010; Physics: Timing and data"
    excited_by = "moves"
    look = "a staircase of the readout while it moves"
    on_table = True

    def written(self, axis: str, drive: Drive) -> Array | None:
        from scipy.interpolate import CubicHermiteSpline

        interval, jet = self.value("interval"), drive.axes[axis]
        n = len(drive.time)
        if interval <= 0 or n < 2:
            return None
        x, v = (np.broadcast_to(np.asarray(part, float), (n,)) for part in (jet.x, jet.v))
        elapsed = drive.time - drive.time[0]
        sent = interval * np.floor(elapsed / interval + 1e-6)
        return np.asarray(CubicHermiteSpline(elapsed, x, v)(sent))

    def restored(self, axis: str, time: Array, written: Array) -> Array:
        from scipy.interpolate import CubicSpline

        rows = sent_rows(time, written, self.value("interval"))
        if len(rows) < 4:
            return written
        within = np.clip(time, time[rows[0]], time[rows[-1]])
        return np.asarray(CubicSpline(time[rows], written[rows])(within))

    def undetermined(self, axis: str, time: Array, written: Array) -> Mask:
        rows = sent_rows(time, written, self.value("interval"))
        if len(rows) < 4:
            return np.zeros(len(time), bool)
        bend = np.abs(np.diff(written[rows], 2))
        bent = bend > max(GROSS * MAD_TO_SIGMA * float(np.median(bend)), ARITHMETIC)
        wide = np.convolve(np.concatenate([[0], bent, [0]]), np.ones(2 * AROUND + 1), "same") > 0
        update = np.clip(np.searchsorted(rows, np.arange(len(time)), side="right") - 1, 0, None)
        return np.asarray(wide[update])


def sent_rows(time: Array, written: Array, interval: float) -> Index:
    """Rows at which a held readout was new: where it changed, and at standstill once an interval.
    time: s, (n,); written: (n,); interval: s.
    """
    step = float(np.median(np.diff(time)))
    new = np.flatnonzero(np.concatenate([[True], np.diff(written) != 0]))
    kept: list[int] = []
    for first, last in zip(new, [*new[1:], len(written)], strict=True):
        kept += _each(time, int(first), int(last), interval - step / 2)
    return np.array(kept, np.intp)


def _each(time: Array, first: int, last: int, interval: float) -> Sequence[int]:
    """Rows from ``first`` to before ``last``, at least an interval (s) apart."""
    rows = [first]
    while (row := int(np.searchsorted(time, time[rows[-1]] + interval))) < last:
        rows.append(row)
    return rows
