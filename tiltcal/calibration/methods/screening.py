"""What is looked at before the numbers of any method are believed: saturated channels, and columns
under each other's name.
"""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
import numpy.typing as npt

from tiltcal.calibration.validity import Test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor

AT_END = 0.05  # of the log, from which a stated range matters
# samples at one extreme, and in a row on average: no code of a quiet converter lasts as long
LEAST, RUN = (
    20,
    20,
)
# at most this share of the other samples repeats the one before: a recording without noise tells
# nothing
LIVELY = 0.5
TURNING = 0.1  # rad/s
APART = 0.3  # share of |w| g by which a wrong order of columns misses the change of the force


def require_unsaturated(recording: Recording, sensor: Sensor) -> None:
    """Refuse a log in which a channel stands at the end of its range: stated, or where it freezes
    at its extreme.

    Raises:
        TiltcalError: naming the channel.
    """
    samples = recording.sensor(sensor)
    stated = sensor.converter.limit if sensor.converter is not None else sensor.full_scale
    for axis, values in zip(sensor.axes, samples.values.T, strict=True):
        known = values[~np.isnan(values)]
        if len(known) == 0:
            continue
        at_end = (
            np.abs(known) >= 0.999 * stated if stated is not None else np.zeros(len(known), bool)
        )
        if at_end.mean() <= AT_END:
            at_end = _frozen_at_an_end(known)
        if at_end.any():
            raise TiltcalError(
                f"{recording.source}, channel {sensor.name}_{axis}",
                found=f"saturated for {at_end.mean():.0%} of the log",
                need="readings within its range",
                do="lower the gain, level the base or turn slower, and record again",
            )


def _frozen_at_an_end(values: Array) -> "npt.NDArray[np.bool_]":
    """Samples that stand exactly at the channel's extreme for long, where the channel is noisy
    elsewhere.
    """
    for extreme in (values.max(), values.min()):
        at_end = values == extreme
        runs = np.count_nonzero(np.diff(at_end.astype(int), prepend=0) == 1)
        rest = values[~at_end]
        if (
            at_end.sum() >= max(LEAST, RUN * runs)
            and len(rest) > LEAST
            and np.mean(np.diff(rest) == 0) < LIVELY
        ):
            return np.asarray(at_end)
    return np.zeros(len(values), bool)


def columns_test(time: Array, rate: Array, force: Array) -> Test:
    """Do a gyro and the accelerometer beside it turn alike? At the hand's pace ``df/dt = f x w``.

    Args:
        time: s, (n,), steps of 0.05 ... 0.5 s.
        rate: rad/s less its bias; force: g, both (n, 3).
    """
    f, w, dt = (force[1:] + force[:-1]) / 2, (rate[1:] + rate[:-1]) / 2, np.diff(time)
    turning = (np.linalg.norm(w, axis=1) > TURNING) & (dt < 1.0) & ~np.isnan(f).any(axis=1)
    if turning.sum() < LEAST:
        return Test("columns of gyro and accelerometer", 0.0, 0, 1.0, True, "too few turns to tell")
    change, f, w = (np.diff(force, axis=0) / dt[:, None])[turning], f[turning], w[turning]
    size = float(np.sqrt(np.mean(np.sum(w * w, axis=1))))

    def misfit(order: tuple[int, ...], signs: tuple[int, ...]) -> float:
        left = np.linalg.norm(change - np.cross(f, np.array(signs) * w[:, list(order)]), axis=1)
        return float(np.sqrt(np.mean(left**2)) / size)

    plain = misfit((0, 1, 2), (1, 1, 1))
    better, words = min((misfit(o, s), _columns(o, s)) for o, s in orders())
    ok = plain < APART or better > plain / 2
    said = (
        f"the change of the force follows the gyro to {plain:.2g}"
        if ok
        else (
            f"the gyro's columns x, y, z turn as the accelerometer's would if they were {words}:"
            " columns of one of them are swapped or have another sign"
        )
    )
    return Test("columns of gyro and accelerometer", plain, 0, float(ok), ok, said)


def orders() -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Every order of three columns with every choice of signs."""
    yield from product(permutations(range(3)), product((1, -1), repeat=3))


def _columns(order: tuple[int, ...], signs: tuple[int, ...]) -> str:
    return ", ".join(f"{'-' if s < 0 else ''}{AXES[i]}" for s, i in zip(signs, order, strict=True))


def order_test(M: Array) -> Test:
    """Does every channel of a sensitivity matrix answer mostly to its own axis? M: (3, 3), near the
    identity.
    """
    strongest = np.abs(M).argmax(axis=1)
    signs = np.sign(M[np.arange(3), strongest]).astype(int)
    ok = bool(np.all(strongest == np.arange(3)) and np.all(signs > 0))
    order = tuple(int(i) for i in strongest)
    said = (
        "each column follows its own axis"
        if ok
        else (
            f"the columns x, y, z follow the axes {_columns(order, tuple(int(s) for s in signs))}:"
            " swapped, or of another sign"
        )
    )
    return Test("columns as named", float(np.abs(M - np.eye(3)).max()), 0, float(ok), ok, said)
