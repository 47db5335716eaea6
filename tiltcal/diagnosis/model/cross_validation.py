"""Prediction of data that was not fitted: blocks of stops, with the moves before them, are left out
in turn.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, whitened_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel

FOLDS = 6


def heldout_gain(fitted: FittedModel, whitened: WhitenedModel, places: Sequence[int]) -> float:
    """Rise of the log-likelihood of left-out blocks by the terms at these places, nats."""
    rest = [t for k, t in enumerate(fitted.terms) if k not in places]
    whole = _left_out(fitted, whitened, list(fitted.terms))
    return 0.5 * (_left_out(fitted, whitened, rest) - whole)


def heldout_misfit(fitted: FittedModel, whitened: WhitenedModel) -> float:
    """Chi-square per sample of left-out blocks."""
    return _left_out(fitted, whitened, list(fitted.terms)) / max(whitened.observations.samples, 1)


def _left_out(fitted: FittedModel, whitened: WhitenedModel, terms: Sequence[FittedTerm]) -> float:
    """Sum of squares of what is left in blocks that the terms were not fitted to, whitened in time.

    What the other blocks do not tell of a size stays near nothing: it is expected to be as large as
        it was found, not larger.
    """
    from scipy.fft import idct

    observations = whitened.observations
    used = [*fitted.nuisance, *terms]
    names = [(t, n) for t in used for n in t.names]
    columns = whitened_of(whitened, used, fitted.effects)
    values = np.array(
        [v / t.hypothesis.size(n) for t in used for n, v in zip(t.names, t.values, strict=True)]
    )
    residual = whitened.residual(fitted.effects)
    gone = [t for t in fitted.terms if t not in terms]
    for t in gone:
        for column, n, v in zip(
            whitened_of(whitened, [t], fitted.effects), t.names, t.values, strict=True
        ):
            for i, part in column.items():
                residual[i] = residual[i] + part * (v / t.hypothesis.size(n))
    total = 0.0
    grams = np.zeros((FOLDS, len(names) + 1, len(names) + 1))
    for i, channel in enumerate(observations.channels):
        mine = [k for k, c in enumerate(columns) if i in c]
        y = residual[i] + sum((values[k] * columns[k][i] for k in mine), np.zeros(len(residual[i])))
        block = idct(np.array([*(columns[k][i] for k in mine), y]), norm="ortho", axis=1)
        index = np.array([*mine, len(names)])
        folds = _folds(channel.stop)
        for f in range(FOLDS):
            part = block[:, folds == f]
            grams[f][np.ix_(index, index)] += part @ part.T
    whole = grams.sum(axis=0)
    free = sum(len(t.names) for t in fitted.nuisance)
    expected = np.array(
        [0.0] * free + [1 / max(v * v, np.finfo(float).tiny) for v in values[free:]]
    )
    for f in range(FOLDS):
        b = _solve(whole - grams[f], expected)
        G = grams[f]
        total += float(G[-1, -1] - 2 * b @ G[:-1, -1] + b @ G[:-1, :-1] @ b)
    return total


def _solve(G: Array, prior: Array) -> Array:
    """Least squares from a Gram matrix whose last row is the target, and the information that there
    is beforehand, (p,).
    """
    A, y = G[:-1, :-1] + np.diag(prior), G[:-1, -1]
    if not len(A):
        return y
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    values, vectors = np.linalg.eigh(A / np.outer(size, size))
    keep = values > 1e-8 * len(values)
    return np.asarray((vectors[:, keep] / values[keep]) @ (vectors[:, keep].T @ (y / size)) / size)


def _folds(stop: Index) -> Array:
    """A fold for each row: a stop and the move before it, dealt out in turn; blocks of equal length
    without stops, (n,).
    """
    starts = np.concatenate([[True], (stop[1:] >= 0) & (stop[:-1] < 0)])
    number = np.cumsum(starts) - 1
    if number[-1] < 2 * FOLDS:
        number = np.arange(len(stop)) * (4 * FOLDS) // len(stop)
    return np.asarray(number % FOLDS)
