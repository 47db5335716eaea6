"""Where a step, a sawtooth or a bump over a coordinate would explain most of what a model leaves.

What a curve does to a reading is the curve times what a constant in its place does. The evidence
for a form is then a sum over the coordinate: all places, widths and periods are compared from sums
over small ranges of it, without a column for each.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.curve_forms import (
    Knots,
    bump_at,
    formed,
    localisable,
    saw_at,
    step_at,
)
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.curve_coordinates import coordinate_of
from tiltcal.setup.tables import axis_of

BINS = 720  # over the range of a coordinate
TEETH = np.arange(0.6, 20.0, 0.25)  # periods of a sawtooth in that range
JUMPS = 24  # places of its jump in a period
WIDTHS = np.geomspace(0.01, 0.3, 6)  # of a step or a bump, in such ranges
PLACES = 72  # of a step or a bump


@dataclass(frozen=True)
class Form:
    """A localised form of the curves of one cause.

    Args:
        hypotheses: the curves in this form, as many as there are.
        tried: among how many it was chosen.
    """

    hypotheses: tuple[Hypothesis, ...]
    tried: int


@dataclass(frozen=True)
class Shapes:
    """Forms of one kind over a range from 0 to 1.

    Args:
        knots: of each; periods: of each, 0 for none, (m,).
        columns: their values in the middles of BINS ranges, (BINS, m); squares: of these.
    """

    knots: Sequence[Knots]
    periods: Sequence[float]
    columns: Array
    squares: Array

    @classmethod
    def of(cls, forms: Sequence[tuple[Knots, float, Array]]) -> "Shapes":
        """Forms by knots, period and values, (BINS,)."""
        knots, periods, values = zip(*forms, strict=True)
        columns = np.column_stack(values)
        return cls(knots, periods, columns, columns**2)


@dataclass(frozen=True)
class Sums:
    """Over even ranges of a coordinate, for each curve of a cause.

    Args:
        low: where the first begins; reach: of all together, SI.
        along: inner products with what is left, (BINS, curves).
        energy: squared lengths, (BINS, curves).
    """

    low: float
    reach: float
    along: Array
    energy: Array

    def gains(self, shapes: Shapes) -> Array:
        """What forms gain beside an offset, roughly, (m,)."""
        whole = np.maximum(self.energy.sum(axis=0), np.finfo(float).tiny)
        level = shapes.columns.T @ self.energy
        rest = shapes.squares.T @ self.energy - level**2 / whole
        there = rest > 1e-6 * whole
        offset = self.along.sum(axis=0) / whole
        along = (shapes.columns.T @ self.along - level * offset) ** 2
        return np.asarray(np.where(there, along / np.where(there, rest, 1.0), 0.0).sum(axis=1))


def nearest_forms(
    curves: Sequence[Hypothesis], fitted: FittedModel, whitened: WhitenedModel
) -> list[Form]:
    """The best step, sawtooth and bump in place of curves over one coordinate that are one cause;
    none by hand, where no table tells what the sensors feel.

    Args:
        curves: over the same coordinate; nothing is found for others.
        fitted: the model without them.
        whitened: the noise by which readings are weighed.
    """
    coordinate = localisable(curves[0]) if whitened.observations.courses else None
    sums = None if coordinate is None else _sums(curves, coordinate, fitted, whitened)
    if sums is None:
        return []
    found = []
    for shapes in _shapes():
        k = int(np.argmax(sums.gains(shapes)))
        knots = tuple(sums.low + sums.reach * at for at in shapes.knots[k])
        period = sums.reach * shapes.periods[k]
        found.append(Form(tuple(formed(h, knots, period) for h in curves), len(shapes.knots)))
    return found


def _sums(
    curves: Sequence[Hypothesis], coordinate: str, fitted: FittedModel, whitened: WhitenedModel
) -> Sums | None:
    """The sums of curves over a coordinate; None where it does not change."""
    from scipy.fft import idct

    followed = _followed(coordinate, fitted, whitened)
    known = np.concatenate(followed)
    low, high = float(np.nanmin(known)), float(np.nanmax(known))
    if not high > low:
        return None
    width = (high - low) / BINS
    along, energy = np.zeros((BINS, len(curves))), np.zeros((BINS, len(curves)))
    noise = whitened.noise_of(fitted.residual)
    for k, curve in enumerate(curves):
        constant = formed(curve, (0.0, 1.0))
        parts = [whitened.columns.stored(constant, name) for name in constant.names]
        for i in {i for part in parts for i in part}:
            root = whitened.roots[i]
            whole = np.sum([part[i] for part in parts if i in part], axis=0)
            change = np.asarray(idct(whole, norm="ortho"))
            left = idct(noise[i] / root, norm="ortho")
            place = ((np.nan_to_num(followed[i], nan=low) - low) / width).astype(int)
            place = np.clip(place, 0, BINS - 1)
            change = np.where(np.isnan(followed[i]), 0.0, change)
            along[:, k] += np.bincount(place, change * left, BINS)
            energy[:, k] += np.bincount(place, change**2, BINS) * np.mean(1 / root**2)
    return Sums(low, high - low, along, energy)


def _followed(coordinate: str, fitted: FittedModel, whitened: WhitenedModel) -> list[Array]:
    """A coordinate at the readings of each channel, SI; NaN where it is not known."""
    observations, axis = whitened.observations, axis_of(coordinate)
    watches = observations.watches(fitted.effects)
    found = []
    for i, channel in enumerate(observations.channels):
        recording = observations.recordings[channel.recording]
        told = np.full(len(channel.time), np.nan)
        if axis is not None:
            if (angle := recording.table(axis)) is not None:
                told = np.interp(channel.time, recording.time, angle)
        elif channel.recording < len(watches) and not channel.derived:
            sense = watches[channel.recording].sense[channel.sensor]
            own = sense.true_input()[:, channel.column]
            told = observations.at_samples(i, coordinate_of(coordinate, sense, own))
        found.append(told)
    return found


@lru_cache(maxsize=1)
def _shapes() -> tuple[Shapes, ...]:
    """Steps, sawteeth and bumps."""
    middles = (np.arange(BINS) + 0.5) / BINS
    return tuple(Shapes.of(list(forms(middles))) for forms in (_steps, _saws, _bumps))


Forms = Iterator[tuple[Knots, float, Array]]
"""Knots, period and values of each."""


def _steps(u: Array) -> Forms:
    for width, middle in product(WIDTHS, np.linspace(0, 1, PLACES + 2)[1:-1]):
        yield step_at(middle, width), 0.0, np.clip((u - middle) / width + 0.5, 0.0, 1.0)


def _saws(u: Array) -> Forms:
    """Each by the jump next to the middle of the range: its place then says nothing of the
    period.
    """
    for period, k in product(1 / TEETH, range(JUMPS)):
        jump = 0.5 + period * (k / JUMPS - 0.5)
        yield saw_at(jump, period), float(period), ((u - jump) / period) % 1.0


def _bumps(u: Array) -> Forms:
    """By one of their numbers: the two beside it bend them."""
    for width, middle in product(WIDTHS, np.linspace(0, 1, PLACES)):
        far = np.abs(u - middle) / width
        yield bump_at(middle, width), 0.0, np.where(far < 2, np.cos(np.pi / 4 * far) ** 2, 0.0)
