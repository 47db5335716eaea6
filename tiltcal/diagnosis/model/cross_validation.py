"""Prediction of data that was not fitted: blocks of stops, with the moves after them, are left out
in turn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.model.fitted_model import FittedModel, whitened_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel

FOLDS = 6  # five sixths determine nearly all, and each is predicted once


def heldout_log_likelihood(fitted: FittedModel, whitened: WhitenedModel) -> float:
    """Log-likelihood of left-out blocks, each predicted from the others, but for a constant, nats.

    The noise is that of the whole recording, and what is expected of a size is what all blocks say
    of it: only the sizes are fitted without a block.
    """
    return -0.5 * _left_out(fitted, whitened) - whitened.log_volume


def heldout_misfit(fitted: FittedModel, whitened: WhitenedModel) -> float:
    """Chi-square per sample of left-out blocks."""
    return _left_out(fitted, whitened) / max(whitened.observations.samples, 1)


def heldout_residuals(fitted: FittedModel, whitened: WhitenedModel) -> list[Array]:
    """What is left of each channel where the sizes of all terms come from the other blocks,
    whitened, in time, (n,) each.
    """
    folded = _Folded.of(fitted, whitened)
    sizes = np.array(folded.solved())
    found = []
    for mine, block, folds in folded.blocks():
        predicted = np.sum(sizes[folds][:, mine] * block[:-1].T, axis=1)
        found.append(block[-1] - predicted)
    return found


def _left_out(fitted: FittedModel, whitened: WhitenedModel) -> float:
    """Sum of squares of what is left in blocks that the terms were not fitted to, whitened in
    time.
    """
    folded = _Folded.of(fitted, whitened)
    total = 0.0
    for G, b in zip(folded.grams, folded.solved(), strict=True):
        total += float(G[-1, -1] - 2 * b @ G[:-1, -1] + b @ G[:-1, :-1] @ b)
    return total


@dataclass(frozen=True)
class _Folded:
    """Columns of the terms of a model, and what they are fitted to, by fold.

    Args:
        whitened: whose channels.
        columns: whitened cosine coefficients per plausible size of each value.
        target: of the fit, whitened cosine coefficients, by channel, (n,): what the adjustable
            terms leave. They are fitted again, each about its value.
        expected: information that there is beforehand about each value, (p,).
        grams: of the columns and the target, of each fold.
    """

    whitened: WhitenedModel
    columns: Sequence[Columns]
    target: Sequence[Array]
    expected: Array
    grams: Array

    @classmethod
    def of(cls, fitted: FittedModel, whitened: WhitenedModel) -> "_Folded":
        """Of a fitted model."""
        used = [*fitted.nuisance, *fitted.terms]
        columns = whitened_of(whitened, used, fitted.effects)
        values = np.array(
            [v / t.hypothesis.size(n) for t in used for n, v in zip(t.names, t.values, strict=True)]
        )
        target = list(whitened.residual(fitted.effects))
        free = sum(len(t.names) for t in fitted.nuisance)
        for column, value in zip(columns[free:], values[free:], strict=True):
            for i, part in column.items():
                target[i] = target[i] + part * value
        expected = np.array(
            [1.0] * free + [1 / max(v * v, np.finfo(float).tiny) for v in values[free:]]
        )
        empty = np.zeros((FOLDS, len(columns) + 1, len(columns) + 1))
        folded = cls(whitened, columns, target, expected, empty)
        for mine, block, folds in folded.blocks():
            index = np.array([*mine, len(columns)])
            for f in range(FOLDS):
                part = block[:, folds == f]
                folded.grams[f][np.ix_(index, index)] += part @ part.T
        return folded

    def blocks(self) -> Iterator[tuple[list[int], Array, Index]]:
        """Of each channel: numbers of the columns it has, these columns and the target in time,
        (p + 1, n), and the fold of each sample, (n,).
        """
        from scipy.fft import idct

        for i, channel in enumerate(self.whitened.observations.channels):
            mine = [k for k, c in enumerate(self.columns) if i in c]
            waves = np.array([*(self.columns[k][i] for k in mine), self.target[i]])
            yield mine, idct(waves, norm="ortho", axis=1), _folds(channel.stop)

    def solved(self) -> list[Array]:
        """The values fitted without each fold, (p,), those of the adjustable terms less what they
        are in the whole fit.

        What the other blocks do not tell of a size is shrunk towards zero: it is expected to be as
        large as it was found, not larger. What they do not tell of an adjustable term (a scale
        factor that one dwell alone determines) stays as it was.
        """
        whole = self.grams.sum(axis=0)
        return [_solve(whole - G, self.expected) for G in self.grams]


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


def _folds(stop: Index) -> Index:
    """A fold for each row: a stop and the move after it, dealt out in turn; blocks of equal length
    without stops, (n,).
    """
    starts = np.concatenate([[True], (stop[1:] >= 0) & (stop[:-1] < 0)])
    number = np.cumsum(starts) - 1
    if number[-1] < 2 * FOLDS:
        number = np.arange(len(stop)) * (4 * FOLDS) // len(stop)
    return np.asarray(number % FOLDS)
