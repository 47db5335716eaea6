"""The loop of diagnosing and recording: budget, log, resume, and a laboratory that fails."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.scenario_files import refusal
from tiltcal.core.errors import TiltcalError
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.investigation import investigate as room
from tiltcal.diagnosis.investigation.command import CommandLaboratory
from tiltcal.diagnosis.investigation.discriminating_blocks import BlockProposal, Pair
from tiltcal.diagnosis.investigation.investigate import InvestigationSetup, investigate
from tiltcal.diagnosis.investigation.next_block import Limits, NextBlock
from tiltcal.diagnosis.investigation.stored import read_investigation
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording
from tiltcal.setup.sequence import Step

PLACING: dict[str, Any] = {
    "schema": 1,
    "name": "loop",
    "site": {"gravity_m_s2": 9.8},
    "rig": {"table": "placing"},
    "sensor": [
        {
            "name": "accel",
            "kind": "accelerometer",
            "rate_hz": 25.0,
            "adjustable": ["bias", "scale", "cross_axis"],
        }
    ],
}
BLOCK = Block("rest", "rest for a while", (Step(action="rest", dwell_s=60),))


def silent(words: str) -> None:
    pass


def some_recording(reading: float = 0.0) -> Recording:
    time = np.arange(50) / 25
    return Recording.from_columns(
        time, {"table_outer_deg": 0 * time, "accel_x_m_s2": 0 * time + reading}, source="some"
    )


class Recorder:
    """Records nothing in particular, and counts."""

    def __init__(self, fails_at: int = 99) -> None:
        self.asked: list[str] = []
        self.fails_at = fails_at

    def record(self, sequence: Path, recording: Path) -> Recording:
        self.asked.append(sequence.name)
        if len(self.asked) == self.fails_at:
            raise TiltcalError("laboratory", found="smoke", need="none", do="open a window")
        made = some_recording(float(sequence.stem.split("_")[1]))
        write_recording(made, str(recording))
        return made


class Doctor:
    """Says what it was told to say, diagnosis after diagnosis."""

    def __init__(self, *verdicts: str) -> None:
        self.verdicts, self.asked = verdicts, [0]

    def __call__(self, files: Sequence[Path], folder: Path) -> None:
        assert all(path.exists() for path in files)
        self.asked.append(len(files))
        folder.mkdir(exist_ok=True)
        (folder / "amended.toml").write_text("schema = 1\n")
        verdict = self.verdicts[int(folder.name[-1])]
        answer = {"verdict": verdict, "statement": f"It is {verdict}.", "findings": []}
        (folder / "diagnosis.json").write_text(json.dumps(answer))


@pytest.fixture(autouse=True)
def _always_the_same_block(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = Pair("acc_K2", "acc_K3", 100.0, 1.0)
    plan = NextBlock(BlockProposal(BLOCK, 1.0, 0.9, (pair,)), "Rest.")
    monkeypatch.setattr(room, "next_block", lambda *_: plan)


def bench_of(folder: Path, doctor: Doctor, recorder: Recorder, **more: Any) -> InvestigationSetup:
    scenario: Scenario = parse_scenario(PLACING | more.pop("table", {}))
    return InvestigationSetup(
        scenario,
        folder,
        doctor,
        recorder,
        Limits(),
        more.get("blocks", 2),
        more.get("minutes", 10.0),
    )


def first_of(tmp_path: Path) -> str:
    path = tmp_path / "first.csv"
    write_recording(some_recording(), str(path))
    return str(path)


def test_it_stops_when_explained_and_the_log_tells_the_story(tmp_path: Path) -> None:
    recorder, doctor = Recorder(), Doctor("ambiguous", "explained")
    state = investigate(bench_of(tmp_path, doctor, recorder), [first_of(tmp_path)], silent)
    assert state.explained
    assert state.verdicts == ("ambiguous", "explained")
    assert doctor.asked == [0, 1, 2]
    assert recorder.asked == ["sequence_1.csv"]
    log = (tmp_path / "log.md").read_text()
    for words in (
        "**ambiguous**",
        "Recorded 'rest' as recording_1.csv (1.0 min",
        "probability 90 % to be explained then",
        "**explained**",
        "It is explained.",
    ):
        assert words in log
    assert read_investigation(tmp_path / "investigation.json") == state


def test_what_is_explained_at_once_costs_no_table_time(tmp_path: Path) -> None:
    recorder = Recorder()
    state = investigate(bench_of(tmp_path, Doctor("match"), recorder), [first_of(tmp_path)], silent)
    assert (state.explained, state.minutes, recorder.asked) == (True, 0.0, [])


def test_it_gives_up_after_so_many_blocks(tmp_path: Path) -> None:
    state = investigate(
        bench_of(tmp_path, Doctor(*["ambiguous"] * 3), Recorder()), [first_of(tmp_path)], silent
    )
    assert not state.explained
    assert len(state.entries) == 2
    assert "Not explained within 2 blocks" in state.statement


def test_it_does_not_overrun_its_budget(tmp_path: Path) -> None:
    recorder = Recorder()
    state = investigate(
        bench_of(tmp_path, Doctor(*["ambiguous"] * 3), recorder, minutes=1.5),
        [first_of(tmp_path)],
        silent,
    )
    assert len(recorder.asked) == 1
    assert state.minutes <= 1.5
    assert "budget of 1.5 min" in state.statement


def test_without_a_recording_the_scenarios_own_sequence_comes_first(tmp_path: Path) -> None:
    sequence = [{"action": "move", "outer_deg": 90.0, "dwell_s": 3.0}]
    doctor = Doctor("", "ambiguous", "explained")
    state = investigate(
        bench_of(tmp_path, doctor, Recorder(), table={"sequence": sequence}), [], silent
    )
    assert [e.block for e in state.entries] == ["first sequence", "rest"]
    assert state.verdicts == ("ambiguous", "explained")
    assert state.designed == 1
    assert "1,move,90" in (tmp_path / "sequence_1.csv").read_text()


def test_with_nothing_to_begin_with_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(TiltcalError, match="no recording given"):
        investigate(bench_of(tmp_path, Doctor("match"), Recorder()), [], silent)


def test_a_laboratory_that_fails_loses_nothing_and_the_rest_is_done_on_resuming(
    tmp_path: Path,
) -> None:
    first = first_of(tmp_path)
    with pytest.raises(TiltcalError, match="smoke"):
        investigate(
            bench_of(tmp_path, Doctor(*["ambiguous"] * 3), Recorder(fails_at=2)), [first], silent
        )
    kept = (tmp_path / "recording_1.csv").read_bytes()
    recorder, doctor = Recorder(), Doctor("ambiguous", "ambiguous", "explained")
    state = investigate(bench_of(tmp_path, doctor, recorder), [], silent, resume=True)
    assert recorder.asked == ["sequence_2.csv"]
    assert doctor.asked == [0, 3]
    assert state.verdicts == ("ambiguous", "ambiguous", "explained")
    assert (tmp_path / "recording_1.csv").read_bytes() == kept


class Copier(Recorder):
    """Returns what it recorded first."""

    def record(self, sequence: Path, recording: Path) -> Recording:
        super().record(sequence, recording)
        write_recording(some_recording(1.0), str(recording))
        return some_recording(1.0)


def test_a_laboratory_that_returns_what_it_returned_before_is_named(tmp_path: Path) -> None:
    doctor, lab = Doctor("ambiguous", "ambiguous", "ambiguous"), Copier()
    with pytest.raises(TiltcalError, match=r"the same readings as in recording_1.csv"):
        investigate(bench_of(tmp_path, doctor, lab), [first_of(tmp_path)], silent)
    kept = read_investigation(tmp_path / "investigation.json")
    assert [e.recording for e in kept.entries] == ["recording_1.csv"]


def test_a_finished_investigation_resumed_does_nothing_more(tmp_path: Path) -> None:
    state = investigate(
        bench_of(tmp_path, Doctor("ambiguous", "explained"), Recorder()),
        [first_of(tmp_path)],
        silent,
    )
    recorder, doctor = Recorder(), Doctor()
    assert investigate(bench_of(tmp_path, doctor, recorder), [], silent, resume=True) == state
    assert (recorder.asked, doctor.asked) == ([], [0])


def test_another_investigation_in_the_folder_is_not_overwritten(tmp_path: Path) -> None:
    first = first_of(tmp_path)
    investigate(bench_of(tmp_path, Doctor("match"), Recorder()), [first], silent)
    with pytest.raises(TiltcalError, match="--resume"):
        investigate(bench_of(tmp_path, Doctor("match"), Recorder()), [first], silent)
    with pytest.raises(TiltcalError, match="the same recordings"):
        investigate(
            bench_of(tmp_path, Doctor("match"), Recorder()), ["other.csv"], silent, resume=True
        )
    (tmp_path / "investigation.json").write_text("{}")
    with pytest.raises(TiltcalError, match="no key"):
        investigate(bench_of(tmp_path, Doctor("match"), Recorder()), [], silent, resume=True)


SCRIPT = """\
import sys, pathlib
{body}
"""


def script(tmp_path: Path, body: str) -> CommandLaboratory:
    path = tmp_path / "my lab.py"
    path.write_text(SCRIPT.format(body=body))
    return CommandLaboratory.parse(f"{sys.executable} '{path}'")


def test_a_command_gets_both_files_without_a_shell(tmp_path: Path) -> None:
    body = (
        "pathlib.Path(sys.argv[2]).write_text('# said: $HOME ; ' + sys.argv[1] +"
        " '\\ntime_s,accel_x_m_s2\\n0,1\\n1,2\\n')"
    )
    found = script(tmp_path, body).record(tmp_path / "a b.csv", tmp_path / "rec 1.csv")
    assert found.metadata["said"] == f"$HOME ; {tmp_path / 'a b.csv'}"
    assert (tmp_path / "rec 1.csv").exists()


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ("sys.exit('no power')", "exit status 1 (no power)"),
        ("sys.exit(3)", "exit status 3 (no message)"),
        ("pass", "no recording written"),
        ("pathlib.Path(sys.argv[2]).write_text('')", "no recording written"),
        ("pathlib.Path(sys.argv[2]).write_text('hello')", "column"),
    ],
)
def test_a_command_that_fails_or_writes_nothing_leaves_no_file(
    tmp_path: Path, body: str, found: str
) -> None:
    before = {*tmp_path.iterdir(), tmp_path / "my lab.py"}
    with pytest.raises(TiltcalError) as error:
        script(tmp_path, body).record(tmp_path / "s.csv", tmp_path / "r.csv")
    assert found in str(error.value)
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize("text", ["", "   ", "record 'half"])
def test_a_command_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(TiltcalError, match="--lab"):
        CommandLaboratory.parse(text)


def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TiltcalError, match="laboratory no-such-program: found no such file"):
        CommandLaboratory.parse("no-such-program --now").record(
            tmp_path / "s.csv", tmp_path / "r.csv"
        )


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["--block-min", "0"], "found 0"),
        (["--rate-deg-s", "-3"], "found -3"),
        (["--angles", "outer=9"], "--angles outer=9: found no AXIS=LOW:HIGH"),
        (["--angles", "outer=9:3"], "--angles outer=9:3: found no AXIS=LOW:HIGH"),
        (["no such.csv"], "no such file"),
    ],
)
def test_wrong_words_of_investigate_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], found: str
) -> None:
    import tomli_w

    (tmp_path / "loop.toml").write_text(tomli_w.dumps(PLACING))
    out = str(tmp_path / "out")
    (tmp_path / "out").mkdir()
    message = refusal(
        ["investigate", "--scenario", tmp_path / "loop.toml", "--lab", "true", "-o", out, *words],
        tmp_path,
        capsys,
    )
    assert found in message
