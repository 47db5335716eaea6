"""Cosine coefficients of the columns of all hypotheses, before any whitening."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Mask
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.families import completes, form_of
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.column_store import Block, ColumnStore, Parts, TriedShapes
from tiltcal.diagnosis.model.setting_covariance import SettingWaves
from tiltcal.effects.base import Effect
from tiltcal.statistics.cosine_transform import cosines


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
        self._places: dict[tuple[object, ...], list[int]] = {}
        self._numbers: dict[int, int] = {}
        self._around: tuple[Effect, ...] = ()
        self._shapes = TriedShapes()
        # how many hypotheses were asked, and who completes the one of a number
        self._families: dict[int, tuple[int, list[int]]] = {}
        # the same of shapes that were tried beside the first of these hypotheses, among those
        self._first = 0
        self._of_tried: dict[object, tuple[int, list[int]]] = {}
        self._store = ColumnStore()
        self._settings: tuple[tuple[Effect, ...], tuple[SettingWaves, ...]] | None = None
        self._kept: dict[tuple[object, str], tuple[object, Columns]] = {}

    @property
    def shared_about(self) -> tuple[Effect, ...]:
        """The model that the hypotheses stand for, columns about which are right to a per cent in
        any fit; none without hypotheses.
        """
        return self._around

    @property
    def settings(self) -> tuple[SettingWaves, ...]:
        """The random settings that the scenario states, of each recording that has any."""
        if self._settings is None or self._settings[0] != self._around:
            channels, found = self.observations.channels, []
            for stops in self.observations.settings(self._around or self.observations.known):
                numbers = tuple(sorted({i for one in stops for i in one}))
                waves = tuple(
                    channels[i]
                    .waves(np.array([one.get(i, 0 * channels[i].values) for one in stops]))
                    .T
                    for i in numbers
                )
                found += [SettingWaves(numbers, waves)] if numbers else []
            self._settings = self._around, tuple(found)
        return self._settings[1]

    def add(self, hypothesis: Hypothesis, around: Sequence[Effect]) -> None:
        """Add the columns of a hypothesis; one that changes nothing is left out."""
        self._around = self._around or tuple(around)
        factors = self.observations.factors(hypothesis.effect, hypothesis.names, around)
        if factors is None:
            self._put(hypothesis, self._simulated(hypothesis, around), in_time=True)
        elif factors:
            owner = self._numbered(hypothesis)
            for i, channel in factors.items():
                self._store.put_factors(i, owner, self.starts[owner], channel)

    def beside(self, hypotheses: Sequence[Hypothesis]) -> "HypothesisColumns":
        """These and further hypotheses, about the model that these stand for; the columns here
        stay as they are.
        """
        other = HypothesisColumns(self.observations)
        other.hypotheses, other.starts = list(self.hypotheses), list(self.starts)
        other.width, other._store = self.width, self._store.shared()
        other._places = {place: list(numbers) for place, numbers in self._places.items()}
        other._numbers, other._families = dict(self._numbers), dict(self._families)
        other._around, other._kept, other._shapes = self._around, self._kept, self._shapes
        other._settings = self._settings
        other._first, other._of_tried = self._first or len(self.hypotheses), self._of_tried
        for hypothesis in hypotheses:
            other._put(hypothesis, self._of_shape(hypothesis))
        return other

    def _put(self, hypothesis: Hypothesis, parts: Parts, in_time: bool = False) -> None:
        if not parts:
            return
        owner = self._numbered(hypothesis)
        for i, (which, columns) in parts.items():
            numbers = [self.starts[owner] + k for k in which]
            self._store.put(i, not hypothesis.textbook, owner, numbers, columns, in_time)

    def _numbered(self, hypothesis: Hypothesis) -> int:
        """The number of a new hypothesis; its columns follow those of the others."""
        owner = len(self.hypotheses)
        self._numbers[id(hypothesis)] = owner
        for place in _places(hypothesis):
            self._places.setdefault(place, []).append(owner)
        self.hypotheses.append(hypothesis)
        self.starts.append(self.width)
        self.width += len(hypothesis.names)
        return owner

    def _simulated(self, hypothesis: Hypothesis, around: Sequence[Effect]) -> Parts:
        """The changes by each size, their rows weighed, in time."""
        parts = self.observations.columns(hypothesis.effect, hypothesis.names, around)
        channels = self.observations.channels
        return {
            i: (which, channels[i].weighed(block).astype(np.float32))
            for i, (which, block) in parts.items()
        }

    def _of_shape(self, hypothesis: Hypothesis) -> Parts:
        """The columns of a hypothesis that is not among these: the same shapes are tried often."""
        key = repr((hypothesis.effect, hypothesis.names))

        def simulate() -> Parts:
            parts = self._simulated(hypothesis, self._around)
            return {i: (which, cosines(columns)) for i, (which, columns) in parts.items()}

        return self._shapes.of(key, simulate)

    def family(self, number: int) -> list[int]:
        """Numbers of the hypotheses that complete the form of one, in order."""
        known, host = self._families.get(number, (0, [])), self.hypotheses[number]
        if number >= self._first > known[0]:  # the same shapes are tried often
            shape = host.alias, repr((host.effect, host.names))
            known = self._asked(host, self._of_tried.get(shape, (0, [])), self._first)
            self._of_tried[shape] = known
        self._families[number] = self._asked(host, known, len(self.hypotheses))
        return self._families[number][1]

    def _asked(
        self, host: Hypothesis, known: tuple[int, list[int]], count: int
    ) -> tuple[int, list[int]]:
        """How many of the first hypotheses were asked, and who of them completes the form of one.

        Args:
            known: the same of fewer of them; count: how many to ask.
        """
        asked, members = known
        if asked >= count:
            return known
        new = (k for k in self._near(host, asked) if k < count and self.hypotheses[k] is not host)
        return count, [*members, *(k for k in new if completes(self.hypotheses[k], host))]

    def completing(self, host: Hypothesis) -> list[Hypothesis]:
        """The hypotheses that complete the form of one, which may be at a shape of its own."""
        near = (self.hypotheses[k] for k in self._near(host, 0))
        return [h for h in near if completes(h, host)]

    def _near(self, hypothesis: Hypothesis, first: int) -> list[int]:
        """Numbers, from the first on, of the hypotheses that may be of its family: of its name, of
        related names, or without a name at its place; of a curve those of its form, in order.
        """
        if hypothesis.listed:
            names = [hypothesis.id, *hypothesis.law.family.effects]
            keys: list[tuple[object, ...]] = [(name, None) for name in names]
            keys += [("", hypothesis.effect.sensor), ("", None)]
        else:
            keys = [form_of(hypothesis)]
        return sorted({k for key in keys for k in self._places.get(key, []) if k >= first})

    def places(self, members: Sequence[int]) -> list[int]:
        """Numbers of all columns of some hypotheses, one after the other."""
        return [
            place
            for m in members
            for place in range(self.starts[m], self.starts[m] + len(self.hypotheses[m].names))
        ]

    def parts(self, number: int) -> Parts:
        """The columns of a hypothesis by channel: their numbers, and coefficients, (k, n)."""
        return self._store.parts(number)

    def stored(self, hypothesis: Hypothesis, name: str) -> Columns:
        """Cosine coefficients of the change by one plausible size, about the model that the
        hypotheses stand for, SI.
        """
        number = self._numbers.get(id(hypothesis))
        if number is not None:
            place = self.starts[number] + hypothesis.names.index(name)
            own = self._store.parts(number, place)
            return {i: waves[0].astype(float) for i, (_, waves) in own.items()}
        parts, k = self._of_shape(hypothesis), hypothesis.names.index(name)
        return {
            i: waves[which.index(k)].astype(float)
            for i, (which, waves) in parts.items()
            if k in which
        }

    def blocks(self, wanted: Mask) -> list[Block]:
        """The blocks that hold a column of a wanted hypothesis; wanted: by its number. wanted:
        (hypotheses,).
        """
        return self._store.of(wanted)

    def all_waves(
        self, hypothesis: Hypothesis, names: Sequence[str], around: Sequence[Effect]
    ) -> list[Columns]:
        """What ``waves`` says of some sizes of a hypothesis; those of a curve are worked out at
        once.
        """
        if hypothesis.effect.role == "calibration" or hypothesis.effect.seen_in is not None:
            return [self.waves(hypothesis, name, around) for name in names]
        effect = hypothesis.at({name: hypothesis.effect.values[name] for name in names})
        channels, found = self.observations.channels, [Columns() for _ in names]
        for i, (which, block) in self.observations.columns(effect, names, around).items():
            for k, wave in zip(which, channels[i].waves(block), strict=True):
                found[k][i] = wave
        return found

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
        found = {i: self.observations.channels[i].waves(c) for i, c in changes.items()}
        if depends is not None:
            self._kept[hypothesis.place, name] = (depends, found)
        return found


def _places(hypothesis: Hypothesis) -> list[tuple[object, ...]]:
    """By what those are found whose family it may be of."""
    if hypothesis.listed:
        return [(hypothesis.id, None)]
    return [("", hypothesis.effect.sensor), form_of(hypothesis)]
