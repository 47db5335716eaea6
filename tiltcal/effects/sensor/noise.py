"""Noise as effects: white, flicker, random walk; drawn by the laboratory, whitened by the fit, from
the same numbers.
"""

from copy import deepcopy
from dataclasses import dataclass
from math import log, pi

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.effects.base import SignalEffect
from tiltcal.effects.hysteresis_and_lag import SteadyRecursion, steady_recursion
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import ACCELEROMETERS, ENCODER, Sense
from tiltcal.effects.sensor.environmental import GYROS
from tiltcal.effects.sensor.stepped_noise import SteppedNoise
from tiltcal.effects.stepwise import StepEffect, Stepping
from tiltcal.setup.sensor import Sensor

SKIP = 1 << 16  # numbers drawn at once to pass them over
FLICKER_TAUS = tuple(4.0**k for k in range(6))  # s: 1, 4, ... 1024


def draw_noise(
    n: int, rate_hz: float, white: float, flicker: float, walk: float, rng: np.random.Generator
) -> Array:
    """One channel of noise, (n,).

    Args:
        rate_hz: of the samples.
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


class NoiseDraw:
    """``draw_noise`` piece by piece: the same numbers to the bit, while only pieces are held.

    A component's numbers follow those of the one before in the same stream, so that each has a
    stream of its own here, found by drawing all numbers before it once.

    Args: as of ``draw_noise``.
    """

    def __init__(
        self,
        n: int,
        rate_hz: float,
        white: float,
        flicker: float,
        walk: float,
        rng: np.random.Generator,
    ) -> None:
        self.white, self.walk, self.last = white * np.sqrt(rate_hz), walk / np.sqrt(rate_hz), 0.0
        self._white = _skipped(rng, n) if white else rng
        self.flicker = []
        variance = flicker**2 * log(4) / pi
        for tau in FLICKER_TAUS if flicker else ():
            decay = float(np.exp(-1 / (rate_hz * tau)))
            size = np.sqrt(variance * (1 - decay**2))
            self.flicker.append((_skipped(rng, n), size, SteadyRecursion(decay, n)))
        self._walk = rng

    @staticmethod
    def possible(n: int, rate_hz: float) -> bool:
        """Whether the numbers of such a recording can be had in pieces."""
        return SteadyRecursion(float(np.exp(-1 / (rate_hz * FLICKER_TAUS[0]))), n).length >= 8

    def __call__(self, n: int) -> Array:
        """The next n samples."""
        noise = np.zeros(n)
        if self.white:
            self._white.standard_normal(out=noise)
            noise *= self.white
        if self.flicker:
            total = np.zeros(n)
            for rng, size, recursion in self.flicker:
                drive = rng.standard_normal(n) * size
                if recursion.done == 0:
                    drive[:1] /= np.sqrt(1 - recursion.decay**2)  # starts stationary
                total += recursion(drive)
            noise += total
        if self.walk:
            steps = self._walk.standard_normal(n)
            steps[:1] += self.last
            walked = np.cumsum(steps)
            self.last = float(walked[-1])
            noise += walked * self.walk
        return noise


def _skipped(rng: np.random.Generator, n: int) -> np.random.Generator:
    """The stream as it is, while the one given advances by n normal numbers."""
    here = deepcopy(rng)
    for first in range(0, n, SKIP):
        rng.standard_normal(min(SKIP, n - first))
    return here


class Noise(SignalEffect):
    """Independent noise on every channel."""

    stage = "sensor"
    order = 75
    random = True
    physics = "Thermal, electronic and 1/f noise of the sensor."
    equation = "Allan variance = N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3"
    source = "IEEE 952; IEEE 1293; Allan 1966; Physics: Noise and Allan variance"
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

    def in_pieces(self, sensor: Sensor, n: int, rng: np.random.Generator) -> "NoiseInPieces":
        """The same noise, applied to one piece after the other of a recording of n samples."""
        # on an inclinometer it acts on the angle: 1 ug = 1 urad
        size = 1 / G0 if sensor.kind == "inclinometer" else 1.0
        white, flicker, walk = (self.value(name) * size for name in ("white", "flicker", "walk"))
        draws = tuple(
            NoiseDraw(n, sensor.rate_hz, white, flicker, walk, stream)
            for stream in rng.spawn(len(sensor.axes))
        )
        return NoiseInPieces(self.values, self.sensor, draws=draws)

    def stepwise(self, stepping: Stepping) -> StepEffect:
        size = 1 / G0 if stepping.sensor.kind == "inclinometer" else 1.0
        white, flicker, walk = (self.value(name) * size for name in ("white", "flicker", "walk"))
        variance = flicker**2 * log(4) / pi
        return SteppedNoise(stepping, white, walk, np.sqrt(variance), np.array(FLICKER_TAUS))


@dataclass(frozen=True)
class NoiseInPieces(SignalEffect):
    """Noise that continues with each piece of a recording it is applied to.

    Args:
        draws: of each channel.
    """

    draws: tuple[NoiseDraw, ...] = ()

    order = Noise.order
    random = True
    row_wise = True
    parameters = ()

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        for i, draw in enumerate(self.draws):
            reading[:, i] += draw(len(reading))
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


class EncNoise(Noise):
    id = "enc_noise"
    needs = "any"
    kinds = ENCODER
    title = "white, flicker, random walk of an encoder"
    parameters = (
        Parameter("white", "arcsec_rthz", (0.01, 0.1, 1), positive=True),
        Parameter("flicker", "arcsec", (0.003, 0.03, 0.3), positive=True),
        Parameter("walk", "arcsec_rts", (0.0003, 0.003, 0.03), positive=True),
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
    cls = next(c for c in (AccNoise, GyrNoise, EncNoise) if c.senses(kind))
    size = 1 / G0 if kind == "inclinometer" else 1.0
    return [[grade * p.factor * size for grade in p.plausible] for p in cls.parameters]
