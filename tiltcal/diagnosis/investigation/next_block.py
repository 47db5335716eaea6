"""What to record next, in words and as a file.

Judging blocks in other processes, which work out the questions again from what was told.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Part, Progress
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.tasks.run_tasks import values_of
from tiltcal.design.identifiability import tie_breaker
from tiltcal.design.recording_blocks import (
    CIRCLE,
    RATE,
    SLIDE_RATE,
    Block,
    TableLimits,
    candidates,
    within,
)
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.investigation.discriminating_blocks import (
    BlockProposal,
    Design,
    Forecast,
    Judge,
    judged_in_turn,
    propose,
)
from tiltcal.diagnosis.investigation.rival_hypotheses import Question, questions
from tiltcal.effects import CATALOGUE
from tiltcal.laboratory.scenario import Scenario, narrowed
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import standstill_rows


def open_questions(
    scenario: Scenario,
    recordings: Sequence[Recording],
    diagnosis: Mapping[str, Any],
    amended: Mapping[str, Any],
) -> list[Question]:
    """What a block may be asked: findings with several names that a motion of the table bears on.

    Args:
        scenario: what is known.
        recordings: those that were diagnosed.
        diagnosis: of them; amended: the scenario with what it found.
    """
    found = questions(scenario, recordings, diagnosis, amended)
    return [q for q in found if len(q.rivals) > 1]


def judge_over(engine: Engine, told: tuple[Any, ...]) -> Judge:
    """Blocks are judged by an engine, an equal share in each of its processes.

    Args:
        engine: whose processes they are.
        told: the arguments of ``open_questions``; a question itself cannot go to another process.
    """

    def judge(blocks: Sequence[Block], draws: int, part: Part) -> list[Forecast]:
        shares = [blocks[k :: engine.slots] for k in range(min(engine.slots, len(blocks)))]
        found = values_of(_judged_apart, [(*told, share, draws) for share in shares], engine, part)
        by_name = {
            block.name: told
            for share, judged in zip(shares, found, strict=True)
            for block, told in zip(share, judged, strict=True)
        }
        return [by_name[block.name] for block in blocks]

    return judge


def _judged_apart(
    scenario: Scenario,
    recordings: Sequence[Recording],
    diagnosis: Mapping[str, Any],
    amended: Mapping[str, Any],
    blocks: Sequence[Block],
    draws: int,
) -> list[Forecast]:
    """What blocks would tell, in a process that has nothing but the files' content."""
    asked = open_questions(scenario, recordings, diagnosis, amended)
    return judged_in_turn(asked, scenario, blocks, draws)


THERMAL = {"temperature", "time"}
OPEN = {
    "cannot_tell": "The recording has no spare readings to test a model by",
    "unlisted": "No name fits what was recorded so far; see whether it keeps its form",
}
PERHAPS = "Perhaps no name fits what was recorded so far; see whether one still does in other poses"


@dataclass(frozen=True)
class Limits:
    """What the user allows.

    Args:
        minutes: of one block; rate: largest, deg/s; dwell: s; angles: (least, largest) of an axis,
            deg, or mm where it slides; slide_rate: mm/s of moves.
    """

    minutes: float = 3.0
    rate: float = RATE
    dwell: float = 3.0
    angles: Mapping[str, tuple[float, float]] | None = None
    slide_rate: float = SLIDE_RATE


@dataclass(frozen=True)
class NextBlock:
    """What to record, what it costs and what it should bring.

    Args:
        proposal: None where no block of this table can split anything.
        statement: in words; twins: pairs out of reach, with what would be needed.
        considered: every block that was compared, the best first.
    """

    proposal: BlockProposal | None
    statement: str
    twins: tuple[str, ...] = ()
    considered: tuple[BlockProposal, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        table: dict[str, Any] = {
            "schema": 1,
            "statement": self.statement,
            "out_of_reach": list(self.twins),
            "block": None,
        }
        if self.proposal is not None:
            p = self.proposal
            table |= {
                "block": p.block.name,
                "words": p.block.description,
                "minutes": p.minutes,
                "confidence": p.chance,
                "nc_per_minute": p.rate,
                "pairs": [
                    {
                        "truth": q.truth,
                        "rival": q.rival,
                        "separation": q.separation,
                        "power": q.chance,
                    }
                    for q in p.pairs
                ],
            }
        return table


def next_block(
    scenario: Scenario,
    recordings: Sequence[Recording],
    diagnosis: Mapping[str, Any],
    amended: Mapping[str, Any],
    limits: Limits,
    progress: Progress,
    engine: Engine | None = None,
    done: Collection[str] = (),
) -> NextBlock:
    """The block that tells the rivals of an ambiguous diagnosis apart.

    Args:
        scenario: what is known. recordings, diagnosis, amended: what was recorded, and what the
            diagnosis of it says.
        limits: what the user allows. progress: is told how many blocks are judged.
        engine: where blocks are judged; in this process if not given.
        done: names of blocks that were recorded: none is asked for twice.

    Raises:
        TiltcalError: nothing in the diagnosis is ambiguous.
    """
    scenario = narrowed(scenario, limits.angles or {})
    table = table_of(scenario, recordings, limits)
    verdict = diagnosis["verdict"]
    rivals = any(len({*f["class"]} - {UNLISTED}) > 1 for f in diagnosis["findings"])
    in_doubt = any(UNLISTED in f["class"] for f in diagnosis["findings"])
    why = OPEN.get(verdict, PERHAPS if in_doubt else "")
    if scenario.rig.axes and not rivals and why:
        return _more_poses(_blocks_of(table, done), table, scenario, why)
    if not (rivals or in_doubt):
        raise TiltcalError(
            "diagnosis",
            found=f"verdict {verdict}, nothing with more than one name",
            need="alternatives to separate",
            do="there is nothing to split",
        )
    if not scenario.rig.axes:
        return NextBlock(
            None,
            "No sequence file can state how to turn a hand-held instrument: " + _by_hand(diagnosis),
        )
    told = (scenario, recordings, diagnosis, amended)
    asked = open_questions(*told)
    if not asked:
        return NextBlock(
            None,
            "No motion of the table separates the alternatives. What does: " + _by_hand(diagnosis),
        )
    blocks = _blocks_of(table, done)
    judge = judge_over(engine, told) if engine else None
    design = propose(asked, blocks, scenario, limits.minutes, progress, judge)
    return NextBlock(design.best, _statement(design), _twins(design), design.proposals)


def table_of(scenario: Scenario, recordings: Sequence[Recording], limits: Limits) -> TableLimits:
    """What the table may do: the whole circle, unless the user, an inclinometer's range or the
    range of a joint of the user's own model says otherwise. An axis that slides goes as far as its
    joint or the user says, else as far as it has gone.

    Raises:
        TiltcalError: a limit names an axis that the table does not have.
    """
    rig = scenario.rig.narrowed(limits.angles or {}, {})
    stated = dict(rig.limits)
    flat = any(s.kind == "inclinometer" for s in scenario.sensor)
    reach = {}
    for name, turns_about in rig.axes:
        size, slides = rig.kind.size(name), name in rig.kind.sliding
        read = [a for r in recordings if (a := r.table(name)) is not None]
        seen = [a[~np.isnan(a)] / size for a in read]
        upright = turns_about == "z" and name == rig.axis_names[0]
        allowed = rig.reach.limits(name)
        span = allowed or (None if slides else CIRCLE)
        tipped = flat and not upright and not slides and name not in stated
        if seen and (span is None or tipped):
            lowest, highest = min(a.min() for a in seen), max(a.max() for a in seen)
            low, high = allowed or (-np.inf, np.inf)
            span = float(max(low, np.floor(lowest))), float(min(high, np.ceil(highest)))
        if slides and span is not None and span[0] == span[1]:
            span = None  # it never moved
        if span is not None:
            reach[name] = span
    visited = poses_of(recordings[0], scenario) if recordings else ()
    mounts = () if flat else TableLimits.mounts
    return TableLimits(rig, reach, limits.rate, limits.dwell, visited, mounts, limits.slide_rate)


def poses_of(recording: Recording, scenario: Scenario) -> tuple[tuple[float, ...], ...]:
    """Readouts of the dwells of a recording, in order, deg, or mm of axes that slide."""
    table = scenario.rig.kind
    columns = [recording.table(n) for n in table.axis_names]
    read = [c for c in columns if c is not None]
    if not read or len(read) < len(columns):
        return ()
    places = np.column_stack(read)
    there = ~np.isnan(places).any(axis=1)
    places, time = places[there], recording.time[there]
    rest = standstill_rows(time, places)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rest.astype(int), [0]])))
    sizes = np.array([table.size(n) for n in table.axis_names])
    middles = [
        np.median(places[a:b], axis=0) / sizes for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return tuple(tuple(round(float(x), 2) for x in m) for m in middles)


def _blocks_of(table: TableLimits, done: Collection[str]) -> list[Block]:
    """What a table can record within its limits but for what it has."""
    return [b for b in candidates(table) if b.name not in done and within(b, table)]


def _more_poses(
    blocks: Sequence[Block], table: TableLimits, scenario: Scenario, why: str
) -> NextBlock:
    """Something of everything, for want of rivals."""
    kind = "tumble" if len(table.turning) > 1 else "reverse"
    block = next((b for b in blocks if b.name.startswith(kind)), None)
    if block is None:
        return NextBlock(None, f"{why}: all poses that this table can add were recorded.")
    minutes = block.seconds(scenario.rig) / 60
    words = f"{why}: {block.description} ({minutes:.1f} min of table time)."
    return NextBlock(BlockProposal(block, minutes), words)


def _by_hand(diagnosis: Mapping[str, Any]) -> str:
    return (
        "; ".join(
            dict.fromkeys(
                f["next_measurement"] for f in diagnosis["findings"] if len(f["class"]) > 1
            )
        )
        + "."
    )


def _statement(design: Design) -> str:
    """What to record, and what it separates, in words."""
    best = design.best
    hardest = None if best is None else best.least
    if best is None or hardest is None:
        return "No block of this table can separate them: " + "; ".join(_twins(design)) + "."
    words = (
        f"Record the block '{best.block.name}' ({best.block.description}): {best.minutes:.1f} min"
        " of table time. The verdict should then be explained with probability"
        f" {100 * best.chance:.0f} %. The hardest pair, {hardest.truth} from {hardest.rival},"
        f" should be separated with probability {100 * hardest.chance:.0f} %."
    )
    return words + (
        ""
        if not design.twins
        else " Not separable on this table: " + "; ".join(_twins(design)) + "."
    )


def _twins(design: Design) -> tuple[str, ...]:
    """Pairs that no block can separate, each with what would be needed. Where only one of the two
    can take the other's place, the pair says which has to be the truth.
    """
    pairs = dict.fromkeys(tuple(sorted(p)) for p in design.twins)
    return tuple(f"{_pair(a, b, design)} ({_needs(a, b)})" for a, b in pairs)


def _pair(a: str, b: str, design: Design) -> str:
    if {(a, b), (b, a)} <= set(design.twins):
        return f"{a} and {b}"
    truth, other = (a, b) if (a, b) in design.twins else (b, a)
    return f"{truth}, if that is the truth, from {other}"


def _needs(a: str, b: str) -> str:
    follows = {CATALOGUE[x].needs for x in (a, b) if x in CATALOGUE}
    if follows & THERMAL:
        return (
            "it would take a course of temperature of its own, and no heater can be commanded: "
            + tie_breaker(a, b)
        )
    return tie_breaker(a, b)
