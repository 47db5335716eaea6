"""``tiltcal investigate``."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from tiltcal.api.diagnosing import explain, load_nominal_scenario, write_results
from tiltcal.api.table_scene import table_in
from tiltcal.cli.design_options import within_options
from tiltcal.cli.options import (
    WHOLE,
    AxisLimits,
    DescribedBy,
    EngineName,
    Jobs,
    Json,
    StartAngles,
)
from tiltcal.cli.output import paragraph, print_json, print_note, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import claimed, require_file
from tiltcal.core.progress import Progress
from tiltcal.core.tasks.engines import shared_engine
from tiltcal.design.recording_blocks import RATE, SLIDE_RATE
from tiltcal.diagnosis.investigation.command import CommandLaboratory
from tiltcal.diagnosis.investigation.investigate import InvestigationSetup
from tiltcal.diagnosis.investigation.investigate import (
    investigate as run_investigation,
)
from tiltcal.diagnosis.investigation.next_block import Limits
from tiltcal.diagnosis.investigation.progress_log import Investigation
from tiltcal.diagnosis.investigation.stored import read_diagnosis
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.report.investigation import write_investigation
from tiltcal.report.poses import poses_of


@dataclass(frozen=True)
class BlockLimits:
    """Limits of one designed block of measurements."""

    block_min: Annotated[float, Parameter(help="Longest table time of one block, min.")] = 3.0
    rate_deg_s: Annotated[float, Parameter(help="Largest rate: that of moves.")] = RATE
    rate_mm_s: Annotated[float, Parameter(help="The same of axes that slide.")] = SLIDE_RATE
    dwell_s: Annotated[float, Parameter(help="Duration of each dwell.")] = 3.0
    angles: AxisLimits = ()
    start: StartAngles = ()


DEFAULT_LIMITS = BlockLimits()


def investigate(
    recordings: Annotated[
        tuple[Path, ...],
        Parameter(
            "REC", help="Recordings so far; without any, the scenario's sequence is recorded."
        ),
    ] = (),
    /,
    *,
    scenario: DescribedBy,
    lab: Annotated[str, Parameter(help="Command that records a sequence.")],
    blocks: Annotated[int, WHOLE, Parameter(help="Largest number of designed blocks.")] = 2,
    budget_min: Annotated[float, Parameter(help="Table time of all blocks, min.")] = 10.0,
    resume: Annotated[
        bool, Parameter(help="Continue from the state of the folder; nothing is recorded twice.")
    ] = False,
    limits: Annotated[
        BlockLimits, Parameter(name="*", group=Group("Limits of a block", sort_key=1))
    ] = DEFAULT_LIMITS,
    output: Annotated[Path, Parameter(alias="-o", help="Folder for all files.")] = Path(
        "investigation"
    ),
    jobs: Jobs = 1,
    engine: EngineName = "processes",
    as_json: Json = False,
) -> int:
    """Diagnose, record what separates the alternatives, and repeat until explained.

    The command of --lab is called as `LAB SEQUENCE.csv RECORDING.csv`, without a
    shell. It drives a real table or a simulated one. The folder of -o keeps
    log.md, investigation.json, report.html, sequences, recordings and diagnoses.

      tiltcal investigate first.csv --scenario bench.toml --lab './record -t 2'
      tiltcal investigate --scenario bench.toml --lab 'tiltcal lab concealed.toml'

    Exit status: 0 explained; 1 not explained within the budget, or not within
    reach of this table; 2 unusable input.
    """
    known = load_nominal_scenario(scenario)
    nominal = within_options(known, limits.angles, limits.start)
    laboratory = CommandLaboratory.parse(lab)
    given = [str(require_file(path, "recording").absolute()) for path in recordings]
    opened = shared_engine(engine, jobs)
    with claimed(output), progress_line() as progress, opened as judging:
        bench = InvestigationSetup(
            nominal,
            output,
            _explainer(nominal, progress),
            laboratory,
            block_limits(limits),
            blocks,
            budget_min,
            judging,
        )
        state = run_investigation(bench, given, progress, resume)
        _report(state, nominal, output)
    _show(state, output, as_json)
    return 0 if state.explained else 1


def _explainer(scenario: Scenario, progress: Progress) -> Callable[[Sequence[Path], Path], None]:
    """A function that diagnoses recordings and writes the results to a folder."""

    def diagnose_files(files: Sequence[Path], folder: Path) -> None:
        data = [read_recording(path) for path in files]
        found = explain(scenario, data, progress=progress)
        write_results(found, folder, scenario, data, files)

    return diagnose_files


def _report(state: Investigation, scenario: Scenario, folder: Path) -> None:
    """Write report.html of an investigation."""
    files = [*map(Path, state.given), *(folder / e.recording for e in state.entries)]
    poses = poses_of([read_recording(path) for path in files], scenario)
    numbers = range(0 if state.given else 1, len(state.entries) + 1)
    answers = [read_diagnosis(folder / f"diagnosis_{k}" / "diagnosis.json") for k in numbers]
    table = table_in(poses, scenario)
    write_investigation(state, answers, folder / "report.html", poses, table)


def _show(state: Investigation, output: Path, as_json: bool) -> None:
    if as_json:
        print_json(state.to_json())
        return
    for entry in state.entries:
        paragraph(
            f"recorded {entry.recording}: {entry.block}, {entry.minutes:.1f} min of table time"
        )
    paragraph(f"{state.verdicts[-1]}: {state.statement}")
    print_note(f"{output}/log.md")
    print_note(f"{output}/report.html")


def block_limits(given: BlockLimits) -> Limits:
    """Limits of a block from the command line.

    Raises:
        TiltcalError: a limit is not positive.
    """
    sizes = {
        "--block-min": given.block_min,
        "--rate-deg-s": given.rate_deg_s,
        "--rate-mm-s": given.rate_mm_s,
        "--dwell-s": given.dwell_s,
    }
    for name, size in sizes.items():
        if not size > 0:
            raise TiltcalError(name, found=f"{size:g}", need="more than 0", do="correct it")
    return Limits(
        given.block_min,
        given.rate_deg_s,
        given.dwell_s,
        slide_rate=given.rate_mm_s,
    )
