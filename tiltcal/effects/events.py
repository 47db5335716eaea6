"""Events happen in one recording: those before it do not meet them, the next ones find what they
leave.
"""

from collections.abc import Sequence
from dataclasses import replace

from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned

AGO = 1e9  # s: long before any recording's first stamp


def active_in(effects: Sequence[Effect], recording: str) -> list[Effect]:
    """The effects as a recording of this fingerprint meets them: events of earlier recordings are
    over, those of later ones are still to come.
    """
    return [met for e in effects if (met := _met(e, recording)) is not None]


def _met(effect: Effect, recording: str) -> Effect | None:
    if effect.seen_in is None or same_recording(effect.seen_in, recording):
        return effect
    if any(same_recording(r, recording) for r in effect.earlier):
        return None
    return afterwards(effect)


def same_recording(one: str, other: str) -> bool:
    """Whether two fingerprints are of one recording; without readings it is identified by its
    stamps.
    """
    stamps, _, readings = one.partition("-")
    others, _, read = other.partition("-")
    return stamps == others and (not readings or not read or readings == read)


def afterwards(effect: Effect) -> Effect | None:
    """What an event leaves: a step stays, a creep stays where it ended, lost samples, a cycle and
    what has no cause that is known leave nothing.
    """
    if effect.leaves_nothing or not effect.lasts:
        return None
    if isinstance(effect, Learned) and effect.coordinate == "time":
        if effect.period:
            return None
        knots, instants = (tuple(t - AGO for t in each) for each in (effect.knots, effect.instants))
        return replace(effect, knots=knots, instants=instants)
    if "time" in effect.values:
        return replace(effect, values={**effect.values, "time": -AGO})
    return effect
