"""How good a calibration is where the truth is known: parameters against injected ones, tilt error
over directions, attitude error of a gyro triad after full turns, and a placing-angle table
against the sensor's own bias over its working range.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.placing_smooth import basis, smooth_names
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.frames import (
    angle_between,
    base_rotation,
    best_rotation,
    parse_mount,
    rotation,
    sphere,
)
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.effects.base import Effect, SignalEffect
from tiltcal.effects.mount.mounting import MountMisalignment
from tiltcal.effects.sense import Sense
from tiltcal.effects.table.geometry import TableLevelling
from tiltcal.forward.signal_chain import CONVERSION
from tiltcal.instrument.placing import BiasTable
from tiltcal.laboratory.laboratory import true_readings
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

DIRECTIONS = 400
CONE = 45 * DEG  # working range of a two-channel sensor


@dataclass(frozen=True)
class TiltError:
    """Root mean square tilt error over directions, rad.

    Args:
        before: of the uncalibrated reading.
        after: of the corrected one.
        bound: what the calibration's own covariance predicts for ``after``.
        over: the directions, as text.
        dof: degrees of freedom of after^2 = sum of w_k chi2(1), by that covariance: the sum of the
            weights w over the largest. A scaled chi-square with so many has tails at least as long.
    """

    before: float
    after: float
    bound: float
    over: str
    dof: float = 1.0

    @property
    def in_arcsec(self) -> tuple[float, float, float]:
        """before, after, bound."""
        return self.before / ARCSEC, self.after / ARCSEC, self.bound / ARCSEC


def mount_rotation(effects: Sequence[Effect]) -> Array:
    """The constant misalignment of the instrument against the faceplate, (3, 3)."""
    R = np.eye(3)
    for e in effects:
        if isinstance(e, MountMisalignment):
            for axis in "xyz":
                R = R @ rotation(axis, e.value(f"tilt_{axis}"))
    return R


def true_parameters(
    setup: Setup, effects: Sequence[Effect], calibration: Calibration
) -> dict[str, float]:
    """The injected value of each recovered parameter, in its unit, where the injected physics
    defines one.

    Bias and M are those of the sensor behind its mounting; ``norm`` sees M only up to a rotation,
    so its truth is the symmetric factor S of M = S R.
    """
    if calibration.bias_tables:
        return table_truth(setup, effects, calibration, mount_rotation(effects))
    truth: dict[str, float] = {}
    for name in calibration.sensors():
        truth |= sensor_truth(setup.named(name), effects, symmetric=calibration.method == "norm")
    for e in effects:
        if isinstance(e, TableLevelling):
            truth |= {"base.roll": e.value("tilt_east"), "base.pitch": e.value("tilt_north")}
    if "base.roll" in calibration.parameters:
        truth = {"base.roll": 0.0, "base.pitch": 0.0} | {
            n: v for n, v in truth.items() if n.startswith("base.")
        }
    if "base.azimuth" in calibration.parameters:
        truth["base.azimuth"] = _true_azimuth(setup, effects, calibration.value("base.azimuth"))
    # its bias is the reading at standstill, with the Earth's rate in it
    of_the_day = calibration.method == "fog_scale"
    return {
        n: v
        for n, v in truth.items()
        if n in calibration.parameters and not (of_the_day and ".bias_" in n)
    }


def _true_azimuth(setup: Setup, effects: Sequence[Effect], found: float) -> float:
    """Azimuth of the horizontal projection of body x at outer = 0, rad, counted so that it lies
    within half a turn of ``found``.
    """
    base = np.eye(3)
    for e in effects:
        if isinstance(e, TableLevelling):
            base = base_rotation(e.value("tilt_east"), e.value("tilt_north"))
    x = (base @ parse_mount(setup.rig.mount) @ mount_rotation(effects))[:, 0]
    heading = 0.0 if setup.site.heading_deg == "unknown" else setup.site.heading_deg
    true = heading * DEG + np.arctan2(x[0], x[1])
    return float(found + (true - found + np.pi) % (2 * np.pi) - np.pi)


def sensor_truth(sensor: Sensor, effects: Sequence[Effect], symmetric: bool) -> dict[str, float]:
    """The injected terms of a sensor by the names of parameters, in their units.

    Args:
        sensor: one of the set-up.
        effects: that are injected.
        symmetric: the matrix up to a rotation, as ``norm`` sees it.
    """
    rows = sensor.axis_indices
    bias, M = np.zeros(len(rows)), np.eye(3)[list(rows)]
    truth: dict[str, float] = {}
    for e in effects:
        if e.sensor != sensor.name:
            continue
        for name, value in e.values.items():
            stem, _, axes = name.rpartition("_")
            if stem == "bias":
                bias[sensor.axes.index(axes)] += value
            elif stem == "scale":
                i = sensor.axes.index(axes)
                M[i, rows[i]] += value
            elif stem == "cross":
                M[sensor.axes.index(axes[0]), "xyz".index(axes[1])] += value
            elif stem in ("k2", "k3", "koq", "kip", "kio", "kpo"):
                factor = next(p.factor for p in e.parameters if name in p.expand(sensor.axes))
                truth[f"{sensor.name}.{stem.upper()[0]}{name[1:]}"] = value / factor
    if sensor.is_accelerometer:
        M = M @ mount_rotation(effects).T
    if symmetric and M.shape == (3, 3):
        u, s, _ = np.linalg.svd(M)
        M = u @ np.diag(s) @ u.T
    for i, axis in enumerate(sensor.axes):
        truth[f"{sensor.name}.bias_{axis}"] = float(bias[i])
        truth[f"{sensor.name}.scale_{axis}"] = float(M[i, rows[i]] - 1)
        for j, other in enumerate("xyz"):
            if other != axis:
                truth[f"{sensor.name}.cross_{axis}{other}"] = float(M[i, j])
    return truth


def tilt_error(setup: Setup, effects: Sequence[Effect], calibration: Calibration) -> TiltError:
    """Tilt error of the true sensor before and after correction, and what the covariance
    predicts.
    """
    if "base.roll" in calibration.parameters:
        return _base_error(effects, calibration)
    if calibration.bias_tables:
        over = f"the table's placing angles and between them, look-up {calibration.lookup}"
        mount = mount_rotation(effects)
        before, after, bound, dof = table_errors(setup, effects, calibration, mount)
        return TiltError(before, after, bound, over, dof)
    sensor = setup.named(calibration.sensors()[0])
    up, over = _directions(sensor)
    in_body = up @ mount_rotation(effects)  # rows (R^T up)'
    reading = true_readings(setup, in_body, effects)[sensor.name]
    free = calibration.method == "norm"
    corrected = calibration.correct(sensor, reading, setup.site.gravity)
    plain = _bare(calibration).correct(sensor, reading, setup.site.gravity)
    if free:
        over += ", after the best common rotation"
    before, after = _rms(plain, up, setup, free), _rms(corrected, up, setup, free)
    bound, dof = _bound(setup, sensor, reading, calibration, free)
    return TiltError(before, after, bound, over, dof)


def _directions(sensor: Sensor) -> tuple[Array, str]:
    up = sphere(DIRECTIONS)
    if len(sensor.axes) == 3:
        return up, f"{DIRECTIONS} directions over the sphere"
    up = sphere(int(DIRECTIONS * 2 / (1 - np.cos(CONE))))
    up = up[up[:, 2] > np.cos(CONE)]
    return up, f"{len(up)} directions within 45 deg of level"


def _bare(calibration: Calibration) -> Calibration:
    """A calibration that changes nothing."""
    return replace(calibration, parameters={}, covariance=np.zeros((0, 0)))


def estimated_up(f: Array, g: float) -> Array:
    """Unit vectors of the estimated up from corrected forces: a triad's own direction, or two
    channels and |f| = g.

    Args:
        f: m/s2, (n, k); the unit vectors, (n, 3).
        g: gravity, m/s2.
    """
    if f.shape[1] == 2:
        f = np.column_stack([f, np.sqrt(np.maximum(g * g - (f * f).sum(axis=1), 0.0))])
    return np.asarray(f / np.linalg.norm(f, axis=1)[:, None])


def predicted_tilt(
    setup: Setup, sensor: Sensor, calibration: Calibration
) -> tuple[float, float, str]:
    """What a calibration states of itself, without a truth, over the directions of ``tilt_error``.

    Returns:
        Root mean square angle between the uncorrected and the corrected reading, and the tilt error
        that the covariance predicts after correction, rad; the directions as text.
    """
    up, over = _directions(sensor)
    g = setup.site.gravity
    reading = g * up[:, list(sensor.axis_indices)]
    free = calibration.method == "norm"
    before = _rms(calibration.correct(sensor, reading, g), up, setup, free)
    after, _ = _bound(setup, sensor, reading, calibration, free)
    return before, after, over + (", after the best common rotation" if free else "")


def _rms(f: Array, up: Array, setup: Setup, free: bool) -> float:
    estimate = estimated_up(f, setup.site.gravity)
    if free:
        estimate = estimate @ best_rotation(up, estimate).T
    return float(np.sqrt(np.mean(angle_between(estimate, up) ** 2)))


def _bound(
    setup: Setup, sensor: Sensor, reading: Array, calibration: Calibration, free: bool
) -> tuple[float, float]:
    """Root mean square tilt error predicted by the covariance, and its degrees of freedom:
    directions moved by each principal parameter error.
    """
    g = setup.site.gravity
    names = list(calibration.parameters)
    values, vectors = np.linalg.eigh(calibration.covariance)
    centre = estimated_up(calibration.correct(sensor, reading, g), g)
    total, changes = 0.0, []
    for value, vector in zip(values, vectors.T, strict=True):
        step = np.sqrt(max(value, 0.0))
        if step == 0:
            continue
        moved = {
            n: replace(calibration.parameters[n], value=calibration.parameters[n].value + step * d)
            for n, d in zip(names, vector, strict=True)
        }
        shifted = estimated_up(
            replace(calibration, parameters=moved).correct(sensor, reading, g), g
        )
        if free:
            shifted = shifted @ best_rotation(centre, shifted).T
        total += float(np.mean(angle_between(shifted, centre) ** 2))
        changes.append((shifted - centre).ravel())
    return float(np.sqrt(total)), dof_of_changes(changes)


def _base_error(effects: Sequence[Effect], calibration: Calibration) -> TiltError:
    """For a base tilt: the angle between the true and the found rotation axis; before: the whole
    tilt.
    """
    truth = {"base.roll": 0.0, "base.pitch": 0.0}
    for e in effects:
        if isinstance(e, TableLevelling):
            truth = {"base.roll": e.value("tilt_east"), "base.pitch": e.value("tilt_north")}
    axis = base_rotation(truth["base.roll"], truth["base.pitch"])[:, 2]
    found = base_rotation(calibration.value("base.roll"), calibration.value("base.pitch"))[:, 2]
    rows = [k for k, n in enumerate(calibration.parameters) if n in truth]
    covariance = np.asarray(calibration.covariance)[np.ix_(rows, rows)]
    variance = float(np.trace(covariance))
    before = float(angle_between(axis[None], np.array([[0.0, 0.0, 1.0]]))[0])
    after = float(angle_between(axis[None], found[None])[0])
    dof = effective_dof(np.asarray(np.linalg.eigvalsh(covariance)))
    return TiltError(before, after, float(np.sqrt(variance)), "the table's rotation axis", dof)


def normalised_error(calibration: Calibration, truth: Mapping[str, float]) -> tuple[float, int]:
    """NEES: squared error of all parameters with a truth in units of the covariance, and their
    number.
    """
    names = [n for n in calibration.parameters if n in truth]
    index = [list(calibration.parameters).index(n) for n in names]
    error = np.array([calibration.parameters[n].value - truth[n] for n in names])
    covariance = np.asarray(calibration.covariance)[np.ix_(index, index)]
    scale = np.sqrt(np.diag(covariance))
    if len(names) == 0 or np.any(scale == 0):
        return 0.0, 0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    determined = values > 1e-9 * values[-1]  # two names of one parameter count once
    z = vectors[:, determined].T @ (error / scale)
    return float(np.sum(z**2 / values[determined])), int(determined.sum())


RATE = 60 * DEG


def attitude_error(setup: Setup, effects: Sequence[Effect], calibration: Calibration) -> TiltError:
    """Angle between true and integrated attitude after one turn about x, y and z at 60 deg/s, rms
    of the three, rad.

    The reading at standstill is subtracted before each turn, as in the field: what remains is scale
        and cross-axis.
    """
    sensor = setup.named(calibration.sensors()[0])
    turns = [_reading(sensor, setup, effects, RATE * axis) for axis in np.eye(3)]
    bare = replace(calibration, parameters={}, covariance=np.zeros((0, 0)))
    over = "attitude after one turn about each axis at 60 deg/s"
    before, after = _attitude_rms(turns, bare, sensor), _attitude_rms(turns, calibration, sensor)
    bound, dof = _attitude_bound(turns, calibration, sensor)
    return TiltError(before, after, bound, over, dof)


def _reading(sensor: Sensor, setup: Setup, effects: Sequence[Effect], rate: Array) -> Array:
    """What the triad reads at a steady rate, without noise and without its reading at standstill,
    (3,).
    """
    sense = replace(
        Sense.at_rest(sensor, setup.site.gravity, np.zeros((2, 3))),
        rate=np.stack([rate, np.zeros(3)]),
    )
    reading = sense.true_input()
    signal = [
        e
        for e in effects
        if isinstance(e, SignalEffect) and e.sensor == sensor.name and not e.random
    ]
    for effect in sorted(signal, key=lambda e: e.order):
        if effect.order < CONVERSION:
            reading = effect.apply(reading, sense, None)
    return np.asarray(reading[0] - reading[1])


def _final(reading: Array, calibration: Calibration, sensor: Sensor) -> Array:
    """Integrated attitude, (3, 3)."""
    from scipy.spatial.transform import Rotation

    rate = np.linalg.solve(calibration.sensitivity(sensor), reading)
    return np.asarray(Rotation.from_rotvec(rate * (2 * np.pi / RATE)).as_matrix())


def _attitude_rms(turns: Sequence[Array], calibration: Calibration, sensor: Sensor) -> float:
    """A whole turn comes back to where it was: what is left is the error."""
    from scipy.spatial.transform import Rotation

    errors = [
        Rotation.from_matrix(_final(reading, calibration, sensor)).magnitude() for reading in turns
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


def _attitude_bound(
    turns: Sequence[Array], calibration: Calibration, sensor: Sensor
) -> tuple[float, float]:
    """What the covariance predicts, and its degrees of freedom: the turns moved by each principal
    error of the parameters.
    """
    from scipy.spatial.transform import Rotation

    names = list(calibration.parameters)
    values, vectors = np.linalg.eigh(calibration.covariance)
    centre = [_final(reading, calibration, sensor) for reading in turns]
    total, changes = 0.0, []
    for value, vector in zip(values, vectors.T, strict=True):
        step = np.sqrt(max(value, 0.0))
        moved = {
            n: replace(e, value=e.value + step * d)
            for (n, e), d in zip(calibration.parameters.items(), vector, strict=True)
        }
        shifted = replace(calibration, parameters=dict(zip(names, moved.values(), strict=True)))
        turned = [
            Rotation.from_matrix(_final(reading, shifted, sensor) @ R.T)
            for reading, R in zip(turns, centre, strict=True)
        ]
        total += float(np.mean([r.magnitude() ** 2 for r in turned]))
        changes.append(np.ravel([r.as_rotvec() for r in turned]))
    return float(np.sqrt(total)), dof_of_changes(changes)


FINE = 8  # directions a step of the table


def placing_directions(axis: str, beta: Array, mount: Array) -> Array:
    """Up in the body frame with ``axis`` horizontal at placing angles beta, (n, 3).

    Args:
        axis: axis of the placing.
        beta: angles, rad, (n,).
        mount: of the body on the faceplate.
    """
    s, c, zero = np.sin(beta), np.cos(beta), np.zeros_like(beta)
    up = np.column_stack([zero, s, c] if axis == "x" else [-s, zero, c])
    return np.asarray(up @ mount)


def true_bias(
    setup: Setup, effects: Sequence[Effect], sensor: Sensor, axis: str, beta: Array, mount: Array
) -> Array:
    """What an axis truly reads when it is horizontal, m/s2, (n,): the sensor's own effects, without
    table and noise.
    """
    readings = true_readings(setup, placing_directions(axis, beta, mount), effects)[sensor.name]
    return np.asarray(readings[:, sensor.axes.index(axis)])


def table_truth(
    setup: Setup, effects: Sequence[Effect], calibration: Calibration, mount: Array
) -> dict[str, float]:
    """The injected value of each parameter of the smooth fits: the true bias over the table's
    angles, in the same terms.

    Args:
        setup: site, table and sensors.
        effects: effects that act.
        calibration: the result.
        mount: (3, 3).
    """
    truth: dict[str, float] = {}
    for sensor, axis, table in _tables(setup, calibration):
        if table.wave:
            order = len(table.wave) // 2
            beta = np.asarray(table.start + table.step * np.arange(len(table.values)), dtype=float)
            bias = true_bias(setup, effects, sensor, axis, beta, mount)
            found = np.linalg.lstsq(basis(beta, order), bias, rcond=None)[0]
            truth |= dict(zip(smooth_names(sensor.name, axis, order), found.tolist(), strict=True))
    return truth


def table_errors(
    setup: Setup, effects: Sequence[Effect], calibration: Calibration, mount: Array
) -> tuple[float, float, float, float]:
    """Tilt error, rad rms, of a horizontal axis over the table's angles and between them.

    Args:
        setup: site, table and sensors.
        effects: effects that act.
        calibration: the result.
        mount: (3, 3).

    Returns:
        Before correction, after it, what entry noise and interpolation let expect, and the
        degrees of freedom of the error after it.
    """
    before, after, steps, noise = [], [], [], []
    g = setup.site.gravity
    for sensor, axis, table in _tables(setup, calibration):
        last = len(table.values) - 1
        beta = table.start + table.step * np.arange(last * FINE + 1) / FINE
        readings = true_readings(setup, placing_directions(axis, beta, mount), effects)[sensor.name]
        channel = sensor.axes.index(axis)
        before.append(readings[:, channel] / g)
        after.append(calibration.correct(sensor, readings, g)[:, channel] / g)
        exact = replace(table, values=true_bias(setup, effects, sensor, axis, beta[::FINE], mount))
        step = (
            0.0
            if calibration.lookup == "smooth"
            else exact.at(beta, calibration.lookup) - readings[:, channel]
        )
        steps.append(step / g + np.zeros(len(beta)))
        noise.append(_look_up_errors(table, beta, sensor, axis, calibration) / g)
    n = sum(len(part) for part in noise)
    expected = [(D**2).sum(axis=1) + step**2 for D, step in zip(noise, steps, strict=True)]
    weights = np.concatenate([np.linalg.eigvalsh(D.T @ D / n) for D in noise])
    dof = effective_dof(weights, float(np.mean(np.concatenate(steps) ** 2)))
    return _root([b**2 for b in before]), _root([a**2 for a in after]), _root(expected), dof


def _root(squares: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _tables(setup: Setup, calibration: Calibration) -> list[tuple[Sensor, str, BiasTable]]:
    found = []
    for name in calibration.sensors():
        sensor = setup.named(name)
        corrector = calibration.placing(sensor, setup.site.gravity)
        found += [
            (sensor, axis, table) for axis, table in (corrector.tables if corrector else {}).items()
        ]
    return found


def _look_up_errors(
    table: BiasTable, beta: Array, sensor: Sensor, axis: str, calibration: Calibration
) -> Array:
    """What each independent error of one standard uncertainty does to the look-up, (n, k)."""
    if calibration.lookup == "smooth":
        names = smooth_names(sensor.name, axis, len(table.wave) // 2)
        index = [list(calibration.parameters).index(n) for n in names]
        values, vectors = np.linalg.eigh(np.asarray(calibration.covariance)[np.ix_(index, index)])
        B = basis(beta, len(table.wave) // 2)
        return np.asarray(B @ vectors * np.sqrt(np.maximum(values, 0.0)))
    t = (beta - table.start) / table.step
    k = np.minimum((t + 1e-9).astype(int), len(table.values) - 2)
    part = t - k
    if calibration.lookup == "rounded":
        part = np.round(part)
    rows = np.arange(len(beta))
    errors = np.zeros((len(beta), len(table.values)))
    errors[rows, k] = (1 - part) * table.sigmas[k]
    errors[rows, k + 1] = part * table.sigmas[k + 1]
    return errors


def effective_dof(weights: Array, constant: float = 0.0) -> float:
    """Degrees of freedom of ``Q = sum of w_k chi2(1)``: the sum of the weights over the largest.

    A chi-square with so many, scaled to the mean of Q, has an upper tail at least as long as that
    of Q: the chi-square mixture of this sum and largest weight that varies most.

    Args:
        weights: w, (k,); negative ones are rounding errors and count as zero.
        constant: mean square of a part that does not vary. It raises the sum; the cross terms
            between it and the part that varies are counted in.

    Returns:
        At least 1. Source: M. E. Bock et al., Inequalities for linear combinations of gamma random
        variables, Canad. J. Statist. 15 (1987) 387.
    """
    positive = np.maximum(np.asarray(weights, dtype=float), 0.0)
    total = float(positive.sum()) + constant
    largest = float(positive.max(initial=0.0))
    if not np.isfinite(total) or largest == 0.0:
        return 1.0
    return max(total / (largest * (1 + constant / total)), 1.0)


def dof_of_changes(changes: Sequence[Array]) -> float:
    """Degrees of freedom of the mean square of ``sum of z_k d_k``, z standard normal.

    Args:
        changes: d, what each principal error of the parameters does to the result, (n,) each.
    """
    if not changes:
        return 1.0
    D = np.array(changes)
    return effective_dof(np.asarray(np.linalg.eigvalsh(D @ D.T)))
