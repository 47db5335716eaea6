"""Judging blocks in other processes, which work out the questions again from what was told."""

from collections.abc import Mapping, Sequence
from typing import Any

from tiltcal.core.progress import Part
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.tasks.run_tasks import values_of
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.investigation.discriminating_blocks import Judge, Pair, judged_in_turn
from tiltcal.diagnosis.investigation.rival_hypotheses import Question, questions
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording


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

    def judge(blocks: Sequence[Block], part: Part) -> list[list[Pair]]:
        shares = [blocks[k :: engine.slots] for k in range(min(engine.slots, len(blocks)))]
        found = values_of(_judged_apart, [(*told, share) for share in shares], engine, part)
        by_name = {
            block.name: pairs
            for share, judged in zip(shares, found, strict=True)
            for block, pairs in zip(share, judged, strict=True)
        }
        return [by_name[block.name] for block in blocks]

    return judge


def _judged_apart(
    scenario: Scenario,
    recordings: Sequence[Recording],
    diagnosis: Mapping[str, Any],
    amended: Mapping[str, Any],
    blocks: Sequence[Block],
) -> list[list[Pair]]:
    """What blocks would tell, in a process that has nothing but the files' content."""
    asked = open_questions(scenario, recordings, diagnosis, amended)
    return judged_in_turn(blocks, asked, scenario)
