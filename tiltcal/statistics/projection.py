"""Orthonormal bases of the space of some columns."""

import numpy as np

from tiltcal.core.arrays import Array

DISTINCT = 1e-9  # least share of a column's energy that is a direction of its own, per column


def column_space(columns: Array) -> Array:
    """An orthonormal basis of the space of some columns, (n, rank)."""
    size = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    if not size.any():
        return columns[:, :0]
    size = np.where(size > 0, size, np.inf)
    values, vectors = np.linalg.eigh(columns.T @ columns / np.outer(size, size))
    keep = values > DISTINCT * np.isfinite(size).sum()
    Q = columns @ (vectors[:, keep] / np.sqrt(values[keep]) / size[:, None])
    # a second pass removes the rounding errors of the small directions
    values, vectors = np.linalg.eigh(Q.T @ Q)
    return np.asarray(Q @ (vectors / np.sqrt(values)))
