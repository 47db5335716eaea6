"""How readings change with every effect of the catalogue: columns at plausible size, and their Gram matrix.

A linear sensor term has its exact column; every other effect is differenced through the closed form with its own plausible
size as the step. Dwells of a schedule are compressed to one row with its number of samples as weight.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tiltcal.chain import readings
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import DelayEffect, Effect, Parameter, WritingEffect
from tiltcal.errors import TiltcalError
from tiltcal.frames import Array
from tiltcal.motion import Course
from tiltcal.setup import Sensor, Setup
from tiltcal.units import G0

GRADES = ("precision", "mid_mems", "consumer")
WHITE = {"accelerometer": 25e-6 * G0, "inclinometer": 25e-6, "gyro": 1e-4, "fog": 3e-6}  # SI per root hertz, when not stated
OF_THE_DRIVE = {"servo_droop", "servo_friction_deadband", "servo_lag"}
NO_COLUMN = {"acc_saturation", "gyr_saturation", "fog_fringe", "fog_deadband", "adc_stuck_bit"}  # thresholds, not sizes


@dataclass(frozen=True)
class Column:
    """How the whitened readings change when one parameter has its plausible size.

    Args:
        effect: id; sensor, axis: where it acts; name: bare parameter name; unit: its suffix.
        size: the plausible size, in ``unit``.
        channels: (sensor, channel) -> whitened change, (n,), float32; channels that do not change are left out.
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
    """All samples of a course; each dwell as one row (two at its ends count as the dwell's rest)."""
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


def candidates(setup: Setup, grade: str) -> Iterator[tuple[str, str | None, str | None, str, Parameter, float]]:
    """(id, sensor, axis, bare name, parameter, size) of every parameter with a column on this set-up."""
    for id, cls in CATALOGUE.items():
        if cls.random or issubclass(cls, WritingEffect) or cls.stage == "data" or id in NO_COLUMN:
            continue
        if (cls.stage == "table" or cls.on_table) and not setup.rig.axes:
            continue
        if id in OF_THE_DRIVE and setup.rig.readout != "command":
            continue  # the encoder sees them
        sensors: Iterable[Sensor | None] = setup.sensors(*cls.kinds) if cls.kinds else (None,)
        axes: Iterable[str | None] = setup.rig.axis_names if cls.axis_wise else (None,)
        for sensor in sensors:
            for axis in axes:
                for p in cls.parameters:
                    if p.default or p.name in ("time", "start", "length", "frequency"):
                        continue  # a shape, not a size
                    for name in p.expand(sensor.axes if sensor else ()):
                        yield id, sensor.name if sensor else None, axis, name, p, sizes(p, grade)


def sensitivity(
    setup: Setup, course: Course, rows: Rows, *, grade: str = "mid_mems", known: Sequence[Effect] = (), only: Sequence[str] = ()
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
    if grade not in GRADES:
        raise TiltcalError(f"grade '{grade}'", found="no such grade", need="one of " + ", ".join(GRADES), do="correct it")
    times = {s.name: rows.time for s in setup.sensor}
    base = readings(setup, course, times, known)
    weights = {s.name: np.sqrt(rows.weight) / white_noise(s, known) for s in setup.sensor}
    middle = (course.times[1] - course.times[0]) / 2
    found = []
    for id, sensor, axis, name, p, size in candidates(setup, grade):
        if only and id not in only:
            continue
        shape = {f"{q.name}{q.suffix}": middle for q in CATALOGUE[id].parameters if q.name in ("time", "start")}
        shape |= {"frequency_hz": 7.0} if any(q.name == "frequency" and not q.default for q in CATALOGUE[id].parameters) else {}
        effect = make_effect(id, {f"{name}{p.suffix}": size, **shape}, setup, sensor=sensor, axis=axis)
        channels = _channels(setup, course, times, known, effect, base, weights)
        found.append(Column(id, sensor, axis, name, p.unit, size, channels))
    return found


def white_noise(sensor: Sensor, known: Sequence[Effect]) -> float:
    """Standard deviation of one sample, in the unit of the reading (SI; rad for an inclinometer)."""
    for e in known:
        if e.sensor == sensor.name and e.id.endswith("_noise") and e.value("white") > 0:
            scale = 1 / G0 if sensor.kind == "inclinometer" else 1.0
            return float(e.value("white") * scale * np.sqrt(sensor.rate_hz))
    return float(WHITE[sensor.kind] * np.sqrt(sensor.rate_hz))


def _channels(
    setup: Setup, course: Course, times: dict[str, Array], known: Sequence[Effect], effect: Effect,
    base: Mapping[str, Array], weights: Mapping[str, Array],
) -> dict[tuple[str, int], "np.ndarray[tuple[int], np.dtype[np.float32]]"]:  # fmt: skip
    touched = {effect.sensor: times[effect.sensor]} if effect.sensor else times
    sign = (1.0,) if effect.linear or isinstance(effect, DelayEffect) else (1.0, -1.0)
    changes: dict[str, Array] = {}
    for s in sign:
        turned = _scaled(effect, s)
        now = readings(setup, course, touched, [*known, turned])
        for name, values in now.items():
            changes[name] = changes.get(name, 0.0) + s * (values - base[name]) / len(sign)
    found = {}
    for name, change in changes.items():
        for k in range(change.shape[1]):
            column = change[:, k] * weights[name]
            if np.linalg.norm(column) > 1e-6:
                found[name, k] = column.astype(np.float32)
    return found


def _scaled(effect: Effect, sign: float) -> Effect:
    """The effect with the sign of its size turned, its shape kept."""
    from dataclasses import replace

    if sign > 0:
        return effect
    shapes = {p.name for p in effect.parameters if p.default or p.name in ("time", "start", "length", "frequency")}
    return replace(effect, values={n: v if n in shapes else -v for n, v in effect.values.items()})


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
