"""A north-seeker on a vertical table: dwell means of FOG and accelerometers, and the fit of heading
and tilt.
"""

from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.reversal import attitudes
from tiltcal.core.arrays import Array
from tiltcal.core.frames import earth_rate
from tiltcal.core.units import DEG, EARTH_RATE
from tiltcal.recordings.references import References
from tiltcal.statistics.least_squares import CommonErrors, Fit, gauss_newton

# chi-square by which a second heading has to be worse: 0.1 % of one degree of freedom
RIVAL = 10.83
GRID = np.arange(0, 360, 1.0) * DEG


@dataclass(frozen=True)
class Turntable:
    """Means of the dwells on a vertical table.

    Args:
        angles: of the table, rad, (m,).
        mount: R_mount, (3, 3).
        axis: of the FOG, body frame, (3,).
        fog: mean rates, rad/s, (m,); fog_whiten: W with ``W C W' = 1`` of their covariance, (m, m).
        force: mean forces of x and y, m/s2, (m, 2), and their whitening (m, 2, 2); None without
            accelerometers.
        gravity: m/s2; latitude: rad.
        names: of the FOG and of the accelerometers.
        references: what uncertain references add to the FOG's means, and to those of x and y.
    """

    angles: Array
    mount: Array
    axis: Array
    fog: Array
    fog_whiten: Array
    force: tuple[Array, Array] | None
    gravity: float
    latitude: float
    names: tuple[str, str]
    references: tuple[References, References] = (References(), References())

    @property
    def common(self) -> CommonErrors:
        """What uncertain references add to the residuals, in their order."""
        fog, level = self.references
        found = fog.along(np.ones((len(self.fog), 1))).times(self.fog_whiten)
        if self.force is None:
            return found
        others = level.whitened(self.force[1])
        return replace(found, columns=np.concatenate([found.columns, others.columns]))

    def input_axes(self, roll: float, pitch: float) -> Array:
        """The FOG's axis in the table's world at each dwell, (m, 3)."""
        return attitudes(roll, pitch, self.angles, self.mount) @ self.axis

    def azimuth(self, heading: float, roll: float, pitch: float) -> float:
        """Azimuth of body x at outer = 0, clockwise from true north, rad in 0..2 pi: of its
        horizontal projection.
        """
        x = attitudes(roll, pitch, np.zeros(1), self.mount)[0][:, 0]
        return float((heading + np.arctan2(x[0], x[1])) % (2 * np.pi))


def start_of(table: Turntable) -> tuple[float, float, float, list[float]]:
    """Roll and pitch by linear reversal, the best heading, and all headings that the FOG cannot
    distinguish from it.
    """
    roll = pitch = 0.0
    if table.force is not None:
        means, _ = table.force
        level = attitudes(0.0, 0.0, table.angles, table.mount)
        columns = np.array([np.hstack([R.T[:2, :2], np.eye(2)]) for R in level])
        # horizontal force, base frame
        u = np.linalg.lstsq(columns.reshape(-1, 4), means.ravel(), rcond=None)[0][:2]
        roll = float(np.arcsin(np.clip(u[1] / table.gravity, -1, 1)))
        pitch = float(-np.arcsin(np.clip(u[0] / (table.gravity * np.cos(roll)), -1, 1)))
    axes = table.input_axes(roll, pitch)
    cost = _profile(table, axes, GRID)
    lowest = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost < np.roll(cost, -1)))
    if not len(lowest):  # the same at every heading: the FOG's axis is vertical, or sees nothing
        lowest = np.array([int(np.argmin(cost))])
    headings = [_refined(table, axes, float(GRID[k])) for k in lowest]
    cost = _profile(table, axes, np.array(headings))
    best = headings[int(np.argmin(cost))]
    rivals = [h for h, c in zip(headings, cost, strict=True) if c < cost.min() + RIVAL]
    return roll, pitch, best, rivals


def _profile(table: Turntable, axes: Array, headings: Array) -> Array:
    """Chi-square of the FOG's means at each heading with the best bias, (h,). axes: of the FOG at
    each dwell, (m, 3).
    """
    across = EARTH_RATE * np.cos(table.latitude)
    north, west = np.cos(headings)[:, None], -np.sin(headings)[:, None]
    rate = across * (axes[:, 1] * north + axes[:, 0] * west)
    rate += EARTH_RATE * np.sin(table.latitude) * axes[:, 2]
    weight = table.fog_whiten.sum(axis=1)
    left = (table.fog - rate) @ table.fog_whiten.T  # (h, m)
    bias = left @ weight / (weight @ weight)
    return np.asarray(((left - bias[:, None] * weight) ** 2).sum(axis=1))


def _refined(table: Turntable, axes: Array, heading: float) -> float:
    """The minimum near a grid point, by parabolas through three points."""
    h = (GRID[1] - GRID[0]) / 2
    for _ in range(6):
        a, b, c = _profile(table, axes, heading + h * np.array([-1.0, 0.0, 1.0]))
        curvature = a - 2 * b + c
        if curvature <= 0:
            break
        heading += float(np.clip(h * (a - c) / (2 * curvature), -4 * h, 4 * h))
        h /= 4
    return heading


def solve(table: Turntable, heading: float, roll: float, pitch: float) -> tuple[Fit, bool]:
    """Heading, bias and (with accelerometers) tilt and their constants together; the heading is
    returned as azimuth. heading, roll, pitch: to start from, rad.
    """
    names = ["base.azimuth", f"{table.names[0]}.bias_a"]
    if table.force is not None:
        names += ["base.roll", "base.pitch", *(f"{table.names[1]}.bias_{a}" for a in "xy")]
    rate = table.input_axes(roll, pitch) @ earth_rate(table.latitude, heading)
    start = [heading, float(np.mean(table.fog - rate))]
    if table.force is not None:
        turned = attitudes(roll, pitch, table.angles, table.mount)
        start += [roll, pitch, *(table.force[0] - table.gravity * turned[:, 2, :2]).mean(axis=0)]
    steps = np.array([1e-4, 1e-8, 1e-4, 1e-4, 1e-3, 1e-3])[: len(names)]

    def problem(x: Array) -> tuple[Array, Array]:
        up = np.array([_residual(table, x + s) for s in np.diag(steps)])
        down = np.array([_residual(table, x - s) for s in np.diag(steps)])
        return _residual(table, x), ((up - down) / (2 * steps[:, None])).T

    fit, converged = gauss_newton(names, np.array(start), problem, common=table.common, limit=20)
    if "base.azimuth" not in fit.names:
        return fit, False
    values = fit.values.copy()
    tilted = (fit.value("base.roll"), fit.value("base.pitch"))
    values[0] = table.azimuth(float(fit.values[0]), *tilted)
    return replace(fit, values=values), converged


def _residual(table: Turntable, x: Array) -> Array:
    """Whitened residuals of all dwells: FOG, then x and y forces. x: heading, bias, and roll,
    pitch, two constants.
    """
    roll, pitch = (float(x[2]), float(x[3])) if table.force is not None else (0.0, 0.0)
    turned = attitudes(roll, pitch, table.angles, table.mount)
    rate = (turned @ table.axis) @ earth_rate(table.latitude, float(x[0]))
    found = [table.fog_whiten @ (table.fog - x[1] - rate)]
    if table.force is not None:
        means, whiten = table.force
        left = means - x[4:6] - table.gravity * turned[:, 2, :2]
        found.append(np.einsum("mij,mj->mi", whiten, left).ravel())
    return np.concatenate(found)
