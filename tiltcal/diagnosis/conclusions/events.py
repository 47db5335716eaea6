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
    """The names of an event, and where it lies between two recordings, those of effects that are
    drawn anew for each: they look alike and are as probable.
    """
    if "time" not in effect.values or not Instant.of(effect).in_pause:
        return names
    others = [id for id, cls in CATALOGUE.items() if cls.like_event == effect.id]
    each = names.probability.get(effect.id, 0.0) / (1 + len(others))
    shared = dict.fromkeys((effect.id, *others), each)
    return replace(
        names, alike=(*names.alike, *others), probability={**names.probability, **shared}
    )
