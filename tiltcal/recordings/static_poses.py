"""Poses: the dwells of a log as means with covariance and, where known, the true up direction."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import force_of_tilt, parse_up
from tiltcal.core.quantisation import lsb_grid
from tiltcal.core.units import DEG
from tiltcal.effects.base import Effect
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import (
    NO_REFERENCES,
    References,
    Standstills,
    references,
    sense_without_table,
)
from tiltcal.recordings.replay import replay
from tiltcal.recordings.samples import Rows
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Jet
from tiltcal.statistics.dwell_noise import pooled_noise, rounding_variance

GRID_SAMPLES = 20_000  # samples of a stretch from which the LSB is determined


@dataclass(frozen=True)
class PoseSpan:
    """A dwell that was used."""

    start_s: float
    end_s: float
    label: str | None = None


@dataclass(frozen=True)
class Poses:
    """The dwells that one sensor saw.

    Args:
        sensor: which.
        spans: where they lie.
        means: of the sensing form, f or rate, SI, (m, k).
        counts: samples each, (m,).
        noise: covariance of one sample, SI, (k, k): pooled over the dwells.
        inflation: variance of a mean over that of white noise, >= 1: correlated noise averages
            worse.
        up: true up in the body frame by readout or label, (m, 3); rows of NaN where unknown.
        angles: mean readout of each table axis, rad, (m,) each.
        spread: noise of one sample at each pose over the pooled, (m, k); 1 but for inclinometers.
        stated: where ``up`` comes from: readout, label or nothing.
        slopes: of a straight line through each dwell, SI a second, (m, k); NaN where only means
            are known.
        rounding: variance of a mean that coarse quantisation leaves however long it is taken, SI,
            (m, k).
        references: what uncertain references add to the means.
    """

    sensor: Sensor
    spans: tuple[PoseSpan, ...]
    means: Array
    counts: Array
    noise: Array
    inflation: float
    up: Array
    angles: dict[str, Array]
    spread: Array
    stated: str
    slopes: Array
    rounding: Array
    references: References = NO_REFERENCES

    def __len__(self) -> int:
        return len(self.spans)

    def covariance(self, k: int) -> Array:
        """Covariance of the mean of pose ``k``, (channels, channels)."""
        return np.asarray(self.covariances[k])

    @property
    def covariances(self) -> Array:
        """Covariance of each mean, (m, k, k)."""
        spread = self.spread[:, :, None] * self.spread[:, None, :]
        white = self.noise * spread * self.inflation / self.counts[:, None, None]
        return np.asarray(white + self.rounding[:, :, None] * np.eye(len(self.noise)))

    def subset(self, mask: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> "Poses":
        """Some of the poses."""
        return Poses(
            self.sensor,
            tuple(s for s, keep in zip(self.spans, mask, strict=True) if keep),
            self.means[mask],
            self.counts[mask],
            self.noise,
            self.inflation,
            self.up[mask],
            {n: a[mask] for n, a in self.angles.items()},
            self.spread[mask],
            self.stated,
            self.slopes[mask],
            self.rounding[mask],
            self.references.at(mask),
        )


def find_poses(
    recording: Recording,
    setup: Setup,
    sensor: Sensor,
    segments: Sequence[Segment] | None = None,
    errors: tuple[Effect, ...] = (),
) -> Poses:
    """The poses of a recording.

    Args:
        recording: a log, or a table of means.
        setup: of the recording.
        sensor: which.
        segments: dwells to use; unless given those found.
        errors: of the table, which ``up`` has: uncertain references are counted from them.

    Raises:
        TiltcalError: no dwell was found, or an uncertain reference does not fit the recording.
    """
    recording.require_increasing()
    if isinstance(recording, MeansTable):
        return _stated_means(recording, setup, sensor, errors)
    found = dwells(find_segments(recording) if segments is None else segments)
    samples = recording.sensor(sensor)
    complete = ~np.isnan(samples.values).any(axis=1)
    readings = samples.values[complete]
    values = readings
    if sensor.kind == "inclinometer":
        values = force_of_tilt(readings, setup.site.gravity)
    kept, slices = _slices(found, samples.rows[complete], recording.source)
    chunks = [values[part] for part in slices]
    means = np.array([c.mean(axis=0) for c in chunks])
    spread = _spread_of(sensor, means, setup.site.gravity)
    residuals = [(c - m) / s for c, m, s in zip(chunks, means, spread, strict=True)]
    noise, inflation = pooled_noise(residuals)
    up, angles, stated, drive = _known_up(recording, setup.seen_by(sensor), kept, errors)
    return Poses(
        sensor,
        tuple(PoseSpan(s.start, s.end, s.label) for s in kept),
        means,
        np.array([len(c) for c in chunks], dtype=float),
        noise,
        inflation,
        up,
        angles,
        spread,
        stated,
        np.array([_slope(c, s.end - s.start) for c, s in zip(chunks, kept, strict=True)]),
        rounding_variance(_quantisation(readings, slices, sensor, setup), residuals, means)
        * spread**2,
        _references(recording, setup, sensor, kept, means, up, drive, errors),
    )


def _stated_means(
    table: MeansTable, setup: Setup, sensor: Sensor, errors: tuple[Effect, ...]
) -> Poses:
    """The poses of a table of means: its complete rows, with the standard deviations stated."""
    found = find_segments(table)
    samples = table.sensor(sensor)
    complete = ~np.isnan(samples.values).any(axis=1)
    rows, means = samples.rows[complete], samples.values[complete]
    sigma = table.sigma_of(sensor)[rows]
    kept = [found[row] for row in rows]
    if sensor.kind == "inclinometer":
        means = force_of_tilt(means, setup.site.gravity)
        sigma = sigma * setup.site.gravity * _spread_of(sensor, means, setup.site.gravity)
    up, angles, stated, drive = _known_up(table, setup, kept, errors)
    none = np.zeros_like(means)
    return Poses(
        sensor,
        tuple(PoseSpan(s.start, s.end, s.label) for s in kept),
        means,
        np.ones(len(kept)),
        np.eye(len(sensor.axes)),
        1.0,
        up,
        angles,
        sigma,
        stated,
        np.full_like(means, np.nan),
        none,
        _references(table, setup, sensor, kept, means, up, drive, errors),
    )


def _references(
    recording: Recording,
    setup: Setup,
    sensor: Sensor,
    segments: Sequence[Segment],
    means: Array,
    up: Array,
    drive: Drive | None,
    errors: tuple[Effect, ...],
) -> References:
    """What the uncertain references of the set-up add to the means of the dwells."""
    if not setup.budget:
        return References()
    time = np.array([(s.start + s.end) / 2 for s in segments])
    by_kind = {
        kind: _body_means(recording, setup, kind, segments) for kind in ("accelerometer", "gyro")
    }
    force = by_kind["accelerometer"]
    force = np.where(np.isnan(up), force, setup.site.gravity * up)
    if sensor.is_accelerometer:
        # its own readings: on a tilted base the nominal force has no horizontal part
        own = list(sensor.axis_indices)
        known = ~np.isnan(up).any(axis=1)
        bias = (means - force[:, own])[known].mean(axis=0) if known.any() else 0.0
        force[:, own] = means - bias
    by_kind["accelerometer"] = force
    warm = recording.temperature()
    if warm is not None:
        warm = np.array([np.nanmean(warm[s.first : s.last]) for s in segments])
    sense = sense_without_table(sensor, setup, time, by_kind, warm)
    if drive is not None and drive.known.all():
        where = setup.seen_by(sensor)
        sense = make_sense(sensor, where, closed_form(where, drive, errors), drive)
        sense = replace(sense, force=force)
    at = Standstills(sensor, drive, sense, errors)
    return references(setup, at.reading, np.arange(len(segments)))


def _body_means(
    recording: Recording, setup: Setup, kind: str, segments: Sequence[Segment]
) -> Array:
    """Mean readings of the first sensor of a kind, body axes, SI, (m, 3); zero without one."""
    for sensor in [s for s in setup.sensors(kind) if recording.has(s)][:1]:
        samples = recording.sensor(sensor)
        ends = np.searchsorted(samples.rows, [(s.first, s.last) for s in segments])
        means = [np.nanmean(samples.values[a:b], axis=0) for a, b in ends]
        return _in_body(sensor, np.nan_to_num(means))
    return np.zeros((len(segments), 3))


def _in_body(sensor: Sensor, readings: Array) -> Array:
    """Readings as vectors along the body axes, (m, 3), zero where the sensor has no axis."""
    found = np.zeros((len(readings), 3))
    found[:, list(sensor.axis_indices)] = readings
    return found


def _slices(found: Sequence[Segment], rows: Rows, source: str) -> tuple[list[Segment], list[slice]]:
    """The dwells with three samples or more of the rows that a sensor has, and where they lie."""
    kept, slices = [], []
    for s in found:
        first, last = np.searchsorted(rows, [s.first, s.last])
        if last - first >= 3:
            kept.append(s)
            slices.append(slice(int(first), int(last)))
    if not kept:
        raise TiltcalError(
            source,
            found="no dwell of this sensor",
            need="stretches at rest of half a second or more",
            do="look at `tiltcal segments`, or give edited ones with --segments",
        )
    return kept, slices


def _quantisation(readings: Array, slices: Sequence[slice], sensor: Sensor, setup: Setup) -> Array:
    """LSB of the channels in the sensing form, 0 where the readings lie on no grid, (k,).

    By the dwells, or by the whole log where the readings hardly change in a dwell.

    Args:
        readings: as recorded, SI, (n, k).
        slices: the dwells.
        sensor, setup: the LSB of an inclinometer is that of an angle.
    """
    factor = setup.site.gravity if sensor.kind == "inclinometer" else 1.0
    widths = []
    for column in readings.T:
        found = [w for s in slices if (w := lsb_grid(column[s][:GRID_SAMPLES]))]
        lsb = float(np.median(found)) if found else lsb_grid(column[:GRID_SAMPLES])
        widths.append(factor * (lsb or 0.0))
    return np.array(widths)


def _slope(values: Array, length: float) -> Array:
    """Slope of a straight line through evenly sampled values (n, k) over a time, a second, (k,)."""
    elapsed = np.linspace(-0.5, 0.5, len(values))
    return np.asarray(elapsed @ values / (elapsed @ elapsed) / max(length, 1e-9))


def _spread_of(sensor: Sensor, means: Array, g: float) -> Array:
    """Noise of the sensing form against its pose: an inclinometer's acts on the angle, so on f with
    cos(tilt).
    """
    if sensor.kind != "inclinometer":
        return np.ones_like(means)
    return np.sqrt(np.clip(1 - (means / g) ** 2, 1e-4, 1.0))


def _known_up(
    recording: Recording, setup: Setup, segments: Sequence[Segment], errors: tuple[Effect, ...]
) -> tuple[Array, dict[str, Array], str, Drive | None]:
    """Up direction of each pose from the readout, else from labels, and the table at each."""
    names = setup.rig.axis_names
    up = np.full((len(segments), 3), np.nan)
    stated = "nothing"
    angles: dict[str, Array] = {}
    drive = None
    if names and all(_was_read(recording, axis) for axis in names):
        drive = _drive_at(recording, setup, segments)
        known = drive.known
        up[known] = closed_form(setup, drive, errors).up[known]
        angles = {name: np.where(known, jet.x, np.nan) for name, jet in drive.axes.items()}
        stated = "readout" if known.any() else stated
    for i, s in enumerate(segments):
        if np.isnan(up[i]).any() and s.label and (direction := parse_up(s.label)) is not None:
            up[i] = direction
            stated = "label" if stated == "nothing" else stated
    return up, angles, stated, drive


def _was_read(recording: Recording, axis: str) -> bool:
    """Whether a table axis was read at all: the head may have been unlocked throughout."""
    readout = recording.table(axis)
    return readout is not None and not bool(np.isnan(readout).all())


def _drive_at(recording: Recording, setup: Setup, segments: Sequence[Segment]) -> Drive:
    """A drive with one row a pose: the mean readout of each dwell."""
    course = replay(recording, setup)
    axes: dict[str, Array] = {name: np.full(len(segments), np.nan) for name in setup.rig.axis_names}
    known = np.ones(len(segments), bool)
    for name in axes:
        readout = recording.table(name)
        assert readout is not None
        for i, s in enumerate(segments):
            part = readout[s.first : s.last]
            part = part[~np.isnan(part)]
            known[i] &= len(part) > 0
            axes[name][i] = part.mean() if len(part) else 0.0
    middle = np.array([(s.start + s.end) / 2 for s in segments])
    zero = np.zeros(len(segments))
    jets = {name: Jet(angle, zero, zero) for name, angle in axes.items()}
    return replace(course.standing(middle, jets), known=known)


def group_directions(
    directions: Array, limit: float = 15 * DEG
) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
    """Number of the direction each pose belongs to: poses within ``limit`` of a group's first are
    one. (m, 3) -> (m,).
    """
    units = directions / np.linalg.norm(directions, axis=1)[:, None]
    near = units @ units.T > np.cos(limit)
    group = np.full(len(units), -1, dtype=np.intp)
    for i in range(len(units)):
        if group[i] < 0:
            group[near[i] & (group < 0)] = group.max() + 1
    return group
