"""What a model of a law leaves of it: another cause may be nothing but that.

A nameless curve is a far worse model of a law than a textbook form is of its own: it may follow
another coordinate than the law does. What either leaves is a discrepancy with a prior (Kennedy and
O'Hagan, J. R. Stat. Soc. B 63, 2001), whose energy is a share of the model's own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit_linearly
from tiltcal.diagnosis.model.score_test import DEVIATIONS, ENERGIES, log_bayes_factor
from tiltcal.diagnosis.search.state import State, laws, refitted, without
from tiltcal.effects.learned import Learned

SHARES = np.array([1e-5, 1e-4, 1.6e-3, 0.02, 0.16, 0.45])
"""Energy that a listed law takes up of what a curve leaves of its law, in energies of the curve,
each as probable as another: three where the curve follows the coordinate of its law, three where it
follows another one. A second curve takes up as much. ``docs/diagnosis_model.md`` says how they were
learnt.
"""
BEYOND_FAMILY = 10.0 ** np.array([-6.0, -5.0, -4.0, -3.0])
"""Energy that a nameless curve takes up of what a textbook form leaves of its law, in energies of
the law. ``docs/diagnosis_model.md`` says what this rests on.
"""


def largest_misfit(fitted: FittedModel) -> float:
    """Share of what the causes of a model explain that their forms may leave at most."""
    nameless = any(not law.listed for law in laws(fitted))
    return float(max(SHARES if nameless else DEVIATIONS))


def of_other_kind(state: State, k: int) -> list[int]:
    """The nameless causes beside a listed one, and the listed ones beside a nameless one."""
    every = laws(state.fitted)
    return [j for j, law in enumerate(every) if law.listed != every[k].listed]


def larger_curves(state: State, k: int) -> list[int]:
    """The nameless causes beside the k-th without which the deviance rises more."""
    gain = [without(state, j).fitted.deviance for j in range(len(state.causes))]
    every = enumerate(laws(state.fitted))
    return [j for j, law in every if not law.listed and gain[j] > gain[k]]


def energy_beside(state: State, k: int, which: Sequence[int]) -> float:
    """What some causes explain without the k-th, each channel as far as the k-th acts there: fall
    of the deviance.
    """
    if not which:
        return 0.0
    rest = without(state, k)
    own = _explained(rest.fitted, state.fitted)
    others = _explained(without(state, k, *which).fitted, rest.fitted)
    return float(own @ others) / max(float(own.sum()), np.finfo(float).tiny)


def misfit_odds(gain: float, energy: float, shares: Array = SHARES) -> float:
    """Log odds of the size of a cause as what those of the other kind leave of their laws, to that
    as a cause of any size, nats.

    Args:
        gain: of the cause, fall of the deviance.
        energy: of the others.
        shares: energy that it may take up, in energies of the others, (n,).
    """
    as_misfit, as_cause = (
        float(log_bayes_factor(np.array([gain]), np.asarray(widths)[:, None])[0])
        for widths in (energy * shares, ENERGIES)
    )
    return as_misfit - as_cause


def nearest(state: State, k: int, which: Sequence[int]) -> int:
    """Of some causes that which explains most in the channels of the k-th."""
    rest = without(state, k)
    own = _explained(rest.fitted, state.fitted)
    return max(which, key=lambda j: own @ _explained(without(state, j, k).fitted, rest.fitted))


def same_curve(state: State, k: int) -> int | None:
    """An earlier nameless cause at the place of the k-th and over its coordinate: the sum of both
    is one law.
    """
    every = laws(state.fitted)
    alike = (j for j in range(k) if _followed(every[j]) == _followed(every[k]))
    return None if every[k].listed else next(alike, None)


def _followed(law: Hypothesis) -> tuple[object, ...] | None:
    """Where a nameless curve acts, and what it follows; None for a name."""
    effect = law.effect
    if law.listed or not isinstance(effect, Learned):
        return None
    place = type(effect), effect.sensor, effect.axis, effect.slot, effect.turn, effect.per_input
    times = effect.beside, effect.times
    return *place, *times, effect.coordinate, effect.lag, effect.relaxing, effect.play


def taken_in(state: State, k: int, j: int) -> State:
    """A state whose k-th cause completes the form of its j-th."""
    fitted, groups = state.fitted, state.fitted.findings()
    law, terms, prices = laws(fitted)[j], [], list(state.prices)
    for i, places in enumerate(groups):
        terms += [fitted.terms[p] for p in places] if i != k else []
        terms += [replace(fitted.terms[p], host=law) for p in groups[k]] if i == j else []
    prices[j] += prices[k]
    return refitted(
        State(
            refit_linearly(fitted, terms, state.whitened),
            state.whitened,
            tuple(c for i, c in enumerate(state.causes) if i != k),
            tuple(p for i, p in enumerate(prices) if i != k),
        )
    )


def _explained(before: FittedModel, after: FittedModel) -> Array:
    """Fall of the deviance from one model to a larger one, by channel, where it falls."""
    pairs = zip(before.residual, after.residual, strict=True)
    return np.array([max(float(r @ r) - float(s @ s), 0.0) for r, s in pairs])
