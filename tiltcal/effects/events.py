"""Events happen in one recording; the next one finds their after-state."""

from collections.abc import Sequence
from dataclasses import replace

from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned

AGO = 1e9  # s: long before any recording's first stamp


def as_met(effects: Sequence[Effect], recording: str) -> list[Effect]:
    """The effects as a recording of this fingerprint meets them: events of other recordings are
    over.
    """
    return [
        met
        for e in effects
        if (met := e if e.seen_in in (None, recording) else afterwards(e)) is not None
    ]


def afterwards(effect: Effect) -> Effect | None:
    """What an event leaves: a step stays, a creep stays where it ended, lost samples leave
    nothing.
    """
    if effect.leaves_nothing:
        return None
    if isinstance(effect, Learned) and effect.coordinate == "time":
        return replace(effect, knots=tuple(k - AGO for k in effect.knots))
    if "time" in effect.values:
        return replace(effect, values={**effect.values, "time": -AGO})
    return effect
