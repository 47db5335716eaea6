"""Forms of a curve: splines, harmonics, what is in proportion."""

from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, with_values
from tiltcal.effects.learned import Learned
from tiltcal.effects.spans import CoordinateRanges


def curve_over(
    cls: type[Learned], coordinate: str, basis: int | tuple[float, ...], **where: Any
) -> Hypothesis:
    """A curve with its coefficients free.

    Args:
        cls: where it acts; coordinate: what it follows.
        basis: its knots, or how many coefficients it has.
        where: fields of the effect.
    """
    knots = () if isinstance(basis, int) else basis
    names = tuple(f"c{k}" for k in range(basis if isinstance(basis, int) else len(basis)))
    effect = cls(
        dict.fromkeys(names, 1e-6),
        where.pop("sensor", None),
        where.pop("axis", None),
        "found",
        coordinate=coordinate,
        knots=knots,
        **where,
    )
    return Hypothesis(effect, names)


def proportional(curve: Hypothesis, alias: str | None = None) -> Hypothesis:
    """What is in proportion to the coordinate of a curve, in its place."""
    effect = curve.effect
    assert isinstance(effect, Learned)
    line = replace(effect, values={"c0": 1e-6}, knots=(), power=1.0, odd=True)
    return Hypothesis(line, ("c0",), alias)


def odd_curve(curve: Hypothesis) -> Hypothesis:
    """A curve through nothing at the middle of its range."""
    names = (curve.names[0], curve.names[-1])
    return Hypothesis(with_values(curve.effect, {n: curve.effect.values[n] for n in names}), names)


def even_knots(coordinate: str, span: CoordinateRanges, count: int) -> tuple[float, ...]:
    """Knots at equal distances over what is spanned; none where nothing is."""
    low, high = span.ranges.get(coordinate, (0.0, 0.0))
    return tuple(np.linspace(low, high, count)) if high > low else ()


def spread_knots(coordinate: str, span: CoordinateRanges) -> tuple[float, ...]:
    """Knots ever further apart: what follows a move is quick at first."""
    high = span.ranges.get(coordinate, (0.0, 0.0))[1]
    knots = (0.0, *np.geomspace(0.4, high, 7)) if high > 2.0 else ()
    return tuple(float(k) for k in knots)


def harmonics(count: int) -> int:
    """Coefficients of so many harmonics."""
    return 2 * count
