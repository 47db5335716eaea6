"""From explanations in the place of a cause to the probability of every name, and of none."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, ndtr

from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.hypotheses import priors
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.search.state import Proposal

LEAST = 1e-4  # probability of a name that is shown
CREDIBLE = 0.9  # of a class: one that lacks the cause costs nine times as much as one name more
SHOWN = 8  # rivals
FAR, STEPS = 8.0, 2000  # sigma beyond what is hidden, and steps of the integral over what is not
COARSE = 3000.0
"""Nats of a law at which the data count half: what is known of its form is no better (coarsened
posterior: Miller and Dunson, J. Am. Stat. Assoc. 114, 2019).
"""

TAKEN, TWICE, LISTED_TWICE = 0.15, 0.27, 0.024
"""Share of the laws that no list has and that a name is taken for; of these laws, and of listed
ones, the share whose name stands in the model more than once. ``docs/diagnosis_model.md`` says how
they were learnt.
"""
AGAIN = float(priors.UNLISTED_ODDS + np.log(TAKEN * TWICE / LISTED_TWICE))
"""Log odds of a law that no list has, of which a name explains a share and the same name the rest,
to laws of that name.
"""


@dataclass(frozen=True)
class Names:
    """What a cause may be.

    Args:
        probability: of each name, ``unlisted`` for none of the catalogue; they sum to one.
        alike: names that the recording cannot tell from the most probable one, which is the first:
            those that explain as much, in their textbook forms where it does so in its own, and
            those that a class of CREDIBLE probability needs; none where that is no name of the
            catalogue.
        in_doubt: whether such a class needs ``unlisted`` beside them.
        perhaps: where none of the catalogue is the most probable, the names that a class of
            CREDIBLE probability needs beside it.
        rivals: (name, cosine, separation) of the nearest names, the most probable first, each
            against the stated one: the multiple correlation of its fit with what that explains, and
            twice the nats that it lacks, as the class has it.
        late: whether no curve over the temperature of now explains it.
    """

    probability: Mapping[str, float]
    alike: tuple[str, ...]
    rivals: tuple[tuple[str, float, float], ...]
    late: bool = False
    in_doubt: bool = False
    perhaps: tuple[str, ...] = ()

    @property
    def listed(self) -> bool:
        """Whether a name of the catalogue is more probable than none of them."""
        return self.probability.get(UNLISTED, 0.0) <= 0.5


@dataclass(frozen=True)
class Row:
    """An explanation in a cause's place: log posterior odds and evidence, nats; gain, the fall of
    the deviance.

    coarse_evidence: where the likelihood is coarsened, nats.
    deviation: part of the evidence that the deviation of its form from the textbook's adds, nats.
    textbook_gain: of its textbook form alone; none where it has no such form, or not at
        sizes that its prior allows.

    misfit: whether it is what the nameless causes leave of their laws; imitated: whether it is the
    share of a law without a name that a listed form explains.
    """

    name: str
    score: float
    evidence: float
    coarse_evidence: float
    gain: float
    proposal: Proposal | None = None
    deviation: float = 0.0
    textbook_gain: float = -np.inf
    misfit: bool = False
    imitated: bool = False

    @property
    def plain_evidence(self) -> float:
        """Evidence for its textbook form, nats."""
        return self.evidence - self.deviation

    @property
    def coarse_score(self) -> float:
        """Log posterior odds where the likelihood is coarsened; the prior is not."""
        return self.score - self.evidence + self.coarse_evidence


def imitation_odds(gain: float, columns: int) -> float:
    """Log odds of a law that no list has, of which a name explains a share, to that name's own law,
    where nothing is found beside it; nats.

    Every share is as probable as another. The rest is one direction among many: up to the energy of
    the largest noise among them it is more likely missed than seen (Ingster, Math. Methods Statist.
    6, 1997: the limit of detection of one direction among many).

    Args:
        gain: what the name explains, fall of the deviance.
        columns: directions in which the rest would be looked for.
    """
    gain, limit = max(gain, LEAST), np.sqrt(2 * np.log(max(columns, 2)))
    signal = np.linspace(0.0, limit + FAR, STEPS)  # square root of the energy of the rest
    missed = ndtr(limit - signal)
    share = 2 * signal * gain / (gain + signal**2) ** 2  # density of the rest's share, by signal
    unseen = float(np.trapezoid(missed * share, signal))
    return priors.UNLISTED_ODDS + float(np.log(min(unseen, 1.0)))


def coarsened(gain: float) -> float:
    """By how much less a difference says where a law explains this much: the larger a law, the more
    it deviates from every form that was tried. gain: fall of the deviance.
    """
    return 1 + gain / (2 * COARSE)


def name_probabilities(rows: Sequence[Row]) -> Names:
    """Probabilities under the coarsened posterior."""
    score = {
        name: float(logsumexp([r.coarse_score for r in rows if r.name == name]))
        for name in {r.name for r in rows}
    }
    whole = logsumexp(list(score.values()))
    order = sorted(score, key=lambda name: -score[name])
    chance = {n: float(np.exp(score[n] - whole)) for n in order}
    shown = {n: p for n, p in chance.items() if p > LEAST}
    best = {n: max((r for r in rows if r.name == n), key=lambda r: r.evidence) for n in order}
    first = next((n for n in order if n != UNLISTED), "")
    as_good = {r.name for r in rows if first and _behind(r, best[first]) < SEPARABLE / 2}
    near = [n for n in order if n not in (first, UNLISTED) and n in as_good]
    more = _needed(chance, {first, *near})
    in_doubt = UNLISTED in more
    near += [n for n in more if n != UNLISTED]
    perhaps: list[str] = []
    if chance.get(UNLISTED, 0.0) > 0.5:
        near, first, in_doubt = [], "", False
        perhaps = _needed(chance, {UNLISTED})
    stated = best[first] if first else max(rows, key=lambda r: r.score)
    rivals = [n for n in order if n not in (first, UNLISTED) and best[n].gain][:SHOWN]
    return Names(
        shown,
        (first, *near) if first else (),
        tuple(
            (
                n,
                float(np.sqrt(min(best[n].gain / stated.gain, 1.0))) if stated.gain > 0 else 0.0,
                2 * max(min(_behind(r, stated) for r in rows if r.name == n), 0.0),
            )
            for n in rivals
        ),
        in_doubt=in_doubt,
        perhaps=tuple(perhaps),
    )


def _behind(row: Row, first: Row) -> float:
    """How much less a row explains than the first one, nats: by their evidence, in textbook form
    where the first has that; or by the fit of its textbook form, however many sizes that takes,
    where the first was fitted.
    """
    evidence = row.evidence if first.deviation else row.plain_evidence
    behind = first.evidence - evidence
    return min(behind, (first.gain - row.textbook_gain) / 2) if first.gain > 0 else behind


def _needed(chance: Mapping[str, float], alike: Collection[str]) -> list[str]:
    """The fewest names that hold the cause with a probability of CREDIBLE beside others.

    Args:
        chance: of each name, the most probable first; alike: the others.
    """
    held, found = sum(p for n, p in chance.items() if n in alike), []
    for name, p in chance.items():
        if held < CREDIBLE and name not in alike:
            found.append(name)
            held += p
    return found
