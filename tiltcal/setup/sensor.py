"""Sensors as a scenario file states them."""

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from tiltcal.core.arrays import Array
from tiltcal.core.frames import unit
from tiltcal.core.units import COLUMN_UNITS, G0
from tiltcal.setup.chain import LinkFrame
from tiltcal.setup.part import StrictTable

RESERVED = {"time", "table", "temperature", "label", "tilt", "north"}


QUANTITY = {
    "accelerometer": "acceleration",
    "inclinometer": "angle",
    "gyro": "rate",
    "fog": "rate",
    "encoder": "angle",
}


SLOPES = {
    "acceleration": "per_m_s2 or per_g",
    "angle": "per_rad or per_deg; a sensor that reads the sine of its tilt is an accelerometer",
    "rate": "per_rad_s or per_deg_s",
}


DEFAULT_UNIT = {
    "accelerometer": "m_s2",
    "inclinometer": "deg",
    "gyro": "deg_s",
    "fog": "deg_h",
    "encoder": "deg",
}


def _not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("a slope of 0 reads nothing")
    return value


NonZero = Annotated[float, AfterValidator(_not_zero)]


class Input(StrictTable):
    """How readings become SI: ``value = (reading - zero) / per_unit``. Raw ones (LSB, V, mA), or
    angles that count otherwise: a zenith angle has ``unit = "deg", zero = 90, per_deg = -1``.
    """

    unit: Literal["V", "mV", "mA", "LSB", "rad", "deg", "arcsec"]
    """Unit of the columns."""
    zero: float | tuple[float, ...] = 0.0
    """Raw reading at zero input, in that unit; one for all channels or one each."""
    per_m_s2: NonZero | None = None
    """Raw units for one m/s2."""
    per_g: NonZero | None = None
    """Raw units for one standard gravity of 9.80665 m/s2."""
    per_rad_s: NonZero | None = None
    """Raw units for one rad/s."""
    per_deg_s: NonZero | None = None
    """Raw units for one deg/s."""
    per_rad: NonZero | None = None
    """Raw units for one rad of inclination."""
    per_deg: NonZero | None = None
    """Raw units for one deg of inclination."""

    @model_validator(mode="after")
    def _one_slope(self) -> "Input":
        if len(self._slopes()) != 1:
            raise ValueError(
                "give exactly one of per_m_s2, per_g, per_rad_s, per_deg_s, per_rad, per_deg"
            )
        if self.counts_angle and self.quantity != "angle":
            raise ValueError(f"unit = '{self.unit}' is an angle: give per_deg or per_rad")
        return self

    @property
    def counts_angle(self) -> bool:
        """Whether the reading is an angle itself, not a raw one."""
        return COLUMN_UNITS[self.unit].quantity == "angle"

    def _slopes(self) -> list[tuple[str, float]]:
        names = ("m_s2", "g", "rad_s", "deg_s", "rad", "deg")
        return [(n, value) for n in names if (value := getattr(self, f"per_{n}")) is not None]

    @property
    def quantity(self) -> str:
        """What a raw reading stands for: acceleration, angle or rate."""
        ((name, _),) = self._slopes()
        return COLUMN_UNITS[name].quantity

    @property
    def slope(self) -> float:
        """Raw counts per SI unit."""
        ((name, value),) = self._slopes()
        return float(value) / COLUMN_UNITS[name].factor

    def to_si(self, raw: Array) -> Array:
        """(n, k) raw readings -> SI."""
        return np.asarray((raw - np.asarray(self.zero)) / self.slope)

    def from_si(self, value: Array) -> Array:
        """(n, k) SI -> raw readings, not rounded."""
        return np.asarray(value * self.slope + np.asarray(self.zero))


class Converter(StrictTable):
    """An analogue chain and one sigma-delta converter that takes the channels in turn; the defaults
    are an AD7705 behind a quartz flexure accelerometer (fCLK 2.4576 MHz).
    """

    current_mA_g: Annotated[float, Field(gt=0)] = 1.0
    """Current of the accelerometer's loop, mA for one g."""
    resistor_ohm: Annotated[float, Field(gt=0)] = 50.0
    """Resistor that the current flows through, ohm."""
    amplifier: Annotated[float, Field(gt=0)] = 90.0
    """Gain before the converter."""
    lowpass_hz: Annotated[float, Field(gt=0)] = 10.0
    """Corner of the first-order filter behind the amplifier, Hz."""
    reference_V: Annotated[float, Field(gt=0)] = 2.5
    """Reference, V; the converter takes +- reference/gain."""
    gain: Annotated[float, Field(gt=0)] = 2.0
    """Gain of the converter's own amplifier."""
    bits: Annotated[int, Field(ge=8, le=24)] = 16
    """Resolution, bits."""
    modulator_hz: Annotated[float, Field(gt=0)] = 19200.0
    """Rate of the modulator, Hz."""
    output_hz: Annotated[float, Field(gt=0)] = 250.0
    """Output rate of the sinc3 filter, whose notches lie at its multiples, Hz."""
    settle: Annotated[int, Field(ge=3)] = 4
    """Conversions until a channel has settled after the switch; the last one is kept."""

    @property
    def volts_per_si(self) -> float:
        """Volts at the converter for one m/s2."""
        return self.current_mA_g * 1e-3 / G0 * self.resistor_ohm * self.amplifier

    @property
    def limit(self) -> float:
        """Largest reading before it clips, m/s2."""
        return self.reference_V / self.gain / self.volts_per_si

    @property
    def lsb(self) -> float:
        """LSB, m/s2."""
        return 2 * self.limit / 2**self.bits

    @property
    def turn_s(self) -> float:
        """Time that one channel takes, s."""
        return self.settle / self.output_hz


class Sensor(StrictTable):
    """One sensor of the instrument: a prefix of columns.

    On a user's own model ``site`` names the site or body where it sits; it is read into ``place``.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9]*$")]
    """Prefix of its columns, such as `accel`; not one of the reserved names."""
    kind: Literal["accelerometer", "inclinometer", "gyro", "fog", "encoder"]
    """What it senses; a sensor that reads the sine of its tilt is an accelerometer, and an encoder
    reads an axis whose table column is the command."""
    axes: tuple[str, ...] = ("x", "y", "z")
    """Channels, along axes of the body; an inclinometer has x and y, a FOG and an encoder the one
    axis a."""
    rate_hz: Annotated[float, Field(gt=0)] = 100.0
    """Sample rate of a simulated recording, Hz."""
    adjustable: tuple[str, ...] = ()
    """What a calibration may re-tune: `bias`, `scale`, `cross_axis`, or ids of effects."""
    input_axis: tuple[float, float, float] | None = None
    """Input axis of a FOG in the body frame; its length does not matter."""
    of: str | None = None
    """Axis of the rig that an encoder reads."""
    input: Input | None = None
    """How raw columns become SI."""
    converter: Converter | None = None
    """Analogue chain and converter of an accelerometer."""
    unit: str | None = None
    """Unit of its simulated columns; by default m_s2, deg, deg_s, and deg_h of a FOG."""
    full_scale: Annotated[float, Field(gt=0)] | None = None
    """Largest input, SI: the range of integral non-linearity and of firmware."""
    place: LinkFrame | None = None
    """Where it sits on a user's own model, if not where the instrument does."""

    @model_validator(mode="after")
    def _consistent(self) -> "Sensor":
        if self.name in RESERVED:
            raise ValueError(f"the sensor name '{self.name}' is reserved")
        alone = {"fog": {"a"}, "encoder": {"a"}, "inclinometer": {"x", "y"}}
        allowed = alone.get(self.kind, {"x", "y", "z"})
        if not self.axes or not set(self.axes) <= allowed or len(set(self.axes)) != len(self.axes):
            raise ValueError(
                f"axes of a {self.kind} are among {', '.join(sorted(allowed))}, each once"
            )
        if self.kind == "fog" and (self.input_axis is None or not np.any(self.input_axis)):
            raise ValueError(
                "a fog needs input_axis = [ux, uy, uz], its input axis in the body frame"
            )
        if (self.kind == "encoder") != (self.of is not None):
            raise ValueError('an encoder, and no other sensor, needs of = "outer", its axis')
        if self.converter is not None:
            if (
                not self.is_accelerometer
                or len(self.axes) * self.converter.turn_s > 1 / self.rate_hz
            ):
                raise ValueError(
                    "a converter serves an accelerometer, and all its channels in turn within one"
                    " sample"
                )
            if self.kind == "inclinometer":
                raise ValueError(
                    "a converter reads a current that follows the force: call the sensor an"
                    " accelerometer"
                )
        if self.input is not None and self.input.quantity != self.quantity:
            raise ValueError(
                f"the input of {self.name} ({self.kind}) states counts per {self.input.quantity},"
                f" need per {self.quantity}: {SLOPES[self.quantity]}"
            )
        if self.unit is not None:
            unit_ = COLUMN_UNITS.get(self.unit)
            if unit_ is None or unit_.quantity != self.quantity:
                raise ValueError(f"unit '{self.unit}' is not a unit of {self.quantity}")
        return self

    @property
    def quantity(self) -> str:
        """acceleration, angle or rate."""
        return QUANTITY[self.kind]

    @property
    def is_accelerometer(self) -> bool:
        """Whether it senses specific force (triad or inclinometer)."""
        return self.kind in ("accelerometer", "inclinometer")

    @property
    def column_unit(self) -> str:
        """The unit that simulated columns are written in."""
        if self.input is not None:
            return self.input.unit
        return self.unit or DEFAULT_UNIT[self.kind]

    @property
    def input_vector(self) -> Array:
        """Unit vector of a FOG's input axis in the body frame, (3,)."""
        if self.input_axis is None:
            raise ValueError(f"sensor {self.name} has no input axis")
        return unit(self.input_axis)

    @property
    def axis_indices(self) -> tuple[int, ...]:
        """Body axis of each channel (the single one of a FOG or an encoder counts as 0)."""
        return tuple("xyz".find(axis) if axis != "a" else 0 for axis in self.axes)
