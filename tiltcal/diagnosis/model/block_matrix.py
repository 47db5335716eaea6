"""Columns of a least-squares design by the channels that they change, and their projection: a term
of calibration changes one channel, most of a dense matrix would be zeros.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.statistics.least_squares import column_space, inverse_root


class BlockDesignMatrix:
    """Columns, p of them, as those parts that are not zero.

    Args:
        columns: by channel, (n,) each.
        lengths: of the channels.
    """

    def __init__(self, columns: Sequence[Columns], lengths: Sequence[int]) -> None:
        self.count, self.lengths = len(columns), list(lengths)
        self.where = [[k for k, c in enumerate(columns) if i in c] for i in range(len(lengths))]
        self.blocks = [
            np.column_stack([columns[k][i] for k in numbers]) if numbers else np.zeros((n, 0))
            for i, (numbers, n) in enumerate(zip(self.where, lengths, strict=True))
        ]

    @cached_property
    def gram(self) -> Array:
        """Inner products of the columns, (p, p)."""
        total = np.zeros((self.count, self.count))
        for numbers, block in zip(self.where, self.blocks, strict=True):
            total[np.ix_(numbers, numbers)] += block.T @ block
        return total

    def along(self, vectors: Sequence[Array]) -> Array:
        """Inner products of the columns with a vector by channel, (p,)."""
        total = np.zeros(self.count)
        for numbers, block, vector in zip(self.where, self.blocks, vectors, strict=True):
            total[numbers] += block.T @ vector
        return total

    def explain(self, vectors: Sequence[Array]) -> tuple[Array, list[Array]]:
        """Coefficients of the columns that take up most of a vector, (p,), and what is left of it,
        by channel, (n,) each.
        """
        turn, taken, left = inverse_root(self.gram), np.zeros(self.count), list(vectors)
        # once more for what rounding left of it
        for _ in range(2):
            step = turn @ (turn.T @ self.along(left))
            taken += step
            for i, (numbers, block) in enumerate(zip(self.where, self.blocks, strict=True)):
                left[i] = left[i] - block @ step[numbers]
        return taken, left

    def basis(self) -> list[Array]:
        """An orthonormal basis of the columns' space, by channel, (n, q) each."""
        own, joint = self._parts()
        ends = np.cumsum([0, *(Q.shape[1] for Q in own)])
        found = [np.zeros((n, ends[-1] + joint[0].shape[1]), order="F") for n in self.lengths]
        for whole, Q, start, other in zip(found, own, ends, joint, strict=False):
            whole[:, start : start + Q.shape[1]] = Q
            whole[:, ends[-1] :] = other
        return found

    def explained(self, vectors: Sequence[Array]) -> float:
        """Energy of a vector by channel in the columns' space. vectors: (n,) each."""
        own, joint = self._parts()
        total = sum(float(np.sum((Q.T @ v) ** 2)) for Q, v in zip(own, vectors, strict=True))
        along = sum((Q.T @ v for Q, v in zip(joint, vectors, strict=True)), np.zeros(1))
        return total + float(along @ along)

    def _parts(self) -> tuple[list[Array], list[Array]]:
        """An orthonormal basis of the columns' space in two parts, by channel, (n, q) each: of the
        columns that change no other channel, and of what the rest have beside these.
        """
        channels = np.bincount([k for numbers in self.where for k in numbers], minlength=self.count)
        own, rest, shared = [], [], []
        for numbers, block in zip(self.where, self.blocks, strict=True):
            alone = channels[numbers] == 1
            Q = column_space(block[:, alone])
            own.append(Q)
            shared.append([k for k, single in zip(numbers, alone, strict=True) if not single])
            rest.append(_without(block[:, ~alone], Q))
        return own, self._joint(own, rest, shared)

    def _joint(
        self, own: Sequence[Array], rest: list[Array], shared: Sequence[Sequence[int]]
    ) -> list[Array]:
        """An orthonormal basis of what columns of several channels have beside the channels' own,
        (n, q) each. It takes the place of ``rest``: there may be a column for each of many stops.
        """
        names = sorted({k for numbers in shared for k in numbers})
        if not names:
            return [np.zeros((n, 0)) for n in self.lengths]
        whole = self.gram.diagonal()[names]
        place = {k: j for j, k in enumerate(names)}
        index = [[place[k] for k in numbers] for numbers in shared]
        gram = np.zeros((len(names), len(names)))
        for numbers, block in zip(index, rest, strict=True):
            gram[np.ix_(numbers, numbers)] += block.T @ block
        turn = inverse_root(gram, whole)
        for i, (numbers, Q) in enumerate(zip(index, own, strict=True)):
            rest[i] = _without(rest[i] @ turn[numbers], Q)
        # rounding, once more
        values, vectors = np.linalg.eigh(
            sum((B.T @ B for B in rest), np.zeros((turn.shape[1],) * 2))
        )
        for i, B in enumerate(rest):
            rest[i] = B @ (vectors / np.sqrt(values))
        return rest


def columns_of(basis: Sequence[Array]) -> list[Columns]:
    """The columns of a matrix by channel, (n, q) each, as those parts that are not zero."""
    count = basis[0].shape[1] if basis else 0
    there = [np.any(B != 0, axis=0).tolist() for B in basis]
    return [{i: B[:, k] for i, B in enumerate(basis) if there[i][k]} for k in range(count)]


def _without(block: Array, Q: Array) -> Array:
    """Columns without their part in an orthonormal basis, (n, p)."""
    return block - Q @ (Q.T @ block) if block.size and Q.size else block


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
