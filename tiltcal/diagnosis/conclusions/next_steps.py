"""What to record next, in words."""

from tiltcal.design.identifiability import tie_breaker
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import Learned


def next_step(names: tuple[str, ...], effect: Effect) -> str:
    """What to record to split a class, or to confirm a single name."""
    others = [n for n in names if n != effect.id and n in CATALOGUE]
    if effect.id in CATALOGUE and others:
        return "; ".join(dict.fromkeys(tie_breaker(effect.id, other) for other in others[:3]))
    if isinstance(effect, Learned):
        return "record the same coordinate again in another order, to see that the curve repeats"
    return f"record {effect.excited_by} again, to confirm"


def step_for_one(recording: str) -> str:
    """What to do about a cause without a name that not all recordings have. recording: in words."""
    which = recording.removeprefix("in ")
    return f"diagnose {which} apart: only laws that all recordings share have a name"
