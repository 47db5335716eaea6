"""Plausible sizes of the terms that a calibration may have."""

from tiltcal.core.units import G0
from tiltcal.instrument.temperature import TemperatureTerms
from tiltcal.instrument.terms import terms_of

WARMEST = 40.0  # K, above T0


def size_of(sensor, name: str) -> float:
    """A plausible size of a term, SI: that of a consumer-grade sensor."""
    cls, parameter = terms_of(sensor.kind, sensor.axes)[name]
    if cls is TemperatureTerms:
        if name.startswith("tempmem"):
            return 1e-4 * G0
        power = int(name[4])
        return (1e-3 if "_bias_" in name else 1e-4) * (1.0 / WARMEST) ** power
    stated = next(p for p in cls.parameters if parameter in p.expand(sensor.axes))
    return stated.plausible[1] * stated.factor
