"""One cause as it really is: a law in its textbook form, and a small deviation from it.

No law is its textbook form. The deviation is a combination of the curves of the law's family (what
acts at the same place and follows the same coordinate) whose prior energy is a share of the law's
own (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001: a discrepancy with a prior).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.cosine_basis import projected
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, stored_of
from tiltcal.diagnosis.model.normal_equations import NormalEquations, normal_equations
from tiltcal.diagnosis.model.score_test import SURVIVES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.bayes_factors import (
    DEVIATIONS,
    ENERGIES,
    SIZES,
    log_bayes_factor,
)
from tiltcal.diagnosis.search.local_level import local_level
from tiltcal.effects.parameter import Parameter

HALF = 0.5
OWN_NAME = 10.0  # times the energy that a deviation of another form has
TOLD = 0.01
"""Nats that a further size of a law has to add. One that hardly shows at plausible sizes, such as
the sine of a tone at half the sampling rate, adds next to nothing at any value.
"""


@dataclass(frozen=True)
class Explanation:
    """A cause in some place of a model.

    Args:
        terms: the law, then what its form deviates by, at expected values.
        evidence: log Bayes factor against nothing in this place, nats.
        gain: fall of the deviance; of a line in units of the level of its neighbourhood.
        tried: columns that a deviation may be made of.
        plain: the law without its deviation; None where it has none.
    """

    terms: tuple[FittedTerm, ...]
    evidence: float
    gain: float
    tried: int
    plain: "Explanation | None" = None

    @property
    def hypothesis(self) -> Hypothesis:
        """The law."""
        return self.terms[0].hypothesis

    @property
    def price(self) -> float:
        """Nats that its numbers cost."""
        return self.gain / 2 - self.evidence


def explain(number: int, fitted: FittedModel, whitened: WhitenedModel) -> Explanation | None:
    """A hypothesis with its deviation; None where it says nothing here.

    Args:
        number: of the hypothesis.
        fitted: what is fitted anyway, and leaves what has to be explained.
        whitened: holds the columns.
    """
    members = [number, *whitened.columns.family(number)]
    normal = normal_equations(members, fitted.basis, fitted.residual, whitened)
    return explained_by(normal, fitted, whitened)


def explained_by(
    normal: NormalEquations, fitted: FittedModel, whitened: WhitenedModel
) -> Explanation | None:
    """A hypothesis with its deviation, from its normal equations with its family; otherwise as
    ``explain``.
    """
    number = normal.owner[0]
    hypothesis = whitened.hypotheses[number]
    law = np.array([owner == number for owner in normal.owner])
    alike = np.array([whitened.hypotheses[k].id == hypothesis.id for k in normal.owner])
    family = [whitened.hypotheses[k] for k in dict.fromkeys(normal.owner) if k != number]
    level = local_level(hypothesis, family, fitted, whitened)
    sized = hypothesis.has_plausible_size
    side, raw = normal.target / level, normal.raw / level
    build = _Build(normal.gram / level, side, raw, law, alike, sized)
    build.add_sizes()
    if not build.used:
        return None
    tried = int((~law).sum())
    terms = _terms(normal, build.used, whitened, hypothesis)
    plain = Explanation(terms, build.evidence, build.gain, tried)
    build.add_deviation(tried)
    terms = _terms(normal, build.used, whitened, hypothesis)
    if not all(possible(t) for t in terms[1:]):
        return plain
    return Explanation(terms, build.evidence, build.gain, tried, plain if tried else None)


def evidence_in_place(
    terms: Sequence[FittedTerm],
    tried: int,
    fitted: FittedModel,
    whitened: WhitenedModel,
) -> tuple[float, float]:
    """Evidence for given terms of one cause, nats, and their gain, as an ``Explanation`` has them.

    Args:
        terms: the law, then its deviation.
        tried: columns that this may be made of.
        fitted, whitened: as in ``explain``.
    """
    basis, target = fitted.basis, fitted.residual
    lengths = [len(r) for r in target]
    law = terms[0].hypothesis
    whole = [FittedTerm.start(law), *terms[1:]]
    stored = stored_of(whitened, whole)
    columns = [_own_part(basis, c, lengths) for c in stored]
    block = np.column_stack(columns)
    owner = [t for t in whole for _ in t.names]
    along = block.T @ np.concatenate(target)
    family = [t.hypothesis for t in terms[1:]]
    family += whitened.columns.completing(law) if law.line_hz else []
    level = local_level(law, family, fitted, whitened)
    build = _Build(
        block.T @ block / level,
        along / level,
        np.array([_energy(c) for c in stored]) / level,
        np.array([t is whole[0] for t in owner]),
        np.array([t.hypothesis.id == law.id for t in owner]),
        law.has_plausible_size,
    )
    build.take_sizes([law.names.index(name) for name in terms[0].names])
    build.take_deviation(range(len(law.names), len(owner)), tried)
    return build.evidence, build.gain


def _own_part(basis: Sequence[Array], column: Columns, lengths: Sequence[int]) -> Array:
    """A column without its part in a basis, (n,); nothing where next to nothing is left."""
    rest = projected(basis, column, lengths)
    whole = np.concatenate([rest[i] for i in range(len(lengths))])
    return whole if whole @ whole >= SURVIVES * _energy(column) else np.zeros_like(whole)


def _energy(column: Columns) -> float:
    return sum(float(c @ c) for c in column.values())


class _Build:
    """Columns taken in one by one, the sum of their evidence, nats, and of their gains.

    A law has at least one of its sizes, each set of them as likely as another. A number of its
    deviation is in use with a chance of one in as many as are tried.

    Args:
        gram, target: inner products of the columns, (p, p), and with what is explained, (p,).
        raw: squared lengths of the columns beside nothing else, (p,).
        law: which columns are the law's; alike: which are of its name, and may be as large, (p,).
        sized: whether the catalogue says how large the law may be.
    """

    def __init__(
        self, gram: Array, target: Array, raw: Array, law: Mask, alike: Mask, sized: bool
    ) -> None:
        self.evidence, self.gain = 0.0, 0.0
        self.used: list[int] = []
        self._G, self._b, self._law, self._sized = gram, target, law, sized
        self._raw = raw
        self._shares = DEVIATIONS[:, None] * np.where(alike, OWN_NAME, 1.0)

    def add_sizes(self) -> None:
        """Those sizes of the law that have evidence, and the strongest."""
        while (each := np.where(self._law, self._factors(), -np.inf)).max(initial=-np.inf) > (
            TOLD if self.used else -np.inf
        ):
            self._take(int(np.argmax(each)), float(each.max()))
        self._rest_of_sizes()

    def take_sizes(self, which: Iterable[int]) -> None:
        """These sizes of the law, the strongest first: evidence depends on the order."""
        left = set(which)
        while left:
            factors = self._factors()
            i = max(sorted(left), key=lambda i: factors[i])
            self._take(i, float(factors[i]))
            left.remove(i)
        self._rest_of_sizes()

    def add_deviation(self, tried: int) -> None:
        """Numbers of a deviation, as long as they have evidence."""
        energy, price = self.gain, np.log(1 + tried)
        while tried:
            each = np.where(self._law, -np.inf, self._deviations(energy)) - price
            if not each.max(initial=-np.inf) > 0:
                break
            self._take(int(np.argmax(each)), float(each.max()))

    def take_deviation(self, which: Iterable[int], tried: int) -> None:
        """These numbers of a deviation, the strongest first."""
        energy, price, left = self.gain, np.log(1 + tried), set(which)
        while left:
            factors = self._deviations(energy)
            i = max(sorted(left), key=lambda i: factors[i])
            self._take(i, max(float(factors[i]), 0.0) - price)
            left.remove(i)

    def _rest_of_sizes(self) -> None:
        """The sizes that are not in use: perhaps they are, but what they would explain is not
        explained; and the price of the choice.
        """
        rest = np.minimum(self._factors()[self._law], 0.0)
        self.evidence += float(np.logaddexp(0.0, rest[np.isfinite(rest)]).sum())
        self.evidence -= float(np.log(2.0 ** self._law.sum() - 1))

    def _info(self) -> tuple[Array, Mask]:
        """Information of each column beside those taken, and which still have some: what is left of
        little is rounding.
        """
        rest = np.diag(self._G)
        there = rest > SURVIVES * self._raw
        there[self.used] = False
        return np.where(there, rest, 1.0), there

    def _factors(self) -> Array:
        info, there = self._info()
        width = SIZES[:, None] * info if self._sized else ENERGIES[:, None] + 0.0 * info
        return np.where(there, log_bayes_factor(self._b**2 / info, width), -np.inf)

    def _deviations(self, energy: float) -> Array:
        info, there = self._info()
        factors = log_bayes_factor(self._b**2 / info, energy * self._shares)
        return np.where(there, factors, -np.inf)

    def _take(self, i: int, evidence: float) -> None:
        self.used.append(i)
        self.evidence += evidence
        if self._G[i, i] > 0:
            part = self._G[i] / self._G[i, i]
            self.gain += float(self._b[i] ** 2 / self._G[i, i])
            self._b, self._G = self._b - part * self._b[i], self._G - np.outer(part, self._G[i])


def _terms(
    normal: NormalEquations, chosen: Sequence[int], whitened: WhitenedModel, host: Hypothesis
) -> tuple[FittedTerm, ...]:
    values = normal.solve(chosen)
    found: dict[int, list[tuple[str, float]]] = {}
    for i, value in zip(chosen, values, strict=True):
        hypothesis = whitened.hypotheses[normal.owner[i]]
        name = normal.names[i]
        found.setdefault(normal.owner[i], []).append((name, value * hypothesis.size(name)))
    return tuple(
        FittedTerm(
            whitened.hypotheses[k],
            tuple(n for n, _ in sorted(pairs)),
            tuple(float(v) for _, v in sorted(pairs)),
            None if whitened.hypotheses[k] is host else host,
        )
        for k, pairs in found.items()
    )


def possible(term: FittedTerm) -> bool:
    """Whether a file may give an effect these sizes: no negative width, of what comes in ones no
    small part of one.
    """
    return not any(
        (p.positive and value < 0) or (p.whole and abs(value) < HALF) for p, value in _sizes(term)
    )


def _sizes(term: FittedTerm) -> Iterator[tuple[Parameter, float]]:
    """The sizes in use, SI, with what the catalogue says of each."""
    for parameter in term.hypothesis.effect.parameters:
        stem = parameter.name.split("{")[0].rstrip("_")
        for name, value in zip(term.names, term.values, strict=True):
            if name == parameter.name or ("{" in parameter.name and name.startswith(stem)):
                yield parameter, value
