"""Diagnosing: the scenario without concealed truth, the answer of the search, its files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tiltcal.api.simulating import simulator
from tiltcal.api.table_scene import table_in
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder, write_json, write_text
from tiltcal.core.progress import Progress, silent
from tiltcal.diagnosis.conclusions import finding
from tiltcal.diagnosis.data_faults.long_recordings import LongRecording
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.recordings.recording import Recording, stem
from tiltcal.recordings.rig_fit import suspected_rig
from tiltcal.report.diagnosis import write_diagnosis
from tiltcal.report.poses import poses_of


@dataclass(frozen=True)
class Diagnosis(finding.Diagnosis):
    """A diagnosis that can be saved.

    Args:
        scenario: that was diagnosed.
        recordings: of it. The other fields are those of the answer.
    """

    scenario: Scenario | None = None
    recordings: tuple[Recording, ...] = ()

    def save(self, folder: Path | str) -> None:
        """Write diagnosis.json, amended.toml and report.html to a folder. The first names no files
        of recordings.

        Raises:
            TiltcalError: the folder cannot be written.
        """
        assert self.scenario is not None
        write_results(self, Path(folder), self.scenario, self.recordings)


def load_nominal_scenario(path: Path | str) -> Scenario:
    """Load a scenario without concealed truth.

    Raises:
        TiltcalError: its role is "concealed".
    """
    return require_no_truth(load_scenario(path), f"scenario {path}")


def require_no_truth(scenario: Scenario, subject: str) -> Scenario:
    """``scenario`` when it does not contain the truth.

    Raises:
        TiltcalError: its role is "concealed".
    """
    if scenario.role == "concealed":
        raise TiltcalError(
            subject,
            found='role = "concealed": it contains the truth',
            need="a scenario without the truth",
            do="give the scenario without its concealed effects",
        )
    return scenario


def explain(
    scenario: Scenario,
    recordings: Sequence[Recording | LongRecording],
    static: Recording | LongRecording | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Why these recordings differ from the scenario; the answer is re-simulated through MuJoCo.

    Args:
        scenario: what is known of the set-up.
        recordings: of one set-up, explained together.
        static: a record at standstill to estimate the noise from.
        progress: receives what is being done.

    Raises:
        TiltcalError: a column is missing, or nothing in a recording has a model.
    """
    laboratory = simulator(progress)
    found = diagnose(scenario, recordings, static=static, laboratory=laboratory, progress=progress)
    read = tuple(r.recording if isinstance(r, LongRecording) else r for r in recordings)
    if found.verdict in ("unlisted", "cannot_tell"):
        found = _with_suspicion(found, scenario, read)
    return Diagnosis(**vars(found), scenario=scenario, recordings=read)


def _with_suspicion(
    found: finding.Diagnosis, scenario: Scenario, recordings: Sequence[Recording]
) -> finding.Diagnosis:
    """A diagnosis whose statement begins with what is wrong with the stated table, if anything."""
    suspicions = dict.fromkeys(suspected_rig(recording, scenario) for recording in recordings)
    texts = [f"{text[0].upper()}{text[1:]}." for text in suspicions if text]
    return replace(found, statement=" ".join([*texts, found.statement])) if texts else found


def write_results(
    found: finding.Diagnosis,
    folder: Path,
    scenario: Scenario,
    recordings: Sequence[Recording],
    files: Sequence[Path] = (),
) -> None:
    """Write the files of a diagnosis.

    Args:
        found: the answer.
        folder: where its files go.
        scenario: that was diagnosed.
        recordings: of it.
        files: of the recordings, for `design --split`; none where they are not known.
    """
    import tomli_w

    make_folder(folder)
    write_text(folder / "amended.toml", tomli_w.dumps(found.amended))
    poses, names = poses_of(recordings, scenario), ", ".join(stem(r.source) for r in recordings)
    write_diagnosis(found, folder / "report.html", names, poses, table_in(poses, scenario))
    write_json(folder / "diagnosis.json", results_json(found, files))


def results_json(found: finding.Diagnosis, files: Sequence[Path]) -> dict[str, object]:
    """The table of diagnosis.json."""
    return found.to_json() | {"recordings": [str(path.absolute()) for path in files]}
