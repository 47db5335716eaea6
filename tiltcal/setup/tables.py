"""The tables. Each is declared here once, next to its MJCF in ``models/``.

Everything that depends on the kind of a table follows from its axes: names of columns, angles that
turn a direction up, the axis that gravity loads, where axes may be out of square. An installed
package adds tables through the entry point group ``tiltcal.tables``.

The direction up in the body, at the nominal geometry, follows from the same axes.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.extensions import members
from tiltcal.core.frames import AXES
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.setup.chain import Chain, Link
from tiltcal.setup.trajectory import Drive, Jet

GROUP = "tiltcal.tables"
CHANNEL = "table_"
OWN_MODEL = "model-"  # begins the name of the table that a user's own model is
Axis = tuple[str, str]
"""Name of a table axis, and the coordinate axis it turns about when all angles are zero."""


@dataclass(frozen=True)
class Table:
    """A kind of table; R_table is the product of the rotations about its axes, in order.

    Args:
        name: as ``rig.table`` states it.
        axes: outermost first; empty: the instrument is hand-held.
        model: its MJCF; None: ``<name>.xml`` among the models of this installation.
        chain: where the axes stand to each other, of a user's own model; None: all angles zero, the
            axes meet in one point along coordinate axes.
    """

    name: str
    axes: tuple[Axis, ...]
    model: Path | None = None
    chain: Chain | None = None

    @classmethod
    def of_model(cls, chain: Chain) -> "Table":
        """The table that a user's own model is; its name is a digest of its links."""
        digest = hashlib.sha256(chain.model_dump_json().encode()).hexdigest()[:8]
        return cls(f"{OWN_MODEL}{digest}", tuple((a, "z") for a in chain.links), None, chain)

    @property
    def mjcf(self) -> Path:
        """The file of its MuJoCo model."""
        return self.model or folder("models") / f"{self.name}.xml"

    @cached_property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, outermost first."""
        return tuple(name for name, _ in self.axes)

    @cached_property
    def directions(self) -> tuple[str, ...]:
        """Coordinate axis of each axis, outermost first."""
        return tuple(direction for _, direction in self.axes)

    @cached_property
    def sliding(self) -> frozenset[str]:
        """Names of the axes that slide: their readout is a length."""
        links = () if self.chain is None else self.chain.link
        return frozenset(link.axis for link in links if link.slides)

    @cached_property
    def turning(self) -> tuple[str, ...]:
        """Names of the axes that turn, outermost first."""
        return tuple(name for name in self.axis_names if name not in self.sliding)

    def unit(self, axis: str) -> str:
        """The unit in which the readout of an axis is written: deg, or mm where it slides."""
        return "mm" if axis in self.sliding else "deg"

    def key(self, axis: str) -> str:
        """Key of the position of an axis in a sequence."""
        return f"{axis}_{self.unit(axis)}"

    def size(self, axis: str) -> float:
        """One ``unit`` of an axis, rad or m."""
        return COLUMN_UNITS[self.unit(axis)].factor

    def columns(self, readout: Mapping[str, Array]) -> dict[str, Array]:
        """Columns ``table_<axis>_<unit>`` of a readout by axis, rad or m, (n,) each."""
        return {
            f"{angle_channel(name)}_{self.unit(name)}": position / self.size(name)
            for name, position in readout.items()
        }

    @cached_property
    def slots(self) -> tuple[str, ...]:
        """Frames that an effect may turn or displace, outermost first: of a user's own model the
        links behind their joints too.
        """
        if self.chain is None:
            return ("base", *(bearing(name) for name in self.axis_names), "mount")
        links = (slot for name in self.axis_names for slot in (bearing(name), name))
        return ("base", *links, "mount")

    @cached_property
    def moving(self) -> tuple[Axis, ...]:
        """The axes that move the instrument, outermost first."""
        if self.chain is None:
            return self.axes
        return tuple(axis for axis in self.axes if axis[0] in self.chain.path)

    @cached_property
    def tilting(self) -> tuple[str, ...]:
        """Names of the axes that change the direction of gravity in the body frame."""
        if self.chain is not None:
            return tuple(n for n in self.chain.path if n not in self.chain.upright)
        upright = self.directions[:1] == ("z",)
        return self.axis_names[1:] if upright else self.axis_names

    @cached_property
    def loaded(self) -> str | None:
        """Name of the outermost axis that does not turn about the vertical: gravity loads it."""
        if self.chain is not None:
            return next(iter(self.tilting), None)
        return next((name for name, direction in self.axes if direction != "z"), None)

    @cached_property
    def pointing(self) -> tuple[Axis, Axis] | None:
        """The two axes that turn any body direction up: the loaded one, and the next across it;
        None where there are no such two, or they do not meet.
        """
        if self.chain is not None:
            return None
        inward = [pair for pair in pairwise(self.axes) if pair[0][0] == self.loaded]
        return next((pair for pair in inward if pair[0][1] != pair[1][1]), None)

    @cached_property
    def joints(self) -> tuple[tuple[str, str, str], ...]:
        """(outer axis, next axis, coordinate axis perpendicular to both) of successive axes that
        should be square to each other.
        """
        if self.chain is not None:
            return ()
        return tuple(
            (a, b, ("xyz".replace(i, "").replace(j, "")))
            for (a, i), (b, j) in pairwise(self.axes)
            if i != j
        )


VERTICAL = Table("vertical", (("outer", "z"),))
PLACING = Table("placing", (("outer", "y"),))
DUAL = Table("dual", (("outer", "x"), ("inner", "z")))
THREE = Table("three", (("outer", "z"), ("middle", "y"), ("inner", "x")))
FOUR = Table("four", (*THREE.axes, ("head", "z")))
HANDHELD = Table("handheld", ())
BUILT_IN = {table.name: table for table in (VERTICAL, PLACING, DUAL, THREE, FOUR, HANDHELD)}
FILE_AXES = THREE.axis_names
"""Axes that every sequence file has a column for, whether its table has them or not."""


_OF_MODELS: dict[str, Table] = {}


def add_model(chain: Chain) -> Table:
    """The table of a user's own model, known by its name from now on."""
    table = Table.of_model(chain)
    return _OF_MODELS.setdefault(table.name, table)


def add_axes(axes: Iterable[tuple[str, str]]) -> None:
    """Make axes known by name and unit of their readout, deg or mm: those of a table of which
    nothing else is known.
    """
    links = tuple(Link(axis=axis, slides=unit == "mm") for axis, unit in axes)
    if any(link.slides or link.axis not in built_in_axes() for link in links):
        add_model(Chain(link=links))


def every_table() -> Mapping[str, Table]:
    """All tables by name, and those of the models that scenarios brought.

    Raises:
        TiltcalError: as ``tables`` does.
    """
    return {**tables(), **_OF_MODELS}


@cache
def tables() -> Mapping[str, Table]:
    """All tables by name: the built-in ones, then those of installed packages.

    Raises:
        TiltcalError: an entry point names no table, or a table whose name is taken.
    """
    found = dict(BUILT_IN)
    brought = members(
        GROUP,
        lambda item: isinstance(item, Table),
        "a tiltcal.setup.tables.Table",
        lambda module: [item for item in vars(module).values() if isinstance(item, Table)],
    )
    for subject, table in brought:
        if table.name in found:
            raise TiltcalError(
                subject,
                found=f"table '{table.name}', which exists already",
                need="a name of its own",
                do="rename it",
            )
        distinct = len(set(table.axis_names)) == len(table.axes)
        if not distinct or not set(table.directions) <= set(AXES):
            raise TiltcalError(
                subject,
                found=f"table '{table.name}' with axes {', '.join(map(' '.join, table.axes))}",
                need="a name of its own for each axis, and x, y or z that it turns about",
                do="correct the declaration",
            )
        found[table.name] = table
    return found


def find_table(name: str) -> Table:
    """The table of that name; installed packages are asked when no built-in table has it.

    Raises:
        KeyError: there is none.
    """
    return BUILT_IN[name] if name in BUILT_IN else every_table()[name]


def built_in_axes() -> tuple[str, ...]:
    """Names of the axes of the built-in tables, those of the table with most axes first."""
    longest = sorted(BUILT_IN.values(), key=lambda table: -len(table.axes))
    return tuple(dict.fromkeys(name for table in longest for name in table.axis_names))


def axis_names() -> tuple[str, ...]:
    """Names of the axes of all tables, those of the built-in ones first."""
    others = (name for table in every_table().values() for name in table.axis_names)
    return tuple(dict.fromkeys((*built_in_axes(), *others)))


def bearing(axis: str) -> str:
    """The frame on the stator side of an axis."""
    return f"{axis}_bearing"


def angle_key(axis: str) -> str:
    """Key of an axis' angle in a sequence."""
    return f"{axis}_deg"


def length_key(axis: str) -> str:
    """Key of the position of an axis that slides, in a sequence."""
    return f"{axis}_mm"


def angle_channel(axis: str, suffix: str = "") -> str:
    """Channel of an axis' readout in a recording, without its unit."""
    return f"{CHANNEL}{axis}{suffix}"


def axis_of(channel: str) -> str | None:
    """The axis whose readout a channel is; None where it is none."""
    return channel.removeprefix(CHANNEL) if channel.startswith(CHANNEL) else None


def up_in_body(
    moving: Sequence[tuple[str, str]],
    chain: Chain | None,
    axes: Mapping[str, Jet],
    drive: Drive,
) -> Array:
    """The unit vector up in the body, (n, 3).

    Args:
        moving: axes that move the instrument with the coordinate axis that each turns about or
            slides along, outermost first.
        chain: the links of a user's own model; None on a table.
        axes: angles, rad, and positions, m.
        drive: has the mountings.
    """
    up = np.zeros((len(drive.time), 3))
    up[:, 2] = 1.0
    for name, axis in moving:
        if chain is not None:
            up = up @ chain.links[name].R
            if chain.links[name].slides:
                continue
        i = "xyz".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        c, s = axes[name].cos_sin
        up[:, j], up[:, k] = c * up[:, j] + s * up[:, k], c * up[:, k] - s * up[:, j]
    if chain is not None:
        up = up @ chain.instrument.R
    starts = [row for row, _ in drive.mounts]
    for row, (_, R) in zip(starts, drive.mounts, strict=True):
        end = min((r for r in starts if r > row), default=len(up))
        up[row:end] = up[row:end] @ R
    return up
