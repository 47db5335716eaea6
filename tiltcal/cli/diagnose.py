"""``tiltcal diagnose``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.laboratory import simulator
from tiltcal.cli.options import DescribedBy, Json
from tiltcal.cli.output import print_json, progress_line, say
from tiltcal.cli.stage import table_in
from tiltcal.core.claimed_folder import claimed
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, write_json, write_text
from tiltcal.diagnosis.conclusions.finding import Diagnosis
from tiltcal.diagnosis.diagnose import diagnose as explain
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.report.diagnosis import write_diagnosis
from tiltcal.report.poses import poses_of


def diagnose(
    recordings: Annotated[
        tuple[Path, ...], Parameter("REC", help="Recordings of the same set-up.")
    ],
    /,
    *,
    scenario: DescribedBy,
    static: Annotated[
        Path | None, Parameter(help="Recording at rest to estimate the noise from.")
    ] = None,
    check: Annotated[
        bool, Parameter(help="Exit with status 1 unless the verdict is match.")
    ] = False,
    output: Annotated[Path | None, Parameter(alias="-o", help="Folder for the results.")] = None,
    as_json: Json = False,
) -> int:
    """Locate, name and model physics that the scenario leaves out.

    Writes diagnosis.json, amended.toml and report.html to the folder of -o.
    Several recordings of the same set-up are explained together. Data faults
    (time going back, repeated or frozen samples) are reported as findings.

      tiltcal diagnose run.csv --scenario bench.toml -o out
      tiltcal diagnose run.csv --scenario out/amended.toml --check
    """
    honest = honest_scenario(scenario)
    data = [read_recording(path) for path in recordings]
    at_rest = read_recording(static) if static else None
    with claimed(output):
        with progress_line() as progress:
            laboratory = simulator(progress)
            found = explain(honest, data, static=at_rest, laboratory=laboratory, progress=progress)
        if output:
            write_results(found, output, recordings, honest, data)
    if as_json:
        print_json(_as_json(found, recordings))
    else:
        say(f"{found.verdict}: {found.statement}")
    return 1 if check and found.verdict != "match" else 0


def honest_scenario(path: Path) -> Scenario:
    """Load a scenario without concealed truth.

    Raises:
        TiltcalError: its role is "concealed".
    """
    scenario = load_scenario(path)
    if scenario.role == "concealed":
        raise TiltcalError(
            f"scenario {path}",
            found='role = "concealed": it contains the truth',
            need="a scenario without the truth",
            do="give the scenario without its concealed effects",
        )
    return scenario


def write_results(
    found: Diagnosis,
    folder: Path,
    recordings: Sequence[Path],
    scenario: Scenario,
    data: Sequence[Recording],
) -> None:
    """Write the files of a diagnosis; diagnosis.json names the recordings, for `design --split`.

    Args:
        found: the answer; folder: of the files.
        recordings: their files; data: what they hold.
        scenario: that was diagnosed.
    """
    import tomli_w

    make_folder(folder)
    write_text(folder / "amended.toml", tomli_w.dumps(found.amended))
    poses = poses_of(data, scenario)
    names = ", ".join(path.name for path in recordings)
    write_diagnosis(found, folder / "report.html", names, poses, table_in(poses, scenario))
    write_json(folder / "diagnosis.json", _as_json(found, recordings))


def _as_json(found: Diagnosis, recordings: Sequence[Path]) -> dict[str, object]:
    return found.to_json() | {"recordings": [str(path.absolute()) for path in recordings]}
