"""What else could be it: every hypothesis, with the curves of its family, in a finding's place."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.hypotheses.families import completes
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.normal_equations import NormalEquations, normal_equations
from tiltcal.diagnosis.model.removed_finding import RemovedFinding, price_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import Learned
from tiltcal.effects.parameter import Parameter

# times the largest plausible size of any grade: beyond it an explanation is no explanation, and no
# alternative
FAIR = 10.0
OWN = 0.9  # least share of the gain that a name's own form brings; below it the name does not fit
NEAR = 0.5  # least cosine with a finding's signal to be looked at
LOOKED_AT = 14  # places that are worked out with their families
# share of a gain by which a law may miss: no real law has its textbook form to a thousandth
LOOSE = 0.002
EQUAL = 2.0  # worth: nearer together two explanations are equally good
ONE_CHANNEL = 0.9  # share of the energy


@dataclass(frozen=True)
class Alternative:
    """One explanation in the place of a finding.

    Args:
        terms: the hypothesis and what completes its form, at expected values.
        gain: fall of the deviance; worth: less the price of its sizes; own: share of its own form
            in the gain.
        cosine: with the finding's signal; separation: energy of that signal which it leaves.
        fair: whether its sizes are plausible.
        form: share of its own form, of a free one too.
    """

    terms: tuple[FittedTerm, ...]
    gain: float
    worth: float
    own: float
    cosine: float
    separation: float
    fair: bool
    form: float = 1.0

    @property
    def hypothesis(self) -> Hypothesis:
        """Who."""
        return self.terms[0].hypothesis

    @property
    def sizes(self) -> int:
        """How many numbers it needs."""
        return sum(len(t.names) for t in self.terms)


def rank_alternatives(
    removed: RemovedFinding,
    whitened: WhitenedModel,
    wanted: Callable[[Hypothesis], bool],
    alone: bool = False,
) -> list[Alternative]:
    """Every wanted hypothesis near the signal, each at its best shape with its family (or alone),
    the worthiest first.
    """
    energy = sum(float(s @ s) for s in removed.signal)
    seen: dict[Any, tuple[float, Hypothesis]] = {}
    price = price_of(whitened)
    for score in whitened.scores(removed.basis, removed.target, wanted):
        if energy > 0 and score.gain()[0] < NEAR**2 * energy:
            continue
        worth = score.best(price)[0] - 2 * np.log(score.hypothesis.variants)
        # felt late: another form
        key = (
            (score.hypothesis.place, score.hypothesis.alias)
            if score.hypothesis.listed
            else id(score.hypothesis)
        )
        if key not in seen or worth > seen[key][0]:
            seen[key] = (worth, score.hypothesis)
    best = sorted(seen.values(), key=lambda item: -item[0])[:LOOKED_AT]
    found = [explain(hypothesis, removed, whitened, alone) for _, hypothesis in best]
    return sorted((r for r in found if r is not None), key=lambda r: -r.worth)


def explain(
    hypothesis: Hypothesis, removed: RemovedFinding, whitened: WhitenedModel, alone: bool = False
) -> Alternative | None:
    """A hypothesis with the curves that complete it (unless alone), built up column by column."""
    near = [] if alone else whitened.columns.near(hypothesis)
    family = [
        k
        for k in near
        if whitened.hypotheses[k] is not hypothesis
        and completes(whitened.hypotheses[k], hypothesis)
    ]
    members = [whitened.hypotheses.index(hypothesis), *family]
    normal = normal_equations(members, removed.basis, removed.target, removed.signal, whitened)
    owner = normal.owner
    price = price_of(whitened)
    own = [i for i, who in enumerate(owner) if who == members[0]]
    lawful = [
        i
        for i, who in enumerate(owner)
        if who == members[0] or _same_kind(whitened.hypotheses[who], hypothesis)
    ]
    chosen = normal.greedy(own, price)
    if not chosen:
        return None
    dear = price + 2 * np.log(1 + len(family))
    chosen = normal.greedy(lawful, dear, chosen)
    lawful_gain = normal.gain(normal.target, chosen)
    whole = normal.greedy(range(len(owner)), dear, chosen)
    gain = normal.gain(normal.target, whole)
    energy = sum(float(s @ s) for s in removed.signal)
    explained = normal.gain(normal.signal, own)
    terms = _terms(normal, whole, whitened, hypothesis)
    form = lawful_gain / gain
    share = 1.0 if hypothesis.law.form == "any" else form
    return Alternative(
        terms,
        gain,
        gain - price * len(whole) - 2 * np.log(hypothesis.variants),
        share,
        float(np.sqrt(np.clip(explained / max(energy, 1e-300), 0, 1))),
        energy - explained,
        all(fair(t) for t in terms if t.host is None or t.hypothesis.alias is not None),
        form,
    )


def _same_kind(other: Hypothesis, hypothesis: Hypothesis) -> bool:
    """Whether what completes a form is of the form itself: a law beside a law, a late curve beside
    the same on another axis.
    """
    return other.listed and (other.alias is None) == (hypothesis.alias is None)


def _terms(
    normal: NormalEquations, chosen: Sequence[int], whitened: WhitenedModel, host: Hypothesis
) -> tuple[FittedTerm, ...]:
    values = normal.solve(normal.target, chosen)
    owner, names = normal.owner, normal.names
    found = []
    for member in dict.fromkeys(owner[i] for i in chosen):
        hypothesis = whitened.hypotheses[member]
        mine = [
            (names[i], float(v) * hypothesis.size(names[i]))
            for i, v in zip(chosen, values, strict=True)
            if owner[i] == member
        ]
        found.append(
            FittedTerm(
                hypothesis,
                tuple(n for n, _ in mine),
                tuple(v for _, v in mine),
                None if hypothesis is host else host,
            )
        )
    return tuple(found)


def fair(term: FittedTerm) -> bool:
    """Whether the sizes are ones that an instrument of some grade may have: of what comes in ones
    no small part of one.
    """
    if not _gentle(term) or _plausible_sizes(term) > FAIR:
        return False
    return not any(
        (p.positive and value < 0) or (p.whole and abs(value) < 0.5) for p, value in _sizes(term)
    )


def _plausible_sizes(term: FittedTerm) -> float:
    """How many times the largest plausible size of any grade the largest size is."""
    return max(
        (
            abs(value) / (max(p.plausible) * p.factor)
            for p, value in _sizes(term)
            if max(p.plausible)
        ),
        default=0.0,
    )


def _sizes(term: FittedTerm) -> Iterator[tuple[Parameter, float]]:
    """The sizes in use, SI, with what the catalogue says of each."""
    for parameter in term.hypothesis.effect.parameters:
        stem = parameter.name.split("{")[0].rstrip("_")
        for name, value in zip(term.names, term.values, strict=True):
            if name == parameter.name or ("{" in parameter.name and name.startswith(stem)):
                yield parameter, value


def _gentle(term: FittedTerm) -> bool:
    """Whether a curved law of temperature is nowhere steeper than its straight form may be."""
    effect, alias = term.hypothesis.effect, term.hypothesis.alias
    if (
        not isinstance(effect, Learned)
        or alias is None
        or effect.coordinate not in ("temperature", "warming")
    ):
        return True
    parameter = CATALOGUE[alias].parameters[0]
    limit = FAIR * max(parameter.plausible) * parameter.factor
    reach = float(np.ptp(effect.knots)) / 2 if effect.knots else 1.0  # nothing at the middle
    return all(abs(value) <= limit * reach for value in term.values)


def preferred(
    alternatives: Sequence[Alternative], signal: Sequence[Array] | None = None
) -> Alternative:
    """The best alternative; among equals the more likely kind.

    What shows in one channel only is more likely an effect of that channel's sensor; what shows in
    several acts on all: table or mount. A converter's transfer curve comes last where a sensor
    effect does the same. A size that some grade of instrument has is more likely than one that none
    has.
    """
    top = max(r.worth for r in alternatives)
    level = {id(r): top - EQUAL - LOOSE * r.gain for r in alternatives}
    equal = [r for r in alternatives if r.worth > level[id(r)]]
    single = True
    if signal is not None:
        energies = [float(s @ s) for s in signal]
        single = max(energies) > ONE_CHANNEL * sum(energies)

    def rank(r: Alternative) -> tuple[bool, bool, bool, int, int, bool, float]:
        stage = CATALOGUE[r.hypothesis.id].stage if r.hypothesis.id in CATALOGUE else "sensor"
        pose = stage in ("table", "mount", "environment")
        alone = len(r.terms) == 1 or r.worth - (1 - r.form) * r.gain > level[id(r)]
        sizes = len(r.terms[0].names) if alone else r.sizes
        usual = -r.worth * (1 - (pose == single))
        beyond = _plausible_sizes(r.terms[0]) > 1
        return (
            r.hypothesis.alias is not None,
            not alone,
            beyond,
            sizes,
            r.sizes,
            stage == "electronics",
            usual,
        )

    return min(equal, key=rank)


def inseparable(best: Alternative, alternatives: Sequence[Alternative]) -> list[Alternative]:
    """The alternatives that could take the place of the best: the data do not separate them."""
    limit = SEPARABLE + LOOSE * best.gain
    return [
        r
        for r in alternatives
        if r.hypothesis is best.hypothesis or (r.fair and r.form >= OWN and _gap(best, r) < limit)
    ]


def _gap(best: Alternative, r: Alternative) -> float:
    """What separates an alternative from the best. Where the best needs no completing curve, the
    alternative's own curves do not count: a free curve makes many laws alike.
    """
    if len(best.terms) == 1 and len(r.terms) > 1:
        return r.separation
    return min(r.separation, (best.gain - 2 * best.sizes) - (r.gain - 2 * r.sizes))
