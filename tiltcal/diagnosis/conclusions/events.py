"""In which of several recordings an event happened, and what else may differ between two."""

from collections.abc import Sequence
from dataclasses import replace

from tiltcal.diagnosis.hypotheses.instants import Instant, recording_of
from tiltcal.diagnosis.search.name_probabilities import Names
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.recordings.recording import Recording, stem


def place_of(effect: Effect, recordings: Sequence[Recording]) -> str | None:
    """The recording that an event happened in, or the two that it happened between; None where
    there is one recording only, or no event.
    """
    if effect.seen_in is None or "time" not in effect.values:
        return None
    number = recording_of(effect, recordings)
    names = [stem(r.source) for r in recordings]
    if Instant.of(effect).in_pause:
        return f"between {names[number - 1]} and {names[number]}"
    return f"in {names[number]}"


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
