"""Parameters of an effect: name, unit, plausible sizes, and on which tables they apply."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import Table, every_table, find_table

Stage = Literal["environment", "table", "mount", "sensor", "electronics", "timing", "data"]


STAGES: tuple[Stage, ...] = (
    "environment",
    "table",
    "mount",
    "sensor",
    "electronics",
    "timing",
    "data",
)


GRADES = ("precision", "mid_mems", "consumer")
"""Grades of instruments, for which plausible sizes are stated."""


Need = Literal["pose", "motion", "direction", "temperature", "vibration", "time", "remount", "any"]
"""What a recording has to hold for an effect to show: several poses, motion, both directions of
approach, ...
"""


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Args:
        name: without unit; ``{axis}`` stands for each axis of the sensor, ``{pair}`` for each
            ordered pair of different axes, ``{matrix}`` for each axis with each direction x, y, z.
        unit: as its suffix in files; empty for a plain count.
        plausible: largest typical size at the grades precision laboratory, mid MEMS, consumer, in
            ``unit``.
        positive: whether only values >= 0 make sense (a width, a time constant, a standard
            deviation).
        default: SI value when a scenario leaves it out.
        shape: whether it states when, how fast or how wide and not how much; so does everything
            with a default.
        whole: whether it counts what comes in ones.
        switch: whether it is 0 or 1.
        bounded: whether a shape beyond those that the effect offers for a recording would make
            another functional form of it.
        tables: names of the tables that have it; empty: any.
        restates: whether it says in other words what further parameters say: nothing is fitted to
            it.
    """

    name: str
    unit: str
    plausible: tuple[float, float, float]
    positive: bool = False
    default: float = 0.0
    shape: bool = False
    whole: bool = False
    switch: bool = False
    bounded: bool = False
    tables: frozenset[str] = frozenset()
    restates: bool = False

    def stands_on(self, rig: Rig) -> bool:
        """Whether the table of a rig has it."""
        return not self.tables or rig.table in self.tables

    def fits_on(self, rig: Rig) -> bool:
        """Whether it is a size that may be fitted on a rig."""
        return not self.is_shape and not self.restates and self.stands_on(rig)

    def expand(self, axes: Sequence[str]) -> list[str]:
        """Bare names for a sensor with these axes."""
        if "{axis}" in self.name:
            return [self.name.format(axis=a) for a in axes]
        if "{matrix}" in self.name:
            return [self.name.format(matrix=a + b) for a in axes for b in "xyz"]
        if "{pair}" in self.name:  # an inclinometer's two channels still see all three components
            return [self.name.format(pair=a + b) for a in axes for b in "xyz" if a != b]
        return [self.name]

    @property
    def is_shape(self) -> bool:
        """Whether the effect stays nothing when only this is given."""
        return self.shape or self.default != 0

    @property
    def suffix(self) -> str:
        """What its name ends in, in files."""
        return f"_{self.unit}" if self.unit else ""

    @property
    def factor(self) -> float:
        """SI value of one ``unit``."""
        return PARAMETER_UNITS[self.unit].factor


@dataclass(frozen=True)
class PerTable:
    """Parameters whose names follow from the axes of a table: those of all tables together.

    Args:
        names: parameter names on one table.
        unit, plausible: as of a Parameter.
        order: names that come first, in this order.
    """

    names: Callable[[Table], Sequence[str]]
    unit: str
    plausible: tuple[float, float, float]
    order: Callable[[], Sequence[str]] = tuple

    def __get__(self, effect: object, cls: type) -> tuple[Parameter, ...]:
        return _on_all_tables(self, tuple(every_table()))


@lru_cache(maxsize=64)  # all tables, and those before a model brought its own
def _on_all_tables(each: PerTable, names: tuple[str, ...]) -> tuple[Parameter, ...]:
    found: dict[str, set[str]] = {name: set() for name in each.order()}
    for table in (find_table(name) for name in names):
        for name in each.names(table):
            found.setdefault(name, set()).add(table.name)
    return tuple(
        Parameter(name, each.unit, each.plausible, tables=frozenset(of))
        for name, of in found.items()
        if of
    )


@lru_cache(maxsize=512)
def by_name(parameters: tuple[Parameter, ...]) -> Mapping[str, Parameter]:
    """The parameter of each name on any sensor."""
    return {name: p for p in parameters for name in p.expand(tuple("xyza"))}
