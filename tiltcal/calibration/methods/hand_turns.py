"""Turns by hand between rests: the gyro's readings during each, and gravity's direction before and
after.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.methods.gyro_model import GyroModel
from tiltcal.core.arrays import Array
from tiltcal.core.frames import angle_between
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses
from tiltcal.setup.sensor import Sensor

EDGE = 0.5  # s of rest beside a turn over which gravity's direction is averaged


@dataclass(frozen=True)
class Turns:
    """Turns between rests, padded to one length.

    Args:
        rate: gyro readings, rad/s, (m, n, 3).
        force: specific force by the calibrated accelerometer, g, (m, n, 3).
        step: time interval of each sample, s, (m, n), 0 in the padding.
        before, after: gravity direction at the rests, unit vectors in the body frame, (m, 3).
        sigma: standard deviation of the propagated less the measured direction, rad, (m,).
    """

    rate: Array
    force: Array
    step: Array
    before: Array
    after: Array
    sigma: Array

    def subset(self, mask: Array) -> "Turns":
        """Some of the turns. mask: (turns,)."""
        return Turns(*(values[mask] for values in vars(self).values()))

    def __len__(self) -> int:
        return len(self.sigma)


@dataclass(frozen=True)
class Series:
    """A vector against time: s, (n,), and its components, (n, 3), NaN where it is unknown."""

    time: Array
    values: Array

    @property
    def known(self) -> "Series":
        """The samples without NaN."""
        complete = ~np.isnan(self.values).any(axis=1)
        return Series(self.time[complete], self.values[complete])

    def at(self, time: Array) -> Array:
        """Linear interpolation, (m, 3)."""
        return np.column_stack([np.interp(time, self.time, v) for v in self.values.T])

    def between(self, start: float, end: float) -> "Series":
        """The samples of an interval, both ends included. start, end: s."""
        inside = (self.time >= start) & (self.time <= end)
        return Series(self.time[inside], self.values[inside])


def collect_turns(
    recording: Recording, gyro: Sensor, rests: Poses, force: Series, sigma: float
) -> Turns:
    """The gyro's readings from the end of each rest to the start of the next.

    Args:
        recording: of the gyro.
        gyro: a triad.
        rests: of the gyro, with its noise.
        force: specific force by the calibrated accelerometer, g.
        sigma: standard deviation of gravity's direction at the edge of a rest, rad.
    """
    samples = recording.sensor(gyro)
    reading = Series(samples.time, samples.values).known
    time = reading.time
    starts = np.searchsorted(time, [s.end_s for s in rests.spans[:-1]])
    ends = np.searchsorted(time, [s.start_s for s in rests.spans[1:]])
    m, n = len(starts), int((ends - starts).max())
    rate, sensed, step = np.zeros((m, n, 3)), np.zeros((m, n, 3)), np.zeros((m, n))
    force_at_gyro = force.known.at(time)
    interval = np.gradient(time)
    for k in range(m):
        part, length = slice(starts[k], ends[k]), ends[k] - starts[k]
        rate[k, :length] = reading.values[part]
        sensed[k, :length] = force_at_gyro[part]
        step[k, :length] = interval[part]
    turning = Series(time, reading.values - _static_rate(rests, force, force_at_gyro))
    angle = _integrated(turning)
    ends_of_rests = [(s.end_s - EDGE, s.end_s, s.end_s) for s in rests.spans[:-1]]
    starts_of_rests = [(s.start_s, s.start_s + EDGE, s.start_s) for s in rests.spans[1:]]
    before = _edge_directions(force, angle, ends_of_rests)
    after = _edge_directions(force, angle, starts_of_rests)
    # the integrated noise of the gyro
    walk = np.trace(rests.noise) / 3 * rests.inflation * (step**2).sum(axis=1)
    return Turns(rate, sensed, step, before, after, np.sqrt(2 * sigma**2 + walk))


def _static_rate(rests: Poses, force: Series, force_at_gyro: Array) -> Array:
    """Bias and g-sensitivity of the rests alone, applied to the force at each sample, rad/s,
    (n, 3).
    """
    poses = [np.nanmean(force.between(s.start_s, s.end_s).values, axis=0) for s in rests.spans]
    design = np.column_stack([np.ones(len(poses)), np.array(poses)])
    coefficients = np.linalg.lstsq(design, rests.means, rcond=None)[0]
    return np.column_stack([np.ones(len(force_at_gyro)), force_at_gyro]) @ coefficients


def _integrated(rate: Series) -> Series:
    """The integral of a rate by the trapezoidal rule, 0 at the first sample."""
    middle = (rate.values[1:] + rate.values[:-1]) / 2
    steps = middle * np.diff(rate.time)[:, None]
    return Series(rate.time, np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]))


def _edge_directions(
    force: Series, angle: Series, spans: Iterable[tuple[float, float, float]]
) -> Array:
    """Mean direction of the force over short spans at the edges of rests, (m, 3).

    A hand is never quite at rest there: each sample is rotated to the instant of the edge by the
    integrated rate. Without that, the rotation inside the spans was the largest error of all on a
    real log (0.22 deg rms against 0.14 deg).

    Args:
        force: g.
        angle: integrated rate, rad.
        spans: start, end, and the instant to which the direction refers, s.
    """
    from scipy.spatial.transform import Rotation

    found = []
    for start, end, instant in spans:
        edge = force.between(start, end).known
        turned = angle.at(np.append(edge.time, instant))
        back = Rotation.from_rotvec(turned[:-1] - turned[-1])
        found.append(back.apply(edge.values).mean(axis=0))
    return np.array(found) / np.linalg.norm(found, axis=1)[:, None]


def propagated(turns: Turns, models: Sequence[GyroModel]) -> Array:
    """Gravity's direction at the end of each turn by the integrated rate of each model,
    (k, m, 3).
    """
    k = len(models)
    rates = np.concatenate([model.rate(turns.rate, turns.force) for model in models])
    rotations = _products(rates, np.tile(turns.step, (k, 1)))
    before = np.tile(turns.before, (k, 1))[:, :, None]
    return np.asarray(rotations @ before).reshape(k, len(turns), 3)


def _products(rate: Array, step: Array) -> Array:
    """Product of the rotations of all samples, newest first, (m, 3, 3), by halving."""
    from scipy.spatial.transform import Rotation

    # components in the body frame turn by minus the rate
    flat = -(rate * step[..., None]).reshape(-1, 3)
    R = np.asarray(Rotation.from_rotvec(flat).as_matrix()).reshape(*rate.shape[:2], 3, 3)
    while R.shape[1] > 1:
        if R.shape[1] % 2:
            R = np.concatenate([R, np.broadcast_to(np.eye(3), (len(R), 1, 3, 3))], axis=1)
        R = R[:, 1::2] @ R[:, ::2]
    return np.asarray(R[:, 0])


def turn_errors(turns: Turns, model: GyroModel) -> Array:
    """Angle between the propagated and the measured gravity direction after each turn, rad,
    (m,).
    """
    return angle_between(propagated(turns, [model])[0], turns.after)
