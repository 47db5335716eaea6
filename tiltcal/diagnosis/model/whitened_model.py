"""The columns of all hypotheses under one noise: what weighs anything against anything else."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.block_matrix import project
from tiltcal.diagnosis.model.column_store import Block, Weighed
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.inner_products import InnerProducts
from tiltcal.diagnosis.model.score_test import ScoreTest
from tiltcal.diagnosis.model.setting_covariance import SettingCovariance
from tiltcal.effects.base import Effect
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel, WhiteFlickerWalk


@dataclass(frozen=True)
class WhitenedModel:
    """Columns of hypotheses, and the noise by which they are weighed.

    Args:
        columns: of all hypotheses.
        noise: model of each channel, in order.
        roots: square roots of their spectra, by channel, (n,) each.
        law: kind of noise model, wherever noise is estimated.
        fits: of the noise of each channel, where it was estimated.
        curved: numbers of the channels to whose reading a nameless curve adds: what is left of
            its law is in their noise.
        settings: the random settings and mountings that the scenario states, of each recording with
            any.
        floors: size, SI, of what coarse codes do to a sensor's misfit, by sensor.
    """

    columns: HypothesisColumns
    noise: tuple[NoiseModel, ...]
    roots: tuple[Array, ...]
    law: type[NoiseModel] = WhiteFlickerWalk
    settings: tuple[SettingCovariance, ...] = ()
    fits: tuple[NoiseFit, ...] = ()
    curved: frozenset[int] = frozenset()
    floors: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        columns: HypothesisColumns,
        noise: Sequence[NoiseModel],
        law: type[NoiseModel] = WhiteFlickerWalk,
    ) -> "WhitenedModel":
        """Columns under a noise, given by channel."""
        channels = columns.observations.channels
        pairs = zip(noise, channels, strict=True)
        roots = tuple(np.sqrt(m.spectrum(len(c.values))) for m, c in pairs)
        settings = tuple(one.under(roots) for one in columns.settings)
        return cls(columns, tuple(noise), roots, law, settings)

    @property
    def observations(self) -> Observations:
        """What was read."""
        return self.columns.observations

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """All that may be searched."""
        return self.columns.hypotheses

    def under(self, noise: Sequence[NoiseModel]) -> "WhitenedModel":
        """The same columns under another noise."""
        return replace(self.of(self.columns, noise, self.law), floors=self.floors)

    def as_fitted(self, fits: Sequence[NoiseFit]) -> "WhitenedModel":
        """The same columns under an estimated noise."""
        told = self.under([f.model for f in fits])
        return replace(told, fits=tuple(fits), curved=self.curved)

    def alone(self, hypotheses: Sequence[Hypothesis], around: Sequence[Effect]) -> "WhitenedModel":
        """Columns of these hypotheses only, under the same noise."""
        columns = HypothesisColumns(self.observations)
        for hypothesis in hypotheses:
            columns.add(hypothesis, around)
        return replace(self, columns=columns)

    def beside(self, hypotheses: Sequence[Hypothesis]) -> "WhitenedModel":
        """These columns and those of further hypotheses, under the same noise."""
        return replace(self, columns=self.columns.beside(hypotheses))

    def whiten(self, columns: Columns) -> Columns:
        """Columns by channel as cosine coefficients in units of the noise."""
        channels = self.observations.channels
        return self.weighed({i: channels[i].waves(column) for i, column in columns.items()})

    def weighed(self, waves: Columns) -> Columns:
        """Cosine coefficients by channel in units of the noise. (n,) or (n, q) each."""
        return self.independent({i: (wave.T / self.roots[i]).T for i, wave in waves.items()})

    def weighed_together(self, waves: Sequence[Columns]) -> list[Columns]:
        """The same of many columns."""
        if not self.settings:
            return [self.weighed(column) for column in waves]
        dense = [np.zeros((len(root), len(waves)), order="F") for root in self.roots]
        for k, column in enumerate(waves):
            for i, part in column.items():
                dense[i][:, k] = part
        whole = self.weighed({i: d for i, d in enumerate(dense) if d.any()})
        found = [Columns() for _ in waves]
        for i, part in whole.items():
            for k in np.flatnonzero(part.any(axis=0)).tolist():
                found[k][i] = part[:, k]
        return found

    def independent(self, vectors: Columns) -> Columns:
        """What is in units of the noise, in those of noise and random settings."""
        for one in self.settings:
            vectors = one.independent(vectors)
        return vectors

    def independent_all(self, vectors: Sequence[Array]) -> list[Array]:
        """The same of vectors that every channel has, in order. (n,) or (n, q) each."""
        return list(self.independent(dict(enumerate(vectors))).values())

    @property
    def log_volume(self) -> float:
        """Half the logarithm of the determinant of the covariance of all readings, nats."""
        noise = sum(float(np.log(root).sum()) for root in self.roots)
        return noise + sum(one.errors.log_det for one in self.settings) / 2

    def noise_of(self, residual: Sequence[Array]) -> list[Array]:
        """A whitened residual less what is expected of the random settings in it, in units of the
        noise, by channel, (n,) each.
        """
        return self.independent_all(residual)

    def less_settings(self, effects: Sequence[Effect]) -> list[Array]:
        """What a model leaves less what is expected of the random settings in it, SI, by channel,
        (n,) each.
        """
        if not self.settings:
            return self.observations.residuals(effects)
        noise = self.noise_of(self.residual(effects))
        channels = self.observations.channels
        return [c.of_waves(p * r) for c, p, r in zip(channels, noise, self.roots, strict=True)]

    def residual(self, effects: Sequence[Effect]) -> list[Array]:
        """Whitened residual of each channel. (n,) each."""
        waves = self.observations.residual_waves(effects)
        return list(self.weighed(dict(enumerate(waves))).values())

    def scores(
        self,
        basis: Sequence[Array],
        residual: Sequence[Array],
        wanted: Callable[[Hypothesis], bool] | None = None,
    ) -> list[ScoreTest]:
        """The score test of every hypothesis, or of those wanted.

        Args:
            basis: of the fitted terms, by channel, (n, q).
            residual: whitened, by channel, (n,).
            wanted: which hypotheses are asked for.
        """
        asked = np.array([wanted is None or wanted(s) for s in self.hypotheses], dtype=bool)
        blocks = self.columns.blocks(asked)
        left = project(basis, residual)
        vectors = [np.column_stack([r, Q]) for r, Q in zip(left, basis, strict=True)]
        both = self.along(vectors, blocks)
        A, UQ = both[:, 0], both[:, 1:]
        own = self.inner_products(blocks)
        found = []
        for k in np.flatnonzero(asked):
            hypothesis, start = self.hypotheses[k], self.columns.starts[k]
            part = slice(start, start + len(hypothesis.names))
            inner = own.of(np.array([k]))[0]
            B = inner - UQ[part] @ UQ[part].T
            found.append(ScoreTest(hypothesis, A[part], B, np.diag(inner).copy()))
        return found

    def along(self, vectors: Sequence[Array], blocks: Sequence[Block]) -> Array:
        """U'V of the columns of some blocks with whitened vectors by channel, (n, q): (P, q)."""
        return self._along(self.independent_all(vectors), blocks)

    def _along(self, vectors: Sequence[Array], blocks: Sequence[Block]) -> Array:
        """The same of vectors that are only in units of the noise."""
        total = np.zeros((self.columns.width, vectors[0].shape[1]))
        # most columns of a basis are of one channel
        there = [np.flatnonzero(v.any(axis=0)) for v in vectors]
        weighed = [
            Weighed((v[:, k] / root[:, None]).astype(np.float32))
            for v, k, root in zip(vectors, there, self.roots, strict=True)
        ]
        for block in blocks:
            index = np.ix_(block.numbers[: block.used], there[block.channel])
            total[index] += block.along(weighed[block.channel])
        return total

    def inner_products(self, blocks: Sequence[Block]) -> InnerProducts:
        """U'U of each hypothesis with a column in some blocks; nothing of the others."""
        weights = [(1 / root).astype(np.float32) for root in self.roots]
        found = InnerProducts([len(h.names) for h in self.hypotheses])
        for block in blocks:
            for numbers, gram in block.grams(weights[block.channel]):
                found.add(numbers, gram)
        for one in self.settings:
            rank = one.errors.columns.shape[1]
            every = [
                one.lost[i] if i in one.lost else np.zeros((len(root), rank))
                for i, root in enumerate(self.roots)
            ]
            found.less(self._along(every, blocks))
        return found
