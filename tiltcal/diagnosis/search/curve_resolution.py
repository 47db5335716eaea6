"""A curve at other resolutions: how many knots it needs is a shape of it, as a time constant is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.learned import Learned

FINER = (1.5, 2.0, 3.0)  # times as many knots
FEWEST = 4  # knots of a curve that has a resolution: one of three is a parabola


def resolutions(hypotheses: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
    """Curves that belong together, each with more knots, spaced alike; one resolution after the
    other.
    """
    for factor in FINER:
        for hypothesis in hypotheses:
            effect = hypothesis.effect
            if isinstance(effect, Learned) and len(effect.knots) >= FEWEST:
                yield _with_knots(hypothesis, effect, round(factor * len(effect.knots)))


def _with_knots(hypothesis: Hypothesis, effect: Learned, count: int) -> Hypothesis:
    places = np.linspace(0.0, 1.0, count)
    knots = np.interp(places, np.linspace(0.0, 1.0, len(effect.knots)), effect.knots)
    names = tuple(f"c{k}" for k in range(count))
    values = dict.fromkeys(names, hypothesis.size(hypothesis.names[0]))
    finer = replace(effect, knots=tuple(float(k) for k in knots), values=values)
    return replace(hypothesis, effect=finer, names=names)
