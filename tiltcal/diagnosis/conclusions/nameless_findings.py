"""What no cause explains and no instrument has as noise, as findings without a name. They have no
part in the amended scenario, where they stay noise.
"""

from collections.abc import Iterator, Sequence
from typing import TypeVar

from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.diagnosis.search.moving_tones import MovingTone
from tiltcal.diagnosis.search.name_probabilities import UNLISTED
from tiltcal.diagnosis.search.narrow_bands import NarrowBand
from tiltcal.diagnosis.search.slow_variation import SlowVariation


def nameless_findings(said: Explained) -> Iterator[Finding]:
    """Slow variation of each axis, then oscillations, of what a search came to."""
    yield from (_slow(one) for one in said.slow)
    yield from _oscillations(said.bands, said.tones)


def _slow(slow: SlowVariation) -> Finding:
    beside = f"the other axes of {slow.sensor}" if slow.beside_axes else "the worst grade"
    return _nameless(
        slow.sensor,
        (slow.axis,),
        slow.probability,
        f"Slow variation of {slow.sensor} {slow.axis} that no listed effect explains:"
        f" {slow.times:.0f} times the slow noise of {beside}.",
        "record the instrument at rest for as long, to see whether it varies without motion",
        "time",
    )


def _oscillations(bands: Sequence[NarrowBand], tones: Sequence[MovingTone]) -> Iterator[Finding]:
    """Oscillations of each sensor, of the axis that shows them most, and of the others: a tone
    whose frequency moves, or else a band.
    """
    for sensor in dict.fromkeys([*(t.sensor for t in tones), *(b.sensor for b in bands)]):
        if moving := _most_probable(tones, sensor):
            yield _moving(sensor, _axes(moving), moving[0])
        else:
            steady = _most_probable(bands, sensor)
            yield _band(sensor, _axes(steady), steady[0])


Oscillation = TypeVar("Oscillation", NarrowBand, MovingTone)


def _most_probable(every: Sequence[Oscillation], sensor: str) -> list[Oscillation]:
    """Those of a sensor, the most probable one first."""
    return sorted((one for one in every if one.sensor == sensor), key=lambda one: -one.probability)


def _axes(own: Sequence[NarrowBand | MovingTone]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(one.axis for one in own))


def _band(sensor: str, axes: tuple[str, ...], first: NarrowBand) -> Finding:
    return _nameless(
        sensor,
        axes,
        first.probability,
        f"An oscillation of {sensor} {', '.join(axes)} without a steady phase that no listed effect"
        f" explains: between {first.low:.3g} and {first.high:.3g} Hz its power is"
        f" {first.times:.2g} times that of the noise beside this band.",
        "record at rest for as long, with the drives on and then off, to see what oscillates",
        "frequency",
    )


def _moving(sensor: str, axes: tuple[str, ...], first: MovingTone) -> Finding:
    return _nameless(
        sensor,
        axes,
        first.probability,
        f"A tone of {sensor} {', '.join(axes)} whose frequency follows {first.follows}, between"
        f" {first.low:.3g} and {first.high:.3g} Hz: no listed effect has this form.",
        f"record where {first.follows} changes in another way, to see the tone follow it",
        "frequency",
    )


def _nameless(
    sensor: str,
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
        sensors=(sensor,),
        axes=axes,
        where=Where(coordinate),
        p_value=1 - probability,
        statement=statement,
        next_measurement=next_step,
        probability=probability,
        name_probability={UNLISTED: 1.0},
    )
