"""Columns that are swapped or have another sign.

Whether a sensor's gain says that its column is in another unit.
"""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.data_quality.units import unit_doubt
from tiltcal.setup.sensor import Sensor

LEAST_TURNING = 20  # samples
TURNING = 0.1  # rad/s
MISFIT = 0.3  # of |w| g: a wrong order of columns misses the change of the force by more


def columns_test(time: Array, rate: Array, force: Array) -> Test:
    """Are the columns of a gyro and an accelerometer consistent? In the body ``df/dt = f x w``
    while gravity dominates.

    Args:
        time: s, (n,), steps of 0.05 ... 0.5 s.
        rate: rad/s less its bias.
        force: g, both (n, 3).
    """
    name = "columns of gyro and accelerometer"
    f, w, dt = (force[1:] + force[:-1]) / 2, (rate[1:] + rate[:-1]) / 2, np.diff(time)
    turning = (np.linalg.norm(w, axis=1) > TURNING) & (dt < 1.0) & ~np.isnan(f).any(axis=1)
    if turning.sum() < LEAST_TURNING:
        return threshold_test(name, 0.0, True, "too few turns for this test")
    change, f, w = (np.diff(force, axis=0) / dt[:, None])[turning], f[turning], w[turning]
    size = float(np.sqrt(np.mean(np.sum(w * w, axis=1))))

    def misfit(order: tuple[int, ...], signs: tuple[int, ...]) -> float:
        left = np.linalg.norm(change - np.cross(f, np.array(signs) * w[:, list(order)]), axis=1)
        return float(np.sqrt(np.mean(left**2)) / size)

    as_named = misfit((0, 1, 2), (1, 1, 1))
    best, columns = min((misfit(*c), columns_in_words(*c)) for c in column_orders())
    ok = as_named < MISFIT or best > as_named / 2
    words = f"the change of the force follows the gyro to {as_named:.2g}"
    if not ok:
        words = (
            f"the gyro's columns x, y, z turn as the accelerometer's would if they were {columns}:"
            " columns of one of them are swapped or have another sign"
        )
    return threshold_test(name, as_named, ok, words)


def column_orders() -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Every order of three columns with every choice of signs."""
    yield from product(permutations(range(3)), product((1, -1), repeat=3))


def columns_in_words(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    """Columns such as ``-y, x, z``."""
    return ", ".join(f"{'-' if s < 0 else ''}{AXES[i]}" for s, i in zip(signs, order, strict=True))


def exchanged_words(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    """A sentence on columns that do not hold their own axes.

    Args:
        order: the column that holds each axis.
        signs: of that column.
    """
    held = tuple(order.index(i) for i in range(len(order)))
    named = columns_in_words(held, tuple(signs[k] for k in held))
    columns = ", ".join(AXES[: len(order)])
    return f"the columns {columns} hold the axes {named}: swapped, or of another sign"


def common_gain(M: Array) -> float:
    """The common gain of a sensitivity matrix, whatever the order and signs of its columns: the
    root of its determinant's size. M: (k, k).
    """
    return float(max(abs(np.linalg.det(M)), 1e-300) ** (1 / len(M)))


def order_test(M: Array) -> Test:
    """Does every channel of a sensitivity matrix respond mostly to its own axis, whatever the unit?
    M: (k, k).
    """
    M = M / common_gain(M)
    axes = np.arange(len(M))
    strongest = np.abs(M).argmax(axis=1)
    signs = np.sign(M[axes, strongest]).astype(int)
    ok = bool(np.all(strongest == axes) and np.all(signs > 0))
    words = "each column follows its own axis"
    if len(set(strongest.tolist())) < len(M):
        words = f"two columns follow the axis {AXES[int(np.bincount(strongest).argmax())]}"
    elif not ok:
        order = np.argsort(strongest)
        words = exchanged_words(tuple(order.tolist()), tuple(signs[order].tolist()))
    return threshold_test("columns as named", np.abs(M - np.eye(len(M))).max(), ok, words)


ONE_AXIS = 0.5  # of the gain: each channel senses one axis to it, and hardly the others


def unit_tests(sensor: Sensor, M: Array, unit: str) -> list[Test]:
    """The test of the unit where each channel senses one axis, whichever; none elsewhere: the
    determinant of another matrix is no gain.

    Args:
        sensor: which.
        M: its sensitivity, (k, k).
        unit: of the columns.
    """
    gain = common_gain(M)
    single = np.eye(len(M))[-1]
    apart = np.abs(np.sort(np.abs(M) / gain, axis=1) - single).max()
    return [unit_test(sensor, gain, unit)] if apart < ONE_AXIS else []


def unit_test(sensor: Sensor, gain: float, unit: str) -> Test:
    """Is the column in the unit that its name states? Fails where the gain is far from one.

    Args:
        sensor: which.
        gain: reading over what acts.
        unit: of the column.
    """
    doubt = unit_doubt(gain, unit, sensor.name)
    words = doubt or f"the gain of {sensor.name} is {gain:.4g}"
    return threshold_test("unit", gain, doubt is None, words)
