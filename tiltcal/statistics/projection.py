"""Orthonormal bases of the space of some columns."""

import numpy as np

from tiltcal.core.arrays import Array

DISTINCT = 1e-9  # least share of a column's energy that is a direction of its own, per column


def column_space(columns: Array) -> Array:
    """An orthonormal basis of the space of some columns, (n, rank)."""
    if not columns.any():
        return columns[:, :0]
    Q = columns @ inverse_root(columns.T @ columns)
    # a second pass removes the rounding errors of the small directions
    values, vectors = np.linalg.eigh(Q.T @ Q)
    return np.asarray(Q @ (vectors / np.sqrt(values)))


def inverse_root(gram: Array, energy: Array | None = None) -> Array:
    """Combinations of columns that are orthonormal, and span the columns' space, (p, rank).

    Args:
        gram: inner products of the columns, (p, p).
        energy: squared lengths that a direction is told from rounding by, (p,); of the columns
            themselves when None.
    """
    energy = np.diag(gram) if energy is None else energy
    size = np.where(energy > 0, np.sqrt(energy), np.inf)
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    keep = values > DISTINCT * np.isfinite(size).sum()
    return np.asarray(vectors[:, keep] / np.sqrt(values[keep]) / size[:, None])
