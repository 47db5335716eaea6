"""``tiltcal investigate``, ``lab`` and what ``design --split`` does."""

import argparse
import json
import sys
import tomllib
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tiltcal.cli.diagnosing import honest_scenario, write_answer
from tiltcal.cli.laboratory import simulator
from tiltcal.cli.output import print_json, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, require_file, write_json, write_text
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.investigation.command import CommandLaboratory
from tiltcal.diagnosis.investigation.investigate import InvestigationSetup, investigate
from tiltcal.diagnosis.investigation.next_block import Limits, NextBlock, next_block
from tiltcal.diagnosis.investigation.progress_log import Investigation
from tiltcal.effects import to_file
from tiltcal.laboratory.scenario import fresh, load_scenario
from tiltcal.laboratory.scenario_tables import EffectTable
from tiltcal.recordings.recording_files import read_recording, write_recording
from tiltcal.setup.sequence_files import read_sequence, sequence_text


def investigate_(args: argparse.Namespace) -> int:
    """Diagnose, record what splits the rivals, diagnose again."""
    scenario = honest_scenario(args.scenario)
    laboratory = CommandLaboratory.parse(args.lab)
    for path in args.recording:
        require_file(Path(path), "recording")
    folder = make_folder(Path(args.output))
    with progress_line() as progress:

        def explain(files: Sequence[Path], place: Path) -> None:
            recordings = [read_recording(path) for path in files]
            found = diagnose(
                scenario, recordings, laboratory=simulator(progress), progress=progress
            )
            write_answer(found, place, [str(path) for path in files])

        bench = InvestigationSetup(
            scenario, folder, explain, laboratory, limits_of(args), args.blocks, args.budget_min
        )
        state = investigate(
            bench, [str(Path(p).absolute()) for p in args.recording], progress, args.resume
        )
    _show(state, args)
    return 0 if state.explained else 1


def _show(state: Investigation, args: argparse.Namespace) -> None:
    if args.json:
        print_json(state.to_json())
        return
    for entry in state.entries:
        print(f"recorded {entry.recording}: {entry.block}, {entry.minutes:.1f} min of table time")
    print(f"{state.verdicts[-1]}: {state.statement}")
    print(f"{args.output}/log.md", file=sys.stderr)


def limits_of(args: argparse.Namespace) -> Limits:
    """Limits of a block from the command line.

    Raises:
        TiltcalError: a limit is no such thing.
    """
    for name in ("block_min", "rate_deg_s", "dwell_s"):
        if not getattr(args, name) > 0:
            raise TiltcalError(
                f"--{name.replace('_', '-')}",
                found=f"{getattr(args, name):g}",
                need="more than 0",
                do="correct it",
            )
    return Limits(
        args.block_min, args.rate_deg_s, args.dwell_s, dict(_range(text) for text in args.angles)
    )


def _range(text: str) -> tuple[str, tuple[float, float]]:
    axis, _, span = text.partition("=")
    low, _, high = span.partition(":")
    try:
        found = (float(low), float(high))
    except ValueError:
        found = (0.0, 0.0)
    if not axis or not found[0] < found[1]:
        raise TiltcalError(
            "--angles",
            found=f"'{text}'",
            need="AXIS=LOW:HIGH in deg, such as outer=-45:45",
            do="correct it",
        )
    return axis, found


def split(args: argparse.Namespace) -> int:
    """Propose the block that tells the rivals of a diagnosis apart."""
    told = args.diagnosed or args.scenario
    if told is None:
        raise TiltcalError(
            "command line of `tiltcal design`",
            found="--split without a scenario",
            need="the scenario that was diagnosed",
            do="add --scenario TOML",
        )
    scenario = honest_scenario(told)
    path = require_file(Path(args.split), "diagnosis")
    diagnosis = _table(path)
    amended = require_file(path.with_name("amended.toml"), "amended scenario")
    recordings = [read_recording(p) for p in _recordings_of(diagnosis, path, args.recordings)]
    with progress_line() as progress:
        table = tomllib.loads(amended.read_text(encoding="utf-8"))
        limits = Limits(
            args.budget / 60,
            args.rate_deg_s,
            args.dwell_s[0],
            dict(_range(text) for text in args.angles),
        )
        plan = next_block(scenario, recordings, diagnosis, table, limits, progress)
    if args.output:
        folder = make_folder(Path(args.output))
        write_json(folder / "next_block.json", plan.to_json())
        if plan.proposal is not None:
            write_text(
                folder / "sequence.csv", sequence_text(plan.proposal.block.steps, scenario.rig)
            )
    _show_plan(plan, scenario.rig, args)
    return 0 if plan.proposal is not None else 1


def _show_plan(plan: NextBlock, rig: Any, args: argparse.Namespace) -> None:
    if args.json:
        print_json(plan.to_json())
        return
    print(plan.statement, file=sys.stderr if not args.output else sys.stdout)
    if plan.proposal is not None and not args.output:
        print(sequence_text(plan.proposal.block.steps, rig), end="")


def _table(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        if {"verdict", "findings"} <= set(table):
            return dict(table)
        found = "no verdict and findings"
    except (ValueError, TypeError) as error:
        found = str(error)
    raise TiltcalError(
        f"diagnosis {path.name}",
        found=found,
        need="what `tiltcal diagnose -o` wrote",
        do="name that file",
    )


def _recordings_of(diagnosis: dict[str, Any], path: Path, given: Sequence[str]) -> list[Path]:
    """The recordings that were diagnosed: named, or those that the diagnosis names.

    Raises:
        TiltcalError: they are not known.
    """
    if given:
        return [Path(p) for p in given]
    named = [Path(p) for p in diagnosis.get("recordings", [])]
    if not named:
        raise TiltcalError(
            f"diagnosis {path.name}",
            found="no recordings in it",
            need="those that were diagnosed",
            do="add --recordings REC ...",
        )
    return named


def lab(args: argparse.Namespace) -> int:
    """Record a sequence file with a scenario's effects: a laboratory for ``investigate``, through
    MuJoCo.
    """
    scenario = load_scenario(args.scenario)
    steps = read_sequence(args.sequence)
    seed = zlib.crc32(Path(args.sequence).read_bytes()) ^ (
        scenario.seed if args.seed is None else args.seed
    )
    events = [
        {**to_file(e), **({"seen_in": "another recording"} if "time" in e.values else {})}
        for e in scenario.effects
    ]
    effects = tuple(
        EffectTable.model_validate(e) for e in events
    )  # what the scenario's events did lies behind it
    again = fresh(scenario, sequence=steps, effect=effects, grade=None)
    with progress_line() as progress:
        recording = simulator(progress).record(again, seed)
    write_recording(recording, args.recording)
    return 0
