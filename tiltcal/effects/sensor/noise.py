"""Noise as effects: white, flicker, random walk; drawn by the laboratory, whitened by the fit, from
the same numbers.
"""

from math import log, pi

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import SignalEffect
from tiltcal.effects.hysteresis_and_lag import steady_recursion
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.sensor.environmental import GYROS

FLICKER_TAUS = tuple(4.0**k for k in range(6))  # s: 1, 4, ... 1024


def draw_noise(
    n: int, rate_hz: float, white: float, flicker: float, walk: float, rng: np.random.Generator
) -> Array:
    """One channel of noise, (n,).

    Args:
        n: samples, at ``rate_hz``.
        white: N; the standard deviation of a sample is N sqrt(rate).
        flicker: B, bias instability: the Allan floor is sqrt(2 ln 2 / pi) B. A sum of first-order
            processes with time constants 1, 4, ... 1024 s, each of variance B^2 ln(4)/pi, has the
            density B^2/(pi f) between their corners.
        walk: K, per square root of a second.
        rng: the channel's own stream.
    """
    noise = np.zeros(n)
    if white:
        rng.standard_normal(out=noise)
        noise *= white * np.sqrt(rate_hz)
    if flicker:
        noise += draw_flicker(n, rate_hz, flicker, rng)
    if walk:
        noise += np.cumsum(rng.standard_normal(n)) * (walk / np.sqrt(rate_hz))
    return noise


def draw_flicker(n: int, rate_hz: float, flicker: float, rng: np.random.Generator) -> Array:
    """Flicker noise of one channel, (n,), see ``draw_noise``."""
    variance = flicker**2 * log(4) / pi
    total = np.zeros(n)
    for tau in FLICKER_TAUS:
        decay = float(np.exp(-1 / (rate_hz * tau)))
        drive = rng.standard_normal(n) * np.sqrt(variance * (1 - decay**2))
        drive[:1] /= np.sqrt(1 - decay**2)  # starts stationary
        total += steady_recursion(decay, drive)
    return total


class Noise(SignalEffect):
    """Independent noise on every channel."""

    stage = "sensor"
    order = 75
    random = True
    physics = "Thermal, electronic and 1/f noise of the sensor."
    equation = "Allan variance = N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3"
    source = "IEEE 952, 1293 (Allan variance annex)"
    excited_by = "any recording"
    look = "Allan slopes -1/2, 0, +1/2"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        if rng is None:
            return reading
        # on an inclinometer it acts on the angle: 1 ug = 1 urad
        size = 1 / G0 if sense.kind == "inclinometer" else 1.0
        white, flicker, walk = (self.value(name) * size for name in ("white", "flicker", "walk"))
        for i, stream in enumerate(rng.spawn(reading.shape[1])):
            reading[:, i] += draw_noise(len(reading), sense.rate_hz, white, flicker, walk, stream)
        return reading


class AccNoise(Noise):
    id = "acc_noise"
    needs = "any"
    kinds = ACCELEROMETERS
    title = "white, flicker, random walk"
    parameters = (
        Parameter("white", "ug_rthz", (7, 40, 200), positive=True),
        Parameter("flicker", "ug", (5, 10, 100), positive=True),
        Parameter("walk", "ug_rts", (0.01, 0.3, 3), positive=True),
    )
    ordinary = True


class GyrNoise(Noise):
    id = "gyr_noise"
    needs = "any"
    kinds = GYROS
    title = "angle random walk, bias instability, rate random walk"
    parameters = (
        Parameter("white", "deg_rth", (0.05, 0.34, 0.84), positive=True),
        Parameter("flicker", "deg_h", (0.5, 10, 30), positive=True),
        Parameter("walk", "deg_h_rth", (0.5, 30, 300), positive=True),
    )
    ordinary = True


def worst_grade(kind: str) -> tuple[float, float]:
    """Flicker and random walk over the white noise per root hertz, Hz^1/2 and 1/s, of the worst
    grade of a kind of sensor.
    """
    white, flicker, walk = (np.array(sizes) for sizes in _sizes(kind))
    return float((flicker / white).max()), float((walk / white).max())


def largest_slow_noise(kind: str) -> tuple[float, float]:
    """Flicker, SI, and random walk, SI per square root of a second, of the worst grade of a kind of
    sensor.
    """
    _, flicker, walk = (max(sizes) for sizes in _sizes(kind))
    return flicker, walk


def _sizes(kind: str) -> list[list[float]]:
    """White noise, flicker and random walk of the grades of a kind of sensor, SI."""
    cls = next(c for c in (AccNoise, GyrNoise) if c.senses(kind))
    size = 1 / G0 if kind == "inclinometer" else 1.0
    return [[grade * p.factor * size for grade in p.plausible] for p in cls.parameters]
