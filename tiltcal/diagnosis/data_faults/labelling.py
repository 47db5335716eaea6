"""What columns may mean besides what their names say: factors, signs and permutations of axes."""

from collections.abc import Iterator, Sequence
from itertools import permutations, product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.effects.data.labelling_faults import (
    DataAxisSwap,
    DataHand,
    DataSign,
    DataUnit,
)
from tiltcal.setup.sensor import Sensor


def signed_permutations(n: int) -> Iterator[Array]:
    """Matrices that exchange channels and change their signs, (n, n)."""
    for order, signs in product(permutations(range(n)), product((1.0, -1.0), repeat=n)):
        P = np.zeros((n, n))
        P[range(n), order] = signs
        yield P


def fault_of_factor(
    k: float, fog: Sensor, gyro: Sensor, fastest: float, gyros: float
) -> list[Fault]:
    """Unit and sign of a FOG whose readings are k times those of the gyros; largest rates rad/s."""
    faults = []
    factor = next(
        (s for c in FACTORS for s in (c, 1 / c) if abs(np.log(abs(k) / s)) < LIKELY), None
    )
    if factor is not None and (abs(k) > 2 or abs(k) < 0.5):
        # a hand turns by about a radian a second
        wrong = fog if abs(np.log(fastest)) > abs(np.log(gyros)) else gyro
        own = factor if wrong is fog else 1 / factor
        effect = DataUnit({"factor": own}, wrong.name, None, "found")
        words = f"{wrong.name} reads {own:.6g} times what its unit says."
        faults.append(Fault(effect, (wrong.name,), wrong.axes, words, sigma={"factor": 1e-3 * own}))
    if k < 0:
        sign = DataSign({"flip_a": 1.0}, fog.name, None, "found")
        faults.append(Fault(sign, (fog.name,), fog.axes, f"{fog.name} has the opposite sign."))
    return faults


def affine_fit(y: Array, f: Array) -> Array:
    """Mean square residual of each column after an affine map of the predictions, (k,)."""
    X = np.column_stack([np.ones(len(f)), f])
    return (
        np.asarray(((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2).mean(axis=0))
        if len(y)
        else np.ones(y.shape[1])
    )


def faults_of_sensor(y: Array, f: Array, sensor: Sensor) -> list[Fault]:
    """Unit, exchanged columns and signs of one sensor, by what it read and should have read, (n, k)
    each.
    """
    if len(y) < 16 or float(np.abs(f).max()) == 0:
        return []
    faults = []
    k = float(np.sqrt(np.sum(y * y) / max(np.sum(f * f), 1e-300)))
    factor = next((s for c in FACTORS for s in (c, 1 / c) if abs(np.log(k / s)) < LIKELY), None)
    if factor is not None and (k > 2 or k < 0.5):
        effect = DataUnit({"factor": factor}, sensor.name, None, "found")
        words = f"{sensor.name} reads {factor:.6g} times what its unit says."
        faults.append(
            Fault(effect, (sensor.name,), sensor.axes, words, sigma={"factor": 1e-3 * factor})
        )
        y = y / factor
    return faults + _permuted(y, f, sensor)


def _permuted(y: Array, f: Array, sensor: Sensor) -> list[Fault]:
    """A signed permutation of the channels that fits far better than none."""
    n = f.shape[1]
    size = float(np.abs(f).max())
    y, f = y / size, f / size
    level = misfit_of(y, f, np.eye(n))
    trials = [(misfit_of(y, f, P), -float(np.trace(P)), P) for P in signed_permutations(n)]
    best, _, P = min(trials, key=lambda t: (t[0], t[1]))
    return [] if level < FAR * best or level < LEAST else faults_of_permutation(P, sensor)


def faults_of_permutation(P: Array, sensor: Sensor) -> list[Fault]:
    """Exchanged columns and signs of a sensor that reads P times what it should, (n, n)."""
    n = len(P)
    moved = [i for i in range(n) if P[i, i] == 0]
    flipped = [i for i in range(n) if P[i].sum() < 0]
    faults = []
    if len(moved) == 2:
        pair = "".join(sensor.axes[i] for i in moved)
        swap = f"swap_{'zx' if pair == 'xz' else pair}"
        words = f"The columns {' and '.join(pair)} of {sensor.name} are exchanged."
        faults.append(_exchanged(sensor, (swap,), tuple(pair), words))
    if len(moved) == 3:
        second = "swap_yz" if P[0, 1] or P[0].argmax() == 1 else "swap_zx"
        words = f"The columns of {sensor.name} are exchanged cyclically."
        faults.append(_exchanged(sensor, ("swap_xy", second), sensor.axes, words))
    if flipped:
        axes = tuple(sensor.axes[i] for i in flipped)
        sign = DataSign({f"flip_{a}": 1.0 for a in axes}, sensor.name, None, "found")
        names = (DataSign.id, DataHand.id) if axes == ("y",) and n == 3 else (DataSign.id,)
        words = f"{sensor.name} {', '.join(axes)} has the opposite sign."
        faults.append(Fault(sign, (sensor.name,), axes, words, names=names))
    return faults


def _exchanged(sensor: Sensor, swaps: Sequence[str], axes: Sequence[str], words: str) -> Fault:
    effect = DataAxisSwap(dict.fromkeys(swaps, 1.0), sensor.name, None, "found")
    return Fault(effect, (sensor.name,), tuple(axes), words)


# between the units that people mix up
FACTORS = (
    9.80665,
    57.29577951308232,
    1000.0,
    1e6,
    3600.0,
    206264.806,
    60.0,
)


LIKELY = 0.1  # relative: how near to such a factor


FAR = 9.0  # times the misfit, at least, that the words have to be worse by


LEAST = 1e-3  # of the square of the largest reading: below it the columns mean what they say


def misfit_of(y: Array, f: Array, P: Array) -> float:
    """Mean square of what is left of ``y`` after ``P f`` and a constant. y: (n, i); f: (n, k); P:
    (i, k).
    """
    left = y - f @ P.T
    return float(np.mean((left - left.mean(axis=0)) ** 2))
