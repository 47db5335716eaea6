"""The effects that calibration frees, by the names of the terms of a sensor."""

from tiltcal.effects.base import Effect
from tiltcal.effects.catalogue import CATALOGUE


def calibration_effect(term: str, kind: str) -> type[Effect] | None:
    """The effect that a term such as ``bias`` stands for on a kind of sensor; None: there is none.

    A term may also be the id of an effect.
    """
    named = (c for c in CATALOGUE.values() if c.calibration_term == term and kind in c.kinds)
    return CATALOGUE.get(term) or next(named, None)
