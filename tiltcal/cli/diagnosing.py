"""``tiltcal diagnose``."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from tiltcal.cli.laboratory import simulator
from tiltcal.cli.output import print_json, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, write_json, write_text
from tiltcal.diagnosis.conclusions.finding import Diagnosis
from tiltcal.diagnosis.diagnose import diagnose as explain
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.report.diagnosis import write_diagnosis


def diagnose(args: argparse.Namespace) -> int:
    """Explain recordings; write diagnosis.json, amended.toml and report.html."""
    scenario = honest_scenario(args.scenario)
    recordings = [read_recording(path) for path in args.recording]
    static = read_recording(args.static) if args.static else None
    with progress_line() as progress:
        found = explain(
            scenario, recordings, static=static, laboratory=simulator(progress), progress=progress
        )
    if args.output:
        write_answer(found, Path(args.output), args.recording)
    if args.json:
        print_json(_as_json(found, args.recording))
    else:
        print(f"{found.verdict}: {found.statement}")
    return 1 if args.check and found.verdict != "match" else 0


def honest_scenario(path: str) -> Scenario:
    """A scenario that holds no truth.

    Raises:
        TiltcalError: it does.
    """
    scenario = load_scenario(path)
    if scenario.role == "concealed":
        raise TiltcalError(
            f"scenario {path}",
            found='role = "concealed": it holds the truth',
            need="what an honest user knows",
            do="give the scenario without its concealed effects",
        )
    return scenario


def write_answer(found: Diagnosis, folder: Path, recordings: Sequence[str]) -> None:
    """The files of a diagnosis; it names its recordings, so that a design can go on from there."""
    import tomli_w

    make_folder(folder)
    write_text(folder / "amended.toml", tomli_w.dumps(found.amended))
    write_diagnosis(
        found, folder / "report.html", ", ".join(Path(path).name for path in recordings)
    )
    write_json(folder / "diagnosis.json", _as_json(found, recordings))


def _as_json(found: Diagnosis, recordings: Sequence[str]) -> dict[str, object]:
    return found.to_json() | {"recordings": [str(Path(path).absolute()) for path in recordings]}
