"""One cause as it really is: a law in its textbook form, and a small deviation from it.

No law is its textbook form. The deviation is a combination of the curves of the law's family (what
acts at the same place and follows the same coordinate) whose prior energy is a share of the law's
own (Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001: a discrepancy with a prior).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.block_matrix import projected
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, stored_of
from tiltcal.diagnosis.model.normal_equations import (
    NormalEquations,
    left_beside,
    left_by_equations,
    normal_equations,
)
from tiltcal.diagnosis.model.score_test import (
    ANY_SHARE,
    DEVIATIONS,
)
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.column_selection import ColumnSelection, NumberEvidence
from tiltcal.effects.parameter import Parameter, by_name

OCTAVE = 2.0  # from the lowest frequency of a neighbourhood to the highest
MIN_COEFFICIENTS = 16  # coefficients to either side


def local_level(
    law: Hypothesis,
    family: Sequence[Hypothesis],
    fitted: FittedModel,
    whitened: WhitenedModel,
) -> float:
    """Mean power of what a line leaves in its neighbourhood, in units of the noise, at least one;
    one for a law that is no line in time. A line among many others, or in a band where all is above
    the noise, is no line (Thomson, Proc. IEEE 70, 1982: the variance of a line test is that of its
    neighbourhood).

    Args:
        law: the line; family: what completes it: of a tone that wanders the lines beside it.
        fitted: the model without them; whitened: the noise.
    """
    if not law.line_hz:
        return 1.0
    own = stored_of(whitened, [FittedTerm.start(h) for h in (law, *family)])
    return _level(law, left_beside(own, fitted.basis, fitted.residual), whitened)


def level_beside(
    law: Hypothesis, equations: NormalEquations, fitted: FittedModel, whitened: WhitenedModel
) -> float:
    """As ``local_level``, from the normal equations of a law with what completes it."""
    if not law.line_hz:
        return 1.0
    return _level(
        law, left_by_equations(equations, fitted.basis, fitted.residual, whitened), whitened
    )


def _level(law: Hypothesis, left: Columns, whitened: WhitenedModel) -> float:
    channels = whitened.observations.channels
    found = [
        part[_near(law.line_hz, float(np.ptp(channels[i].time)), len(part))]
        for i, part in left.items()
    ]
    powers = np.concatenate([*found, np.zeros(0)]) ** 2
    return max(float(powers.mean()), 1.0) if len(powers) else 1.0


def _near(frequency: float, duration: float, n: int) -> slice:
    """Cosine coefficients within an octave about a frequency."""
    middle = 2 * duration * frequency
    low = min(middle / np.sqrt(OCTAVE), middle - MIN_COEFFICIENTS)
    high = max(middle * np.sqrt(OCTAVE), middle + MIN_COEFFICIENTS)
    return slice(max(int(low), 1), min(int(high) + 1, n))


HALF = 0.5  # of what comes in ones: less is none


def possible(term: FittedTerm) -> bool:
    """Whether a file may give an effect these sizes: no negative width, of what comes in ones no
    small part of one.
    """
    return not any(
        (p.positive and value < 0) or (p.whole and abs(value) < HALF) for p, value in _sizes(term)
    )


def _sizes(term: FittedTerm) -> Iterator[tuple[Parameter, float]]:
    """The sizes in use, SI, with what the catalogue says of each; a curve's coefficients are not in
    it.
    """
    known = by_name(term.hypothesis.effect.parameters)
    for name, value in zip(term.names, term.values, strict=True):
        if name in known:
            yield known[name], value


OWN_NAME = 10.0  # times the energy that a deviation of another form has


@dataclass(frozen=True)
class Explanation:
    """A cause in some place of a model.

    Args:
        terms: the law, then what its form deviates by, at expected values.
        tried: columns that a deviation may be made of.
        choice: part of the evidence that is for the choice of the law's sizes, nats.
        numbers: the evidence for each number in use.
        level: of the neighbourhood of a line, in units of the noise, that it is judged by.
        plain: the law without its deviation; None where it has none.
    """

    terms: tuple[FittedTerm, ...]
    tried: int
    choice: float
    numbers: tuple[NumberEvidence, ...]
    level: float = 1.0
    plain: "Explanation | None" = None

    @property
    def hypothesis(self) -> Hypothesis:
        """The law."""
        return self.terms[0].hypothesis

    @cached_property
    def evidence(self) -> float:
        """Log Bayes factor against nothing in this place, nats."""
        return self.choice + sum(n.evidence for n in self.numbers)

    @property
    def gain(self) -> float:
        """Fall of the deviance; of a line in units of the level of its neighbourhood."""
        return sum(n.gain for n in self.numbers)

    @property
    def price(self) -> float:
        """Nats that its numbers cost: what they take off the deviance, less the evidence."""
        return self.level * self.gain / 2 - self.evidence

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
    level = level_beside(hypothesis, normal, fitted, whitened)
    gram, side, raw = (part / level for part in (normal.gram, normal.target, normal.raw))
    selection = ColumnSelection(
        gram, side, raw, law, _deviations(alike), hypothesis.has_plausible_size
    )
    selection.add_sizes()
    if not selection.used:
        return None
    tried = int((~law).sum())
    terms = _terms(normal, selection.used, whitened, hypothesis)
    plain = _explanation(terms, tried, selection, level)
    selection.add_deviation(tried)
    terms = _terms(normal, selection.used, whitened, hypothesis)
    if not all(possible(t) for t in terms[1:]):
        return plain
    return replace(_explanation(terms, tried, selection, level), plain=plain if tried else None)


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
    selection = ColumnSelection(
        block.T @ block / level,
        along / level,
        np.array([_energy(c) for c in stored]) / level,
        np.array([t is whole[0] for t in owner]),
        np.where(any_share, ANY_SHARE[:, None], _deviations(alike)),
        law.has_plausible_size,
    )
    selection.take_sizes([law.names.index(name) for name in terms[0].names])
    plain = _explanation(terms[:1], tried, selection, level) if len(terms) > 1 else None
    selection.take_deviation(range(len(law.names), len(owner)), tried)
    return replace(_explanation(terms, tried, selection, level), plain=plain)


def _explanation(
    terms: Sequence[FittedTerm], tried: int, selection: ColumnSelection, level: float
) -> Explanation:
    """What was selected, as a cause with these terms."""
    return Explanation(tuple(terms), tried, selection.choice, tuple(selection.numbers), level)


def _deviations(alike: Mask) -> Array:
    """Prior energy of each number of a deviation, in energies of the law, (s, p).

    Args:
        alike: those of the law's own name, which may be larger, (p,).
    """
    return np.asarray(DEVIATIONS[:, None] * np.where(alike, OWN_NAME, 1.0))


def _own_part(basis: Sequence[Array], column: Columns, lengths: Sequence[int]) -> Array:
    """A column without its part in a basis, (n,)."""
    rest = projected(basis, column, lengths)
    return np.concatenate([rest[i] for i in range(len(lengths))])


def _energy(column: Columns) -> float:
    return sum(float(c @ c) for c in column.values())


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
