"""What a recording says about an instrument model: readings less what the model predicts, with the
uncertainty of both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from tiltcal.calibration.correction import thermal_course
from tiltcal.calibration.validity import SIGNIFICANCE
from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import force_of_tilt
from tiltcal.core.units import DEG, EARTH_RATE
from tiltcal.effects.base import Effect
from tiltcal.effects.sense import Sense
from tiltcal.effects.sensor.temporal import AccDrift
from tiltcal.effects.table.geometry import TableLevelling
from tiltcal.forward.kinematics import closed_form
from tiltcal.instrument.model import InstrumentModel
from tiltcal.instrument.placing import PlacingBias
from tiltcal.instrument.temperature import ThermalStream
from tiltcal.instrument.terms import terms_of
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Jet
from tiltcal.statistics.dwell_noise import pooled_noise
from tiltcal.statistics.least_squares import CommonErrors
from tiltcal.statistics.noise_spectrum import most_slow_variance

BLOCKS = 400  # of a recording over temperature, at most
NOTHING = 1e-9  # SI per unit of a parameter: rounding of a pose in which it does not show
RANK = 1e-9  # singular values below this share of the largest are none
LINEAR = ("bias", "scale", "cross_axis")
"""Terms of which one is named as the likeliest change where a recording does not agree."""
HORIZONTAL = np.sin(1 * DEG)  # of g along an axis at which its placing-angle table is judged


def linear_columns(sensor: Sensor, sense: Sense) -> dict[str, Array]:
    """Reading per unit of each bias, scale-factor and cross-axis term by name, SI, (m, k)."""
    found = {}
    for name, (cls, parameter) in terms_of(sensor.kind, sensor.axes).items():
        if cls.calibration_term in LINEAR:
            channel, column = cls().term(parameter, sense)
            block = np.zeros((len(sense.time), len(sensor.axes)))
            block[:, channel] = column
            found[f"{sensor.name}.{name}"] = block
    return found


@dataclass(frozen=True)
class Evidence:
    """Readings of a sensor less those that a model predicts.

    Args:
        sensor: which.
        kind: what is judged: ``tilt``, ``norm`` where attitudes are unknown, ``table`` of a placing
            angle, or ``rate``.
        sense: what the sensor senses on each row, (m,) rows.
        residual: reading less prediction, in the sensing form, SI, (m, k); NaN: not judged.
        noise: covariance of each row's reading, SI, (m, k, k).
        model: what one standard deviation in each direction of the model's covariance adds, SI,
            (p, m, k).
        nuisance: what may be in the readings in addition, each with its prior as its size, SI,
            (q, m, k).
        free: how many of these are fitted: their prior says next to nothing.
        shown: which parameters of the model the readings depend on, (p,).
        spans: beginning and end of each row, s.
        references: what one standard uncertainty of each stated reference adds, SI, (q, m, k);
            None: nothing is stated.
        rows: what a row is, for a sentence.
    """

    sensor: Sensor
    kind: str
    sense: Sense
    residual: Array
    noise: Array
    model: Array
    nuisance: Array
    shown: Mask
    spans: Sequence[tuple[float, float]]
    free: int = 0
    rows: str = "dwells"
    references: Array | None = None

    @property
    def _stated(self) -> Array:
        """What stated references add, (q, m, k)."""
        none = np.zeros((0, *self.residual.shape))
        return none if self.references is None else self.references

    @cached_property
    def judged(self) -> Mask:
        """Readings that are judged, (m, k)."""
        return np.asarray(~np.isnan(self.residual))

    def chi2(self) -> tuple[float, int]:
        """Chi-square of the residual against noise, model and nuisance, and its degrees of
        freedom.
        """
        r, X = self._whitened()
        inner = np.eye(X.shape[1]) + X.T @ X
        b = X.T @ r
        chi2 = float(r @ r - b @ np.linalg.solve(inner, b))
        free = X[:, len(self.model) : len(self.model) + self.free]
        taken = int(np.linalg.matrix_rank(free)) if self.free else 0
        return max(chi2, 0.0), max(len(r) - taken, 0)

    def _whitened(self) -> tuple[Array, Array]:
        """Residual, (N,), and columns, (N, q), in units of the noise."""
        added = np.concatenate([self.model, self.nuisance, self._stated])
        rows, columns = [np.zeros(0)], [np.zeros((0, len(added)))]
        for i, keep in enumerate(self.judged):
            if keep.any():
                root = np.linalg.cholesky(self.noise[i][np.ix_(keep, keep)])
                rows.append(np.linalg.solve(root, self.residual[i, keep]))
                columns.append(np.linalg.solve(root, added[:, i, keep].T))
        return np.concatenate(rows), np.concatenate(columns)

    def likeliest_change(self, candidates: Mapping[str, Array]) -> tuple[str, float, float]:
        """The change of one parameter that explains most of the residual: its name, size and
        sigma, SI.

        Args:
            candidates: reading per unit of each parameter, (m, k).
        """
        r, X = self._whitened()
        inner = np.linalg.inv(np.eye(X.shape[1]) + X.T @ X)
        best, score = ("", 0.0, np.inf), 0.0
        for name, column in candidates.items():
            x, _ = replace_residual(self, column)._whitened()
            weighed = x - X @ (inner @ (X.T @ x))
            information = float(x @ weighed)
            if information <= 0:
                continue
            size = float(r @ weighed) / information
            if size * size * information > score:
                best, score = (name, size, information**-0.5), size * size * information
        return best

    def with_scatter(self, terms: Array, most: Array) -> "Evidence":
        """The same with as much slow noise as the rows scatter with about their own best bias,
        scale factors and cross-axis terms, where that is significantly more than white noise, and
        not more than the samples allow.

        The calibration is as uncertain by it as these rows are.

        Args:
            terms: reading per unit of each of these terms, (q, m, k).
            most: covariance of each row with the most slow noise, SI, (m, k, k).
        """
        from scipy.special import chdtrc

        alone = np.zeros((0, *self.residual.shape))
        nuisance = np.concatenate([terms, self.nuisance])
        r, X = replace(self, model=alone, nuisance=nuisance)._whitened()
        X, stated = X[:, : len(nuisance)], X[:, len(nuisance) :]
        common = CommonErrors(stated, np.ones(stated.shape[1], bool))
        r, X = common.weight(r), common.weight(X)
        size = np.linalg.norm(X, axis=0)
        U, values, _ = np.linalg.svd(X[:, size > 0] / size[size > 0], full_matrices=False)
        taken = U[:, values > RANK * values[0]]
        dof = len(r) - taken.shape[1]
        if dof <= 0:
            return self
        scatter = float(r @ r - (taken.T @ r) @ (taken.T @ r)) / dof
        if chdtrc(dof, scatter * dof) > SIGNIFICANCE:
            return self
        allowed = float(np.mean(np.einsum("mii->mi", most) / np.einsum("mii->mi", self.noise)))
        factor = min(scatter, allowed)
        return replace(self, noise=self.noise * factor, model=self.model * np.sqrt(factor))

    @cached_property
    def expected(self) -> Array:
        """Covariance of each row's residual by noise, model and references, SI, (m, k, k)."""
        added = np.concatenate([self.model, self._stated])
        return np.asarray(self.noise + np.einsum("qmi,qmj->mij", added, added))


def replace_residual(evidence: Evidence, residual: Array) -> Evidence:
    """The evidence with another residual on the same judged readings. residual: SI, (m, k)."""
    return replace(evidence, residual=np.where(evidence.judged, residual, np.nan))


def evidence_at_rest(
    model: InstrumentModel,
    sensor: Sensor,
    recording: Recording,
    setup: Setup,
    segments: Sequence[Segment] | None,
    own_frame: bool,
) -> Evidence:
    """The dwells of a recording against a model.

    Args:
        model: of the sensor.
        sensor: which.
        recording: with dwells.
        setup: of the recording.
        segments: dwells to use.
        own_frame: whether the model's axes are the sensor's own, turned against the table's by an
            unknown rotation.

    Raises:
        TiltcalError: no dwell, or no temperature where the model follows it.
    """
    poses, by_norm = _judged_poses(recording, setup, sensor, segments, own_frame)
    rows = _Rows.of(model, sensor, recording, setup, poses)
    sense = rows.sense(model, sensor, setup, by_norm)
    if model.geometry and poses.angles and not by_norm:
        force = _forces(recording, setup.seen_by(sensor), poses, model.geometry)
        sense = replace(sense, force=force[rows.pose])
    residual = rows.means - model.predict(sensor, sense)
    noise, most = rows.covariances(model, sensor, sense)
    tables = [e for e in model.signal(sensor) if isinstance(e, PlacingBias)]
    _judge_tables(tables, sensor, sense, residual, noise)
    sensitivity = model.sensitivity(sensor, sense)
    shown = np.asarray(np.abs(sensitivity).max(axis=(1, 2)) > NOTHING)
    columns = in_standard_deviations(model, sensitivity)
    terms = np.array(list(linear_columns(sensor, sense).values()))
    stated = poses.references.at(rows.pose).stated(residual.shape)
    if by_norm:
        along, found = _by_the_norm(model, sensor, sense, noise, columns, shown, rows.spans)
        most = np.einsum("mi,mij,mj->m", along, most, along)[:, None, None]
        terms, stated = (np.einsum("pmk,mk->pm", c, along)[:, :, None] for c in (terms, stated))
        return replace(found, references=stated).with_scatter(terms, most)
    nuisance = _nuisance(model, sensor, sense, rows.pose, own_frame)
    kind = "tilt" if sensor.is_accelerometer else "rate"
    if tables:
        kind, nuisance = "table", _unlevelled(model, sensor, recording, setup, rows)
    # the Earth's rate has a prior; a rotation of the frame and what a table adds are fitted
    found = Evidence(
        sensor,
        kind,
        sense,
        residual,
        noise,
        columns,
        nuisance,
        shown,
        rows.spans,
        len(nuisance) if sensor.is_accelerometer else 0,
        "dwells" if rows.warm is None else "stretches of the dwells",
        stated,
    )
    return found if kind == "table" else found.with_scatter(terms, most)


def _judged_poses(
    recording: Recording,
    setup: Setup,
    sensor: Sensor,
    segments: Sequence[Segment] | None,
    own_frame: bool,
) -> tuple[Poses, bool]:
    """The dwells by which a sensor is judged, and whether by their norm alone.

    Raises:
        TiltcalError: no attitude is known, and the sensor is no triad.
    """
    poses = find_poses(recording, setup, sensor, segments)
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    by_norm = sensor.is_accelerometer and (not known.any() or (own_frame and known.sum() < 3))
    if by_norm and len(sensor.axes) < 3:
        raise TiltcalError(
            recording.source,
            found=f"no known attitude, and {len(sensor.axes)} axes of {sensor.name}",
            need="table readout or direction labels, or a triad to judge by the norm",
            do="label the dwells",
        )
    return (poses.subset(known) if sensor.is_accelerometer and not by_norm else poses), by_norm


def in_standard_deviations(model: InstrumentModel, columns: Array) -> Array:
    """Columns of the parameters as those of the independent standard deviations of the model.

    Args:
        model: with its covariance.
        columns: reading per unit of each parameter, SI, (p, m, k); also the result.
    """
    values, vectors = np.linalg.eigh(model.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(np.tensordot(root.T, columns, axes=1))


@dataclass(frozen=True)
class _Rows:
    """Stretches of dwells: whole dwells, or short ones where the model follows the temperature.

    Args:
        poses: the dwells.
        samples: readings of each dwell, sensing form, SI, (n_i, k); none of a table of means.
        warm: temperature, degC, and memory of it at each sample, (n_i,) each; None where the model
            does not follow it.
        cut: dwell, first sample and sample after the last of each row, (m, 3).
        means: of the reading, SI, (m, k).
        spans: beginning and end of each, s.
        length: samples in the time from the first to the last dwell.
    """

    poses: Poses
    samples: Sequence[Array]
    warm: Sequence[tuple[Array, Array]] | None
    cut: Index
    means: Array
    spans: Sequence[tuple[float, float]]
    length: int

    @property
    def pose(self) -> Index:
        """Number of the dwell of each row, (m,)."""
        return self.cut[:, 0]

    @classmethod
    def of(
        cls,
        model: InstrumentModel,
        sensor: Sensor,
        recording: Recording,
        setup: Setup,
        poses: Poses,
    ) -> "_Rows":
        """The rows of a recording."""
        whole = [(s.start_s, s.end_s) for s in poses.spans]
        if isinstance(recording, MeansTable):
            cut = np.array([(i, 0, 1) for i in range(len(poses))])
            return cls(poses, (), None, cut, poses.means, whole, len(poses))
        read = recording.sensor(sensor)
        values = read.values
        if sensor.kind == "inclinometer":
            values = force_of_tilt(values, setup.site.gravity)
        complete = ~np.isnan(values).any(axis=1)
        time, values, at = read.time[complete], values[complete], read.rows[complete]
        ends = np.searchsorted(time, [(a, np.nextafter(b, np.inf)) for a, b in whole])
        samples = [values[a:b] for a, b in ends]
        length = int(ends[-1, 1] - ends[0, 0])
        terms = model.temperature_terms(sensor)
        if terms is None:
            cut = np.array([(i, 0, len(part)) for i, part in enumerate(samples)])
            return cls(poses, samples, None, cut, poses.means, whole, length)
        course = thermal_course(recording, ThermalStream(terms))
        warm = [(course.level[at[a:b]], course.memory[at[a:b]]) for a, b in ends]
        size = max(sum(map(len, samples)) // BLOCKS, 3)
        cut = np.array(
            [
                (i, r, min(r + size, len(part)))
                for i, part in enumerate(samples)
                for r in range(0, len(part), size)
            ]
        )
        means = np.array([samples[i][a:b].mean(axis=0) for i, a, b in cut])
        first = ends[:, 0]
        spans = [(float(time[first[i] + a]), float(time[first[i] + b - 1])) for i, a, b in cut]
        return cls(poses, samples, warm, cut, means, spans, length)

    def sense(self, model: InstrumentModel, sensor: Sensor, setup: Setup, by_norm: bool) -> Sense:
        """What the sensor senses on each row; where attitudes are not known, by its readings."""
        g = setup.site.gravity
        sense = Sense.at_rest(sensor, g, g * np.nan_to_num(self.poses.up)[self.pose])
        time = np.array([(start + end) / 2 for start, end in self.spans])
        angles = {axis: angle[self.pose] for axis, angle in self.poses.angles.items()}
        sense = replace(sense, time=time, elapsed=time - time[:1].sum(), angles=angles)
        if sensor.kind == "fog":
            sense = replace(sense, input_vector=sensor.input_vector)
        if self.warm is not None:
            mean = [[self.warm[i][k][a:b].mean() for i, a, b in self.cut] for k in (0, 1)]
            warm = np.array(mean[0]) - (model.reference_degC or 0.0)
            sense = replace(sense, temperature=warm, temperature_memory=np.array(mean[1]))
        if by_norm:
            sense = replace(sense, force=model.invert(sensor, self.means, sense))
        return sense

    def covariances(
        self, model: InstrumentModel, sensor: Sensor, sense: Sense
    ) -> tuple[Array, Array]:
        """Covariance of each mean by white noise and rounding, SI, (m, k, k), and with as much
        flicker as the samples allow.
        """
        poses, pose = self.poses, self.pose
        if not self.samples:
            return poses.covariances, poses.covariances
        left = [self._left(i, model, sensor, sense) / poses.spread[i] for i in range(len(poses))]
        counts = (self.cut[:, 2] - self.cut[:, 1]).astype(float)
        spread = poses.spread[pose]
        white, _ = pooled_noise(left)
        found = white / counts[:, None, None] * (spread[:, :, None] * spread[:, None, :])
        found += poses.rounding[pose][:, :, None] * np.eye(len(white))
        most = found.copy()
        for i in range(len(white)):
            slow = most_slow_variance([part[:, i] for part in left], counts, self.length)
            most[:, i, i] += slow * spread[:, i] ** 2
        return np.asarray(found), most

    def _left(self, dwell: int, model: InstrumentModel, sensor: Sensor, sense: Sense) -> Array:
        """Readings of a dwell less their mean, and less what the temperature does to them."""
        left = self.samples[dwell]
        if self.warm is not None:
            row = int(np.flatnonzero(self.pose == dwell)[0])
            level, memory = self.warm[dwell]
            n = len(level)
            at = Sense.at_rest(sensor, model.gravity, np.tile(sense.force[row], (n, 1)))
            at = replace(
                at,
                temperature=level - (model.reference_degC or 0.0),
                temperature_memory=memory,
                input_vector=sense.input_vector,
            )
            left = left - model.predict(sensor, at)
        return np.asarray(left - left.mean(axis=0))


def _judge_tables(
    tables: Sequence[PlacingBias], sensor: Sensor, sense: Sense, residual: Array, noise: Array
) -> None:
    """Leave in the residual what placing-angle tables are judged by: the readings of their axes
    while these are horizontal; add the tables' own uncertainty to the noise.

    Args:
        tables: of the sensor; nothing is done without any.
        sensor: which.
        sense: on each row, (m,).
        residual: SI, (m, k); changed.
        noise: SI, (m, k, k); changed.
    """
    if not tables:
        return
    for table in tables:
        axis = "xyz".index(str(table.axis))
        i = sense.axes.index(axis)
        residual[np.abs(sense.force[:, axis]) >= HORIZONTAL * sense.gravity, i] = np.nan
        noise[:, i, i] += np.nan_to_num(table.sigma(sense)) ** 2
    stated = [table.axis for table in tables]  # of the other channels nothing is stated
    residual[:, [axis not in stated for axis in sensor.axes]] = np.nan


def _nuisance(
    model: InstrumentModel,
    sensor: Sensor,
    sense: Sense,
    pose: Index,
    own_frame: bool,
) -> Array:
    """What may be in the readings in addition, each at the size of its prior, SI, (q, m, k): an
    unknown rotation of the sensor's own frame, 1 rad; of a rate sensor the Earth's rate, in each
    dwell for itself.
    """
    _, M = model.linear(sensor)
    if sensor.is_accelerometer:
        if not own_frame:
            return np.zeros((0, *pose.shape, len(sensor.axes)))
        return np.array([np.cross(axis, sense.force) @ M.T for axis in np.eye(3)])
    # one for each dwell and channel
    each = (pose[None, :] == np.unique(pose)[:, None])[:, None, :, None]
    channels = np.eye(len(sensor.axes))[None, :, None, :]
    return EARTH_RATE * (each * channels).reshape(-1, len(pose), len(sensor.axes))


def _forces(recording: Recording, setup: Setup, poses: Poses, effects: Sequence[Effect]) -> Array:
    """Specific force at the mean readout of each dwell under some effects, body frame, m/s2, (m,
    3).
    """
    middle = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    still = np.zeros(len(middle))
    jets = {name: Jet(angle, still, still) for name, angle in poses.angles.items()}
    return closed_form(setup, replay(recording, setup).standing(middle, jets), effects).force


def _unlevelled(
    model: InstrumentModel, sensor: Sensor, recording: Recording, setup: Setup, rows: _Rows
) -> Array:
    """What a table that is not level adds to the rows, at the size of a middling one, and a drift
    of the zero in each mounting, SI, (q, m, k): a placing-angle table is made without both.
    """
    where, poses = setup.seen_by(sensor), rows.poses
    course = replay(recording, where)
    middle = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    level = _forces(recording, where, poses, ())
    _, M = model.linear(sensor)
    columns = []
    for parameter in TableLevelling.parameters:
        size = parameter.plausible[1] * parameter.factor
        tilted = _forces(recording, where, poses, (TableLevelling({parameter.name: size}),))
        columns.append((tilted - level)[rows.pose] @ M.T)
    drift = AccDrift.parameters[0]
    size = drift.plausible[1] * drift.factor
    for begin, end in pairwise([*(start for start, _ in course.mounts), np.inf]):
        mounted = (middle >= begin) & (middle < end)
        if mounted.sum() > 1:
            ramp = np.where(mounted, middle - middle[mounted].mean(), 0.0)
            ramp *= size / np.ptp(middle[mounted])
            columns += [ramp[rows.pose, None] * channel for channel in np.eye(len(sensor.axes))]
    return np.array(columns)


def _by_the_norm(
    model: InstrumentModel,
    sensor: Sensor,
    sense: Sense,
    noise: Array,
    columns: Array,
    shown: Mask,
    spans: Sequence[tuple[float, float]],
) -> tuple[Array, Evidence]:
    """The error of the norm alone, as one channel in units of g: corrected readings less g;
    and its change per reading, (m, k).

    Args:
        model: of the sensor.
        sensor: a triad.
        sense: with the corrected readings as the force, (m,) rows.
        noise: of each reading, SI, (m, k, k).
        columns: of the model, SI, (p, m, k).
        shown: as in ``Evidence``.
        spans: of the rows, s.
    """
    length = np.linalg.norm(sense.force, axis=1)
    _, M = model.linear(sensor)
    along = sense.force / length[:, None] @ np.linalg.inv(M) / model.gravity  # per reading
    spread = np.einsum("mi,mij,mj->m", along, noise, along)
    return along, Evidence(
        sensor,
        "norm",
        sense,
        (length / model.gravity - 1)[:, None],
        spread[:, None, None],
        np.einsum("pmk,mk->pm", columns, along)[:, :, None],
        np.zeros((0, len(length), 1)),
        shown,
        spans,
    )
