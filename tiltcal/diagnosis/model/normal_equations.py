"""Normal equations of a few hypotheses' columns in a finding's place: all that choosing among them
asks of the samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.data.observations import Columns
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.column_store import Waves
from tiltcal.diagnosis.model.inner_products import column_lengths, pseudo_inverse
from tiltcal.diagnosis.model.score_test import SURVIVES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel


@dataclass(frozen=True)
class NormalEquations:
    """Inner products of projected whitened columns, (p,) or (p, p).

    Args:
        gram: of the columns with each other; target: with what has to be explained.
        owner: number of the hypothesis of each column; names: of its size.
        raw: squared lengths of the columns before the projection.
        sized: whether each is of a plausible size.
    """

    gram: Array
    target: Array
    owner: list[int]
    names: list[str]
    raw: Array
    sized: Mask

    def gain(self, chosen: Sequence[int]) -> float:
        """Energy that some columns explain."""
        return float(self.target[list(chosen)] @ self.solve(chosen))

    def solve(self, chosen: Sequence[int]) -> Array:
        """Least squares on some columns, (len(chosen),). The shape is (m,)."""
        return np.asarray(self._inverse(chosen) @ self.target[list(chosen)])

    def _inverse(self, chosen: Sequence[int]) -> Array:
        index = list(chosen)
        part = self.gram[np.ix_(index, index)]
        size = column_lengths(part, self.sized[index])
        return pseudo_inverse(part / np.outer(size, size))[0] / np.outer(size, size)


def normal_equations(
    members: Sequence[int],
    basis: Sequence[Array],
    target: Sequence[Array],
    whitened: WhitenedModel,
) -> NormalEquations:
    """Of all columns of some hypotheses, the basis projected out.

    Args:
        members: numbers of the hypotheses.
        basis: orthonormal, by channel, (n, q).
        target: free of it, whitened, by channel, (n,).
        whitened: holds the columns.
    """
    along = np.zeros((len(whitened.columns.places(members)), 1 + basis[0].shape[1]))
    left, inside = whitened.independent_all(target), whitened.independent_all(basis)
    for i, (mine, part) in _parts(members, whitened).items():
        along[mine, 0] += part @ left[i]
        along[mine, 1:] += part @ inside[i]
    return projected_equations(members, gram_of(members, whitened), along, whitened)


def explained_beside(
    columns: Sequence[Columns], basis: Sequence[Array], target: Sequence[Array]
) -> float:
    """Energy of a target that some whitened columns explain beside a basis, from inner products
    alone: a column that is projected changes every channel.

    Args:
        columns: by channel, (n,) each.
        basis: orthonormal, by channel, (n, q).
        target: free of it, by channel, (n,).
    """
    _, _, equations = _beside(columns, basis, target)
    return equations.gain(range(len(equations.target)))


def left_beside(
    columns: Sequence[Columns], basis: Sequence[Array], target: Sequence[Array]
) -> dict[int, Array]:
    """What such columns leave of the target in the channels that they change, (n,) each."""
    matrix, inside, equations = _beside(columns, basis, target)
    values = equations.solve(range(matrix.count))
    along = inside.T @ values
    each = zip(matrix.where, matrix.blocks, basis, target, strict=True)
    return {
        i: r - block @ values[numbers] + B @ along
        for i, (numbers, block, B, r) in enumerate(each)
        if block.shape[1]
    }


def left_by_equations(
    equations: NormalEquations,
    basis: Sequence[Array],
    target: Sequence[Array],
    whitened: WhitenedModel,
) -> dict[int, Array]:
    """What all columns of some equations leave of the target in the channels that they change, (n,)
    each.

    Args:
        equations: of the columns beside the basis, in the target.
        basis: orthonormal, by channel, (n, q).
        target: free of it, by channel, (n,).
        whitened: holds the columns.
    """
    values = equations.solve(range(len(equations.target)))
    parts = _parts(list(dict.fromkeys(equations.owner)), whitened)
    signal = whitened.independent({i: values[mine] @ part for i, (mine, part) in parts.items()})
    along = np.sum([basis[i].T @ part for i, part in signal.items()], axis=0)
    return {i: target[i] - part + basis[i] @ along for i, part in signal.items()}


def _beside(
    columns: Sequence[Columns], basis: Sequence[Array], target: Sequence[Array]
) -> tuple[BlockDesignMatrix, Array, NormalEquations]:
    """The columns, their inner products with the basis, and their normal equations beside it."""
    matrix = BlockDesignMatrix(columns, [len(r) for r in target])
    inside = np.zeros((matrix.count, basis[0].shape[1]))
    for numbers, block, B in zip(matrix.where, matrix.blocks, basis, strict=True):
        inside[numbers] += block.T @ B
    own, sized = [0] * matrix.count, np.ones(matrix.count, bool)
    along = matrix.along(target)
    return matrix, inside, _projected(matrix.gram, along, inside, own, [], sized)


def gram_of(members: Sequence[int], whitened: WhitenedModel) -> Array:
    """Inner products of all columns of some hypotheses with each other, (p, p)."""
    count = len(whitened.columns.places(members))
    gram, parts = np.zeros((count, count)), _parts(members, whitened)
    for mine, part in parts.values():
        gram[np.ix_(mine, mine)] += part @ part.T
    for one in whitened.settings:
        along = np.zeros((count, one.errors.columns.shape[1]))
        for i, lost in one.lost.items():
            if i in parts:
                along[parts[i][0]] += parts[i][1] @ lost
        gram -= along @ along.T
    return gram


def projected_equations(
    members: Sequence[int], gram: Array, along: Array, whitened: WhitenedModel
) -> NormalEquations:
    """Of all columns of some hypotheses, a basis projected out.

    Args:
        members: numbers of the hypotheses.
        gram: of their columns, (p, p).
        along: inner products of them with the target and the basis, (p, 1 + q).
        whitened: holds the columns.
    """
    owner = [m for m in members for _ in whitened.hypotheses[m].names]
    names = [n for m in members for n in whitened.hypotheses[m].names]
    sized = np.array([whitened.hypotheses[m].has_plausible_size for m in owner], bool)
    return _projected(gram, along[:, 0], along[:, 1:], owner, names, sized)


def _projected(
    gram: Array, side: Array, inside: Array, owner: list[int], names: list[str], sized: Mask
) -> NormalEquations:
    """The equations after a basis is projected out. inside: inner products with it, (p, q);
    sized: see ``NormalEquations``, (p,).
    """
    rest, side, raw = gram - inside @ inside.T, side.copy(), np.diag(gram)
    gone = np.diag(rest) < SURVIVES * raw
    rest[gone], rest[:, gone], side[gone] = 0.0, 0.0, 0.0
    return NormalEquations(rest, side, owner, names, raw, sized)


def _parts(members: Sequence[int], whitened: WhitenedModel) -> dict[int, tuple[list[int], Array]]:
    """By channel: which columns of some hypotheses change it, and these in units of the noise,
    (k, n).
    """
    by_channel: dict[int, tuple[list[int], list[Waves]]] = {}
    before = 0
    for member in members:
        start = whitened.columns.starts[member] - before
        for i, (numbers, waves) in whitened.columns.parts(member).items():
            which, rows = by_channel.setdefault(i, ([], []))
            which += [number - start for number in numbers]
            rows.append(waves)
        before += len(whitened.hypotheses[member].names)
    return {
        i: (which, np.concatenate(rows) * (1 / whitened.roots[i]))
        for i, (which, rows) in by_channel.items()
    }
