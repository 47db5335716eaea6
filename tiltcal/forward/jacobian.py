"""How readings change with every effect of the catalogue: columns at plausible size, and their Gram
matrix.

A linear sensor term has its exact column; every other effect is differenced through the closed form
with its own plausible size as the step. Dwells of a schedule are compressed to one row with its
number of samples as weight.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import one_of
from tiltcal.core.frames import tilt_of_force
from tiltcal.core.units import G0
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import (
    ACCELEROMETERS,
    GRADES,
    DelayEffect,
    Effect,
    Parameter,
    SignalEffect,
)
from tiltcal.effects.learned import Learned, LearnedReading, LearnedReadout, LearnedTilt
from tiltcal.effects.sensor.noise import Noise
from tiltcal.forward.kinematics import closed_form, force_and_rate
from tiltcal.forward.linearised_kinematics import Responses, moves_smoothly
from tiltcal.forward.signal_chain import CONVERSION, make_sense
from tiltcal.setup.setup import Sensor, Setup
from tiltcal.setup.trajectory import Course

# SI per root hertz, when not stated
WHITE = {
    "accelerometer": 25e-6 * G0,
    "inclinometer": 25e-6,
    "gyro": 1e-4,
    "fog": 3e-6,
}


@dataclass(frozen=True)
class Column:
    """How the whitened readings change when one parameter has its plausible size.

    Args:
        effect: id; sensor, axis: where it acts; name: bare parameter name; unit: its suffix.
        size: the plausible size, in ``unit``.
        channels: (sensor, channel) -> whitened change, (n,), float32; channels that do not change
            are left out.
    """

    effect: str
    sensor: str | None
    axis: str | None
    name: str
    unit: str
    size: float
    channels: Mapping[tuple[str, int], "np.ndarray[tuple[int], np.dtype[np.float32]]"]

    @property
    def label(self) -> str:
        """``acc_K2[accel].k2_x``."""
        where = self.sensor or self.axis
        return f"{self.effect}{f'[{where}]' if where else ''}.{self.name}"


@dataclass(frozen=True)
class Rows:
    """Where columns are evaluated.

    Args:
        time: s, (n,).
        weight: samples that each row stands for, (n,).
    """

    time: Array
    weight: Array


def rows_of(course: Course, rate_hz: float) -> Rows:
    """All samples of a course; each dwell as one row (two at its ends count as the dwell's
    rest).
    """
    start, end = course.times
    time = start + np.arange(int((end - start) * rate_hz) + 1) / rate_hz
    stop = course.drive(time).stop
    keep = np.ones(len(time), bool)
    weight = np.ones(len(time))
    edges = np.flatnonzero(np.diff(stop, prepend=stop[0] - 1, append=stop[-1] + 1))
    for first, last in pairwise(edges):
        if stop[first] >= 0 and last - first > 3:
            keep[first + 1 : last - 1] = False
            weight[first] = weight[last - 1] = (last - first) / 2
    return Rows(time[keep], weight[keep])


def sizes(parameter: Parameter, grade: str) -> float:
    """Plausible size of a parameter at a grade, in its unit."""
    return parameter.plausible[GRADES.index(grade)]


def candidates(
    setup: Setup, grade: str
) -> Iterator[tuple[str, str | None, str | None, str, Parameter, float]]:
    """(id, sensor, axis, bare name, parameter, size) of every parameter with a column on this
    set-up.
    """
    for id, cls in CATALOGUE.items():
        if not (cls.has_column() and cls.shows_on(setup.rig)):
            continue
        sensors: Iterable[Sensor | None] = setup.sensors(*cls.kinds) if cls.kinds else (None,)
        axes: Iterable[str | None] = setup.rig.axis_names if cls.axis_wise else (None,)
        for sensor in sensors:
            for axis in axes:
                for p in cls.parameters:
                    if p.is_shape or not p.stands_on(setup.rig):
                        continue  # a shape, not a size; or of another table
                    for name in p.expand(sensor.axes if sensor else ()):
                        yield id, sensor.name if sensor else None, axis, name, p, sizes(p, grade)


def sensitivity(
    setup: Setup,
    course: Course,
    rows: Rows,
    *,
    grade: str = "mid_mems",
    known: Sequence[Effect] = (),
    only: Sequence[str] = (),
) -> list[Column]:
    """Columns of all candidates (or of the ids ``only``), whitened, at their plausible size.

    Args:
        setup: site, rig, sensors.
        course: what the table does.
        rows: where to evaluate.
        grade: precision, mid_mems or consumer.
        known: effects that are there anyway; their noise whitens.
        only: ids to keep.
    """
    one_of(grade, GRADES, "grade")
    watch = NominalMotion(setup, course, rows.time)
    weight = {s.name: np.sqrt(rows.weight) / white_noise(s, known) for s in setup.sensor}
    middle = (course.times[1] - course.times[0]) / 2
    found = []
    for id, sensor, axis, name, p, size in candidates(setup, grade):
        if only and id not in only:
            continue
        shape = {
            f"{q.name}{q.suffix}": middle
            for q in CATALOGUE[id].parameters
            if q.name in ("time", "start")
        }
        shape |= (
            {"frequency_hz": 7.0}
            if any(q.name == "frequency" and not q.default for q in CATALOGUE[id].parameters)
            else {}
        )
        effect = make_effect(
            id, {f"{name}{p.suffix}": size, **shape}, setup, sensor=sensor, axis=axis
        )
        found.append(
            Column(id, sensor, axis, name, p.unit, size, whitened(watch.changes(effect), weight))
        )
    return found


Some = TypeVar("Some", bound=Effect)
Channels = dict[tuple[str, int], "np.ndarray[tuple[int], np.dtype[np.float32]]"]


class NominalMotion:
    """The nominal motion at some rows, and what an effect changes against it.

    Args:
        setup: site, rig, sensors.
        course: what the table does.
        time: of the rows, s, (n,).
        matrices: of each sensor by name, (k, 3): reading per unit of force or rate in the body
            frame; the nominal one unless given. A FOG's is (1, 1).
    """

    def __init__(
        self, setup: Setup, course: Course, time: Array, matrices: Mapping[str, Array] | None = None
    ) -> None:
        self.setup, self.course, self.time = setup, course, time
        self.matrices = matrices or {}
        self.drive = course.drive(time)
        motion = closed_form(setup, self.drive)
        self.sense = {s.name: make_sense(s, setup, motion, self.drive) for s in setup.sensor}
        self.ideal = {name: sense.true_input() for name, sense in self.sense.items()}
        self.responses = Responses(setup, self.drive)
        self._slopes: tuple[Array, Array] | None = None

    def through(self, matrices: Mapping[str, Array]) -> "NominalMotion":
        """The same motion through other sensor matrices."""
        other = copy(self)
        other.matrices = matrices
        return other

    def changes(self, effect: Effect) -> dict[str, Array]:
        """Change of the readings of each sensor that changes, SI, (n, k)."""
        if isinstance(effect, DelayEffect):
            changes = self._late(effect)
        elif isinstance(effect, SignalEffect):
            changes = {str(effect.sensor): self._signal(effect)}
        else:
            changes = self._moved(effect)
        return {name: self._converted(name, change, effect) for name, change in changes.items()}

    def each(self, effect: Learned) -> dict[str, Array]:
        """Changes by one of each coefficient of a curve, SI, (n, k, p): all at once."""
        if isinstance(effect, LearnedReading):
            sense = self.sense[str(effect.sensor)]
            columns = effect.columns(sense)
            change = np.zeros(
                (len(self.time), len(sense.axes) if sense.kind != "fog" else 1, columns.shape[1])
            )
            change[:, effect.channel(sense)] = columns
            return {str(effect.sensor): self._converted(str(effect.sensor), change, effect)}
        assert isinstance(effect, LearnedReadout | LearnedTilt)
        place = (
            ("axis", str(effect.axis))
            if isinstance(effect, LearnedReadout)
            else (effect.slot, effect.turn)
        )
        force, rate = self.responses.to({place: effect.each_along(self.drive)})
        return {
            name: self._converted(name, change, effect)
            for name, change in self._read(force, rate).items()
        }

    def _converted(self, name: str, change: Array, effect: Effect) -> Array:
        """The change of what an inclinometer says, where the effect acts on the force it senses: d
        asin(f/g) = df / (g cos).
        """
        if (
            self.setup.named(name).kind != "inclinometer"
            or getattr(effect, "order", 0) >= CONVERSION
        ):
            return change
        g = self.setup.site.gravity
        steep = np.sqrt(np.maximum(g * g - self.ideal[name] ** 2, (1e-3 * g) ** 2))
        return change / (steep[:, :, None] if change.ndim == 3 else steep)

    def _signal(self, effect: SignalEffect) -> Array:
        """Change of a reading by an effect of the sensor or its electronics."""
        sensor = self.setup.named(str(effect.sensor))
        start = self.ideal[sensor.name]
        if effect.order >= CONVERSION and sensor.kind == "inclinometer":
            start = tilt_of_force(start, self.setup.site.gravity)
        sense = self.sense[sensor.name]
        small = replace(
            effect,
            values={**effect.values, **{n: effect.straight * v for n, v in effect.sizes.items()}},
        )
        # the last samples of a loss have none
        up = np.nan_to_num(small.apply(start.copy(), sense, None) - start) / effect.straight
        if one_sided(effect):
            return up
        return (
            up - (effect_down(small).apply(start.copy(), sense, None) - start) / effect.straight
        ) / 2

    def _moved(self, effect: Effect) -> dict[str, Array]:
        """Change of every sensor's reading by what moves differently."""
        if moves_smoothly(effect):
            turns = self.responses.turns(effect)
            if not one_sided(effect):
                down = self.responses.turns(effect_down(effect))
                turns = {place: (jet - down[place]).scaled(0.5) for place, jet in turns.items()}
            return self._read(*self.responses.to(turns))
        up = force_and_rate(self.setup, self.drive, [effect])
        if one_sided(effect):
            base = next(iter(self.sense.values()))
            return self._read(up[0] - base.force, up[1] - base.rate)
        low = force_and_rate(self.setup, self.drive, [effect_down(effect)])
        return self._read((up[0] - low[0]) / 2, (up[1] - low[1]) / 2)

    def _read(self, force: Array, rate: Array) -> dict[str, Array]:
        """What a change of force and rate in the body frame, (n, 3) or (n, 3, p) each, does to each
        sensor.
        """
        found = {}
        for name, sense in self.sense.items():
            source = force if sense.kind in ACCELEROMETERS else rate
            if sense.kind == "fog":
                matrix = sense.input_vector[None, :]
            else:
                matrix = self.matrices.get(name, np.eye(3)[list(sense.axes)])
            found[name] = np.moveaxis(np.tensordot(source, matrix, axes=(1, 1)), -1, 1)
        return found

    def _late(self, effect: DelayEffect) -> dict[str, Array]:
        """Change of a sensor's reading by a delay: minus the delay times its time derivative, by a
        millisecond's step.

        A delay that names no sensor is the recorder's own: all sensors alike.
        """
        if self._slopes is None:
            step = 5e-4
            ahead, behind = (
                force_and_rate(self.setup, self.course.drive(self.time + sign * step))
                for sign in (1, -1)
            )
            self._slopes = (ahead[0] - behind[0]) / (2 * step), (ahead[1] - behind[1]) / (2 * step)
        slopes = self._read(*self._slopes)
        names = [effect.sensor] if effect.sensor else list(slopes)
        return {
            name: np.column_stack(
                [
                    -effect.delay(self.drive.elapsed, k, None) * column
                    for k, column in enumerate(slopes[name].T)
                ]
            )
            for name in names
        }


def whitened(changes: Mapping[str, Array], weight: Mapping[str, Array]) -> Channels:
    """Changes by channel in units of the noise, (n,) each; channels that do not change are left
    out.
    """
    found: Channels = {}
    for name, change in changes.items():
        for k in range(change.shape[1]):
            column = change[:, k] * weight[name]
            if np.abs(column).max(initial=0.0) > 1e-9 and np.linalg.norm(column) > 1e-6:
                found[name, k] = column.astype(np.float32)
    return found


def white_noise(sensor: Sensor, known: Sequence[Effect]) -> float:
    """Standard deviation of one sample, in the unit of the reading (SI; rad for an
    inclinometer).
    """
    for e in known:
        if e.sensor == sensor.name and isinstance(e, Noise) and e.value("white") > 0:
            scale = 1 / G0 if sensor.kind == "inclinometer" else 1.0
            return float(e.value("white") * scale * np.sqrt(sensor.rate_hz))
    return float(WHITE[sensor.kind] * np.sqrt(sensor.rate_hz))


def one_sided(effect: Effect) -> bool:
    """Whether one step up tells all: a linear effect, or a size that has no negative side."""
    return effect.linear or any(p.positive and not p.is_shape for p in effect.parameters)


def effect_down(effect: Some) -> Some:
    """The effect with the sign of its size turned, its shape kept."""
    return replace(effect, values={**effect.values, **{n: -v for n, v in effect.sizes.items()}})


def gram(columns: Sequence[Column]) -> Array:
    """Inner products of all columns, (p, p), accumulated channel by channel."""
    total = np.zeros((len(columns), len(columns)))
    keys = sorted({key for c in columns for key in c.channels})
    for key in keys:
        index = [i for i, c in enumerate(columns) if key in c.channels]
        block = np.array([columns[i].channels[key] for i in index])
        for start in range(0, block.shape[1], 16384):
            part = block[:, start : start + 16384].astype(float)
            total[np.ix_(index, index)] += part @ part.T
    return total
