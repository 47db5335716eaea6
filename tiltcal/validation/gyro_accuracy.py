"""Attitude error of a gyro triad after full turns, before and after its calibration, where the
truth is known.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.effects.base import Effect, SignalEffect
from tiltcal.effects.sense import Sense
from tiltcal.forward.signal_chain import CONVERSION
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.validation.accuracy import TiltError
from tiltcal.validation.effective_dof import dof_of_changes

RATE = 60 * DEG


def attitude_error(setup: Setup, effects: Sequence[Effect], calibration: Calibration) -> TiltError:
    """Angle between true and integrated attitude after one turn about x, y and z at 60 deg/s, rms
    of the three, rad.

    The reading at rest is taken off before each turn, as in the field: what remains is scale and
        cross-axis.
    """
    sensor = setup.named(calibration.sensors()[0])
    turns = [_reading(sensor, setup, effects, RATE * axis) for axis in np.eye(3)]
    bare = replace(calibration, parameters={}, covariance=np.zeros((0, 0)))
    over = "attitude after one turn about each axis at 60 deg/s"
    before, after = _rms(turns, bare, sensor), _rms(turns, calibration, sensor)
    bound, dof = _bound(turns, calibration, sensor)
    return TiltError(before, after, bound, over, dof)


def _reading(sensor: Sensor, setup: Setup, effects: Sequence[Effect], rate: Array) -> Array:
    """What the triad reads at a steady rate, without noise and without its reading at rest,
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


def _rms(turns: Sequence[Array], calibration: Calibration, sensor: Sensor) -> float:
    """A whole turn comes back to where it was: what is left is the error."""
    from scipy.spatial.transform import Rotation

    errors = [
        Rotation.from_matrix(_final(reading, calibration, sensor)).magnitude() for reading in turns
    ]
    return float(np.sqrt(np.mean(np.square(errors))))


def _bound(turns: Sequence[Array], calibration: Calibration, sensor: Sensor) -> tuple[float, float]:
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
