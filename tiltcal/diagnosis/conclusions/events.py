"""In which of several recordings an event happened or a line in time is, and what else may differ
between two.
"""

from collections.abc import Sequence
from dataclasses import replace

from tiltcal.diagnosis.hypotheses.instants import Instant, recording_of
from tiltcal.diagnosis.search.name_probabilities import Names
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.recordings.recording import Recording, stem


def place_of(effects: Sequence[Effect], recordings: Sequence[Recording]) -> str | None:
    """The recording that an event happened in, or the two that it happened between; those that hold
    a line in time. None where there is one recording only, or where all hold it.

    Args:
        effects: of one finding, the leading one first.
        recordings: that were diagnosed.
    """
    if len(recordings) == 1 or effects[0].seen_in is None:
        return None
    names = [stem(r.source) for r in recordings]
    number = recording_of(effects[0], recordings)
    if "time" in effects[0].values:
        pause = Instant.of(effects[0]).in_pause
        return (
            f"between {names[number - 1]} and {names[number]}" if pause else f"in {names[number]}"
        )
    held = sorted({recording_of(e, recordings) for e in effects if e.seen_in is not None})
    return f"in {' and '.join(names[k] for k in held)}" if len(held) < len(names) else None


def beside_drawn_anew(names: Names, effect: Effect) -> Names:
    """The names of an event; where it lies between two recordings, each with those of effects that
    are drawn anew for each recording: they look alike and are as probable.
    """
    if "time" not in effect.values or not Instant.of(effect).in_pause:
        return names
    probability: dict[str, float] = {}
    for name, chance in names.probability.items():
        same = _drawn_anew(name)
        probability |= dict.fromkeys(same, chance / len(same))
    alike = dict.fromkeys(other for name in names.alike for other in _drawn_anew(name))
    return replace(names, alike=tuple(alike), probability=probability)


def _drawn_anew(name: str) -> tuple[str, ...]:
    """An event and the effects that look like it between two recordings."""
    return name, *(id for id, cls in CATALOGUE.items() if cls.like_event == name)
