"""Columns that do not mean what their names say: units, signs, axes, angles, labels, rate."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import SignalEffect, WritingEffect
from tiltcal.effects.electronics.converter import ANALOG
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense
from tiltcal.setup.trajectory import Drive


class ColumnFault(SignalEffect):
    """The columns of a sensor hold a linear map of its channels."""

    row_wise = True
    stage = "data"
    kinds = ANALOG
    mislabels = True
    repair = "columns"

    @abstractmethod
    def matrix(self, axes: Sequence[str]) -> Array:
        """What it does to the channels of these axes, (k, k)."""


class DataUnit(ColumnFault):
    id = "data_unit"
    order = 96
    title = "wrong unit"
    parameters = (Parameter("factor", "unitless", (9.80665, 57.29578, 1000), positive=True),)
    physics = "The column is labelled with one unit and contains another."
    equation = "reading *= factor (0: none)"
    source = "Physics: Timing and data"
    excited_by = "any recording"
    look = "the norm at rest is off by a factor such as 9.80665 or 57.3"

    def matrix(self, axes: Sequence[str]) -> Array:
        return (self.value("factor") or 1.0) * np.eye(len(axes))

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        return reading * (self.value("factor") or 1.0)


class DataSign(ColumnFault):
    id = "data_sign"
    order = 97
    title = "sign flipped"
    parameters = (Parameter("flip_{axis}", "unitless", (1, 1, 1), positive=True, switch=True),)
    physics = "One axis is counted the other way."
    equation = "reading_i *= 1 - 2 flip_i, flip 0 or 1"
    source = "Physics: Timing and data"
    excited_by = "tilting or turning that axis"
    look = "a left-handed triad"

    def matrix(self, axes: Sequence[str]) -> Array:
        return np.diag([1 - 2 * self.value(f"flip_{axis}") for axis in axes])

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        for i, index in enumerate(sense.axes):
            axis = "a" if sense.kind == "fog" else "xyz"[index]
            reading[:, i] *= 1 - 2 * self.value(f"flip_{axis}")
        return reading


class DataAxisSwap(ColumnFault):
    id = "data_axis_swap"
    order = 98
    title = "axes permuted"
    parameters = tuple(
        Parameter(f"swap_{pair}", "unitless", (1, 1, 1), positive=True, switch=True)
        for pair in ("xy", "yz", "zx")
    )
    physics = "Two columns are exchanged."
    equation = "the two channels of a pair are exchanged where its swap is 1"
    source = "Physics: Timing and data"
    excited_by = "tilting"
    look = "each channel follows the other's attitude"

    def matrix(self, axes: Sequence[str]) -> Array:
        P = np.eye(len(axes))
        for pair in ("xy", "yz", "zx"):
            if self.value(f"swap_{pair}") and set(pair) <= set(axes):
                a, b = (axes.index(x) for x in pair)
                P[[a, b]] = P[[b, a]]
        return P

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        for pair in ("xy", "yz", "zx"):
            i, j = ("xyz".index(a) for a in pair)
            if self.value(f"swap_{pair}") and i in sense.axes and j in sense.axes:
                a, b = sense.axes.index(i), sense.axes.index(j)
                reading[:, [a, b]] = reading[:, [b, a]]
        return reading


class DataHand(ColumnFault):
    id = "data_hand"
    order = 99
    title = "left-handed frame"
    parameters = (Parameter("mirror", "unitless", (1, 1, 1), positive=True),)
    physics = "The driver's y axis points the other way (a left-handed frame)."
    equation = "reading_y *= 1 - 2 mirror, mirror 0 or 1"
    source = "Physics: Timing and data"
    excited_by = "tilting about two axes"
    look = "no rotation maps the frame onto the table's: determinant -1"

    def matrix(self, axes: Sequence[str]) -> Array:
        return np.diag([1 - 2 * self.value("mirror") if axis == "y" else 1.0 for axis in axes])

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        if 1 in sense.axes:
            reading[:, sense.axes.index(1)] *= 1 - 2 * self.value("mirror")
        return reading


class DataTruncation(WritingEffect):
    id = "data_truncation"
    stage = "data"
    title = "too few decimals in the file"
    parameters = (Parameter("step", "deg", (0.001, 0.01, 0.1), positive=True),)
    physics = "The readout is cut to a few decimals when it is written."
    equation = "written = step floor(readout / step)"
    source = "Widrow and Kollar 2008; Physics: Timing and data"
    excited_by = "angles between the steps"
    look = "angles on a grid; a sawtooth of the residual over the angle"
    axis_wise = True

    def written(self, axis: str, drive: Drive) -> Array | None:
        step = self.value("step")
        readout = np.asarray(drive.axes[axis].x)
        return None if self.axis not in (None, axis) else step * np.floor(readout / step + 1e-9)


class DataPoseLabel(WritingEffect):
    id = "data_pose_label"
    stage = "data"
    title = "wrong angle or label written"
    parameters = (
        Parameter("error", "arcsec", (3600, 36000, 324000)),
        Parameter("stop", "", (20, 20, 20), positive=True, default=1.0, whole=True),
    )
    physics = "The operator mistypes one angle."
    equation = "written = readout + error during one dwell (stop number, from 0)"
    source = "Physics: Timing and data"
    excited_by = "several dwells"
    look = "one dwell is a large rotation off, norm unchanged"
    axis_wise = True
    leaves_nothing = True
    repair = "samples"

    def written(self, axis: str, drive: Drive) -> Array | None:
        if axis != (self.axis or next(iter(drive.axes))):
            return None
        return np.asarray(drive.axes[axis].x) + self.value("error") * (
            drive.stop == int(self.value("stop"))
        )


class DataRotationSense(WritingEffect):
    id = "data_rotation_sense"
    stage = "data"
    title = "table angle counted the other way"
    parameters = (Parameter("reversed", "unitless", (1, 1, 1), positive=True),)
    physics = "The controller counts clockwise."
    equation = "written = readout (1 - 2 r), r 0 or 1"
    source = "Physics: Timing and data"
    excited_by = "any turn"
    look = "the readings follow the mirrored angle"
    axis_wise = True
    mislabels = True

    def written(self, axis: str, drive: Drive) -> Array | None:
        if axis != (self.axis or next(iter(drive.axes))):
            return None
        return np.asarray(drive.axes[axis].x) * (1 - 2 * self.value("reversed"))

    def restored(self, axis: str, time: Array, written: Array) -> Array:
        return written * (1 - 2 * self.value("reversed")) if self.axis in (None, axis) else written


class DataTransitionSamples(WritingEffect):
    id = "data_transition_samples"
    needs = "motion"
    stage = "data"
    title = "moves counted as dwell"
    parameters = (Parameter("lead", "s", (0.5, 1, 2), positive=True),)
    physics = "The controller reports the next angle before the table has arrived."
    equation = "written(t) = readout(t + lead)"
    source = "Physics: Timing and data"
    excited_by = "moves"
    look = "the first samples of each dwell still move"

    def written(self, axis: str, drive: Drive) -> Array | None:
        return np.interp(
            drive.time + self.value("lead"), drive.time, np.asarray(drive.axes[axis].x)
        )

    def restored(self, axis: str, time: Array, written: Array) -> Array:
        return np.interp(time - self.value("lead"), time, written)


class DataRateLabel(WritingEffect):
    id = "data_rate_label"
    needs = "any"
    stage = "timing"
    title = "true rate is not the stated one"
    parameters = (Parameter("rate_error", "ppm", (100, 1000, 20000)),)
    physics = "Stamps are made from a nominal rate that the recorder does not keep."
    equation = "written t = t (1 + e), for all columns alike"
    source = "Physics: Timing and data"
    excited_by = "turning"
    look = "a common scale of all rates against the table's whole turns"

    def stamps(self, time: Array) -> Array:
        return time[0] + (time - time[0]) * (1 + self.value("rate_error"))
