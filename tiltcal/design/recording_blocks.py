"""Blocks of a sequence that separate hypotheses, and their description in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil

from tiltcal.setup.schedule_builder import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import angle_key

WORDS = {
    "circle": "go once round with {axis}: whole circles separate what a part of one mixes",
    "reverse": "approach the same angles of {axis} from both sides",
    "tumble": "add poses all over the sphere, with two axes loaded at 45 deg among them",
    "flip": (
        "take the same body attitudes in both ways that the table can: table errors stay with the"
        " angles, sensor errors do not"
    ),
    "spin": "turn {axis} round at two rates, both ways",
    "ramp": "move {axis} over the same way at several rates, with sharp stops",
    "far": "dwell long at the ends of the range of {axis}",
    "rest": "rest for a while without moving",
    "slow": "turn {axis} slowly over its range",
    "repeat": "repeat the poses of the first recording in the opposite order",
    "remount": (
        "remount by {mount} and repeat the same angles: table errors stay with the angle, sensor"
        " errors go with the body"
    ),
}
"""What each block does, and why."""


def said(kind: str, axis: str | None = None, mount: str = "180 deg") -> str:
    """The description of a kind of block; ``axis``: that it moves, any unless given."""
    return WORDS[kind].format(axis="an axis" if axis is None else f"the {axis} axis", mount=mount)


DWELL, RATE = 3.0, 30.0  # s, deg/s, unless the user says otherwise
REMOUNT = 60.0  # s of table time that a remounting takes
# s at rest at both ends of a slow turn: a recording that hardly rests does not show what rest is
QUIET = 10.0
MOUNTS = ("Rz(180)", "Rx(180)", "Rz(90)")
CIRCLE = (0.0, 360.0)  # deg, of an axis that may go round


@dataclass(frozen=True)
class TableLimits:
    """What a table may do.

    Args:
        rig: which table.
        reach: smallest and largest angle of each axis, deg.
        rate: of moves, deg/s; slow and fast rates are a third and twice of it.
        dwell: s.
        visited: angles of the poses so far, outermost axis first, deg.
        mounts: mountings that may be tried.
    """

    rig: Rig
    reach: Mapping[str, tuple[float, float]]
    rate: float = RATE
    dwell: float = DWELL
    visited: tuple[tuple[float, ...], ...] = ()
    mounts: tuple[str, ...] = MOUNTS

    def round_trip(self, axis: str) -> bool:
        """Whether an axis may go round."""
        low, high = self.reach[axis]
        return high - low >= 360 - 1e-9

    def grid(self, axis: str, step: float) -> list[float]:
        """Angles over an axis' range, deg, evenly, at most ``step`` apart."""
        low, high = self.reach[axis]
        n = max(1, ceil((high - low) / step - 1e-9))
        return [low + (high - low) * k / n for k in range(n + 1)]


@dataclass(frozen=True)
class Block:
    """Something to record.

    Args:
        name: for lists; words: what it does and why; steps: in laboratory words.
    """

    name: str
    words: str
    steps: tuple[Step, ...]

    @property
    def remounts(self) -> int:
        """How often the instrument is remounted."""
        return sum(s.action == "remount" for s in self.steps)

    def seconds(self, rig: Rig) -> float:
        """Table time, remounting counted, s."""
        start, end = build_schedule(self.steps, rig).times
        return end - start + REMOUNT * self.remounts

    def __add__(self, other: "Block") -> "Block":
        return Block(
            f"{self.name} + {other.name}",
            f"{self.words}; then {other.words}",
            self.steps + other.steps,
        )


def candidates(table: TableLimits) -> Iterator[Block]:
    """Every block that this table can run."""
    names = table.rig.kind.turning
    for axis in names:
        yield from _of_axis(table, axis)
    if len(names) > 1:
        yield Block("tumble", said("tumble"), _poses(table, _spread(table)))
        yield Block("short tumble", said("tumble"), _poses(table, _spread(table)[::2]))
    two = table.rig.kind.chain is None and table.rig.directions[1:] == ("z",)
    if two and all(table.round_trip(a) for a in names):
        pairs = [(a, b) for a in (30.0, 75.0, 120.0) for b in (0.0, 135.0)]
        poses = [pose for a, b in pairs for pose in ((a, b), (360 - a, b + 180))]
        yield Block("flip", said("flip"), _poses(table, poses))
    if table.visited:
        yield Block("repeat", said("repeat"), _poses(table, table.visited[::-1]))
    yield Block("rest", said("rest"), (Step(action="rest", dwell_s=90.0),))
    for mount in table.mounts if names else ():
        steps = (Step(action="remount", mount=mount), *_poses(table, _spread(table)))
        yield Block(f"remount {mount}", said("remount", mount=mount), steps)


def _of_axis(table: TableLimits, axis: str) -> Iterator[Block]:
    """Blocks that move one axis, the others where they tell most."""
    for others in _elsewhere(table, axis):
        at = {angle_key(k): v for k, v in others.items()}
        where = "".join(f" at {k} {v:g}" for k, v in others.items())
        low, high = table.reach[axis]

        def block(kind: str, moves: Sequence[tuple[float, float, float]], more: str = "") -> Block:
            go = [
                {angle_key(axis): angle, "rate_deg_s": rate, "dwell_s": dwell}
                for angle, rate, dwell in moves
            ]
            go[0] |= at  # noqa: B023
            steps = tuple(Step.model_validate({"action": "move", **g}) for g in go)
            return Block(f"{kind}{more} {axis}{where}", said(kind, axis), steps)  # noqa: B023

        dwell, rate = table.dwell, table.rate
        yield block("circle", [(a, rate, dwell) for a in table.grid(axis, 30.0)])
        yield block("circle", [(a, rate, dwell) for a in table.grid(axis, 15.0)], " fine")
        up = table.grid(axis, 45.0)
        yield block("reverse", [(a, rate, dwell) for a in (*up, *up[-2::-1])])
        start = [(low, rate, dwell)]
        yield block(
            "spin", [*start, *((a, r, dwell) for r in (rate, 2 * rate) for a in (high, low))]
        )
        far = low + (high - low) / 4
        yield block(
            "ramp",
            [*start, *((a, r, dwell) for r in (rate / 3, rate, 2 * rate) for a in (far, low))],
        )
        yield block("far", [(a, rate, 25.0) for a in (low, (low + high) / 2, high)])
        yield block("slow", [(low, rate, QUIET), (high, max((high - low) / 60.0, 1.0), QUIET)])


def _elsewhere(table: TableLimits, axis: str) -> list[dict[str, float]]:
    """Where the other axes stand: as they are, and turned a quarter."""
    others = [n for n in table.rig.kind.turning if n != axis]
    if not others:
        return [{}]
    places = []
    for share in (0.0, 0.25):
        places.append(
            {n: table.reach[n][0] + share * (table.reach[n][1] - table.reach[n][0]) for n in others}
        )
    return places


def _spread(table: TableLimits) -> list[tuple[float, ...]]:
    """Poses all over the reach, in an order of short moves that passes most angles from both sides,
    deg.
    """
    names = table.rig.kind.turning
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


def _poses(table: TableLimits, poses: Sequence[Sequence[float]]) -> tuple[Step, ...]:
    """Moves to poses, with a dwell at each."""
    names = [angle_key(n) for n in table.rig.kind.turning]
    common = {"action": "move", "rate_deg_s": table.rate, "dwell_s": table.dwell}
    return tuple(
        Step.model_validate({**common, **dict(zip(names, pose, strict=True))}) for pose in poses
    )


def within(block: Block, table: TableLimits) -> bool:
    """Whether every angle of a block is allowed."""
    for step in block.steps:
        for axis, (low, high) in table.reach.items():
            angle = step.angles_deg.get(axis)
            if angle is not None and not low - 1e-9 <= angle <= high + 1e-9:
                return False
    return True
