"""Cosine coefficients of the columns of all hypotheses, before any whitening."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Mask
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.column_store import ColumnBlock, ColumnStore, Waves
from tiltcal.effects.base import Effect
from tiltcal.statistics.noise_spectrum import cosines


class HypothesisColumns:
    """The columns of all hypotheses, in SI: they depend on no noise.

    Args:
        observations: what was read.
    """

    def __init__(self, observations: Observations) -> None:
        self.observations = observations
        self.hypotheses: list[Hypothesis] = []
        self.starts: list[int] = []
        self.width = 0
        self._places: dict[tuple[str, str | None], list[int]] = {}
        self._store = ColumnStore()
        self._kept: dict[tuple[tuple[str, str | None, str | None], str], tuple[bytes, Columns]] = {}

    def add(self, hypothesis: Hypothesis, around: Sequence[Effect]) -> None:
        """Add the columns of a hypothesis; one that changes nothing is left out."""
        parts = self.observations.columns(hypothesis.effect, hypothesis.names, around)
        if not parts:
            return
        owner = len(self.hypotheses)
        self._places.setdefault(_place(hypothesis), []).append(owner)
        self.hypotheses.append(hypothesis)
        self.starts.append(self.width)
        for i, (which, block) in parts.items():
            numbers = [self.width + k for k in which]
            waves = np.asarray(cosines(block.astype(np.float32)), np.float32)
            self._store.put(i, not hypothesis.textbook, owner, numbers, waves)
        self.width += len(hypothesis.names)

    def near(self, hypothesis: Hypothesis) -> list[int]:
        """Numbers of the hypotheses that may be of its family: of its name, of related names, or
        without a name at its place, in order.
        """
        names = [hypothesis.id, *hypothesis.law.family.effects] if hypothesis.listed else []
        keys = [*((n, None) for n in names), ("", hypothesis.effect.sensor), ("", None)]
        return sorted({k for key in keys for k in self._places.get(key, [])})

    def column(self, number: int) -> list[tuple[int, Waves]]:
        """The channels that a column changes, and its coefficients there, (n,)."""
        return self._store.column(number)

    def blocks(self, wanted: Mask) -> list[ColumnBlock]:
        """The blocks that hold a column of a wanted hypothesis; wanted: by its number."""
        return self._store.of(wanted)

    def waves(self, hypothesis: Hypothesis, name: str, around: Sequence[Effect]) -> Columns:
        """Cosine coefficients of the change by one plausible size, these effects being there, SI.

        Those of calibration are asked for often, and kept as long as nothing changes them.
        """
        depends = None
        if hypothesis.effect.role == "calibration":
            depends = self.observations.depends_on(around)
        kept = self._kept.get((hypothesis.place, name))
        if kept is not None and kept[0] == depends:
            return kept[1]
        changes = self.observations.changes(hypothesis.alone(name), around)
        found = {i: cosines(column) for i, column in changes.items()}
        if depends is not None:
            self._kept[hypothesis.place, name] = (depends, found)
        return found


def _place(hypothesis: Hypothesis) -> tuple[str, str | None]:
    return (hypothesis.id, None) if hypothesis.listed else ("", hypothesis.effect.sensor)
