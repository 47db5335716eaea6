"""Forms that a grid of curves describes poorly: bumps, steps and sawteeth over an angle; a period
over the time since a move.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.removed_finding import RemovedFinding, price_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import Alternative, explain
from tiltcal.effects.learned import Learned
from tiltcal.setup.tables import axis_of

WIDTHS = (0.15, 0.3, 0.6)  # rad, of bumps and steps
SHARPER = 4  # times three
WAVES = 6  # of a period: three harmonics tell it from others before its jump is known
TURNS = 1.2  # periods that have to be seen
FINEST = 0.3  # rad, of a period
BETWEEN = 4  # periods tried for each that could be told apart
RAMP = 0.5  # share of the worth of any curve of the angle that they have to have
# places of the jump that are tried, from the middle of the range: there the period says nothing
# about it
JUMPS = 32
NEAR = (-2, -1, 0, 1, 2)  # steps to both sides
CLOSER = 5  # halvings of them
# frequencies of an echo tried in the width of a line over one rest, before its period is halved in
TOLD = 8


@dataclass(frozen=True)
class Shape:
    """A form over a coordinate.

    Args:
        knots: rad or s, of a curve; free: those of its values that are not nothing.
        period: rad or s, after which it begins anew; 0 for never.
    """

    knots: tuple[float, ...]
    free: tuple[int, ...]
    period: float = 0.0


def local(
    alternative: Alternative, removed: RemovedFinding, whitened: WhitenedModel
) -> list[Alternative]:
    """Bumps, steps and sawteeth over the coordinate of a curve, in its place, on all axes on which
    it may act.
    """
    coordinate = angle_of(alternative)
    assert coordinate is not None
    angles = [
        a
        for r in whitened.observations.recordings
        if (a := r.table(str(axis_of(coordinate)))) is not None
    ]
    low, high = min(float(np.nanmin(a)) for a in angles), max(float(np.nanmax(a)) for a in angles)
    found = _best_of(_bumps(low, high), alternative, removed, whitened)
    steps = _steps(low, high, alternative, removed, whitened)
    return [*found[:2], *steps, *_saws(low, high, steps, alternative, removed, whitened)]


def echo(alternative: Alternative, removed: RemovedFinding, whitened: WhitenedModel) -> Alternative:
    """An oscillation after each move at its best period: a spectral peak gives the period only to a
    part of the peak's width.
    """
    stops = [
        (r.time, stop)
        for r, stop in zip(
            whitened.observations.recordings, whitened.observations.stops, strict=True
        )
    ]
    rest = float(
        np.median(
            [
                np.ptp(time[stop == k])
                for time, stop in stops
                for k in range(int(stop.max(initial=-1)) + 1)
            ]
        )
    )
    apart, best = 1 / (TOLD * rest), alternative
    for k in range(CLOSER + 1):
        middle = 1 / _shape_of(best.hypothesis).period
        tones = [middle + apart * m for m in (range(-TOLD, TOLD + 1) if k == 0 else NEAR)]
        found = _best_of(
            [Shape((), tuple(range(WAVES)), float(1 / f)) for f in tones if f > 0],
            alternative,
            removed,
            whitened,
        )
        # it beats once, wherever it was looked for
        found = [replace(r, worth=r.gain - price_of(whitened) * r.sizes) for r in found]
        best, apart = max([best, *found], key=lambda r: r.worth), apart / 2
    return best


def is_echo(alternative: Alternative) -> bool:
    """Whether a curve is periodic in the time since the last move."""
    effect = alternative.hypothesis.effect
    return isinstance(effect, Learned) and effect.coordinate == "since_move" and effect.period > 0


def angle_of(alternative: Alternative) -> str | None:
    """The one table angle that a curve goes over."""
    effect = alternative.hypothesis.effect
    return (
        effect.coordinate
        if isinstance(effect, Learned) and axis_of(effect.coordinate) and not effect.beside
        else None
    )


def _bumps(low: float, high: float) -> list[Shape]:
    """Bumps at every position and width over an angle from ``low`` to ``high``."""
    return [
        Shape(tuple(float(middle + width * k) for k in (-3, -2, -1, 0, 1, 2, 3)), (2, 3, 4))
        for width in WIDTHS
        for middle in np.arange(low, high, width)
    ]


def _steps(
    low: float,
    high: float,
    alternative: Alternative,
    removed: RemovedFinding,
    whitened: WhitenedModel,
) -> list[Alternative]:
    """The best step, refined to its width."""
    steps = _best_of(
        [step_at(m, 1.5 * w) for w in WIDTHS for m in np.arange(low, high, w)],
        alternative,
        removed,
        whitened,
    )
    for _ in range(SHARPER if steps else 0):
        left, middle, right = _shape_of(steps[0].hypothesis).knots
        reach = (right - left) / 2
        near = [step_at(middle + reach * k / 4, reach / 3) for k in range(-4, 5)]
        steps = max(
            steps,
            _best_of(near, alternative, removed, whitened),
            key=lambda f: f[0].worth if f else -np.inf,
        )
        if _shape_of(steps[0].hypothesis).knots == (left, middle, right):
            break
    return steps[:1]


def step_at(middle: float, reach: float) -> Shape:
    """From one level to another within ``reach`` to both sides of an angle: two numbers, one of
    them an offset.
    """
    return Shape(tuple(float(middle + reach * k) for k in (-1, 0, 1)), (0, 2))


def _saws(
    low: float,
    high: float,
    steps: Sequence[Alternative],
    alternative: Alternative,
    removed: RemovedFinding,
    whitened: WhitenedModel,
) -> list[Alternative]:
    """The best sawtooth: its period from its first harmonics, then the position of its jump.

    Where only one jump is seen, the best of ``steps`` gives its position, and trial periods the
    distance to the next.
    """
    middle, reach = (low + high) / 2, high - low
    teeth = np.arange(TURNS, reach / FINEST, 1 / BETWEEN)
    waves = _best_of(
        [Shape((), tuple(range(WAVES)), float(reach / n)) for n in teeth],
        alternative,
        removed,
        whitened,
    )[:1]
    starts = []
    if waves and waves[0].worth > RAMP * alternative.worth:
        period = _shape_of(waves[0].hypothesis).period
        apart, far = period / JUMPS, period**2 / (2 * BETWEEN * reach)
        starts.append(
            (
                [saw_at(middle + apart * k, period + far * m) for k in range(JUMPS) for m in NEAR],
                apart,
                far,
            )
        )
    if steps and steps[0].worth > RAMP * alternative.worth:
        knots = _shape_of(steps[0].hypothesis).knots
        periods = np.linspace(reach / (2 * TURNS), 2 * reach, JUMPS)
        starts.append(
            (
                [saw_at(knots[1], p) for p in periods],
                knots[2] - knots[1],
                float(periods[1] - periods[0]),
            )
        )
    found = [
        saw
        for start in starts
        if (saw := _sharpened(*start, alternative, removed, whitened)) is not None
    ]
    return [max(found, key=lambda r: r.worth)] if found else []


def _sharpened(
    shapes: Sequence[Shape],
    apart: float,
    far: float,
    alternative: Alternative,
    removed: RemovedFinding,
    whitened: WhitenedModel,
) -> Alternative | None:
    """The best of some sawteeth, with the position of its jump, known to ``apart``, and its period,
    known to ``far``, refined, rad.
    """
    saws = _best_of(shapes, alternative, removed, whitened)
    for _ in range(CLOSER if saws else 0):
        apart, far = apart / 2, far / 2
        begin, period = _shape_of(saws[0].hypothesis).knots[0], _shape_of(saws[0].hypothesis).period
        saws = _best_of(
            [saw_at(begin + apart * k, period + far * m) for k in NEAR for m in NEAR],
            alternative,
            removed,
            whitened,
        )
    return saws[0] if saws else None


def saw_at(begin: float, period: float) -> Shape:
    """A periodic ramp that begins at a position: two parameters, one of them an offset."""
    return Shape((float(begin), float(begin + period)), (0, 1), float(period))


def _best_of(
    shapes: Sequence[Shape],
    alternative: Alternative,
    removed: RemovedFinding,
    whitened: WhitenedModel,
) -> list[Alternative]:
    """The best two of some shapes, each on all axes on which the alternative acts; the number of
    shapes tried is charged for.
    """
    own = whitened.alone(list(_shaped(alternative, shapes)), ())
    best: dict[Shape, float] = {}
    scores = own.scores(removed.basis, removed.target)
    for score in scores:
        shape = _shape_of(score.hypothesis)
        best[shape] = best.get(shape, 0.0) + score.best(price_of(whitened))[0]
    found = []
    for shape in sorted(best, key=lambda s: -best[s])[:2]:
        mine = max(
            (s for s in scores if _shape_of(s.hypothesis) == shape), key=lambda s: s.gain()[0]
        )
        if (explained := explain(mine.hypothesis, removed, own)) is not None:
            found.append(replace(explained, worth=explained.worth - 2 * np.log(len(best))))
    return found


def _shape_of(hypothesis: Hypothesis) -> Shape:
    effect = hypothesis.effect
    assert isinstance(effect, Learned)
    return Shape(effect.knots, tuple(int(name[1:]) for name in hypothesis.names), effect.period)


def _shaped(alternative: Alternative, shapes: Sequence[Shape]) -> Iterator[Hypothesis]:
    """The curves of an alternative in other shapes."""
    for shape in shapes:
        values = {f"c{k}": 1e-6 for k in shape.free}
        for term in alternative.terms:
            if isinstance(term.hypothesis.effect, Learned):
                effect = replace(
                    term.hypothesis.effect, values=values, knots=shape.knots, period=shape.period
                )
                yield Hypothesis(effect, tuple(values))
