"""The score of every hypothesis at an operating point, with the adjustable terms projected out, in
units of the noise.

For columns U of a hypothesis, whitened, and an orthonormal basis Q of what is re-tuned anyway, A =
U'(I - QQ')r and
B = U'(I - QQ')U hold all: the gain in deviance A'B^-1 A ~ chi2(rank, lambda), the expected values
B^-1 A, the absorbed share.
Everything lives in the cosine basis, where whitening is a division.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.column_store import ColumnBlock, ColumnStore, Waves
from tiltcal.effects.base import Effect
from tiltcal.statistics.noise_spectrum import NoiseModel

# share of a direction's energy below which nothing is left of it after the nuisance parameters
SURVIVES = 1e-3


@dataclass(frozen=True)
class ScoreTest:
    """What one hypothesis would explain.

    Args:
        hypothesis: who.
        A, B: of the module's head, per plausible size, (p,) and (p, p).
        raw: energy of each column before projection, (p,).
    """

    hypothesis: Hypothesis
    A: Array
    B: Array
    raw: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Of its columns."""
        return self.hypothesis.names

    def gain(self, keep: Sequence[int] | None = None) -> tuple[float, int]:
        """Fall of the deviance with these columns (all), and its degrees of freedom."""
        index = self._index(keep)
        if len(index) == 1:
            i = index[0]
            there = self.B[i, i] > SURVIVES * max(self.raw[i], 1e-300)
            return (float(self.A[i] ** 2 / self.B[i, i]), 1) if there else (0.0, 0)
        values, vectors, size = self._directions(index)
        return float((((vectors.T @ (self.A[index] / size)) ** 2) / values).sum()), len(values)

    def estimate(self, keep: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Expected values of these columns, SI, and their covariance."""
        index = self._index(keep)
        values, vectors, size = self._directions(index)
        unit = np.array([self.hypothesis.size(self.names[i]) for i in index])
        C = (vectors / values) @ vectors.T / np.outer(size, size)
        return unit * (C @ self.A[index]), C * np.outer(unit, unit)

    def _index(self, keep: Sequence[int] | None) -> list[int]:
        return list(range(len(self.names))) if keep is None else list(keep)

    def _directions(self, index: list[int]) -> tuple[Array, Array, Array]:
        """Eigenvalues and vectors of B that survive, its columns scaled by ``size``."""
        size = np.sqrt(np.maximum(self.raw[index], 1e-300))
        values, vectors = np.linalg.eigh(self.B[np.ix_(index, index)] / np.outer(size, size))
        keep = values > SURVIVES
        return values[keep], vectors[:, keep], size

    @property
    def absorbed(self) -> float:
        """Share of the columns' energy that the nuisance parameters take."""
        return 1 - float(np.trace(self.B) / max(self.raw.sum(), 1e-300))

    def best(self, price: float) -> tuple[float, list[int]]:
        """Largest gain less ``price`` a column over subsets, built up one column at a time."""
        A, B, size = self.A.astype(float), self.B.astype(float), SURVIVES * self.raw
        chosen: list[int] = []
        top = 0.0
        free = np.diag(B) > size
        while free.any():
            rest = np.diag(B)
            free &= rest > size
            gains = np.where(free, A * A / np.where(free, rest, 1.0), 0.0)
            i = int(np.argmax(gains))
            if gains[i] <= price:
                break
            top += float(gains[i]) - price
            chosen.append(i)
            free[i] = False
            part = B[i] / B[i, i]
            A, B = A - part * A[i], B - np.outer(part, B[i])
        return top, sorted(chosen)


class WhitenedModel:
    """Cosine coefficients of the columns of all hypotheses, kept; scored against any noise and
    operating point.

    Args:
        observations: what was read.
    """

    def __init__(self, observations: Observations) -> None:
        self.observations = observations
        self.hypotheses: list[Hypothesis] = []
        self.starts: list[int] = []
        self._width = 0
        self._places: dict[tuple[str, str | None], list[int]] = {}
        self._shelves = ColumnStore()
        self.roots: list[Array] = []
        self._kept: dict[tuple[tuple[str, str | None, str | None], str], tuple[bytes, Columns]] = {}

    def add(self, hypothesis: Hypothesis, around: Sequence[Effect]) -> None:
        """Keep a hypothesis's columns; one that changes nothing is left out."""
        parts = self.observations.columns(hypothesis.effect, hypothesis.names, around)
        if not parts:
            return
        owner = len(self.hypotheses)
        self._places.setdefault(_place(hypothesis), []).append(owner)
        self.hypotheses.append(hypothesis)
        self.starts.append(self._width)
        for i, (which, block) in parts.items():
            numbers = [self._width + k for k in which]
            self._shelves.put(
                i,
                not hypothesis.textbook,
                owner,
                numbers,
                np.asarray(cosines(block.astype(np.float32)), np.float32),
            )
        self._width += len(hypothesis.names)

    def near(self, hypothesis: Hypothesis) -> list[int]:
        """Numbers of those who may be of the family of a hypothesis: of its name, its kin, or
        nameless
        at its place, in order.
        """
        names = [hypothesis.id, *hypothesis.law.family.effects] if hypothesis.listed else []
        keys = [*((n, None) for n in names), ("", hypothesis.effect.sensor), ("", None)]
        return sorted({k for key in keys for k in self._places.get(key, [])})

    def column(self, number: int) -> list[tuple[int, Waves]]:
        """The channels that a column of the whitened model changes, and its coefficients there,
        (n,).
        """
        return self._shelves.column(number)

    def under(self, noise: Sequence[NoiseModel]) -> None:
        """Weigh by this noise from now on."""
        self.weigh(
            [
                np.sqrt(m.spectrum(len(c.values)))
                for m, c in zip(noise, self.observations.channels, strict=True)
            ]
        )

    def weigh(self, roots: Sequence[Array]) -> None:
        """Weigh by these square roots of spectra from now on, (n,) each."""
        self.roots = list(roots)

    def whiten(self, columns: Columns) -> Columns:
        """Columns by channel as cosine coefficients in units of the noise."""
        return self.weighed({i: cosines(column) for i, column in columns.items()})

    def weighed(self, waves: Columns) -> Columns:
        """Cosine coefficients by channel in units of the noise."""
        return {i: wave / self.roots[i] for i, wave in waves.items()}

    def waves(self, hypothesis: Hypothesis, name: str, around: Sequence[Effect]) -> Columns:
        """Cosine coefficients of the change by one plausible size, these effects being there, SI.

        Those of calibration are asked for again and again, and kept as long as nothing changes
        them.
        """
        depends = (
            self.observations.depends_on(around)
            if hypothesis.effect.role == "calibration"
            else None
        )
        kept = self._kept.get((hypothesis.place, name))
        if kept is not None and kept[0] == depends:
            return kept[1]
        found = {
            i: cosines(column)
            for i, column in self.observations.changes(hypothesis.alone(name), around).items()
        }
        if depends is not None:
            self._kept[hypothesis.place, name] = (depends, found)
        return found

    def residual(self, effects: Sequence[Effect]) -> list[Array]:
        """Whitened residual of each channel."""
        return [
            cosines(r) / root
            for r, root in zip(self.observations.residuals(effects), self.roots, strict=True)
        ]

    def scores(
        self,
        basis: Sequence[Array],
        residual: Sequence[Array],
        wanted: Callable[[Hypothesis], bool] | None = None,
    ) -> list[ScoreTest]:
        """The score of every hypothesis, or of those wanted. basis: Q by channel, (n, q); residual:
        whitened, by channel, (n,).
        """
        asked = np.array([wanted is None or wanted(s) for s in self.hypotheses], dtype=bool)
        shelves = self._shelves.of(asked)
        both = self._inner(
            [np.column_stack([r, Q]) for r, Q in zip(project(basis, residual), basis, strict=True)],
            shelves,
        )
        A, UQ = both[:, 0], both[:, 1:]
        own = self._own(shelves)
        found = []
        for k in np.flatnonzero(asked):
            hypothesis, start = self.hypotheses[k], self.starts[k]
            part = slice(start, start + len(hypothesis.names))
            inner = own.get(int(k), np.zeros((len(hypothesis.names),) * 2))
            found.append(
                ScoreTest(hypothesis, A[part], inner - UQ[part] @ UQ[part].T, np.diag(inner).copy())
            )
        return found

    def _inner(self, vectors: Sequence[Array], shelves: Sequence[ColumnBlock]) -> Array:
        """U'V of the columns on some column store with some whitened vectors, given by channel, (n,
        q):
        (P, q).
        """
        total = np.zeros((self._width, vectors[0].shape[1]))
        there = [
            np.flatnonzero(v.any(axis=0)) for v in vectors
        ]  # most columns of a basis are of one channel
        weighed = [
            (v[:, k] / root[:, None]).astype(np.float32)
            for v, k, root in zip(vectors, there, self.roots, strict=True)
        ]
        for shelf in shelves:
            total[np.ix_(shelf.numbers[: shelf.used], there[shelf.channel])] += (
                shelf.columns @ weighed[shelf.channel]
            )
        return total

    def _own(self, shelves: Sequence[ColumnBlock]) -> dict[int, Array]:
        """U'U of each hypothesis with a column on some column store, by its number."""
        weights = [(1 / root).astype(np.float32) for root in self.roots]
        energies = np.zeros(self._width)
        owners: set[int] = set()
        said = []
        for shelf in shelves:
            single, several = shelf.energies(weights[shelf.channel])
            energies[shelf.numbers[: shelf.used]] += single
            owners.update(shelf.owners[: shelf.used].tolist())
            said += several
        found = {
            k: np.diag(energies[self.starts[k] : self.starts[k] + len(self.hypotheses[k].names)])
            for k in owners
        }
        for k, numbers, gram in said:
            place = numbers - self.starts[k]
            found[k][np.ix_(place, place)] += gram
        return found


def _place(hypothesis: Hypothesis) -> tuple[str, str | None]:
    return (hypothesis.id, None) if hypothesis.listed else ("", hypothesis.effect.sensor)


def cosines(column: Array) -> Array:
    """Orthonormal DCT-II along the last axis, (..., n)."""
    from scipy.fft import dct

    return np.asarray(dct(column, norm="ortho"))


def basis_of(columns: Sequence[Columns], lengths: Sequence[int]) -> list[Array]:
    """An orthonormal basis of some whitened columns, split by channel, (n, q) each."""
    return BlockDesignMatrix(columns, lengths).basis()


def project(basis: Sequence[Array], vectors: Sequence[Array]) -> list[Array]:
    """What is left of a vector, by channel, without its part in the basis."""
    along = sum(Q.T @ v for Q, v in zip(basis, vectors, strict=True))
    return [v - Q @ along for Q, v in zip(basis, vectors, strict=True)]


def projected(basis: Sequence[Array], column: Columns, lengths: Sequence[int]) -> Columns:
    """What is left of one whitened column without its part in the basis, in every channel."""
    return dict(
        enumerate(project(basis, [column.get(i, np.zeros(n)) for i, n in enumerate(lengths)]))
    )
