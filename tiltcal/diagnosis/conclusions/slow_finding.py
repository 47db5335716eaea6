"""Slow variation as a finding without a name."""

from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.search.name_probabilities import UNLISTED
from tiltcal.diagnosis.search.slow_variation import SlowVariation


def slow_finding(slow: SlowVariation) -> Finding:
    """The finding; it has no part in the amended scenario, where it stays noise."""
    beside = f"the other axes of {slow.sensor}" if slow.beside_axes else "the worst grade"
    return Finding(
        effect=None,
        names=(),
        stage="sensor",
        sensors=(slow.sensor,),
        axes=(slow.axis,),
        where=Where("time"),
        p_value=1 - slow.probability,
        statement=f"Slow variation of {slow.sensor} {slow.axis} that no listed effect explains:"
        f" {slow.times:.0f} times the slow noise of {beside}.",
        next_measurement="record the instrument at rest for as long, to see whether it varies"
        " without motion",
        probability=slow.probability,
        name_probability={UNLISTED: 1.0},
    )
