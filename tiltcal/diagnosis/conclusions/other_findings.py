"""Faults of the data as findings.

What no cause explains and no instrument has as noise, as findings without a name. They have no
part in the amended scenario, where they stay noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from tiltcal.core.frames import is_steep
from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.conclusions.parts import part_of
from tiltcal.diagnosis.conclusions.statements import step_for_one
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.inspection import LeftOut, by_recording
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.residual_checks.oscillations import MovingTone, NarrowBand
from tiltcal.diagnosis.residual_checks.random_motion import RandomMotion
from tiltcal.diagnosis.residual_checks.slow_variation import SlowVariation
from tiltcal.diagnosis.search.candidates import CREDIBLE
from tiltcal.diagnosis.search.explained import CLAIM, DOUBTED, Explained
from tiltcal.diagnosis.search.slow_laws import probabilities
from tiltcal.effects.parameter import by_name
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor


def rows_out_of_order(left_out: Sequence[LeftOut], sensors: Sequence[Sensor]) -> list[Finding]:
    """Rows whose time is out of order, as findings: no effect of the catalogue states it, so that
    they have no part in the amended scenario.
    """
    return [
        Finding(
            effect=None,
            names=(),
            stage="data",
            sensors=tuple(s.name for s in sensors),
            axes=tuple(dict.fromkeys(axis for s in sensors for axis in s.axes)),
            where=Where("sample"),
            statement=f"{rows.words}.",
            next_measurement="look at the file and at what wrote it",
            probability=1.0,
        )
        for rows in by_recording(left_out)
        if rows.out_of_order
    ]


def repeated_stamps(left_out: Sequence[LeftOut]) -> list[str]:
    """Stamps that only repeat, as notes: they may be rounded."""
    return [rows.words for rows in by_recording(left_out) if not rows.out_of_order]


def readings_near_pole(sensors: Sequence[Sensor], recordings: Sequence[Recording]) -> list[str]:
    """Readings of an inclinometer that nothing is fitted to, as notes."""
    found = []
    for sensor in (s for s in sensors if s.kind == "inclinometer"):
        read = [r.sensor(sensor).values for r in recordings if r.has(sensor)]
        left = sum(int(is_steep(values).sum()) for values in read)
        if left:
            found.append(
                f"{sensor.name}: {left} of {sum(np.isfinite(v).sum() for v in read)} readings are"
                " so near +-90 deg, where the arcsine has a pole, that nothing is fitted to them"
            )
    return found


def _or_another(fault: Fault) -> str:
    """What was seen, and what else it may be."""
    others = [name for name in fault.names if name != fault.effect.id]
    if not others:
        return fault.words
    return f"{fault.words.rstrip('.')} (or {', '.join(others)}: this recording cannot tell)."


def finding_of(fault: Fault) -> Finding:
    """A fault as it stands in the answer."""
    known, parameters = by_name(fault.effect.parameters), {}
    for name, value in fault.effect.values.items():
        p = known[name]
        parameters[f"{name}{p.suffix}"] = value / p.factor, fault.sigma.get(name, 0.0) / p.factor
    return Finding(
        effect=fault.effect.id,
        names=fault.names or (fault.effect.id,),
        stage=fault.effect.stage,
        sensors=fault.sensors,
        axes=fault.axes,
        where=Where("sample", None, fault.interval),
        parameters=parameters,
        parts=(part_of(fault),),
        p_value=fault.p_value,
        statement=_or_another(fault),
        next_measurement="look at the file and at what wrote it",
    )


def nameless_findings(said: Explained) -> list[Finding]:
    """Slow variation of each axis, oscillations, and random motion, of what a search came to."""
    return [f for chance, f in _all_of(said) if chance >= CLAIM]


def not_noise(said: Explained) -> dict[int, float]:
    """Numbers of the channels whose slow noise is more probably one of some listed effects than
    noise, each with that probability.
    """
    numbers = {number for law in said.in_noise for number in law.channels}
    chances = {n: sum(probabilities(said.in_noise, n).values()) for n in sorted(numbers)}
    return {n: chance for n, chance in chances.items() if chance > DOUBTED}


def nameless_doubts(said: Explained) -> list[tuple[str, float]]:
    """Those that are not probable enough to be claimed: what they are, and their probabilities."""
    doubted = ((chance, f.statement.rstrip(".")) for chance, f in _all_of(said) if chance < CLAIM)
    return [(f"{words[0].lower()}{words[1:]}", chance) for chance, words in doubted]


def _all_of(said: Explained) -> Iterator[tuple[float, Finding]]:
    """Every one with its probability."""
    hiding = [said.whitened.observations.channels[i] for law in said.in_noise for i in law.channels]
    for one in said.slow:
        lawful = any(c.sensor == one.sensor and c.axis in one.axes for c in hiding)
        yield one.probability, _slow(one, lawful)
    yield from _oscillations(said.bands, said.tones)
    yield from ((one.probability, _random(one)) for one in said.motions)


def _slow(slow: SlowVariation, lawful: bool) -> Finding:
    """As a finding; lawful: whether listed laws explain it as well as noise does."""
    others = "the other recordings" if slow.whole else f"the other axes of {slow.sensor}"
    beside = others if slow.beside_others else "a consumer-grade sensor"
    place = f" in {slow.recording}" if slow.recording else ""
    but = "" if lawful else " that no listed effect explains"
    found = _nameless(
        (slow.sensor,),
        slow.axes,
        slow.probability,
        f"Slow variation of {slow.sensor} {', '.join(slow.axes)}{place}{but}:"
        f" {slow.times:.0f} times the slow noise of {beside}.",
        step_for_one(slow.recording)
        if slow.recording
        else "record the instrument at rest for as long, to see whether it varies without motion",
        "time",
    )
    where = replace(found.where, recording=place.strip() or None)
    return replace(found, where=where)


def _oscillations(
    bands: Sequence[NarrowBand], tones: Sequence[MovingTone]
) -> Iterator[tuple[float, Finding]]:
    """Oscillations of each sensor, of the axis that shows them most, and of the others: a tone
    whose frequency moves, or else a band; with their probabilities.
    """
    for sensor in dict.fromkeys([*(t.sensor for t in tones), *(b.sensor for b in bands)]):
        moving, steady = _most_probable(tones, sensor), _most_probable(bands, sensor)
        axes = tuple(dict.fromkeys(one.axis for one in moving or steady))
        where = f"{sensor} {', '.join(axes)}"
        words = _moving(where, moving[0]) if moving else _steady(where, steady[0])
        chance = (moving or steady)[0].probability
        yield chance, _nameless((sensor,), axes, chance, *words, "frequency")


def _random(motion: RandomMotion) -> Finding:
    """Random motion, with the law of slow motion that it may be."""
    where = f"{', '.join(motion.sensors)} {', '.join(motion.axes)}"
    names = tuple(motion.names) if motion.names[UNLISTED] < CREDIBLE else ()
    laws = ", ".join(name for name in names if name != UNLISTED)
    other = f" (or it is {laws}: this recording cannot tell)" if laws else ""
    found = _nameless(
        motion.sensors,
        motion.axes,
        motion.probability,
        f"Random motion of {motion.place}, seen by {where}: no listed effect has this form{other}."
        f" Between {motion.low:.2g} and {motion.high:.2g} Hz what some channels read predicts the"
        " others, as the attitude has it, which noise of a channel does not.",
        f"record at rest in two attitudes for as long, to see whether {motion.place} moves",
        "time",
    )
    return replace(found, stage=motion.stage, names=names, name_probability=motion.names)


Oscillation = TypeVar("Oscillation", NarrowBand, MovingTone)


def _most_probable(every: Sequence[Oscillation], sensor: str) -> list[Oscillation]:
    """Those of a sensor, the most probable one first."""
    return sorted((one for one in every if one.sensor == sensor), key=lambda one: -one.probability)


def _steady(where: str, band: NarrowBand) -> tuple[str, str]:
    """What is said of a band, and what to record next."""
    return (
        f"An oscillation of {where} without a steady phase that no listed effect explains: between"
        f" {band.low:.3g} and {band.high:.3g} Hz its power is {band.times:.2g} times that of the"
        " noise next to this band.",
        "record at rest for as long, with the drives on and then off, to see what oscillates",
    )


def _moving(where: str, tone: MovingTone) -> tuple[str, str]:
    """What is said of a tone whose frequency moves, and what to record next."""
    return (
        f"A tone of {where} whose frequency follows {tone.follows}, between {tone.low:.3g} and"
        f" {tone.high:.3g} Hz: no listed effect has this form.",
        f"record where {tone.follows} changes in another way, to see the tone follow it",
    )


def _nameless(
    sensors: tuple[str, ...],
    axes: tuple[str, ...],
    probability: float,
    statement: str,
    next_step: str,
    coordinate: str,
) -> Finding:
    return Finding(
        effect=None,
        names=(),
        stage="sensor",
        sensors=sensors,
        axes=axes,
        where=Where(coordinate),
        p_value=1 - probability,
        statement=statement,
        next_measurement=next_step,
        probability=probability,
        name_probability={UNLISTED: 1.0},
    )
