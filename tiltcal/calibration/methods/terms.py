"""Calibration terms: which effects they are, their columns at poses, and their names in
CAL.json.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import TermEffect
from tiltcal.effects.calibration_terms import calibration_effect
from tiltcal.effects.sense import Sense
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

_ACC, _RATE = ("acc", "m_s2"), "rad_s"
_KINDS = {
    "accelerometer": _ACC,
    "inclinometer": _ACC,
    "gyro": ("gyr", _RATE),
    "fog": ("fog", _RATE),
    "encoder": ("enc", "rad"),
}
"""Prefix of the effects of each kind of sensor, and SI unit of what it reads."""

LINEAR = ("bias", "scale", "cross_axis")


def require_names(terms: Sequence[str], method: str) -> None:
    """Refuse anything but a list of names.

    Raises:
        TiltcalError: it is another value.
    """
    listed = isinstance(terms, Sequence) and not isinstance(terms, str)
    if not listed or not all(isinstance(t, str) for t in terms):
        raise TiltcalError(
            f"method {method}, option terms",
            found=repr(terms),
            need="a list of names",
            do='write terms=\'["bias", "scale"]\'',
        )


def effect_of_term(term: str, sensor: Sensor) -> type[TermEffect]:
    """The effect class of ``bias``, ``scale``, ``cross_axis``, ``K2`` ... or a catalogue id, on a
    sensor.

    Raises:
        TiltcalError: there is no such linear term for this sensor.
    """
    prefix = _KINDS[sensor.kind][0]
    cls = calibration_effect(term, sensor.kind) or CATALOGUE.get(f"{prefix}_{term}")
    if (
        cls is None
        or not issubclass(cls, TermEffect)
        or not cls.linear
        or sensor.kind not in cls.kinds
    ):
        terms = [
            i.removeprefix(prefix + "_")
            for i, c in CATALOGUE.items()
            if issubclass(c, TermEffect) and sensor.kind in c.kinds
        ]
        raise TiltcalError(
            f"calibration term '{term}' of sensor {sensor.name}",
            found="no linear term of that name",
            need="bias, scale, cross_axis or a linear effect",
            do=nearest(term, terms),
        )
    return cls


def term_columns(
    terms: Sequence[str], sensor: Sensor, setup: Setup, force: Array
) -> tuple[list[str], list[str], Array]:
    """Names, units and columns of all parameters of some terms.

    Returns:
        ``<sensor>.<name>`` (p), its unit (p), and columns (p, m, k): reading per unit parameter.
    """
    return columns_under(terms, sensor, Sense.at_rest(sensor, setup.site.gravity, force))


def columns_under(
    terms: Sequence[str], sensor: Sensor, sense: Sense
) -> tuple[list[str], list[str], Array]:
    """The same for anything that is sensed, moving too: names, units and columns (p, n, k)."""
    names, units, columns = [], [], []
    for term in terms:
        cls = effect_of_term(term, sensor)
        effect = cls()
        for parameter in (p for p in cls.parameters if not p.is_shape):
            for name in parameter.expand(sensor.axes):
                channel, column = effect.term(name, sense)
                block = np.zeros((len(sense.time), len(sensor.axes)))
                if channel >= 0:
                    block[:, channel] = column
                linear = term in LINEAR
                unit = (
                    _KINDS[sensor.kind][1] if term == "bias" else "1" if linear else parameter.unit
                )
                columns.append(block if linear else block * parameter.factor)
                names.append(f"{sensor.name}.{_cal_name(name)}")
                units.append(unit)
    return names, units, np.array(columns)


def _cal_name(name: str) -> str:
    return name[0].upper() + name[1:] if name[:1] == "k" else name
