"""One cause as it really is: a law in its textbook form, and a small deviation from it.

No law is its textbook form. The deviation is a combination of the curves of the law's family (what
acts at the same place and follows the same coordinate) whose prior energy is a share of the law's
own (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001: a discrepancy with a prior).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

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
    ANY_SHARE,
    DEVIATIONS,
    ENERGIES,
    SIZES,
    log_bayes_factor,
)
from tiltcal.diagnosis.search.local_level import local_level
from tiltcal.diagnosis.search.number_evidence import NumberEvidence
from tiltcal.diagnosis.search.possible_sizes import possible

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
        choice: part of the evidence that is for the choice of the law's sizes, nats.
        numbers: the evidence for each number in use.
        plain: the law without its deviation; None where it has none.
    """

    terms: tuple[FittedTerm, ...]
    evidence: float
    gain: float
    tried: int
    choice: float
    numbers: tuple[NumberEvidence, ...]
    plain: "Explanation | None" = None

    @property
    def hypothesis(self) -> Hypothesis:
        """The law."""
        return self.terms[0].hypothesis

    @property
    def price(self) -> float:
        """Nats that its numbers cost."""
        return self.gain / 2 - self.evidence

    def coarsely(self, coarse: float) -> float:
        """The evidence where the likelihood is raised to the power 1/coarse, nats."""
        return self.choice + sum(n.at(coarse) for n in self.numbers)


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
    law = np.equal(normal.owner, number)
    alike = np.array([whitened.hypotheses[k].id == hypothesis.id for k in normal.owner])
    family = [whitened.hypotheses[k] for k in dict.fromkeys(normal.owner) if k != number]
    level = local_level(hypothesis, family, fitted, whitened)
    gram, side, raw = (part / level for part in (normal.gram, normal.target, normal.raw))
    build = _Build(gram, side, raw, law, _deviations(alike), hypothesis.has_plausible_size)
    build.add_sizes()
    if not build.used:
        return None
    tried = int((~law).sum())
    terms = _terms(normal, build.used, whitened, hypothesis)
    plain = build.explanation(terms, tried)
    build.add_deviation(tried)
    terms = _terms(normal, build.used, whitened, hypothesis)
    if not all(possible(t) for t in terms[1:]):
        return plain
    return replace(build.explanation(terms, tried), plain=plain if tried else None)


def explanation_of(
    terms: Sequence[FittedTerm],
    tried: int,
    fitted: FittedModel,
    whitened: WhitenedModel,
    free: Sequence[FittedTerm] = (),
) -> Explanation:
    """One cause with given terms, at the values that they have.

    Args:
        terms: the law, then its deviation.
        tried: columns that this may be made of.
        fitted, whitened: as in ``explain``.
        free: terms that may have any share of the law, not only that of a deviation.
    """
    basis, law = fitted.basis, terms[0].hypothesis
    lengths = [len(r) for r in fitted.residual]
    whole = [FittedTerm.start(law), *terms[1:]]
    stored = stored_of(whitened, whole)
    columns = [_own_part(basis, c, lengths) for c in stored]
    block = np.column_stack(columns)
    owner = [t for t in whole for _ in t.names]
    along = block.T @ np.concatenate(fitted.residual)
    family = [t.hypothesis for t in terms[1:]]
    family += whitened.columns.completing(law) if law.line_hz else []
    level = local_level(law, family, fitted, whitened)
    alike = np.array([t.hypothesis.id == law.id for t in owner])
    any_share = np.array([any(t is f for f in free) for t in owner])
    build = _Build(
        block.T @ block / level,
        along / level,
        np.array([_energy(c) for c in stored]) / level,
        np.array([t is whole[0] for t in owner]),
        np.where(any_share, ANY_SHARE[:, None], _deviations(alike)),
        law.has_plausible_size,
    )
    build.take_sizes([law.names.index(name) for name in terms[0].names])
    plain = build.explanation(terms[:1], tried) if len(terms) > 1 else None
    build.take_deviation(range(len(law.names), len(owner)), tried)
    return replace(build.explanation(terms, tried), plain=plain)


def _deviations(alike: Mask) -> Array:
    """Prior energy of each number of a deviation, in energies of the law, (s, p).

    Args:
        alike: those of the law's own name, which may be larger, (p,).
    """
    return np.asarray(DEVIATIONS[:, None] * np.where(alike, OWN_NAME, 1.0))


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
        law: which columns are the law's, (p,).
        shares: prior energy of each number of a deviation, in energies of the law, (s, p).
        sized: whether the catalogue says how large the law may be.
    """

    def __init__(
        self, gram: Array, target: Array, raw: Array, law: Mask, shares: Array, sized: bool
    ) -> None:
        self.used: list[int] = []
        self._evidence, self._gain, self._choice = 0.0, 0.0, 0.0
        self._numbers: list[NumberEvidence] = []
        self._G, self._b, self._law, self._sized = gram, target, law, sized
        self._raw, self._shares = raw, shares

    def explanation(self, terms: Sequence[FittedTerm], tried: int) -> Explanation:
        """What was taken in, as a cause with these terms."""
        told = self._evidence, self._gain, tried, self._choice, tuple(self._numbers)
        return Explanation(tuple(terms), *told)

    def add_sizes(self) -> None:
        """Those sizes of the law that have evidence, and the strongest."""
        while (each := np.where(self._law, self._factors(self._widths()), -np.inf)).max(
            initial=-np.inf
        ) > (TOLD if self.used else -np.inf):
            self._take(int(np.argmax(each)), float(each.max()), self._widths())
        self._rest_of_sizes()

    def take_sizes(self, which: Iterable[int]) -> None:
        """These sizes of the law, the strongest first: evidence depends on the order."""
        left = set(which)
        while left:
            factors = self._factors(self._widths())
            i = max(sorted(left), key=lambda i: factors[i])
            self._take(i, float(factors[i]), self._widths())
            left.remove(i)
        self._rest_of_sizes()

    def add_deviation(self, tried: int) -> None:
        """Numbers of a deviation, as long as they have evidence."""
        widths, price = self._gain * self._shares, float(np.log(1 + tried))
        while tried:
            each = np.where(self._law, -np.inf, self._factors(widths)) - price
            if not each.max(initial=-np.inf) > 0:
                break
            self._take(int(np.argmax(each)), float(each.max()), widths, price)

    def take_deviation(self, which: Iterable[int], tried: int) -> None:
        """These numbers of a deviation, the strongest first."""
        widths, price, left = self._gain * self._shares, float(np.log(1 + tried)), set(which)
        while left:
            factors = self._factors(widths)
            i = max(sorted(left), key=lambda i: factors[i])
            self._take(i, max(float(factors[i]), 0.0) - price, widths, price)
            left.remove(i)

    def _rest_of_sizes(self) -> None:
        """The sizes that are not in use: perhaps they are, but what they would explain is not
        explained; and the price of the choice.
        """
        rest = np.minimum(self._factors(self._widths())[self._law], 0.0)
        self._choice = float(np.logaddexp(0.0, rest[np.isfinite(rest)]).sum())
        self._choice -= float(np.log(2.0 ** self._law.sum() - 1))
        self._evidence += self._choice

    def _info(self) -> tuple[Array, Mask]:
        """Information of each column beside those taken, and which still have some: what is left of
        little is rounding.
        """
        rest = np.diag(self._G)
        there = rest > SURVIVES * self._raw
        there[self.used] = False
        return np.where(there, rest, 1.0), there

    def _widths(self) -> Array:
        """Prior variances of the sizes of the law over those of their estimates, (k, p)."""
        info, _ = self._info()
        return SIZES[:, None] * info if self._sized else ENERGIES[:, None] + 0.0 * info

    def _factors(self, widths: Array) -> Array:
        """Log Bayes factor of each column, under each of these prior variances alike, (p,)."""
        info, there = self._info()
        return np.where(there, log_bayes_factor(self._b**2 / info, widths), -np.inf)

    def _take(self, i: int, evidence: float, widths: Array, price: float = 0.0) -> None:
        """Take in a column, with its evidence less its price."""
        gain = float(self._b[i] ** 2 / self._G[i, i]) if self._G[i, i] > 0 else 0.0
        first = not self.used
        self._numbers.append(NumberEvidence(gain, widths[:, i], price, needed=first))
        self.used.append(i)
        self._evidence += evidence
        if self._G[i, i] > 0:
            part = self._G[i] / self._G[i, i]
            self._gain += gain
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
