"""Findings that are dropped once the others are in the model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.model.finding_tests import ALPHA, NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, refit
from tiltcal.diagnosis.model.removed_finding import price_of, remove_finding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import (
    fair,
)


def backward_elimination(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """Drop findings one by one that are not significant beside the others; also returns the noise
    that is left.
    """
    while fitted.terms:
        fitted = drop_implausible_sizes(refit(fitted, whitened), whitened)
        if not fitted.terms:
            break
        values, whitened = gate.log_p(fitted, whitened)
        groups = fitted.findings()
        worst = max(range(len(groups)), key=lambda j: values[j])
        if values[worst] < np.log(ALPHA):
            break
        fitted = replace(
            fitted, terms=tuple(t for k, t in enumerate(fitted.terms) if k not in groups[worst])
        )
    whitened = gate.left_by(fitted, whitened)
    return refit(fitted, whitened), whitened


def drop_below_bic(
    fitted: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, WhitenedModel]:
    """The fitted model under the noise that it leaves, without findings that lower the deviance by
    less than the BIC asks for their parameters; also returns that noise.
    """
    while True:
        whitened = gate.left_by(fitted, whitened)
        fitted = refit(fitted, whitened)
        groups = fitted.findings()
        worth = [_worth(fitted, whitened, places) for places in groups]
        if not groups or min(worth) >= 0:
            return fitted, whitened
        worst = groups[worth.index(min(worth))]
        fitted = replace(
            fitted, terms=tuple(t for k, t in enumerate(fitted.terms) if k not in worst)
        )


def _worth(fitted: FittedModel, whitened: WhitenedModel, places: Sequence[int]) -> float:
    """Fall of the deviance by a finding, less the BIC price of its parameters."""
    gain = (
        sum(float(t @ t) for t in remove_finding(fitted, whitened, places).target) - fitted.deviance
    )
    return gain - price_of(whitened) * sum(len(fitted.terms[k].names) for k in places)


def drop_implausible_sizes(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model without findings whose sizes, re-fitted beside all others, are larger than
    any instrument has.

    A completing term is dropped too where a file does not allow its size, such as a negative width.
    """
    while True:
        good = [places for places in fitted.findings() if fair(fitted.terms[places[0]])]
        terms = tuple(
            fitted.terms[k]
            for places in good
            for k in places
            if k == places[0] or _written(fitted.terms[k])
        )
        if len(terms) == len(fitted.terms):
            return fitted
        fitted = refit(replace(fitted, terms=terms), whitened)


def _written(term: FittedTerm) -> bool:
    """Whether a scenario file may give an effect these sizes."""
    positive = {p.name for p in term.hypothesis.effect.parameters if p.positive}
    return all(
        value >= 0 for name, value in zip(term.names, term.values, strict=True) if name in positive
    )
