"""A hand-held log of a gyro triad and one FOG, as means over short blocks: rests, turns, and the
difference of the two sensors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG, G0
from tiltcal.effects.base import Effect
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import References, log_reader, references
from tiltcal.recordings.segmentation import Segment, dwells
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import CommonErrors

# s: means over it make the bias by the noise in H negligible (0.1 ppm; 1 ppm sample by sample)
BLOCK = 0.1
BIAS_SPAN = 10.0  # s, whose mean the patent takes for the bias


@dataclass(frozen=True)
class FieldLog:
    """Block means of a log, from its first rest to its end.

    Args:
        time: middle of each block, s, (n,).
        span: s each block stands for, (n,).
        rate: gyro reading, rad/s, (n, 3).
        fog: FOG reading, rad/s, (n,).
        force: specific force, g, (n, 3); None without an accelerometer triad.
        rest: number of the rest each block lies in, (n,), -1 while turning.
        axis: input axis of the FOG in the body frame, (3,).
        density: variance of ``axis . rate - fog`` times its averaging time, (rad/s)^2 s.
        bias: mean gyro reading and FOG reading of the first rest, rad/s, (4,).
        freedom: degrees of freedom behind ``density``.
    """

    time: Array
    span: Array
    rate: Array
    fog: Array
    force: Array | None
    rest: Index
    axis: Array
    density: float
    bias: Array
    freedom: float = 1e6

    @property
    def turned(self) -> Array:
        """Rate with the first rest's mean taken off, rad/s, (n, 3)."""
        return self.rate - self.bias[:3]

    @property
    def difference(self) -> Array:
        """``axis . rate - fog``, both without the first rest's means, rad/s, (n,): the
        Earth's rate cancels.
        """
        return np.asarray(self.turned @ self.axis - (self.fog - self.bias[3]))

    @property
    def variance(self) -> Array:
        """Variance of ``difference``, (n,)."""
        return self.density / self.span

    def angles(self) -> Array:
        """Angle turned about each axis, both ways added up, rad, (3,)."""
        moving = self.rest < 0
        return np.asarray((np.abs(self.turned) * self.span[:, None])[moving].sum(axis=0))


@dataclass(frozen=True)
class HandTurn:
    """A turn between two rests: its net angle about each axis, rad, and when it was made, s."""

    start: float
    end: float
    angle: Array

    def words(self) -> str:
        """``402 deg about +x``."""
        i = int(np.argmax(np.abs(self.angle)))
        return (
            f"{abs(self.angle[i]) / DEG:.0f} deg about {'+' if self.angle[i] > 0 else '-'}{AXES[i]}"
        )


def field_log(
    recording: Recording, setup: Setup, gyro: Sensor, fog: Sensor, segments: Sequence[Segment]
) -> FieldLog:
    """Blocks of BLOCK seconds of both sensors; blocks over a gap in either are left out.

    Raises:
        TiltcalError: no rest before the first turn, or no turn after it.
    """
    rests = dwells(segments)
    if not rests or not any(s.kind == "move" and s.start >= rests[0].end for s in segments):
        what = "no turn after a standstill" if rests else "no standstill"
        raise TiltcalError(
            recording.source,
            found=what,
            need=f"a standstill of 20 s (at least {BIAS_SPAN:.0f} s), then turns about x, y and z",
            do="let the instrument lie still, then turn it; look at `tiltcal segments`",
        )
    poses = find_poses(recording, setup, gyro, rests), find_poses(recording, setup, fog, rests)
    turned, reference = _series(recording, gyro), _series(recording, fog)
    edges = _edges(turned[0], reference[0], max(rests[0].start, turned[0][0], reference[0][0]))
    rate, whole = _block_means(*turned, edges)
    other, known = _block_means(*reference, edges)
    keep = whole & known
    time, span = ((edges[1:] + edges[:-1]) / 2)[keep], np.diff(edges)[keep]
    rest = _rest_numbers(edges, rests)[keep]
    triads = [s for s in setup.sensors("accelerometer") if len(s.axes) == 3 and recording.has(s)]
    force = None
    if triads:
        stamps, values = _series(recording, triads[0])
        force = np.column_stack([np.interp(time, stamps, values[:, i]) for i in range(3)]) / G0
    first = rest == 0
    bias = np.append(rate[keep][first].mean(axis=0), other[keep][first].mean())
    return FieldLog(
        time,
        span,
        rate[keep],
        other[keep][:, 0],
        force,
        rest,
        fog.input_vector,
        _density(poses, gyro, fog),
        bias,
        float(min(p.counts.sum() - len(p) for p in poses)),
    )


def log_references(
    log: FieldLog, recording: Recording, setup: Setup, gyro: Sensor, fog: Sensor
) -> References:
    """What uncertain references add to the readings of gyro and FOG in each block, rad/s,
    (q, n, 4).
    """
    if not setup.budget:
        return References()
    still = np.zeros_like(log.rate)
    by_kind = {"gyro": log.rate, "accelerometer": still if log.force is None else log.force * G0}
    readers = [log_reader(recording, setup, s, log.time, by_kind) for s in (gyro, fog)]

    def evaluate(where: Setup, effect: Effect | None) -> Array:
        return np.hstack([read(where, effect) for read in readers])

    return references(setup, evaluate, log.rest)


def errors_of_difference(log: FieldLog, uncertain: References) -> CommonErrors:
    """What uncertain references add to the difference of the two sensors, rad/s, (n, q)."""
    slopes = np.tile(np.append(log.axis, -1.0), (len(log.time), 1))
    found = uncertain.along(slopes)
    return replace(found, columns=found.columns - found.columns[log.rest == 0].mean(axis=0))


def hand_turns(log: FieldLog) -> list[HandTurn]:
    """The turns between standstills, in order."""
    moving = np.concatenate([[False], log.rest < 0, [False]])
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        angle = (log.turned[first:last] * log.span[first:last, None]).sum(axis=0)
        found.append(HandTurn(float(log.time[first]), float(log.time[last - 1]), angle))
    return [t for t in found if np.abs(t.angle).max() > 5 * DEG]


def _series(recording: Recording, sensor: Sensor) -> tuple[Array, Array]:
    """Stamps and complete readings of a sensor, SI."""
    samples = recording.sensor(sensor)
    complete = ~np.isnan(samples.values).any(axis=1)
    return samples.time[complete], samples.values[complete]


def _edges(gyro: Array, fog: Array, start: float) -> Array:
    """Block edges halfway between gyro stamps, so that every sample belongs to one block."""
    step = float(np.median(np.diff(gyro)))
    stride = max(round(max(BLOCK, float(np.median(np.diff(fog)))) / step), 1)
    middles = (gyro[1:] + gyro[:-1]) / 2
    middles = middles[middles >= start]
    return np.asarray(middles[::stride][: len(middles) // stride + 1])


def _block_means(time: Array, values: Array, edges: Array) -> tuple[Array, Mask]:
    """Means over the blocks, each sample standing for the time to halfway to its neighbours, (n,
    k); and which have no gap.
    """
    half = np.diff(time) / 2
    step = float(np.median(2 * half))
    bounds = np.concatenate([[time[0] - step / 2], time[:-1] + half, [time[-1] + step / 2]])
    total = np.vstack(
        [np.zeros(values.shape[1]), np.cumsum(values * np.diff(bounds)[:, None], axis=0)]
    )
    at = np.column_stack([np.interp(edges, bounds, total[:, i]) for i in range(values.shape[1])])
    gaps = np.concatenate([[0], np.cumsum(np.diff(bounds) > 2.5 * step)])
    seen = gaps[np.clip(np.searchsorted(bounds, edges), 0, len(gaps) - 1)]
    inside = (edges[:-1] >= bounds[0]) & (edges[1:] <= bounds[-1])
    return np.diff(at, axis=0) / np.diff(edges)[:, None], inside & (np.diff(seen) == 0)


def _rest_numbers(edges: Array, rests: Sequence[Segment]) -> Index:
    """Number of the rest each block lies in wholly, -1 elsewhere."""
    number = np.full(len(edges) - 1, -1, dtype=np.intp)
    for k, s in enumerate(rests):
        number[(edges[:-1] >= s.start - 1e-9) & (edges[1:] <= s.end + 1e-9)] = k
    return number


def _density(poses: tuple[Poses, Poses], gyro: Sensor, fog: Sensor) -> float:
    """Noise of ``axis . rate - fog``: variance of a sample times its interval, both sensors."""
    u = fog.input_vector
    triad = float(u @ poses[0].noise @ u) * poses[0].inflation / gyro.rate_hz
    return triad + float(poses[1].noise[0, 0]) * poses[1].inflation / fog.rate_hz


def rests_with_motion(
    recording: Recording, setup: Setup, fog: Sensor, rests: Sequence[Segment]
) -> list[tuple[Segment, float]]:
    """Rests during which the instrument turned according to the FOG, with the rate, rad/s.

    The means of consecutive quarters of a rest must agree within five sigmas of the FOG's noise,
    and the mean must not exceed the Earth's rate and the bias of a FOG (60 deg/h).
    """
    poses = find_poses(recording, setup, fog, rests)
    time, values = _series(recording, fog)
    sample = float(np.sqrt(poses.noise[0, 0] * poses.inflation))
    found = []
    for s in rests:
        part = values[(time >= s.start) & (time <= s.end), 0]
        if len(part) < 8:
            continue
        quarters = np.array([q.mean() for q in np.array_split(part, 4)])
        limit = 5 * sample * np.sqrt(2 * 4 / len(part))
        worst = max((abs(b - a) for a, b in pairwise(quarters)), default=0.0)
        mean = abs(float(part.mean()))
        if worst > limit or mean > 60 * DEG / 3600:
            found.append((s, max(worst, mean)))
    return found
