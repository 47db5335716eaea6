"""Blocks of a sequence that separate hypotheses, and their description as text."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil

from tiltcal.setup.reach import ROUNDING
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.setup import Rig

DESCRIPTIONS = {
    "circle": "go once round with {axis}: whole circles separate what a part of one mixes",
    "along": "dwell at angles all along the range of {axis}",
    "reverse": "approach the same angles of {axis} from both sides",
    "tumble": "add poses all over the sphere, with two axes loaded at 45 deg among them",
    "flip": (
        "take the same body attitudes in both ways that the table can: table errors stay with the"
        " angles, sensor errors do not"
    ),
    "spin": "turn {axis} round at two rates, both ways",
    "ramp": "move {axis} over the same way at several rates, with sharp stops",
    "far": "dwell long at the ends of the range of {axis}",
    "rest": "stand still for a while",
    "slow": "move {axis} slowly over its range",
    "repeat": "repeat the poses of the first recording in the opposite order",
    "remount": (
        "remount by {mount} and repeat the same angles: table errors stay with the angle, sensor"
        " errors go with the body"
    ),
}
"""What each block does, and why."""


def describe_block(kind: str, axis: str | None = None, mount: str = "180 deg") -> str:
    """The description of a kind of block; ``axis``: that it moves, any unless given."""
    return DESCRIPTIONS[kind].format(
        axis="an axis" if axis is None else f"the {axis} axis", mount=mount
    )


# s, deg/s, mm/s, unless the user gives others
DWELL, RATE, SLIDE_RATE = 3.0, 60.0, 50.0
REMOUNT = 60.0  # s of table time that a remounting takes
# s of dwell at both ends of a slow turn: noise at standstill follows from these
QUIET = 10.0
SLOW, SLOWEST = 60.0, 1 / 60  # s of a slow turn at most, part of the usual rate at least
MOUNTS = ("Rz(180)", "Rx(180)", "Rz(90)")
CIRCLE = (0.0, 360.0)  # deg, of an axis that may go round


@dataclass(frozen=True)
class TableLimits:
    """What a table may do.

    Args:
        rig: which table.
        reach: smallest and largest readout of each axis that may move, deg, or mm where it slides.
        rate: largest, deg/s: that of moves; slower ones are a half and a sixth of it.
        dwell: s.
        visited: readouts of the poses so far, outermost axis first, deg or mm.
        mounts: mountings that may be tried.
        slide_rate: as ``rate``, of axes that slide, mm/s.
    """

    rig: Rig
    reach: Mapping[str, tuple[float, float]]
    rate: float = RATE
    dwell: float = DWELL
    visited: tuple[tuple[float, ...], ...] = ()
    mounts: tuple[str, ...] = MOUNTS
    slide_rate: float = SLIDE_RATE

    def slides(self, axis: str) -> bool:
        """Whether an axis slides."""
        return axis in self.rig.kind.sliding

    @property
    def turning(self) -> list[str]:
        """The axes that turn, outermost first."""
        return [name for name in self.rig.kind.turning if name in self.reach]

    def rates(self, times: float = 1.0) -> dict[str, float]:
        """Rates of a step, so many times the usual ones."""
        return {"rate_deg_s": times * self.rate, "rate_mm_s": times * self.slide_rate}

    def moved(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Target of a step, by key of a sequence. positions: by axis, deg or mm."""
        return {self.rig.kind.key(axis): position for axis, position in positions.items()}

    def round_trip(self, axis: str) -> bool:
        """Whether an axis may go round."""
        low, high = self.reach[axis]
        return not self.slides(axis) and high - low >= 360 - 1e-9

    def grid(self, axis: str, step: float) -> list[float]:
        """Positions over the range of an axis, evenly spaced, at most ``step`` apart, deg: the
        whole range of one that slides counts as a circle.
        """
        low, high = self.reach[axis]
        span = CIRCLE[1] if self.slides(axis) else high - low
        n = max(1, ceil(span / step - 1e-9))
        return [low + (high - low) * k / n for k in range(n + 1)]


@dataclass(frozen=True)
class Block:
    """Something to record.

    Args:
        name: name in lists.
        description: what it does and why.
        steps: steps of a sequence.
    """

    name: str
    description: str
    steps: tuple[Step, ...]

    @property
    def remounts(self) -> int:
        """How often the instrument is remounted."""
        return sum(s.action == "remount" for s in self.steps)

    def seconds(self, rig: Rig) -> float:
        """Table time, remounting counted, s."""
        start, end = build_schedule(self.steps, rig).times
        return end - start + REMOUNT * self.remounts


def candidates(table: TableLimits) -> Iterator[Block]:
    """Every block that this table can run."""
    names = table.turning
    for axis in (name for name in table.rig.axis_names if name in table.reach):
        yield from _of_axis(table, axis)
    if len(names) > 1:
        yield Block("tumble", describe_block("tumble"), _poses(table, _spread(table)))
        yield Block("short tumble", describe_block("tumble"), _poses(table, _spread(table)[::2]))
    two = table.rig.kind.chain is None and table.rig.directions[1:] == ("z",)
    if two and all(table.round_trip(a) for a in names):
        pairs = [(a, b) for a in (30.0, 75.0, 120.0) for b in (0.0, 135.0)]
        poses = [pose for a, b in pairs for pose in ((a, b), (360 - a, b + 180))]
        yield Block("flip", describe_block("flip"), _poses(table, poses))
    if table.visited:
        every = table.rig.axis_names
        yield Block("repeat", describe_block("repeat"), _poses(table, table.visited[::-1], every))
    yield Block("rest", describe_block("rest"), (Step(action="rest", dwell_s=90.0),))
    for mount in table.mounts if names else ():
        steps = (Step(action="remount", mount=mount), *_poses(table, _spread(table)))
        yield Block(f"remount {mount}", describe_block("remount", mount=mount), steps)


def _of_axis(table: TableLimits, axis: str) -> Iterator[Block]:
    """Blocks that move one axis, the others where most is learned."""
    for others in _elsewhere(table, axis):
        at = table.moved(others)
        where = "".join(f" at {k} {v:g}" for k, v in others.items())
        low, high = table.reach[axis]

        def block(kind: str, moves: Sequence[tuple[float, float, float]], more: str = "") -> Block:
            go = [
                {**table.moved({axis: position}), **table.rates(times), "dwell_s": dwell}
                for position, times, dwell in moves
            ]
            go[0] |= at  # noqa: B023
            steps = tuple(Step.model_validate({"action": "move", **g}) for g in go)
            return Block(f"{kind}{more} {axis}{where}", describe_block(kind, axis), steps)  # noqa: B023

        dwell, up = table.dwell, table.grid(axis, 45.0)
        start, far = [(low, 1.0, dwell)], low + (high - low) / 4
        way = "along" if table.slides(axis) else "circle"
        yield block(way, [(a, 1.0, dwell) for a in table.grid(axis, 30.0)])
        yield block(way, [(a, 1.0, dwell) for a in table.grid(axis, 15.0)], " fine")
        yield block("reverse", [(a, 1.0, dwell) for a in (*up, *up[-2::-1])])
        if not table.slides(axis):
            yield block(
                "spin", [*start, *((a, k, dwell) for k in (1 / 2, 1.0) for a in (high, low))]
            )
        ramps = ((a, k, dwell) for k in (1 / 6, 1 / 2, 1.0) for a in (far, low))
        yield block("ramp", [*start, *ramps])
        yield block("far", [(a, 1.0, 25.0) for a in (low, (low + high) / 2, high)])
        rate = table.slide_rate if table.slides(axis) else table.rate
        slow = min(max((high - low) / SLOW, SLOWEST * rate) / rate, 1.0)
        yield block("slow", [(low, 1.0, QUIET), (high, slow, QUIET)])


def _elsewhere(table: TableLimits, axis: str) -> list[dict[str, float]]:
    """Where the other axes stand: as they are, and turned a quarter."""
    others = [n for n in table.rig.axis_names if n != axis and n in table.reach]
    if not others:
        return [{}]
    positions = []
    for share in (0.0, 0.25):
        positions.append(
            {n: table.reach[n][0] + share * (table.reach[n][1] - table.reach[n][0]) for n in others}
        )
    return positions


def _spread(table: TableLimits) -> list[tuple[float, ...]]:
    """Poses all over the reach, in an order of short moves that passes most angles from both sides,
    deg.
    """
    names = table.turning
    if len(names) == 1:
        grid = table.grid(names[0], 45.0)
        return [(a,) for a in (*grid, *grid[-2::-1])]
    outer, inner = table.grid(names[0], 60.0)[:-1], table.grid(names[-1], 90.0)[:-1]
    poses = []
    for k, a in enumerate(outer):
        for b in inner[k % 2 :: 2] if k % 4 < 2 else inner[k % 2 :: 2][::-1]:
            middle = [
                table.reach[name][0] + (k % 3) / 3 * (table.reach[name][1] - table.reach[name][0])
                for name in names[1:-1]
            ]
            poses.append((a, *middle, b + (15.0 if table.round_trip(names[-1]) else 0.0)))
    return poses


def _poses(
    table: TableLimits, poses: Sequence[Sequence[float]], axes: Sequence[str] = ()
) -> tuple[Step, ...]:
    """Moves to poses, with a dwell at each.

    Args:
        table: limits of the table.
        poses: readouts, deg or mm, one pose a row.
        axes: axes of these readouts; those that turn if not given.
    """
    names = axes or table.turning
    common = {"action": "move", "dwell_s": table.dwell, **table.rates()}
    return tuple(
        Step.model_validate({**common, **table.moved(dict(zip(names, pose, strict=True)))})
        for pose in poses
    )


def within(block: Block, table: TableLimits) -> bool:
    """Whether every position of a block is allowed."""
    for step in block.steps:
        for axis, position in (step.angles_deg | step.lengths_mm).items():
            for low, high in filter(None, (table.reach.get(axis), table.rig.reach.limits(axis))):
                if not low - ROUNDING <= position <= high + ROUNDING:
                    return False
    return True
