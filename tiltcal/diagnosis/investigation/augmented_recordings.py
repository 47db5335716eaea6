"""Recordings so far with one more beside them: what they changed is worked out once, whatever is
put beside them.
"""

from collections.abc import Sequence
from dataclasses import replace

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.data.observe import observe
from tiltcal.effects.base import Effect
from tiltcal.laboratory.scenario import fresh
from tiltcal.recordings.recording import Recording


class Remembering(Observations):
    """Observations that remember how their readings change with each effect.

    Args:
        inner: what was observed.
    """

    def __init__(self, inner: Observations) -> None:
        self.inner = inner
        self.scenario, self.recordings, self.known = inner.scenario, inner.recordings, inner.known
        self.channels, self.stops = inner.channels, inner.stops
        self._kept: dict[str, Columns] = {}

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read. SI, (n,) each."""
        return self.inner.predict(effects)

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect; ``around`` is the same every time."""
        key = repr(effect)
        if key not in self._kept:
            self._kept[key] = self.inner.changes(effect, around)
        return self._kept[key]


class Joined(Observations):
    """Remembered observations and one more recording.

    Args:
        old: what was read so far.
        more: another recording, of the same T0.
        block: samples that are averaged into one.
        reference: T0, degC.
    """

    def __init__(self, old: Remembering, more: Recording, block: int, reference: float) -> None:
        climate = old.scenario.climate.model_copy(update={"reference_degC": reference})
        self.old = old
        self.new = observe(fresh(old.scenario, climate=climate), [more], old.known, block)
        self.scenario, self.known = old.scenario, old.known
        self.recordings = (*old.recordings, more)
        late = tuple(replace(c, recording=len(old.recordings)) for c in self.new.channels)
        self.channels = (*old.channels, *late)
        self.stops = [*old.stops, *self.new.stops]

    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read. SI, (n,) each."""
        return [*self.old.predict(effects), *self.new.predict(effects)]

    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect."""
        first = len(self.old.channels)
        return self.old.changes(effect, around) | {
            first + i: c for i, c in self.new.changes(effect, around).items()
        }
