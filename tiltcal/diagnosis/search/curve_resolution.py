"""A curve at other resolutions: how many knots it needs is a shape of it, as a time constant is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.curve_forms import proportional
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.learned import Learned

OTHERS = (0.6, 1.5, 2.0, 3.0)  # times as many knots
RESOLUTIONS = 2 + len(OTHERS)  # with the first one and the line
FEWEST = 4  # knots of a curve that has a resolution: one of three is a parabola


def resolutions(hypotheses: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
    """Curves that belong together, in proportion to their coordinate, and with fewer or more knots,
    spaced alike; one resolution after the other.
    """
    curves = [
        (h, h.effect)
        for h in hypotheses
        if isinstance(h.effect, Learned) and len(h.effect.knots) >= FEWEST
    ]
    yield from (proportional(hypothesis) for hypothesis, _ in curves)
    for factor in OTHERS:
        for hypothesis, effect in curves:
            yield _with_knots(hypothesis, effect, round(factor * len(effect.knots)))


def _with_knots(hypothesis: Hypothesis, effect: Learned, count: int) -> Hypothesis:
    places = np.linspace(0.0, 1.0, count)
    knots = np.interp(places, np.linspace(0.0, 1.0, len(effect.knots)), effect.knots)
    names = tuple(f"c{k}" for k in range(count))
    values = dict.fromkeys(names, hypothesis.size(hypothesis.names[0]))
    finer = replace(effect, knots=tuple(float(k) for k in knots), values=values)
    return replace(hypothesis, effect=finer, names=names)
