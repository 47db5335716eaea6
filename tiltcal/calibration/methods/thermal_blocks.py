"""Readings over temperature: the temperature at every row, the stretches at rest, their blocks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.thermal_model import FOLDS, Blocks, Design
from tiltcal.calibration.screen.causes import Misfit, lacking_terms, part_words
from tiltcal.calibration.validity import Test, chi2_test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import force_of_tilt
from tiltcal.core.units import G0
from tiltcal.effects.sense import Sense
from tiltcal.instrument.temperature import held
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import References
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.static_poses import find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.dwell_noise import pooled_noise
from tiltcal.statistics.noise_spectrum import most_slow_variance

MOST_BLOCKS = 1500
LEAST_BLOCKS = 4 * FOLDS
LEAST_RANGE = 2.0  # degC
MOST_POSES = 60  # unknown attitudes, each with its own constant


def temperature_of(recording: Recording) -> Array:
    """Temperature at every row, degC, the last reading held where there is none. (n,).

    Raises:
        TiltcalError: the recording has no temperature.
    """
    column = recording.channel("temperature")
    values = None if column is None else held(recording.column(column))
    span = 0.0 if values is None else float(np.ptp(values))
    if values is None or not np.isfinite(span) or span < LEAST_RANGE:
        found = "no temperature" if values is None else f"a temperature over {span:.3g} degC"
        raise TiltcalError(
            recording.source,
            found=found,
            need=f"a column temperature_degC over {LEAST_RANGE:g} degC or more",
            do="record warming and cooling",
        )
    return values


def stretches_at_rest(
    recording: Recording, segments: Sequence[Segment] | None
) -> tuple[list[Segment], list[str]]:
    """Dwells; the whole recording where less than half of it is found at rest."""
    recording.require_increasing()
    found = dwells(find_segments(recording) if segments is None else segments)
    rows = sum(s.last - s.first for s in found)
    if segments is not None or 2 * rows >= len(recording):
        return found, []
    start, end = float(recording.time[0]), float(recording.time[-1])
    labels = recording.labels
    label = None if labels is None else next((w for w in labels if w), None)
    whole = Segment(start, end, 0, len(recording), "dwell", label)
    return [whole], ["no dwells are found: the whole recording is taken as one attitude"]


def blocks_of(
    recording: Recording, setup: Setup, sensor: Sensor, stretches: Sequence[Segment]
) -> tuple[Blocks, bool]:
    """Block means of a sensor, less the force where attitudes are known.

    Raises:
        TiltcalError: no stretch is long enough for a block.
    """
    samples = recording.sensor(sensor)
    values = samples.values
    if sensor.kind == "inclinometer":
        values = force_of_tilt(values, setup.site.gravity)
    full = np.full((len(recording), values.shape[1]), np.nan)
    full[samples.rows] = values
    size = max(sum(s.last - s.first for s in stretches) // MOST_BLOCKS, 3)
    cut = [(p, r, r + size) for p, s in enumerate(stretches) for r in range(s.first, s.last, size)]
    rows = np.array([(a, min(b, stretches[p].last)) for p, a, b in cut], dtype=np.intp)
    pose = np.array([p for p, _, _ in cut], dtype=np.intp)
    means = np.array([_mean(full[a:b]) for a, b in rows])
    good = ~np.isnan(means).any(axis=1)
    rows, pose, means = rows[good], pose[good], means[good]
    if len(means) < LEAST_BLOCKS:
        raise TiltcalError(
            recording.source,
            found=f"{len(means)} blocks of readings of {sensor.name}",
            need=f"{LEAST_BLOCKS} or more",
            do="record longer",
        )
    time = recording.time[rows[:, 0]]
    rate = sensor.quantity == "rate"
    poses = find_poses(recording, setup, sensor, stretches) if setup.budget or not rate else None
    uncertain = References()
    if poses is not None and len(poses) == len(stretches):
        uncertain = poses.references.at(pose)
    if poses is None or rate:
        return Blocks(means, None, np.zeros_like(pose), rows, time, uncertain), True
    up = poses.up
    force = setup.site.gravity * up[pose] if len(up) == len(stretches) else None
    if force is None or np.isnan(force).any():
        number = np.unique(pose, return_inverse=True)[1]
        if number.max() >= MOST_POSES:
            number = np.zeros_like(number)
        return Blocks(means, None, number, rows, time, uncertain), False
    error = means - force[:, list(sensor.axis_indices)]
    spans = np.linalg.matrix_rank(np.column_stack([np.ones(len(up)), up]), tol=0.1) == 4
    force = force / G0 if spans else None
    return Blocks(error, force, np.zeros_like(pose), rows, time, uncertain), True


@dataclass(frozen=True)
class BlockFit:
    """How well blocks were fitted.

    Args:
        sensor: which.
        chi2, dof: of the residuals against white noise.
        allowed: variance of a block by white noise and the most flicker which the samples allow,
            over that by white noise.
        worst: the stretch with the largest residual, s, and its rms residual over its noise.
        sigma: standard deviation of each block by white noise, SI, (n, k).
    """

    sensor: str
    chi2: float
    dof: int
    allowed: float
    worst: tuple[float, float, float]
    sigma: Array

    def test(self) -> Test:
        """Do the residuals stay within the noise?"""
        found = chi2_test(f"fit of {self.sensor}", self.chi2 / self.allowed, self.dof, "")
        words = f"residuals of {self.sensor} against the noise of the means"
        if not found.passed:
            start, end, ratio = self.worst
            words += (
                f": {np.sqrt(self.chi2 / self.dof):.3g} times it; the largest from {start:.6g} to"
                f" {end:.6g} s, {ratio:.3g} times"
            )
        return replace(found, statement=words)


def fit_over_blocks(
    recording: Recording, setup: Setup, sensor: Sensor, blocks: Blocks, left: Array, rank: int
) -> BlockFit:
    """How well the blocks of a sensor were fitted.

    Args:
        recording: that they are of.
        setup: of the recording.
        sensor: which.
        blocks: fitted.
        left: their residuals, SI, (n, k).
        rank: number of parameters that were fitted to all channels.
    """
    samples = recording.sensor(sensor)
    full = np.full((len(recording), left.shape[1]), np.nan)
    full[samples.rows] = (
        force_of_tilt(samples.values, setup.site.gravity)
        if sensor.kind == "inclinometer"
        else samples.values
    )
    within = []
    for a, b in blocks.rows:
        part = full[a:b][~np.isnan(full[a:b]).any(axis=1)]
        within.append(part - part.mean(axis=0))
    counts = np.array([len(part) for part in within], dtype=float)
    white = np.maximum(np.diag(pooled_noise(within)[0]), 1e-30)
    sigma = np.sqrt(white / counts[:, None])
    scaled = (left / sigma) ** 2
    series = [part + r for part, r in zip(within, left, strict=True)]
    stretch = np.cumsum(np.diff(blocks.rows[:, 0], prepend=blocks.rows[0, 0]) > blocks.size)
    parts = [
        np.concatenate([series[i] for i in np.flatnonzero(stretch == k)])
        for k in np.unique(stretch)
    ]
    length = int(blocks.rows[-1, 1] - blocks.rows[0, 0])
    slow = np.array(
        [
            most_slow_variance([p[:, i] - p[:, i].mean() for p in parts], counts, length).mean()
            for i in range(len(white))
        ]
    )
    allowed = 1 + float(np.mean(slow * counts.mean() / white))
    by_stretch = [float(np.sqrt(scaled[stretch == k].mean())) for k in np.unique(stretch)]
    k = int(np.argmax(by_stretch))
    rows = blocks.rows[stretch == k]
    time = recording.time
    worst = (float(time[rows[0, 0]]), float(time[rows[-1, 1] - 1]), by_stretch[k])
    dof = max(left.size - rank, 1)
    return BlockFit(sensor.name, float(scaled.sum()), dof, allowed, worst, sigma)


def misfit_of_blocks(
    sensor: Sensor, setup: Setup, blocks: Blocks, fit: BlockFit, left: Array, widest: Design
) -> Misfit:
    """What a fit of blocks leaves.

    Args:
        sensor: that was read.
        setup: of the recording.
        blocks: that were fitted.
        fit: how well.
        left: residuals, SI, (n, k).
        widest: columns of the widest model, so that its choice cannot hide a cause.
    """
    n, k = left.shape
    force = np.zeros((n, 3)) if blocks.force is None else blocks.force * G0
    sense = Sense.at_rest(sensor, setup.site.gravity, force)
    sense = replace(sense, time=blocks.time, elapsed=blocks.time - blocks.time[0])
    inputs = force[:, list(sensor.axis_indices)] if sensor.quantity != "rate" else np.zeros((n, k))
    each = np.einsum("np,ij,ni->nipj", widest.X, np.eye(k), 1 / fit.sigma)
    design = each[:, :, widest.allowed(k)].reshape(n * k, -1)
    new = np.diff(blocks.rows[:, 0], prepend=blocks.rows[0, 0]) > blocks.size
    part = np.cumsum(new, dtype=np.intp)
    ends = [blocks.time[part == i][[0, -1]] for i in range(part[-1] + 1)]
    return Misfit(
        [f"{sensor.name}_{a}" for a in sensor.axes],
        blocks.time,
        blocks.error + inputs,
        inputs,
        fit.sigma,
        part,
        [part_words("stretch", *each) for each in ends],
        (left / fit.sigma).ravel(),
        design,
        lambda errors: (errors / fit.sigma).reshape(len(errors), -1).T,
        lacking_terms(sensor, sense),
        fit.allowed,
    )


def _mean(values: Array) -> Array:
    known = ~np.isnan(values).any(axis=1)
    return values[known].mean(axis=0) if known.any() else np.full(values.shape[1], np.nan)
