"""How good a placing-angle table is where the truth is known: against the sensor's own bias, over
its working range.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.bias_table import BiasTable
from tiltcal.calibration.methods.placing_smooth import basis, smooth_names
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.effects.base import Effect
from tiltcal.laboratory.laboratory import true_readings
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.validation.effective_dof import effective_dof

FINE = 8  # directions a step of the table


def placing_directions(axis: str, beta: Array, mount: Array) -> Array:
    """Up in the body frame with ``axis`` horizontal at placing angles beta, (n, 3); mount: of the
    body on the faceplate.
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
    angles, in the same terms. mount: (3, 3).
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
    """Tilt error, rad rms, of a horizontal axis over the table's angles and between them. mount:
    (3, 3).

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
