"""The loop: diagnose, design the block that splits what is ambiguous, have it recorded, diagnose
together, until explained.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_json, write_text
from tiltcal.core.progress import Progress
from tiltcal.core.read_back import read_toml
from tiltcal.core.tasks.engines import Engine
from tiltcal.diagnosis.investigation.next_block import Limits, NextBlock, next_block
from tiltcal.diagnosis.investigation.progress_log import Entry, Investigation, log_of
from tiltcal.diagnosis.investigation.stored import read_diagnosis, read_investigation
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.setup.schedule import build_schedule, require_allowed
from tiltcal.setup.sequence import Step
from tiltcal.setup.sequence_files import sequence_text

Diagnose = Callable[[Sequence[Path], Path], None]
"""Diagnoses the recordings in some files and leaves diagnosis.json and amended.toml in a folder."""

AMENDED = "an amended.toml as `tiltcal diagnose -o` writes it"


class Recorder(Protocol):
    """Whoever records a sequence file."""

    def record(self, sequence: Path, recording: Path) -> Recording:
        """The recording, and its file."""


@dataclass(frozen=True)
class InvestigationSetup:
    """What an investigation works with.

    Args:
        scenario: what is known; folder: where everything is kept.
        diagnose: writes a diagnosis; laboratory: records.
        limits: of a block; blocks: at most; minutes: of table time for all of them.
        engine: where blocks are judged before one is recorded; in this process if not given.
    """

    scenario: Scenario
    folder: Path
    diagnose: Diagnose
    laboratory: Recorder
    limits: Limits
    blocks: int
    minutes: float
    engine: Engine | None = None


def investigate(
    at: InvestigationSetup, given: Sequence[str], progress: Progress, resume: bool = False
) -> Investigation:
    """Run until explained, or nothing more can be recorded; kept in the folder after every step.

    Raises:
        TiltcalError: an investigation is in the folder already, or the laboratory fails.
    """
    state = _begun(at, tuple(given), resume)
    if not state.given and not state.entries:
        state = _first(at, state, progress)
    while True:
        state = _diagnosed(at, state, progress)
        answer = _answer(at, len(state.entries))
        if state.explained:
            return _kept(at, replace(state, statement=answer["statement"]))
        if state.designed >= at.blocks:
            return _kept(
                at,
                replace(
                    state,
                    statement=f"Not explained within {_blocks(at.blocks)}. {answer['statement']}",
                ),
            )
        plan = _plan(at, state, answer, progress)
        if plan.proposal is None:
            return _kept(at, replace(state, statement=plan.statement))
        if state.minutes + plan.proposal.minutes > at.minutes:
            words = (
                f"The budget of {at.minutes:g} min does not allow another block. {plan.statement}"
            )
            return _kept(at, replace(state, statement=words))
        state = _recorded(at, state, plan, progress)


def _begun(at: InvestigationSetup, given: tuple[str, ...], resume: bool) -> Investigation:
    """A new investigation, or the one in the folder."""
    file = at.folder / "investigation.json"
    if not file.exists():
        return Investigation(given)
    if not resume:
        raise TiltcalError(
            f"output {at.folder}",
            found="an investigation",
            need="an empty folder",
            do="choose another, or go on with --resume",
        )
    state = read_investigation(file)
    if given and given != state.given:
        raise TiltcalError(
            f"output {at.folder}",
            found=f"an investigation of {', '.join(state.given) or 'no recordings'}",
            need="the same recordings",
            do="choose another folder, or leave the recordings out",
        )
    return replace(state, verdicts=state.verdicts[: len(state.entries) + 1])


def _kept(at: InvestigationSetup, state: Investigation) -> Investigation:
    """Written down."""
    write_json(at.folder / "investigation.json", state.to_json())
    write_text(at.folder / "log.md", log_of(state))
    return state


def _first(at: InvestigationSetup, state: Investigation, progress: Progress) -> Investigation:
    """With nothing recorded the scenario's own sequence comes first."""
    steps = at.scenario.sequence
    if not steps:
        raise TiltcalError(
            f"scenario {at.scenario.name}",
            found="no recording given and no [[sequence]]",
            need="something to begin with",
            do="give a recording, or a sequence to record first",
        )
    start, end = build_schedule(steps, at.scenario.rig).times
    return _run(
        at,
        state,
        steps,
        ("first sequence", "the scenario's own sequence", (end - start) / 60, 0.0),
        progress,
    )


def _recorded(
    at: InvestigationSetup, state: Investigation, plan: NextBlock, progress: Progress
) -> Investigation:
    """The state with one more block recorded."""
    assert plan.proposal is not None
    p = plan.proposal
    return _run(
        at, state, p.block.steps, (p.block.name, p.block.description, p.minutes, p.chance), progress
    )


def _run(
    at: InvestigationSetup,
    state: Investigation,
    steps: Sequence[Step],
    said: tuple[str, str, float, float],
    progress: Progress,
) -> Investigation:
    """Write the sequence, have it recorded, and keep both."""
    number = len(state.entries) + 1
    sequence, recording = (
        at.folder / f"sequence_{number}.csv",
        at.folder / f"recording_{number}.csv",
    )
    require_allowed(steps, at.scenario.rig)
    write_text(sequence, sequence_text(steps, at.scenario.rig))
    progress(f"recording {said[0]}")
    made = at.laboratory.record(sequence, recording)
    _require_new(made, _files(at, state))
    entry = Entry(*said, sequence.name, recording.name)
    return _kept(at, replace(state, entries=(*state.entries, entry)))


def _require_new(made: Recording, earlier: Sequence[Path]) -> None:
    """Refuse a recording that is there already.

    Raises:
        TiltcalError: it has the readings of an earlier one.
    """
    for path in earlier:
        if read_recording(path).fingerprint == made.fingerprint:
            raise TiltcalError(
                "laboratory (--lab)",
                found=f"the same readings as in {path.name}",
                need="a new recording of each sequence",
                do="see what the command writes to its second argument; nothing is lost, go on with"
                " --resume",
            )


def _diagnosed(at: InvestigationSetup, state: Investigation, progress: Progress) -> Investigation:
    """The state with a diagnosis of everything recorded so far; one that is there already is
    kept.
    """
    folder = at.folder / f"diagnosis_{len(state.entries)}"
    if not (folder / "diagnosis.json").exists():
        progress("diagnosing")
        at.diagnose(_files(at, state), folder)
    verdict = _answer(at, len(state.entries))["verdict"]
    known = state.verdicts[: state.designed]
    return _kept(at, replace(state, verdicts=(*known, verdict)))


def _files(at: InvestigationSetup, state: Investigation) -> list[Path]:
    """Of all recordings so far, in order."""
    return [*map(Path, state.given), *(at.folder / e.recording for e in state.entries)]


def _answer(at: InvestigationSetup, number: int) -> dict[str, Any]:
    return read_diagnosis(at.folder / f"diagnosis_{number}" / "diagnosis.json")


def _plan(
    at: InvestigationSetup, state: Investigation, answer: Mapping[str, Any], progress: Progress
) -> NextBlock:
    """What to record next, kept beside the diagnosis."""
    folder = at.folder / f"diagnosis_{len(state.entries)}"
    amended = read_toml(folder / "amended.toml", "amended scenario", AMENDED)
    recordings = [read_recording(path) for path in _files(at, state)]
    told = at.scenario, recordings, answer, amended
    done = [entry.block for entry in state.entries]
    plan = next_block(*told, at.limits, progress, at.engine, done)
    write_json(folder / "next_block.json", plan.to_json())
    return plan


def _blocks(count: int) -> str:
    return f"{count} block{'' if count == 1 else 's'}"
