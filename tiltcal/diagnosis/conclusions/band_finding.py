"""A band of frequencies with more power than noise as a finding without a name."""

from collections.abc import Iterator, Sequence
from itertools import groupby

from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.search.name_probabilities import UNLISTED
from tiltcal.diagnosis.search.narrow_bands import NarrowBand


def band_findings(bands: Sequence[NarrowBand]) -> Iterator[Finding]:
    """A finding for each sensor; it has no part in the amended scenario, where it stays noise."""
    for sensor, every in groupby(bands, lambda b: b.sensor):
        own = sorted(every, key=lambda b: -b.probability)
        axes, first = tuple(b.axis for b in own), own[0]
        yield Finding(
            effect=None,
            names=(),
            stage="sensor",
            sensors=(sensor,),
            axes=axes,
            where=Where("time"),
            p_value=1 - first.probability,
            statement=f"An oscillation of {sensor} {', '.join(axes)} without a steady phase that no"
            f" listed effect explains: between {first.low:.3g} and {first.high:.3g} Hz its power is"
            f" {first.times:.2g} times that of the noise beside this band.",
            next_measurement="record at rest for as long, with the drives on and then off, to see"
            " what oscillates",
            probability=first.probability,
            name_probability={UNLISTED: 1.0},
        )
