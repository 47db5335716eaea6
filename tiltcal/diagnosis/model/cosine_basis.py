"""Columns and vectors of all channels in the cosine basis, where whitening is a division."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix


def basis_of(columns: Sequence[Columns], lengths: Sequence[int]) -> list[Array]:
    """An orthonormal basis of some whitened columns, split by channel, (n, q) each."""
    return BlockDesignMatrix(columns, lengths).basis()


def project(basis: Sequence[Array], vectors: Sequence[Array]) -> list[Array]:
    """What is left of a vector, by channel, without its part in the basis. basis: by channel, (n,
    p); vectors: (n,) each.
    """
    along = sum(Q.T @ v for Q, v in zip(basis, vectors, strict=True))
    return [v - Q @ along for Q, v in zip(basis, vectors, strict=True)]


def projected(basis: Sequence[Array], column: Columns, lengths: Sequence[int]) -> Columns:
    """What is left of one whitened column without its part in the basis, in every channel. basis:
    by channel, (n, p).
    """
    return dict(
        enumerate(project(basis, [column.get(i, np.zeros(n)) for i, n in enumerate(lengths)]))
    )
