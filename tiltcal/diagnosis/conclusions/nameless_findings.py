"""What no cause explains and no instrument has as noise, as findings without a name. They have no
part in the amended scenario, where they stay noise.
"""

from collections.abc import Iterator, Sequence

from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.search.name_probabilities import UNLISTED
from tiltcal.diagnosis.search.narrow_bands import NarrowBand
from tiltcal.diagnosis.search.slow_variation import SlowVariation


def slow_finding(slow: SlowVariation) -> Finding:
    """Slow variation of one axis."""
    beside = f"the other axes of {slow.sensor}" if slow.beside_axes else "the worst grade"
    return _nameless(
        slow.sensor,
        (slow.axis,),
        slow.probability,
        f"Slow variation of {slow.sensor} {slow.axis} that no listed effect explains:"
        f" {slow.times:.0f} times the slow noise of {beside}.",
        "record the instrument at rest for as long, to see whether it varies without motion",
    )


def band_findings(bands: Sequence[NarrowBand]) -> Iterator[Finding]:
    """Oscillations of each sensor, of the axis that shows them most, and of the others."""
    for sensor in dict.fromkeys(b.sensor for b in bands):
        own = sorted((b for b in bands if b.sensor == sensor), key=lambda b: -b.probability)
        axes, first = tuple(dict.fromkeys(b.axis for b in own)), own[0]
        yield _nameless(
            sensor,
            axes,
            first.probability,
            f"An oscillation of {sensor} {', '.join(axes)} without a steady phase that no listed"
            f" effect explains: between {first.low:.3g} and {first.high:.3g} Hz its power is"
            f" {first.times:.2g} times that of the noise beside this band.",
            "record at rest for as long, with the drives on and then off, to see what oscillates",
        )


def _nameless(
    sensor: str, axes: tuple[str, ...], probability: float, statement: str, next_step: str
) -> Finding:
    return Finding(
        effect=None,
        names=(),
        stage="sensor",
        sensors=(sensor,),
        axes=axes,
        where=Where("time"),
        p_value=1 - probability,
        statement=statement,
        next_measurement=next_step,
        probability=probability,
        name_probability={UNLISTED: 1.0},
    )
