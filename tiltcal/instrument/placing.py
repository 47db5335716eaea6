"""Placing-angle bias tables applied: each axis of a level gives the other its placing angle, one
sample at a time or in blocks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import asin, atan2, cos, nan, pi, sin, sqrt
from typing import Any, ClassVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import COLUMN_UNITS, DEG
from tiltcal.effects.base import SignalEffect, TermEffect
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.effects.sense import ACCELEROMETERS, Sense
from tiltcal.effects.sensor.dynamics import placing_angle

LOOKUPS = ("interpolated", "rounded", "smooth")
PASSES = 2  # a bias b of the other axis shifts the angle by b/g: the second pass leaves (b/g)^2
STEEP = sin(5 * DEG)  # of g across an axis: below it the placing angle is mostly noise
MOST = 1 << 20  # steps of a table: a third of a millidegree over a whole turn
BLOCK = 8192  # samples that stay in a core's cache


@dataclass(frozen=True)
class BiasTable:
    """Zero bias of one axis against its placing angle.

    Args:
        start, step: of the angles, rad.
        values: bias at each angle, m/s2, (n,).
        sigmas: their standard uncertainties, m/s2, (n,).
        wave: the smooth fit c0, c1, s1, c2, s2, ...: bias = c0 + sum c_n cos(n beta) + s_n sin(n
            beta); empty without one.
    """

    start: float
    step: float
    values: Array
    sigmas: Array
    wave: tuple[float, ...] = ()

    @property
    def range_deg(self) -> tuple[float, float]:
        """First and last angle, deg."""
        return self.start / DEG, (self.start + (len(self.values) - 1) * self.step) / DEG

    def at(self, beta: Array, lookup: str = "interpolated") -> Array:
        """Bias at placing angles beta (rad), (n,); NaN more than half a step outside the table.

        Errors:
            Interpolated: step^2/8 of the largest second derivative; rounded: step/2 of the largest
                first one. For 1 mg cos(n beta) at 1 deg that is 0.0079 n^2 and 1.80 n arcsec.
        """
        t = (beta - self.start) * (1 / self.step)
        last = len(self.values) - 1
        inside = np.clip(t, 0.0, last)
        inside[np.isnan(inside)] = 0.0
        if lookup == "smooth":
            found = evaluate_wave(self.wave, beta)
        elif lookup == "rounded":
            found = self.values[(inside + 0.5).astype(np.intp)]
        else:
            k = np.minimum(inside.astype(np.intp), last - 1)
            low = self.values[k]
            found = low + (inside - k) * (self.values[k + 1] - low)
        outside = ~((t >= -0.5) & (t <= last + 0.5))
        if outside.any():
            found[outside] = np.nan
        return np.asarray(found)


def evaluate_wave(wave: Sequence[float], beta: Array) -> Array:
    """c0 + sum c_n cos(n beta) + s_n sin(n beta), (n,)."""
    once = np.exp(1j * np.asarray(beta))
    turn, total = once, np.full(np.shape(beta), wave[0])
    for n in range(1, len(wave), 2):
        total += wave[n] * turn.real + wave[n + 1] * turn.imag
        turn = turn * once
    return np.asarray(total)


def tables_of(
    stated: Mapping[str, Sequence[Mapping[str, Any]]], sensor: str, values: Mapping[str, float]
) -> dict[str, BiasTable]:
    """The tables of a sensor's axes from ``bias_tables`` of CAL.json, with the smooth fit among its
    parameters.

    Args:
        stated: ``<sensor>.<axis>`` -> entries with angle_deg, value, sigma, unit.
        sensor: whose.
        values: parameters by name, m/s2.

    Raises:
        TiltcalError: fewer than two entries, uneven angles, or a unit that is no acceleration.
    """
    found = {}
    for key, entries in stated.items():
        name, _, axis = key.partition(".")
        if name == sensor:
            try:
                found[axis] = _table(entries, _wave(sensor, axis, values))
            except (KeyError, ValueError, TypeError, IndexError) as error:
                what = f"no key {error}" if isinstance(error, KeyError) else str(error)
                raise TiltcalError(
                    f"bias table {key}",
                    found=what,
                    need="angle_deg in equal steps upwards, value, sigma and unit m_s2",
                    do="make it with `tiltcal calibrate --method placing_table`",
                ) from error
    return found


def _table(entries: Sequence[Mapping[str, Any]], wave: tuple[float, ...]) -> BiasTable:
    angles = np.array([float(e["angle_deg"]) for e in entries])
    step = float(np.median(np.diff(angles))) if len(angles) > 1 else 0.0
    whole = np.round((angles - angles[:1]) / (step or 1.0))
    if (
        step <= 0
        or np.any(np.diff(whole) < 1)
        or np.abs(angles - angles[0] - whole * step).max() > 1e-6
    ):
        raise ValueError(f"{len(angles)} entries at uneven or descending angles")
    if whole[-1] > MOST:
        raise ValueError(f"a table over {whole[-1]:.4g} steps of {step:g} deg")
    for e in entries:
        if e["unit"] not in COLUMN_UNITS or COLUMN_UNITS[e["unit"]].quantity != "acceleration":
            raise ValueError(f"unit {e['unit']}")
    grid = np.arange(int(whole[-1]) + 1)  # an angle that is missing is bridged by its neighbours
    factor = np.array([COLUMN_UNITS[e["unit"]].factor for e in entries])
    bias, sigma = (
        np.interp(grid, whole, factor * [float(e.get(k, 0.0)) for e in entries])
        for k in ("value", "sigma")
    )
    return BiasTable(angles[0] * DEG, step * DEG, bias, sigma, wave)


def _wave(sensor: str, axis: str, values: Mapping[str, float]) -> tuple[float, ...]:
    names = [f"{sensor}.bias_{axis}"]
    while f"{sensor}.cos{(len(names) + 1) // 2}_{axis}" in values:
        n = (len(names) + 1) // 2
        names += [f"{sensor}.cos{n}_{axis}", f"{sensor}.sin{n}_{axis}"]
    return tuple(values[n] for n in names) if len(names) > 1 else ()


@dataclass(frozen=True)
class PlacingBias(SignalEffect):
    """A zero bias that is tabulated against the placing angle of its axis.

    Args:
        table: of the channel ``axis``.
        lookup: how it is read, see ``BiasTable.at``.
    """

    id: ClassVar[str] = "placing_bias"
    stage: ClassVar[Stage] = "sensor"
    kinds: ClassVar[frozenset[str]] = ACCELEROMETERS
    order: ClassVar[int] = 25
    row_wise: ClassVar[bool] = True
    title: ClassVar[str] = "tabulated zero bias against the placing angle"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    equation: ClassVar[str] = "reading_i += table_i(beta_i); beta_i: turn about axis i from level"
    source: ClassVar[str] = "CN 109459585; Physics: Placing-angle tables"
    table: BiasTable | None = None
    lookup: str = "interpolated"

    def apply(self, reading: Array, sense: Sense, rng: np.random.Generator | None) -> Array:
        """See ``SignalEffect``; NaN outside the table. reading: SI, (n, k)."""
        if self.table is not None and self.axis is not None:
            channel = TermEffect.channel_of(self.axis, sense)
            angle = placing_angle(self.axis, sense.force)
            reading[:, channel] += self.table.at(angle, self.lookup)
        return reading

    def sigma(self, sense: Sense) -> Array:
        """Standard uncertainty of the table at what a sensor senses, m/s2, (n,)."""
        assert self.table is not None
        assert self.axis is not None
        stated = replace(self.table, values=self.table.sigmas)
        return stated.at(placing_angle(self.axis, sense.force))


class PlacingCorrector:
    """The on-line corrector of a two-axis level: constant memory, constant time a sample.

    ``beta_x = atan2(f_y, f_z)``, ``beta_y = atan2(-f_x, f_z)``; without a z
    channel ``f_z = sqrt(g^2 - f_x^2 - f_y^2)``, so that an instrument upside down cannot be told
    from an upright one. The angles come from the raw readings first (as in the patent), then once
    more from the corrected ones.

    Args:
        tables: of the axes ``x`` and ``y``; one may be missing and is passed on as it is.
        gravity: m/s2.
        lookup: ``interpolated``, ``rounded`` (the patent's) or ``smooth``.

    Raises:
        TiltcalError: the look-up is unknown, or smooth without a fit.

    Source: patent CN 109459585 (docs/sources.md, "Placing-angle bias table").
    """

    def __init__(
        self, tables: Mapping[str, BiasTable], gravity: float, lookup: str = "interpolated"
    ) -> None:
        if lookup not in LOOKUPS:
            raise TiltcalError("look-up", found=lookup, need=" or ".join(LOOKUPS), do="correct it")
        for axis, table in tables.items():
            if lookup == "smooth" and not table.wave:
                raise TiltcalError(
                    f"look-up smooth of axis {axis}",
                    found="no smooth fit that holds",
                    need="one among the parameters",
                    do="use interpolated, or calibrate with more harmonics",
                )
        self.tables, self.gravity, self.lookup = dict(tables), gravity, lookup
        self._x, self._y = (_Single(tables[a], lookup) if a in tables else None for a in "xy")

    def correct_one(self, f_x: float, f_y: float, f_z: float | None = None) -> tuple[float, float]:
        """Corrected f_x, f_y, m/s2, of one sample; NaN for an axis whose placing angle its table
        does not hold.
        """
        x, y, squared = f_x, f_y, self.gravity * self.gravity
        least = STEEP * STEEP * squared
        b_x = b_y = 0.0
        for _ in range(PASSES):
            up = f_z if f_z is not None else sqrt(max(squared - x * x - y * y, 0.0))
            if self._x is not None:
                b_x = self._x.at(atan2(y, up)) if y * y + up * up > least else nan
            if self._y is not None:
                b_y = self._y.at(atan2(-x, up)) if x * x + up * up > least else nan
            # outside its table an axis still gives the other its angle
            x = f_x - b_x if b_x == b_x else f_x
            y = f_y - b_y if b_y == b_y else f_y
        return f_x - b_x, f_y - b_y

    def update(self, force: Sequence[float]) -> tuple[float, float]:
        """Tilt of x and y, rad, from one sample (f_x, f_y) or (f_x, f_y, f_z), m/s2, as it
        comes.
        """
        f_x, f_y = self.correct_one(*force)
        g = self.gravity
        t_x, t_y = f_x / g, f_y / g
        return (
            (
                asin(t_x)
                if -1.0 <= t_x <= 1.0
                else (pi / 2 if t_x > 1 else -pi / 2 if t_x < -1 else nan)
            ),
            (
                asin(t_y)
                if -1.0 <= t_y <= 1.0
                else (pi / 2 if t_y > 1 else -pi / 2 if t_y < -1 else nan)
            ),
        )

    def correct(self, force: Array) -> Array:
        """Corrected f_x, f_y, (n, 2), of a block of samples, (n, 2) or (n, 3), m/s2."""
        found = np.empty((len(force), 2))
        for start in range(0, len(force), BLOCK):
            part = slice(start, start + BLOCK)
            found[part, 0], found[part, 1] = self._correct(*np.ascontiguousarray(force[part].T))
        return found

    def tilt(self, force: Array) -> Array:
        """Tilt of x and y, rad, (n, 2), of a block of samples, (n, 2) or (n, 3), m/s2."""
        found = np.empty((len(force), 2))
        for start in range(0, len(force), BLOCK):
            part = slice(start, start + BLOCK)
            for i, f in enumerate(self._correct(*np.ascontiguousarray(force[part].T))):
                f /= self.gravity
                np.clip(f, -1.0, 1.0, out=f)
                found[part, i] = np.arcsin(f)
        return found

    def _correct(self, f_x: Array, f_y: Array, f_z: Array | None = None) -> tuple[Array, Array]:
        x, y, squared = f_x, f_y, self.gravity**2
        b_x = b_y = np.zeros(len(f_x))
        for _ in range(PASSES):
            xx, yy = x * x, y * y
            zz = np.maximum(squared - xx - yy, 0.0) if f_z is None else f_z * f_z
            up = np.sqrt(zz) if f_z is None else f_z
            if "x" in self.tables:
                b_x = self._bias("x", np.arctan2(y, up), yy + zz)
            if "y" in self.tables:
                b_y = self._bias("y", np.arctan2(-x, up), xx + zz)
            x, y = _less(f_x, b_x), _less(f_y, b_y)
        return f_x - b_x, f_y - b_y

    def _bias(self, axis: str, beta: Array, across: Array) -> Array:
        found = self.tables[axis].at(beta, self.lookup)
        steep = across <= (STEEP * self.gravity) ** 2
        if steep.any():
            found[steep] = np.nan
        return found


def _less(f: Array, bias: Array) -> Array:
    """f - bias; f alone where the bias is not known."""
    less = f - bias
    unknown = np.isnan(bias)
    if unknown.any():
        less[unknown] = f[unknown]
    return np.asarray(less)


class _Single:
    """A table for one sample at a time: plain lists and floats, because an array of one costs a
    hundred times as much.
    """

    def __init__(self, table: BiasTable, lookup: str) -> None:
        self.start, self.per, self.last = table.start, 1 / table.step, len(table.values) - 1
        self.values = table.values.tolist()
        self.slopes = [*np.diff(table.values).tolist(), 0.0]
        self.wave, self.rounded = table.wave, lookup == "rounded"
        self.smooth = lookup == "smooth"

    def at(self, beta: float) -> float:
        """Bias, m/s2; NaN more than half a step outside."""
        t = (beta - self.start) * self.per
        if not -0.5 <= t <= self.last + 0.5:
            return nan
        if self.smooth:
            return self._smooth(beta)
        t = 0.0 if t < 0 else self.last if t > self.last else t
        if self.rounded:
            return self.values[int(t + 0.5)]
        k = int(t)
        return self.values[k] + (t - k) * self.slopes[k]

    def _smooth(self, beta: float) -> float:
        wave, total = self.wave, self.wave[0]
        c1, s1 = cos(beta), sin(beta)
        c, s = c1, s1
        for n in range(1, len(wave), 2):
            total += wave[n] * c + wave[n + 1] * s
            c, s = c * c1 - s * s1, s * c1 + c * s1
        return total
