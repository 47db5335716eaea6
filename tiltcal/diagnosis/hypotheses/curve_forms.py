"""Forms of a curve: splines, harmonics, what is in proportion.

Localised forms of a curve: a step, a sawtooth, a bump.

Where a form lies, how wide it is and when it begins anew are its shape, as a time constant is of an
effect of the catalogue.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, with_values
from tiltcal.effects.curve_coordinates import INPUTS
from tiltcal.effects.learned import Learned, LearnedReading
from tiltcal.effects.spans import ROUNDING, CoordinateRanges
from tiltcal.setup.tables import angle_channel, axis_of


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
    varies = high - low > ROUNDING * max(abs(low), abs(high))
    return tuple(np.linspace(low, high, count)) if varies else ()


def spread_knots(coordinate: str, span: CoordinateRanges) -> tuple[float, ...]:
    """Knots ever further apart: what follows a move is quick at first."""
    high = span.ranges.get(coordinate, (0.0, 0.0))[1]
    knots = (0.0, *np.geomspace(0.4, high, 7)) if high > 2.0 else ()
    return tuple(float(k) for k in knots)


def harmonics(count: int) -> int:
    """Coefficients of so many harmonics."""
    return 2 * count


STEPS = 36  # places of a step over the range of an angle
BUMP = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)  # knots of a bump, in widths from its middle
RAISED = (2, 3, 4)  # those of them at which it is not nothing

Knots = tuple[float, ...]


def step_at(middle: float, width: float) -> Knots:
    """From one level to another within a width, SI: two numbers."""
    return float(middle - width / 2), float(middle + width / 2)


def saw_at(jump: float, period: float) -> Knots:
    """A ramp that begins anew at a jump, SI: two numbers."""
    return float(jump), float(jump + period)


def bump_at(middle: float, width: float) -> Knots:
    """Nothing but about a middle, rad: three numbers."""
    return tuple(float(middle + width * k) for k in BUMP)


def is_bump(hypothesis: Hypothesis) -> bool:
    """Whether a curve has the form of ``bump_at``."""
    effect = hypothesis.effect
    return isinstance(effect, Learned) and hypothesis.names == tuple(f"c{k}" for k in RAISED)


def is_localised(hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis has one of these forms."""
    effect = hypothesis.effect
    return isinstance(effect, Learned) and (effect.is_step or effect.is_saw or is_bump(hypothesis))


def localisable(hypothesis: Hypothesis) -> str | None:
    """The coordinate of now that a curve without a name follows, where it may have such a form: a
    table angle, a temperature, a channel's own input; of a scale factor and of what another input
    is multiplied by the time, too. An addition that steps with time is listed.
    """
    effect = hypothesis.effect
    if hypothesis.listed or not isinstance(effect, Learned):
        return None
    if effect.beside or effect.power or effect.lag or effect.play:
        return None
    if effect.times:
        return "time" if effect.coordinate == "time" and effect.times in INPUTS else None
    local = effect.coordinate in ("temperature", "input", *(["time"] if effect.per_input else []))
    return effect.coordinate if local or axis_of(effect.coordinate) else None


def formed(hypothesis: Hypothesis, knots: Knots, period: float = 0.0) -> Hypothesis:
    """A curve in a localised form."""
    effect = hypothesis.effect
    assert isinstance(effect, Learned)
    free = RAISED if len(knots) == len(BUMP) else range(len(knots))
    values = {f"c{k}": hypothesis.size(hypothesis.names[0]) for k in free}
    holds = effect.holds or effect.coordinate == "temperature"  # it goes on as it ends
    form = replace(effect, values=values, knots=knots, period=float(period), holds=holds)
    return replace(hypothesis, effect=form, names=tuple(values))


def steps_beside(curves: Iterable[Hypothesis]) -> Iterator[Hypothesis]:
    """Curves, and after each spline of a reading over a table angle its steps at even places."""
    for curve in curves:
        yield curve
        effect = curve.effect
        over = localisable(curve)
        if isinstance(effect, LearnedReading) and effect.knots and over and axis_of(over):
            edges = np.linspace(effect.knots[0], effect.knots[-1], STEPS + 1)
            for low, high in pairwise(edges):
                yield formed(curve, (float(low), float(high)))


def form_of(hypothesis: Hypothesis) -> dict[str, float]:
    """The continuous shapes of a localised curve, SI: its place, its width or its period."""
    effect = hypothesis.effect
    if not isinstance(effect, Learned) or not is_localised(hypothesis):
        return {}
    knots = effect.knots
    if effect.is_saw:
        return {"place": knots[0], "period": effect.period}
    return {"place": (knots[0] + knots[-1]) / 2, "breadth": (knots[-1] - knots[0])}


def with_form(hypothesis: Hypothesis, name: str, value: float) -> Hypothesis:
    """A localised curve at another place, breadth or period."""
    effect, form = hypothesis.effect, {**form_of(hypothesis), name: value}
    assert isinstance(effect, Learned)
    if effect.is_saw:
        return formed(hypothesis, saw_at(form["place"], form["period"]), form["period"])
    far = np.array(effect.knots) - form_of(hypothesis)["place"]
    far = far / (effect.knots[-1] - effect.knots[0])
    return formed(hypothesis, tuple(float(form["place"] + k * form["breadth"]) for k in far))


def span_of(axis: str, span: CoordinateRanges) -> float:
    """How far an axis turns, rad."""
    low, high = span.ranges.get(angle_channel(axis), (0.0, 0.0))
    return high - low
