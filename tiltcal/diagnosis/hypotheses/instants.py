"""When what does not last may have happened: an event at an instant in a recording or between two,
a line in time in one recording.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.effects.base import Effect
from tiltcal.recordings.recording import Recording

FEW, MOST = 30, 120  # ends of moves; beside fewer stands an even grid, of more it takes the place
GRID = 60  # instants


@dataclass(frozen=True)
class Instant:
    """When an event may have happened.

    Args:
        time: s from the first stamp of its recording; 0: between the recording before and this one.
        seen_in, earlier: fingerprints of its recording and of those before it; None and none where
            there is one recording only.
    """

    time: float
    seen_in: str | None = None
    earlier: tuple[str, ...] = ()

    @property
    def in_pause(self) -> bool:
        """Whether it lies between two recordings."""
        return bool(self.earlier) and self.time <= 0

    @classmethod
    def of(cls, effect: Effect) -> "Instant":
        """When an event happened."""
        return cls(float(effect.values["time"]), effect.seen_in, effect.earlier)

    def date(self, effect: Effect) -> Effect:
        """An event at this instant."""
        values = {**effect.values, "time": self.time}
        return replace(effect, values=values, seen_in=self.seen_in, earlier=self.earlier)


def instants(observations: Observations) -> list[Instant]:
    """Instants at which a step is tried: the ends of moves, or an even grid, or where moves are few
    both; and the pauses between recordings.
    """
    recordings = observations.recordings
    names = [r.fingerprint for r in recordings]
    several = len(recordings) > 1
    found = []
    for number, recording in enumerate(recordings):
        own = next((c for c in observations.channels if c.recording == number), None)
        times = [] if own is None else _within(own, recording, MOST // len(recordings))
        if number:
            times.append(0.0)
        seen = (names[number], tuple(names[:number])) if several else (None, ())
        found += [Instant(t, *seen) for t in times]
    return found


def _within(channel: Channel, recording: Recording, most: int) -> list[float]:
    """Instants in one recording, s from its first stamp."""
    elapsed = channel.time - recording.time[0]
    span = float(np.ptp(recording.time))
    edges: Array = elapsed[np.flatnonzero(np.diff((channel.stop >= 0).astype(int)) != 0)]
    even = np.linspace(0, span, min(GRID, most) + 2)[1:-1]
    if len(edges) > most:
        edges = even
    elif len(edges) < FEW:
        edges = np.union1d(edges, even)
    return [float(t) for t in edges if 0.01 * span < t < 0.99 * span]


def recording_of(effect: Effect, recordings: Sequence[Recording]) -> int:
    """Number of the recording that an event happened in or a line is in; 0 of anything else."""
    return next((k for k, r in enumerate(recordings) if r.fingerprint == effect.seen_in), 0)


def in_each(effect: Effect, recordings: Sequence[Recording]) -> Iterator[Effect]:
    """A line in time, once for each of several recordings: its phase begins anew with each, and a
    source may be on in one only.
    """
    names = [r.fingerprint for r in recordings]
    if len(names) == 1:
        yield effect
        return
    for k, name in enumerate(names):
        yield replace(effect, seen_in=name, earlier=tuple(names[:k]))
