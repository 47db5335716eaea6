"""What a cause may be: the posterior probability of every name, and of none of the listed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.hypotheses import priors
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.search.candidates import (
    Candidate,
    Names,
    candidates_for_cause,
    coarsened,
    name_of,
    name_probabilities,
)
from tiltcal.diagnosis.search.curve_misfit import (
    BEYOND_FAMILY,
    SHARES,
    energy_beside,
    larger_curves,
    misfit_odds,
    nearest,
    of_other_kind,
    same_curve,
    taken_in,
)
from tiltcal.diagnosis.search.explanation import explain
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import State, laws, refitted, with_cause, without
from tiltcal.effects.learned import Learned


def named(state: State, scan: Scan, random: bool = False) -> tuple[State, list[Names]]:
    """A state whose causes are the most probable ones in their places, and what each may be.

    Args:
        state: whose causes.
        scan: of its hypotheses.
        random: whether stops are at random about their settings: a nameless curve would take them
            up, and is not looked for.
    """
    found = []
    for k in range(len(state.fitted.findings())):
        every = candidates_for_cause(state, k, scan)
        rows: Sequence[Candidate] = [r for r in every if r.name != UNLISTED] if random else every
        state, rows, own = _most_probable_in_place(state, k, rows)
        names, law = name_probabilities(rows), laws(state.fitted)[k]
        if law.listed and not names.listed:  # no curve could take its place
            names = replace(names, alike=(law.id,), in_doubt=True)
        found.append(replace(names, late=_late(state, k, own)))
    return state, found


def _most_probable_in_place(
    state: State, k: int, rows: Sequence[Candidate]
) -> tuple[State, Sequence[Candidate], Candidate]:
    """A state with the most probable cause in the place of one, the rows that stand, and that of
    this cause. A name that looks better and is separably worse when fitted does not stand.
    """
    mine = name_of(state.terms(k))
    names = name_probabilities(rows)
    stated = names.alike[0] if names.listed else UNLISTED
    own = [r for r in rows if r.name == stated and not (r.misfit or r.partial) and r.proposal]
    if stated == mine or not own:
        return state, rows, rows[0]
    best = max(own, key=lambda r: r.score)
    assert best.proposal is not None
    other = refitted(with_cause(state, k, best.proposal))
    worse = UNLISTED not in (mine, stated) and not other.cost < state.cost + SEPARABLE / 2
    if worse or not np.isfinite(other.cost):
        return _most_probable_in_place(state, k, [r for r in rows if r.name != stated])
    return other, rows, best


def without_misfits(state: State, scan: Scan) -> tuple[State, tuple[int, ...]]:
    """A state whose causes are laws of their own, and which of its causes they were: a listed one
    that is more probably what a nameless curve leaves of its law completes that curve's form, a
    nameless one that is more probably what a textbook form, or a larger curve, leaves of its law
    completes that form, and so does a further curve of the same place and coordinate.
    """
    kept = list(range(len(state.fitted.findings())))
    while True:
        part = next((kj for k in range(len(kept)) if (kj := _part(state, k, scan))), None)
        if part is None:
            return state, tuple(kept)
        state = taken_in(state, *part)
        del kept[part[0]]


def _part(state: State, k: int, scan: Scan) -> tuple[int, int] | None:
    """A cause that completes another one, and that one; None where it is a law of its own."""
    others = of_other_kind(state, k)
    if laws(state.fitted)[k].listed:
        return (k, nearest(state, k, others)) if _is_misfit(state, k, scan) else None
    if (j := same_curve(state, k)) is not None:
        return k, j
    for which, shares in ((others, BEYOND_FAMILY), (larger_curves(state, k), SHARES)):
        energy = energy_beside(state, k, which)
        gain = without(state, k).fitted.deviance - state.fitted.deviance
        if energy > 0 and misfit_odds(gain, energy, shares) > priors.NAMELESS:
            return k, nearest(state, k, which)
    return None


def _is_misfit(state: State, k: int, scan: Scan) -> bool:
    """Whether a listed cause is no thing of its own, but what nameless ones leave of their laws."""
    if not energy_beside(state, k, of_other_kind(state, k)) > 0:
        return False
    rows = candidates_for_cause(state, k, scan)
    best = max((r for r in rows if r.name == UNLISTED), key=lambda r: r.score)
    return best.misfit and not name_probabilities(rows).listed


def _late(state: State, k: int, own: Candidate) -> bool:
    """Whether a cause follows temperature late, and all curves over the temperature of now, at the
    places where such curves act on its sensor, are separably worse.
    """
    law = laws(state.fitted)[k].effect
    if not isinstance(law, Learned) or law.coordinate != "temperature" or not law.lag:
        return False
    fitted, whitened = without(state, k).fitted, state.whitened
    prompt = [
        told.evidence
        for number, h in enumerate(whitened.hypotheses)
        if isinstance(h.effect, Learned)
        and (h.effect.coordinate, h.effect.lag) == (law.coordinate, 0.0)
        and h.effect.sensor == law.sensor
        and (told := explain(number, fitted, whitened)) is not None
    ]
    beyond = own.evidence - max(prompt, default=0.0)
    return beyond > SEPARABLE / 2 * coarsened(own.gain)
