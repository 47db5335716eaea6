"""S4's north-seeker: azimuth from the Earth's rate that a FOG sees at two, four or more positions
of a vertical table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tiltcal.calibration.methods.common import pick_sensor, wrap_up
from tiltcal.calibration.methods.reversal import attitudes, dwell_angles, mount_of, require_vertical
from tiltcal.calibration.methods.reversal_faults import Reversal, explain
from tiltcal.calibration.methods.screening import require_unsaturated
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import earth_rate
from tiltcal.core.units import ARCSEC, DEG, EARTH_RATE
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, gauss_newton

NAME = "north"
RIVAL = (
    10.83  # chi-square by which a second azimuth has to be worse: 0.1 % of one degree of freedom
)
GRID = np.arange(0, 360, 1.0) * DEG
POLE = 85 * DEG


@dataclass(frozen=True)
class Turntable:
    """What the dwells say.

    Args:
        angles: of the table, rad, (m,).
        mount: R_mount, (3, 3).
        axis: of the FOG, body frame, (3,).
        fog: mean rates, rad/s, (m,); fog_sigma: their standard deviations.
        force: mean forces of x and y, m/s2, (m, 2), and their whitening (m, 2, 2); None without
            accelerometers.
        gravity: m/s2; latitude: rad.
        names: of the FOG and of the accelerometers.
    """

    angles: Array
    mount: Array
    axis: Array
    fog: Array
    fog_sigma: Array
    force: tuple[Array, Array] | None
    gravity: float
    latitude: float
    names: tuple[str, str]

    def input_axes(self, roll: float, pitch: float) -> Array:
        """The FOG's axis in the table's world at each dwell, (m, 3)."""
        return attitudes(roll, pitch, self.angles, self.mount) @ self.axis

    def azimuth(self, heading: float, roll: float, pitch: float) -> float:
        """Azimuth of body x at outer = 0, clockwise from true north, rad in 0..2 pi: of its
        horizontal projection.
        """
        x = attitudes(roll, pitch, np.zeros(1), self.mount)[0][:, 0]
        return float((heading + np.arctan2(x[0], x[1])) % (2 * np.pi))


def north(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    level: str | None = None,
    tilt: bool = True,
    near_deg: float | None = None,
) -> Calibration:
    """Azimuth of the instrument, and with accelerometers on the same table the tilt of its base,
    from the same turn.

    Model: ``fog = b + u . R_wb' W``, ``force = c + P R_wb' (0, 0, g)``, ``R_wb = Rx(roll) Ry(pitch)
    Rz(outer) R_mount``; W is the Earth's rate in a world turned by the unknown heading. All dwells
    and both sensors are fitted together.

    Args:
        recording: dwells at two positions half a turn apart, better four a quarter turn apart.
        setup: table ``vertical``, site with latitude (its heading is not used), a FOG, an
            accelerometer or inclinometer with x, y.
        segments: dwells to use.
        sensor: which FOG, when several fit.
        level: which accelerometer, when several fit.
        tilt: False leaves the tilt correction out.
        near_deg: azimuth known beforehand to some 60 deg (a compass): decides between the two that
            two positions leave.

    Raises:
        TiltcalError: another table, no latitude or one near a pole, one position only.

    Errors:
        Two positions give the azimuth's cosine only, and nothing near north: sigma = N / (sqrt(2 T)
        Omega cos(lat) |sin psi|).
        A tilt left out, e along the FOG's axis, costs tan(lat)/|sin psi| e; the FOG's axis out of
        the table's plane is bias.

    Source: seed S4 (Transducer and Microsystem Technologies 2009 28(12) p. 86); PHYSICS 6 (4).
    """
    require_vertical(setup, NAME, "use a table that turns about Up")
    fog = pick_sensor(setup, recording, ("fog",), sensor, NAME)
    require_unsaturated(recording, fog)
    found = list(find_segments(recording)) if segments is None else dwells(segments)
    table, poses = _turntable(
        recording, setup, fog, _level(recording, setup, level) if tilt else None, found
    )
    roll, pitch, heading, rivals = start_of(table)
    if near_deg is not None:
        heading = min(
            rivals, key=lambda h: abs(_wrapped(table.azimuth(h, roll, pitch) - near_deg * DEG))
        )
    fit, converged = solve(table, heading, roll, pitch)
    tests = _tests(table, fit, rivals, roll, pitch)
    sure = len(rivals) == 1 or near_deg is not None
    notes = _notes(table, fit, rivals, sure, roll, pitch)
    units = [
        "rad_s" if n.startswith(fog.name) else "rad" if n.startswith("base.") else "m_s2"
        for n in fit.names
    ]
    return wrap_up(
        NAME,
        verdict_of(tests, sure and converged and not fit.dropped),
        fit,
        units,
        tests,
        notes,
        poses,
        recording,
        equation=(
            f"{fog.name} = bias + u . R_wb' W(azimuth), R_wb = Rx(roll) Ry(pitch) Rz(outer) R_mount"
        ),
        inverse="rate = reading - bias",
    )


def _level(recording: Recording, setup: Setup, name: str | None) -> Sensor | None:
    """The sensor that sees the tilt; None when there is none with x and y."""
    kinds = ("accelerometer", "inclinometer")
    if name is not None:
        return pick_sensor(setup, recording, kinds, name, NAME)
    fitting = [s for s in setup.sensors(*kinds) if recording.has(s) and {"x", "y"} <= set(s.axes)]
    for sensor in fitting[:1]:
        require_unsaturated(recording, sensor)
    return fitting[0] if fitting else None


def _turntable(
    recording: Recording,
    setup: Setup,
    fog: Sensor,
    level: Sensor | None,
    segments: Sequence[Segment],
) -> tuple[Turntable, Poses]:
    if setup.site.latitude_deg is None or abs(setup.site.latitude_deg) * DEG > POLE:
        found = (
            "no latitude"
            if setup.site.latitude_deg is None
            else f"latitude {setup.site.latitude_deg:g} deg"
        )
        raise TiltcalError(
            "site", found=found, need="one within 85 deg of the equator", do="state latitude_deg"
        )
    poses = find_poses(recording, setup, fog, segments)
    angles = dwell_angles(poses, recording)
    sigma = np.sqrt([poses.covariance(k)[0, 0] for k in range(len(poses))])
    force = None
    if level is not None:
        seen = find_poses(recording, setup, level, segments)
        if len(seen) != len(poses):
            raise TiltcalError(
                recording.source,
                found=f"{len(seen)} dwells of {level.name} and {len(poses)} of {fog.name}",
                need="both sensors at every position",
                do="record both throughout",
            )
        ij = [level.axes.index(a) for a in ("x", "y")]
        whiten = [
            np.linalg.inv(np.linalg.cholesky(seen.covariance(k)[np.ix_(ij, ij)]))
            for k in range(len(seen))
        ]
        force = seen.means[:, ij], np.array(whiten)
    table = Turntable(
        angles,
        mount_of(recording, setup),
        fog.input_vector,
        poses.means[:, 0],
        sigma,
        force,
        setup.site.gravity,
        setup.site.latitude_deg * DEG,
        (fog.name, "" if level is None else level.name),
    )
    return table, poses


def start_of(table: Turntable) -> tuple[float, float, float, list[float]]:
    """Roll and pitch by linear reversal, the best heading, and all headings that the FOG cannot
    tell from it.
    """
    roll = pitch = 0.0
    if table.force is not None:
        means, _ = table.force
        columns = np.array(
            [
                np.hstack([R.T[:2, :2], np.eye(2)])
                for R in attitudes(0.0, 0.0, table.angles, table.mount)
            ]
        )
        # horizontal force, base frame
        u = np.linalg.lstsq(columns.reshape(-1, 4), means.ravel(), rcond=None)[0][:2]
        roll = float(np.arcsin(np.clip(u[1] / table.gravity, -1, 1)))
        pitch = float(-np.arcsin(np.clip(u[0] / (table.gravity * np.cos(roll)), -1, 1)))
    axes = table.input_axes(roll, pitch)
    cost = _profile(table, axes, GRID)
    lowest = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost < np.roll(cost, -1)))
    headings = [_refined(table, axes, float(GRID[k])) for k in lowest]
    worth = _profile(table, axes, np.array(headings))
    best = int(np.argmin(worth))
    return (
        roll,
        pitch,
        headings[best],
        [h for h, c in zip(headings, worth, strict=True) if c < worth[best] + RIVAL],
    )


def _profile(table: Turntable, axes: Array, headings: Array) -> Array:
    """Chi-square of the FOG's means at each heading with the best bias, (h,). axes: of the FOG at
    each dwell, (m, 3).
    """
    across = EARTH_RATE * np.cos(table.latitude)
    rate = across * (
        axes[:, 1] * np.cos(headings)[:, None] - axes[:, 0] * np.sin(headings)[:, None]
    )
    rate += EARTH_RATE * np.sin(table.latitude) * axes[:, 2]
    weight = 1 / table.fog_sigma
    left = (table.fog - rate) * weight  # (h, m)
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
    then named as azimuth.
    """
    names = ["base.azimuth", f"{table.names[0]}.bias_a"]
    if table.force is not None:
        names += ["base.roll", "base.pitch", *(f"{table.names[1]}.bias_{a}" for a in "xy")]
    bias = float(
        np.mean(table.fog - table.input_axes(roll, pitch) @ earth_rate(table.latitude, heading))
    )
    start = [heading, bias]
    if table.force is not None:
        turned = attitudes(roll, pitch, table.angles, table.mount)
        start += [roll, pitch, *(table.force[0] - table.gravity * turned[:, 2, :2]).mean(axis=0)]
    steps = np.array([1e-4, 1e-8, 1e-4, 1e-4, 1e-3, 1e-3])[: len(names)]

    def problem(x: Array) -> tuple[Array, Array]:
        slopes = [
            (_residual(table, x + s) - _residual(table, x - s)) / (2 * s.sum())
            for s in np.diag(steps)
        ]
        return _residual(table, x), np.array(slopes).T

    fit, converged = gauss_newton(names, np.array(start), problem, limit=20)
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
    found = [(table.fog - x[1] - rate) / table.fog_sigma]
    if table.force is not None:
        means, whiten = table.force
        left = means - x[4:6] - table.gravity * turned[:, 2, :2]
        found.append(np.einsum("mij,mj->mi", whiten, left).ravel())
    return np.concatenate(found)


def _tests(
    table: Turntable, fit: Fit, rivals: list[float], roll: float, pitch: float
) -> list[Test]:
    tests = []
    if fit.dof > 0:
        test = chi2_test(
            "fit", fit.chi2, fit.dof, f"{len(table.angles)} positions agree within their noise"
        )
        if not test.passed and table.force is not None:
            why = (
                explain(Reversal(*table.force, table.angles, table.mount))
                or "the tilts repeat, or no single fault explains them"
            )
            test = replace(
                test,
                statement=f"{len(table.angles)} positions do not agree within their noise; {why}",
            )
        tests.append(test)
    axes = table.input_axes(roll, pitch)
    design = (
        np.column_stack([np.ones(len(axes)), axes[:, 0], axes[:, 1]]) / table.fog_sigma[:, None]
    )
    if len(axes) > 2 and np.linalg.cond(design / np.linalg.norm(design, axis=0)) < 30:
        target = (table.fog - axes[:, 2] * EARTH_RATE * np.sin(table.latitude)) / table.fog_sigma
        x = np.linalg.lstsq(design, target, rcond=None)[0]
        C = np.linalg.inv(design.T @ design)[1:, 1:]
        size = float(np.hypot(x[1], x[2]))
        sigma = float(np.sqrt(x[1:] @ C @ x[1:])) / size
        expected = EARTH_RATE * np.cos(table.latitude)
        words = (
            f"the horizontal Earth rate is {size / expected:.4f} +- {sigma / expected:.4f} of what"
            " the latitude says"
        )
        tests.append(chi2_test("horizontal Earth rate", ((size - expected) / sigma) ** 2, 1, words))
    sigma_azimuth = (
        float(np.sqrt(fit.covariance[0, 0])) if fit.names[:1] == ("base.azimuth",) else np.inf
    )
    # near north the two that share a cosine meet
    apart = [abs(_wrapped(h - k)) for h, k in combinations(rivals, 2)]
    enough = sigma_azimuth < min([5 * DEG, *(gap / 6 for gap in apart)])
    words = f"azimuth known to {sigma_azimuth / DEG:.2g} deg" + (
        "" if enough else ": stay longer, or turn the FOG's axis off north"
    )
    tests.append(Test("resolution", min(sigma_azimuth / DEG, 1e6), 0, float(enough), enough, words))
    return tests


def _notes(
    table: Turntable, fit: Fit, rivals: list[float], sure: bool, roll: float, pitch: float
) -> list[str]:
    notes = []
    if not sure:
        others = " or ".join(f"{table.azimuth(h, roll, pitch) / DEG:.4g} deg" for h in rivals)
        notes.append(
            f"the sign cannot be told: azimuth {others}. Two positions give its cosine only: record"
            " at 90 and 270 deg too, or say --option near_deg=..."
        )
    if table.force is None:
        worst = np.tan(abs(table.latitude))
        notes.append(
            "no tilt correction: each arcsec of tilt along the FOG's axis costs up to"
            f" {worst:.2g}/|sin psi| arcsec of azimuth"
        )
        return notes
    flat = replace(table, force=None)
    heading = min(
        start_of(flat)[3], key=lambda h: abs(_wrapped(flat.azimuth(h, 0, 0) - fit.values[0]))
    )
    difference = _wrapped(flat.azimuth(heading, 0.0, 0.0) - float(fit.values[0]))
    notes += [
        (
            f"without the tilt correction the azimuth would be {difference / ARCSEC:.4g} arcsec"
            f" ({difference / DEG:.3g} deg) off"
        ),
        (
            "base.* is the tilt of the table's rotation axis; bias_x and bias_y of the"
            " accelerometers are bias plus mounting"
        ),
    ]
    return notes


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
