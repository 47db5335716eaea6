"""Normal equations of a few hypotheses' columns in a finding's place: all that choosing among them
asks of the samples.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.model.column_store import Waves
from tiltcal.diagnosis.model.score_test import SURVIVES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.projection import DISTINCT

NEW = 9e-4  # share of a column's energy that has to be its own beside the chosen ones


@dataclass(frozen=True)
class NormalEquations:
    """Inner products of projected whitened columns, (p,) or (p, p).

    Args:
        gram: of the columns with each other; target, signal: with what has to be explained, and
            with the finding's signal.
        owner: number of the hypothesis of each column; names: of its size.
    """

    gram: Array
    target: Array
    signal: Array
    owner: list[int]
    names: list[str]

    def gain(self, along: Array, chosen: Sequence[int]) -> float:
        """Energy of the part of a vector in the space of some columns, given its products with
        them, (p,).
        """
        b = along[list(chosen)]
        return float(b @ self.solve(along, chosen))

    def solve(self, along: Array, chosen: Sequence[int]) -> Array:
        """Least squares on some columns, (len(chosen),)."""
        return np.asarray(self._inverse(chosen) @ along[list(chosen)])

    def _inverse(self, chosen: Sequence[int]) -> Array:
        index = list(chosen)
        part = self.gram[np.ix_(index, index)]
        size = np.sqrt(np.diag(part))
        size = np.where(size > 0, size, np.inf)
        values, vectors = np.linalg.eigh(part / np.outer(size, size))
        keep = values > DISTINCT * max(len(values), 1)
        return np.asarray(
            (vectors[:, keep] / values[keep]) @ vectors[:, keep].T / np.outer(size, size)
        )

    def greedy(self, allowed: Iterable[int], price: float, start: Sequence[int] = ()) -> list[int]:
        """Columns added one by one to a start while each brings more than its price."""
        chosen = list(start)
        G, b, size = self.gram, self.target, np.diag(self.gram)
        if chosen:
            part = self._inverse(chosen) @ G[chosen]
            b = b - part.T @ b[chosen]
            G = G - G[:, chosen] @ part
        free = np.zeros(len(b), bool)
        free[[i for i in allowed if size[i] > 0 and i not in chosen]] = True
        while free.any():
            rest = np.diag(G)
            good = free & (rest > NEW * size)
            gains = np.where(good, b * b / np.where(good, rest, 1.0), 0.0)
            j = int(np.argmax(gains))
            if gains[j] <= price:
                break
            part = G[j] / G[j, j]
            b, G = b - part * b[j], G - np.outer(part, G[j])
            free[j] = False
            chosen.append(j)
        return chosen


def normal_equations(
    members: Sequence[int],
    basis: Sequence[Array],
    target: Sequence[Array],
    signal: Sequence[Array],
    whitened: WhitenedModel,
) -> NormalEquations:
    """Of all columns of some hypotheses, the basis projected out.

    Args:
        members: numbers of the hypotheses.
        basis: orthonormal, by channel, (n, q); target, signal: free of it, whitened, by channel,
            (n,).
        whitened: holds the columns.
    """
    places = [
        whitened.columns.starts[m] + j
        for m in members
        for j in range(len(whitened.hypotheses[m].names))
    ]
    p = len(places)
    gram, sides, inside = np.zeros((p, p)), np.zeros((p, 2)), np.zeros((p, basis[0].shape[1]))
    by_channel: dict[int, list[tuple[int, Waves]]] = {}
    for k, place in enumerate(places):
        for i, wave in whitened.columns.column(place):
            by_channel.setdefault(i, []).append((k, wave))
    for i, rows in by_channel.items():
        mine = [k for k, _ in rows]
        part = np.array([wave for _, wave in rows]) * (1 / whitened.roots[i])
        gram[np.ix_(mine, mine)] += part @ part.T
        sides[mine] += part @ np.column_stack([target[i], signal[i]])
        inside[mine] += part @ basis[i]
    raw = np.diag(gram).copy()
    gram -= inside @ inside.T
    gone = np.diag(gram) < SURVIVES * raw
    gram[gone], gram[:, gone], sides[gone] = 0.0, 0.0, 0.0
    owner = [m for m in members for _ in whitened.hypotheses[m].names]
    names = [n for m in members for n in whitened.hypotheses[m].names]
    return NormalEquations(gram, sides[:, 0], sides[:, 1], owner, names)
