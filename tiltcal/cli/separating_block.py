"""``tiltcal design --split``: the block that separates the alternatives of a diagnosis."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tiltcal.api.diagnosing import honest_scenario
from tiltcal.api.table_scene import table_in
from tiltcal.cli.axis_limits import axis_limits
from tiltcal.cli.design_options import Separation, TableTime
from tiltcal.cli.output import paragraph, print_json, progress_line, say, tell
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, require_file, write_json, write_text
from tiltcal.core.read_back import read_toml
from tiltcal.core.tasks.engines import Engine
from tiltcal.diagnosis.investigation.investigate import AMENDED
from tiltcal.diagnosis.investigation.next_block import Limits, NextBlock, next_block
from tiltcal.diagnosis.investigation.stored import read_diagnosis
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.report.poses import Pose, poses_of_steps
from tiltcal.report.separating_block import write_separating_block
from tiltcal.setup.sequence_files import sequence_text
from tiltcal.setup.setup import Rig


def design_separating_block(
    split: Path,
    scenario_file: Path | None,
    wanted: Separation,
    table: TableTime,
    engine: Engine | None,
    output: Path | None,
    as_json: bool,
) -> int:
    """Propose the block that separates the alternatives of the diagnosis ``split``.

    Raises:
        TiltcalError: the scenario, the diagnosis or its recordings are missing.
    """
    described = wanted.diagnosed or scenario_file
    if described is None:
        raise TiltcalError(
            "command line of `tiltcal design`",
            found="--split without a scenario",
            need="the scenario that was diagnosed",
            do="add --scenario TOML",
        )
    scenario = honest_scenario(described)
    diagnosis = read_diagnosis(split)
    amended = require_file(split.with_name("amended.toml"), "amended scenario")
    data = [read_recording(p) for p in _recordings_of(diagnosis, split, wanted.recordings)]
    limits = Limits(
        table.budget_s / 60,
        table.rate_deg_s,
        table.dwell_s[0],
        axis_limits(table.angles),
        wanted.rate_mm_s,
    )
    with progress_line() as progress:
        amended_table = read_toml(amended, "amended scenario", AMENDED)
        plan = next_block(scenario, data, diagnosis, amended_table, limits, progress, engine)
    if output:
        _write(plan, scenario, make_folder(output))
    _show(plan, scenario.rig, output, as_json)
    return 0 if plan.proposal is not None else 1


def _write(plan: NextBlock, scenario: Scenario, folder: Path) -> None:
    write_json(folder / "next_block.json", plan.to_json())
    poses: list[Pose] = []
    if plan.proposal is not None:
        steps = plan.proposal.block.steps
        write_text(folder / "sequence.csv", sequence_text(steps, scenario.rig))
        poses = poses_of_steps(steps, scenario, "proposed block")
    table = table_in(poses, scenario)
    write_separating_block(plan, folder / "report.html", scenario, scenario.name, poses, table)


def _show(plan: NextBlock, rig: Rig, output: Path | None, as_json: bool) -> None:
    if as_json:
        print_json(plan.to_json())
        return
    if output:
        paragraph(plan.statement)
    else:
        tell(plan.statement)
    if plan.proposal is not None and not output:
        say(sequence_text(plan.proposal.block.steps, rig).rstrip("\n"))


def _recordings_of(diagnosis: dict[str, Any], path: Path, given: Sequence[Path]) -> list[Path]:
    """The recordings that were diagnosed: the given ones, or those the diagnosis names.

    Raises:
        TiltcalError: neither names any.
    """
    if given:
        return list(given)
    named = [Path(p) for p in diagnosis.get("recordings", [])]
    if not named:
        raise TiltcalError(
            f"diagnosis {path.name}",
            found="no recordings in it",
            need="those that were diagnosed",
            do="add --recordings REC ...",
        )
    return named
