"""How good a calibration is where the truth is known: parameters against injected ones, tilt error
over directions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

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
from tiltcal.effects.base import Effect
from tiltcal.effects.mount.mounting import MountMisalignment
from tiltcal.effects.table.geometry import TableLevelling
from tiltcal.laboratory.laboratory import true_readings
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.validation.bias_table_accuracy import table_errors, table_truth
from tiltcal.validation.effective_dof import dof_of_changes, effective_dof

DIRECTIONS = 400
CONE = 45 * DEG  # working range of a two-channel sensor


@dataclass(frozen=True)
class TiltError:
    """Root mean square tilt error over directions, rad.

    Args:
        before: of the uncalibrated reading; after: of the corrected one.
        bound: what the calibration's own covariance predicts for ``after``.
        over: the directions, in words.
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
    # its bias is the reading at rest, with the Earth's rate in it
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
    channels and |f| = g. f: m/s2, (n, k); the unit vectors, (n, 3).
    """
    if f.shape[1] == 2:
        f = np.column_stack([f, np.sqrt(np.maximum(g * g - (f * f).sum(axis=1), 0.0))])
    return np.asarray(f / np.linalg.norm(f, axis=1)[:, None])


def predicted_tilt(
    setup: Setup, sensor: Sensor, calibration: Calibration
) -> tuple[float, float, str]:
    """What a calibration says of itself, without a truth, over the directions of ``tilt_error``.

    Returns:
        Root mean square angle between the uncorrected and the corrected reading, and the tilt error
        that the covariance predicts after correction, rad; the directions in words.
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
