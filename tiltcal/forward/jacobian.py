"""How readings change with every effect of the catalogue: columns at plausible size, and their Gram
matrix.

A linear sensor term has its exact column; every other effect is differenced through the closed form
with its own plausible size as the step. Dwells of a schedule are compressed to one row with its
number of samples as weight.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import one_of
from tiltcal.core.units import ARCSEC, G0
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import Effect
from tiltcal.effects.parameter import GRADES, Parameter
from tiltcal.effects.sensor.noise import Noise
from tiltcal.forward.nominal_motion import Channels, NominalMotion
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Course

# SI per root hertz, when not stated
WHITE = {
    "accelerometer": 25e-6 * G0,
    "inclinometer": 25e-6,
    "gyro": 1e-4,
    "fog": 3e-6,
    "encoder": 0.1 * ARCSEC,  # enc_noise of the mid grade
}


@dataclass(frozen=True)
class Column:
    """How the whitened readings change when one parameter has its plausible size.

    Args:
        effect: id.
        sensor, axis: where it acts.
        name: bare parameter name.
        unit: its suffix.
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
    """All samples of a course; each dwell as one row (two at its ends stand for the
    remainder of the dwell).
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
        for sensor in sensors:
            for axis in cls.axes_on(setup.rig):
                for p in cls.parameters:
                    if not p.fits_on(setup.rig):
                        continue
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
        known: effects that are there anyway; their noise whitens, and loads show through what
            bends.
        only: ids to keep.
    """
    one_of(grade, GRADES, "grade")
    watch = NominalMotion.of(setup, course, rows.time)
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
            Column(
                id, sensor, axis, name, p.unit, size, whitened(watch.changes(effect, known), weight)
            )
        )
    return found


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
