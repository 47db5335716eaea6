"""Which curves complete the form of a named effect: real laws are seldom the one-parameter textbook
form.

A family keeps where the effect acts and what it follows, and frees how: an encoder's error of its
angle keeps to that angle, a bias that follows temperature may follow it late or bent. A curve of
another place or coordinate is another effect.
"""

from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.learned import (
    Learned,
    LearnedDelay,
    LearnedReading,
    LearnedReadout,
    LearnedTilt,
)

OFF = 0.05  # of a tone's frequency, that an overtone may be off a multiple of it
OVERTONES = 9.5  # times its frequency


def completes(curve: Hypothesis, host: Hypothesis) -> bool:
    """Whether a curve is of the family of a named effect."""
    effect = curve.effect
    if not host.listed:
        return _same_curve(curve, host)
    if curve.listed and curve.alias:
        return _same_name(curve, host)
    if curve.listed:
        return _same_law(curve, host)
    assert isinstance(effect, Learned)
    once = host.effect.seen_in is not None
    if effect.is_step or (once and effect.coordinate == "time" and not curve.line_hz):
        return False  # a curve over time is the same in every recording
    # what varies or fades is no form of it
    fades = effect.times or effect.relaxing or effect.instants
    if fades or isinstance(effect, LearnedDelay):
        return False
    if curve.line_hz:
        return host.law.spectral_line == "time" and _cycle_of(curve, host)
    family = host.law.family
    if isinstance(effect, LearnedReading):
        if effect.sensor != host.effect.sensor or (
            host.effect.axis and host.effect.axis != effect.axis
        ):
            return False
        if (
            not any(name.endswith(f"_{effect.axis}") or "_" not in name for name in host.names)
            and not family.scale
        ):
            return False
        return effect.coordinate in (family.scale if effect.per_input else family.reading)
    if effect.beside:  # no law of a readout or a frame follows two angles
        return False
    if isinstance(effect, LearnedReadout):
        axis = host.effect.axis or effect.axis
        own = [coordinate.format(axis=axis) for coordinate in family.readout]
        return effect.axis == axis and effect.coordinate in own
    assert isinstance(effect, LearnedTilt)
    return family.has_tilt(effect.slot, effect.coordinate, host.effect.axis)


def _same_name(curve: Hypothesis, host: Hypothesis) -> bool:
    """Whether a curve under a name completes a form of that name, or is of the same form."""
    effect, other = curve.effect, host.effect
    if curve.id != host.id or effect.sensor != other.sensor or not isinstance(effect, Learned):
        return False
    return not isinstance(other, Learned) or (
        (other.lag, other.power) == (effect.lag, effect.power)
        and len(curve.names) == len(host.names)
    )


def _same_law(listed: Hypothesis, host: Hypothesis) -> bool:
    """Whether an effect of the catalogue completes another."""
    if listed.id in host.law.family.effects:
        return listed.effect.sensor == host.effect.sensor
    if listed.id != host.id or listed.effect.sensor != host.effect.sensor:
        return False
    law, mine, other = listed.law, listed.effect.values, host.effect.values
    if law.acts_from_an_instant:  # what creeps on after it
        return listed.instant == host.instant and mine.get("creep", 0) > 0
    if law.wander:
        return _of_one_source(mine["frequency"], other["frequency"], law.wander)
    return law.alike_on_axes or (law.superposes and listed.effect.axis == host.effect.axis)


def _cycle_of(curve: Hypothesis, host: Hypothesis) -> bool:
    """Whether a curve that repeats in time is of a tone: an addition to the same readings, as near
    as the tone wanders; a base that tilts to and fro shakes.
    """
    effect, law = curve.effect, host.law
    if isinstance(effect, LearnedReading):
        near = abs(curve.line_hz - host.line_hz) < law.wander
        return near and effect.sensor == host.effect.sensor
    return isinstance(effect, LearnedTilt) and effect.slot == "base" and law.superposes


def _of_one_source(frequency: float, tone: float, wander: float) -> bool:
    """Whether a frequency is that of a tone that wanders, Hz, or an overtone of it."""
    times = max(frequency, tone) / min(frequency, tone)
    overtone = frequency > tone and abs(times - round(times)) < OFF and 1.5 < times < OVERTONES
    return abs(frequency - tone) < wander or overtone


def form_of(curve: Hypothesis) -> tuple[object, ...]:
    """What the parts of one unnamed effect have in common; equal for curves that differ in axis,
    turn or recording only.
    """
    effect = curve.effect
    assert isinstance(effect, Learned)
    form = type(effect), len(curve.names), *effect.curve_id, effect.sensor
    if isinstance(effect, LearnedTilt):
        return *form, effect.slot
    return *form, effect.per_input if isinstance(effect, LearnedReading) else effect.axis


def _same_curve(curve: Hypothesis, host: Hypothesis) -> bool:
    """Whether two curves are parts of one unnamed effect: the same coordinate at the same place, on
    another axis or in another recording.
    """
    a, b = curve.effect, host.effect
    if type(a) is not type(b) or form_of(curve) != form_of(host):
        return False
    if isinstance(a, LearnedTilt) and isinstance(b, LearnedTilt):
        return a.turn != b.turn
    return isinstance(a, LearnedReading) and (a.axis != b.axis or a.seen_in != b.seen_in)
