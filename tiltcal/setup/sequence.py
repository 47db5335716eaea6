"""The steps of a sequence, and the climate it runs in."""

from math import pi
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from tiltcal.core.arrays import Array
from tiltcal.core.frames import parse_up
from tiltcal.setup.part import StrictTable
from tiltcal.setup.setup import readable_mount
from tiltcal.setup.tables import angle_key, axis_names, built_in_axes, every_table, length_key


class Climate(StrictTable):
    """Temperature of the laboratory against time: start, ramp, swing and an exponential change."""

    start_degC: float = 23.0
    """Temperature at the first sample, degC."""
    ramp_degC_h: float = 0.0
    """Steady change, degC/h."""
    swing_degC: float = 0.0
    """Amplitude of a sine, degC."""
    period_s: Annotated[float, Field(gt=0)] = 900.0
    """Period of that sine, s."""
    change_degC: float = 0.0
    """Size of an exponential change from the first sample on, degC."""
    tau_s: Annotated[float, Field(gt=0)] = 600.0
    """Time constant of that change, s."""
    reference_degC: float | None = None
    """T0 of effects of temperature, degC; not given: the mean over the recording."""

    def at(self, elapsed: Array) -> Array:
        """Temperature, degC, (n,), at times since the first stamp, s."""
        found = np.full(np.shape(elapsed), self.start_degC)
        if self.ramp_degC_h:
            found += self.ramp_degC_h / 3600 * elapsed
        if self.swing_degC:
            found += self.swing_degC * np.sin(2 * pi * elapsed / self.period_s)
        if self.change_degC:
            found += self.change_degC * -np.expm1(-elapsed / self.tau_s)
        return found

    def reference(self, duration: float) -> float:
        """T0: as stated, else the mean over the recording, degC."""
        return (
            float(np.mean(self.at(np.linspace(0, duration, 2001))))
            if self.reference_degC is None
            else self.reference_degC
        )


def sliding_axes() -> list[str]:
    """Names of the axes that slide, of all tables."""
    found = (name for table in every_table().values() for name in sorted(table.sliding))
    return list(dict.fromkeys(found))


def _axis_keys() -> list[str]:
    return [*map(angle_key, axis_names()), *map(length_key, sliding_axes())]


def _is_axis_key(key: str) -> str:
    if key not in map(angle_key, built_in_axes()) and key not in _axis_keys():
        raise PydanticCustomError("extra_forbidden", "Extra inputs are not permitted")
    return key


def _list_axes(schema: dict[str, Any]) -> None:
    number = schema["additionalProperties"]
    schema["properties"] |= dict.fromkeys(_axis_keys(), number)
    schema["additionalProperties"] = False


class Step(StrictTable):
    """One step of a sequence: what to do, then how long to dwell there.

    ``rest`` dwells; ``move`` goes to the angles (or, hand-held, until ``up`` points up); ``turn``
    turns ``axis`` by ``angle_deg`` at a constant rate; ``sweep`` goes to the angles in steps of
    ``step_deg``, dwelling at each; ``oscillate`` swings ``axis``; ``remount`` changes the mounting;
    ``scheme`` goes through all positions of a measuring ``scheme`` of the library, dwelling at
    each. Angles are keys ``<axis>_deg``, of any axis of any table, and ``<axis>_mm`` of axes that
    slide; those left out stay as they are.
    """

    model_config = ConfigDict(extra="allow", allow_inf_nan=False, json_schema_extra=_list_axes)
    __pydantic_extra__: dict[Annotated[str, AfterValidator(_is_axis_key)], float | None]

    action: Literal["rest", "move", "turn", "sweep", "oscillate", "remount", "scheme"]
    """What the table does."""
    rate_deg_s: Annotated[float, Field(gt=0)] = 20.0
    """Rate of a move or a turn, deg/s."""
    rate_mm_s: Annotated[float, Field(gt=0)] = 50.0
    """Rate of a move along an axis that slides, mm/s."""
    dwell_s: Annotated[float, Field(ge=0)] = 0.0
    """Time at standstill after the motion, s."""
    mount: str | None = None
    """Mounting after `remount`, as in `[rig]`."""
    label: str | None = None
    """The operator's label of the dwell, such as "+x"."""
    axis: str | tuple[float, float, float] | None = None
    """Axis of `turn` and `oscillate`: its name, or hand-held a direction in the body."""
    angle_deg: float | None = None
    """Angle of `turn`, deg."""
    step_deg: Annotated[float, Field(gt=0)] = 10.0
    """Step of `sweep`, deg."""
    step_mm: Annotated[float, Field(gt=0)] = 50.0
    """Step of `sweep` along an axis that slides, mm."""
    amplitude_deg: float | None = None
    """Amplitude of `oscillate`, deg."""
    frequency_hz: Annotated[float, Field(gt=0)] | None = None
    """Frequency of `oscillate`, Hz."""
    cycles: Annotated[int, Field(gt=0)] = 5
    """Cycles of `oscillate`."""
    up: str | None = None
    """Hand-held: body direction that points up after `move`, such as "+x" or "[0.5, 0, 1]"."""
    scheme: Literal["6", "8", "12", "24", "tumble"] | None = None
    """Measuring scheme of `scheme`: its number of positions, or a tumble."""

    @classmethod
    def keys(cls) -> list[str]:
        """All keys, those of the axes of every known table included."""
        return [*super().keys(), *_axis_keys()]

    @property
    def angles_deg(self) -> dict[str, float]:
        """Angle of each axis that the step names, deg."""
        return self._positions(angle_key(""))

    @property
    def lengths_mm(self) -> dict[str, float]:
        """Place of each axis that slides and that the step names, mm."""
        return self._positions(length_key(""))

    def _positions(self, suffix: str) -> dict[str, float]:
        """What the step states under keys of this end, by axis."""
        given = (self.model_extra or {}).items()
        return {
            key.removesuffix(suffix): position
            for key, position in given
            if key.endswith(suffix) and position is not None
        }

    @field_validator("up")
    @classmethod
    def _up_reads(cls, text: str | None) -> str | None:
        if text is not None and parse_up(text) is None:
            raise ValueError(f"up = '{text}' is no direction; write '+x', '-z' or '[0.5, 0, 1]'")
        return text

    @field_validator("mount")
    @classmethod
    def _mount_reads(cls, text: str | None) -> str | None:
        return text if text is None else readable_mount(text)

    @model_validator(mode="after")
    def _complete(self) -> "Step":
        needs = {
            "turn": ("axis", "angle_deg"),
            "oscillate": ("axis", "amplitude_deg", "frequency_hz"),
            "remount": ("mount",),
            "scheme": ("scheme",),
        }
        missing = [key for key in needs.get(self.action, ()) if getattr(self, key) is None]
        if missing:
            raise ValueError(f"action {self.action} needs {', '.join(missing)}")
        return self
