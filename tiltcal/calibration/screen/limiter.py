"""Channels that stay at one reading while the table turns: a limiter, ahead of the noise."""

import numpy as np

from tiltcal.calibration.validity import SIGNIFICANCE, Test
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.frames import force_of_tilt
from tiltcal.effects.sense import ACCELEROMETERS
from tiltcal.forward.kinematics import closed_form
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

BLOCK = 20  # samples whose scatter is their noise: the middle one of all blocks is at standstill
LEAST = 21  # samples away from the extreme: three for each coefficient
NEAR = 8.0  # sigmas of a sample from its extreme: it is at the limit, within 4 each side


def limiter_tests(recording: Recording, setup: Setup, sensor: Sensor) -> list[Test]:
    """Whether a channel of an accelerometer or inclinometer keeps to its extreme where the readout
    of the table says that gravity along it changes. Nothing without a readout.

    The samples away from the extremes give what the channel reads in each attitude, as a constant
    and the components of up and north, so that a base that is not level is one of the attitudes;
    those at an extreme are held against it.
    """
    names = setup.rig.axis_names
    read = [recording.table(a) for a in names]
    still = not names or any(r is None or bool(np.isnan(r).all()) for r in read)
    if still or isinstance(recording, MeansTable) or sensor.kind not in ACCELEROMETERS:
        return []
    drive = replay(recording, setup).drive(recording.time)
    motion = closed_form(setup.seen_by(sensor), drive)
    attitude = np.hstack([motion.up, motion.north])
    samples = recording.sensor(sensor)
    known = drive.known[samples.rows]
    values, attitude = samples.values[known], attitude[samples.rows][known]
    if sensor.kind == "inclinometer":
        values = force_of_tilt(values, setup.site.gravity)
    found = [_of_channel(values[:, i], attitude) for i in range(values.shape[1])]
    worst = min(range(len(found)), key=lambda i: found[i][0])
    p, spread, limit = found[worst]
    p = min(1.0, p * len(found))
    words = "no channel keeps to its extreme while gravity along it changes"
    if p <= SIGNIFICANCE:
        words = (
            f"{sensor.name}_{sensor.axes[worst]} keeps to {limit:.5g} m/s2 while gravity along it"
            f" changes by {spread:.3g} m/s2: saturated, a limiter ahead of the noise"
        )
    name = f"{sensor.name} not limited"
    return [Test(name, spread, 0, p, p > SIGNIFICANCE, words)]


def _of_channel(values: Array, attitude: Array) -> tuple[float, float, float]:
    """The p-value that a channel follows gravity at its extremes, by how much this changes while
    the channel keeps to one of them, m/s2, and that extreme.

    Args:
        values: readings, m/s2, (n,).
        attitude: up and north in the body frame, (n, 6).
    """
    complete = ~np.isnan(values)
    values, design = (
        values[complete],
        np.column_stack([np.ones(complete.sum()), attitude[complete]]),
    )
    none = (1.0, 0.0, float("nan"))
    blocks = values[: len(values) // BLOCK * BLOCK].reshape(-1, BLOCK)
    if not len(blocks):
        return none
    sigma = float(np.median(blocks.std(axis=1, ddof=1)))
    ends: list[tuple[Mask, float]] = [
        (np.abs(values - end) <= NEAR * sigma, float(end)) for end in (values.max(), values.min())
    ]
    apart = ~(ends[0][0] | ends[1][0])
    if sigma <= 0 or apart.sum() < LEAST or np.linalg.matrix_rank(design[apart]) < 2:
        return none
    fit, _, rank, _ = np.linalg.lstsq(design[apart], values[apart], rcond=None)
    left = values[apart] - design[apart] @ fit
    scatter = float(np.sqrt(left @ left / (apart.sum() - rank)))
    freedom = int(apart.sum() - rank)
    return min(_kept(design[rows] @ fit, scatter, sigma, end, freedom) for rows, end in ends)


def _kept(
    predicted: Array, scatter: float, sigma: float, end: float, freedom: int
) -> tuple[float, float, float]:
    """By Student's t: is the spread of what is predicted where the readings keep to an extreme more
    than these allow? freedom: of the scatter.
    """
    from scipy.special import stdtr

    spread = float(np.ptp(predicted))
    beyond = max(spread - NEAR * sigma, 0.0) / (np.sqrt(2) * np.hypot(scatter, sigma))
    p = len(predicted) ** 2 * float(stdtr(freedom, -beyond)) if len(predicted) else 1.0
    return min(p, 1.0), spread, end
