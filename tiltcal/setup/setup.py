"""The set-up: site, rig and sensors, as a scenario's file states them. Frozen; SI through the
properties.
"""

from collections.abc import Iterable, Mapping
from functools import cache, cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import earth_rate, parse_mount
from tiltcal.core.units import DEG
from tiltcal.setup.chain import BASE, Chain, Link, LinkFrame
from tiltcal.setup.part import StrictTable
from tiltcal.setup.reach import Ends, Reach
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.sources import SourceTable
from tiltcal.setup.tables import (
    BUILT_IN,
    OWN_MODEL,
    Axis,
    Table,
    add_model,
    every_table,
    find_table,
    tables,
)


class Site(StrictTable):
    """Where the laboratory stands."""

    gravity_m_s2: Annotated[float, Field(gt=0, le=1e6)]
    """Local plumb-line gravity, m/s2."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Geodetic latitude, deg; needed by gyros and FOGs; not given: no Earth's rate."""
    heading_deg: float | Literal["unknown"] = 0.0
    """Azimuth of the table's North mark, clockwise from true north, deg; "unknown" makes it
    adjustable.
    """
    temperature_degC: float = 23.0
    """Temperature of the laboratory, degC."""

    @model_validator(mode="before")
    @classmethod
    def _unknown_heading(cls, text: Any) -> Any:
        """``heading = "unknown"`` is another way to write that the heading is not known."""
        if not isinstance(text, dict) or text.get("heading") != "unknown":
            return text
        return {"heading_deg": "unknown"} | {k: v for k, v in text.items() if k != "heading"}

    @property
    def gravity(self) -> float:
        """m/s2."""
        return self.gravity_m_s2

    @property
    def earth_rate(self) -> Array:
        """Earth's rotation in the world frame, rad/s, (3,); zero when the latitude is not
        stated.
        """
        if self.latitude_deg is None:
            return np.zeros(3)
        heading = 0.0 if self.heading_deg == "unknown" else self.heading_deg
        return earth_rate(self.latitude_deg * DEG, heading * DEG)


def readable_mount(text: str) -> str:
    """``text`` when it is a mounting; a ValueError for pydantic otherwise."""
    try:
        parse_mount(text)
    except TiltcalError as error:
        raise ValueError(str(error)) from error
    return text


def known_table(name: str) -> str:
    """``name`` when it is a table's; an error for pydantic otherwise."""
    if name not in BUILT_IN and name not in every_table():
        *others, last = (f"'{table}'" for table in tables())
        raise PydanticCustomError("literal_error", f"Input should be {', '.join(others)} or {last}")
    return name


def _list_tables(schema: dict[str, Any]) -> None:
    schema["enum"] = list(tables())


def _pairs(text: Any) -> Any:
    return tuple(text.items()) if isinstance(text, Mapping) else text


def _table_of_pairs(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    return dict(pairs)


def _by_axis(schema: dict[str, Any]) -> tuple[Any, ...]:
    """A table in the file, pairs in memory: a rig is hashable."""
    table = {"type": "object", "additionalProperties": schema}
    return BeforeValidator(_pairs), PlainSerializer(_table_of_pairs), WithJsonSchema(table)


NUMBER: dict[str, Any] = {"type": "number"}
TWO_NUMBERS: dict[str, Any] = {"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 2}
LimitsByAxis = Annotated[tuple[tuple[str, Ends], ...], *_by_axis(TWO_NUMBERS)]
PositionByAxis = Annotated[tuple[tuple[str, float], ...], *_by_axis(NUMBER)]


class Rig(StrictTable):
    """The table and how the instrument sits on it.

    A user's own model is read into ``link`` and ``instrument``; ``model`` is the file that they
    were read from, ``site`` the instrument's in it, and ``table`` follows from them.
    """

    table: Annotated[str, AfterValidator(known_table), Field(json_schema_extra=_list_tables)]
    """Table; its axes are defined under frames and signs of the interfaces."""
    model: str = ""
    """File that the links were read from."""
    site: str = ""
    """Site or body of the model where the instrument sits."""
    link: tuple[Link, ...] = ()
    """Links of a user's own model, from the base outwards."""
    instrument: LinkFrame = LinkFrame()
    """Where the instrument sits on the links."""
    readout: Literal["encoder", "command"] = "encoder"
    """What the table's columns hold: the encoder's angle, or the one the drive was asked for."""
    mount: str = "identity"
    """Rotation from body to faceplate, such as "Rz(180)" or "Rx(90) Rz(180)", deg."""
    rated_payload_kg: Annotated[float, Field(gt=0)] | None = None
    """Largest payload of a user's own robot, kg: how large an unknown one may plausibly be."""
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the axes' common point to the sensors, in the body frame, m."""
    limits: LimitsByAxis = ()
    """Lowest and highest readout of an axis, such as `{ outer = [-90, 90] }`, deg, or mm where it
    slides: plans keep to them and to the ranges of a model's joints.
    """
    start: PositionByAxis = ()
    """Readout of an axis before the first move, deg or mm; not given: zero, or the allowed readout
    nearest to it.
    """

    @model_validator(mode="before")
    @classmethod
    def _table_of_links(cls, text: Any) -> Any:
        """The links of a user's own model are a table of their own, whose name is made from them:
        a file that an earlier version wrote has another.
        """
        if not isinstance(text, dict) or not text.get("link"):
            return text
        chain = Chain.model_validate({k: text[k] for k in ("link", "instrument") if k in text})
        if (problem := chain.problem()) is not None:
            raise ValueError(problem)
        name = add_model(chain).name
        if not str(text.get("table", name)).startswith(OWN_MODEL):
            raise ValueError(f"table '{text['table']}' with links; leave it out")
        return {**text, "table": name}

    @field_validator("mount")
    @classmethod
    def _mount_reads(cls, text: str) -> str:
        return readable_mount(text)

    @model_validator(mode="after")
    def _stands_within_its_limits(self) -> Self:
        try:
            _ = self.reach
        except TiltcalError as error:
            raise ValueError(str(error)) from error
        return self

    @cached_property
    def kind(self) -> Table:
        """The declaration of its table."""
        return find_table(self.table)

    @cached_property
    def reach(self) -> Reach:
        """Where its axes may stand, and where they stand before the first move."""
        return Reach.of(self.kind, dict(self.limits), dict(self.start))

    def narrowed(self, limits: Mapping[str, Ends], start: Mapping[str, float]) -> "Rig":
        """The rig with further limits, or another start.

        Args:
            limits: lowest and highest readout by axis, deg or mm.
            start: readout before the first move by axis, deg or mm.

        Raises:
            TiltcalError: there is no such axis, or a joint or a limit rules them out.
        """
        own = dict(self.limits)
        both = {
            axis: (max(low, own[axis][0]), min(high, own[axis][1])) if axis in own else (low, high)
            for axis, (low, high) in limits.items()
        }
        together, stands = own | both, dict(self.start) | dict(start)
        Reach.of(self.kind, together, stands)
        return Rig.model_validate({**self.model_dump(), "limits": together, "start": stands})

    @property
    def axes(self) -> tuple[Axis, ...]:
        """(name, coordinate axis) of each table axis, outermost first."""
        return self.kind.axes

    @property
    def mount_rotation(self) -> Array:
        """R_mount: body to faceplate components, (3, 3)."""
        return parse_mount(self.mount)

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Lowest and highest readout of the axes whose joint in a user's own model has a range, deg
        or, where it slides, mm.
        """
        return {} if self.kind.chain is None else self.kind.chain.ranges

    @property
    def directions(self) -> tuple[str, ...]:
        """Coordinate axis of each table axis, outermost first."""
        return self.kind.directions

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the table's axes, outermost first."""
        return self.kind.axis_names


@cache
def _rig_at(rig: Rig, position: LinkFrame) -> Rig:
    """A rig of a user's own model with the instrument somewhere else on it."""
    text = rig.model_dump(exclude={"table"})
    return Rig.model_validate({**text, "instrument": position.model_dump()})


class Setup(StrictTable):
    """Site, rig and sensors: what a user knows of a laboratory, and how well."""

    site: Site
    """Gravity, latitude and heading of the laboratory."""
    rig: Rig
    """The table and how the instrument sits on it."""
    sensor: tuple[Sensor, ...] = ()
    """Sensors of the instrument; each has its own columns."""
    budget: tuple[SourceTable, ...] = ()
    """Uncertain references: part of the fit, the verdict and the uncertainty."""

    @model_validator(mode="after")
    def _links_exist(self) -> "Setup":
        for s in self.sensor:
            if s.place is not None and s.place.on not in {BASE, *(k.axis for k in self.rig.link)}:
                raise ValueError(f"sensor '{s.name}' on '{s.place.on}', which is no link")
            if s.of is None:
                continue
            if s.of not in self.rig.axis_names:
                names = ", ".join(self.rig.axis_names) or "none"
                raise ValueError(f"encoder '{s.name}' of '{s.of}', which is no axis: {names}")
            if self.rig.readout != "command":
                raise ValueError(
                    f"encoder '{s.name}' beside readout = 'encoder': the table columns hold what it"
                    " reads; write readout = 'command'"
                )
        return self

    @property
    def bare(self) -> "Setup":
        """The set-up alone: of a scenario without what it simulates and judges."""
        if type(self) is Setup:
            return self
        return Setup(site=self.site, rig=self.rig, sensor=self.sensor, budget=self.budget)

    def seen_by(self, sensor: Sensor) -> Self:
        """The set-up with the instrument where one sensor sits."""
        if sensor.place is None or not self.rig.link:
            return self
        return self.model_copy(update={"rig": _rig_at(self.rig, sensor.place)})

    def sensors(self, *kinds: str) -> list[Sensor]:
        """The sensors of these kinds (of all kinds when none is named)."""
        return [s for s in self.sensor if not kinds or s.kind in kinds]

    def named(self, name: str) -> Sensor:
        """The sensor of that name.

        Raises:
            TiltcalError: there is none.
        """
        for s in self.sensor:
            if s.name == name:
                return s
        names = ", ".join(s.name for s in self.sensor) or "none"
        raise TiltcalError(
            f"sensor '{name}'",
            found="no such sensor",
            need=f"one of {names}",
            do="correct the name",
        )
