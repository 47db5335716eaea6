"""The laboratory behind a command: it does what a sequence file says, and refuses what it cannot
do.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.test_sequence_files import HEAD
from tiltcal.recordings.recording_files import read_recording

TESTS = Path(__file__).parent


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Numbers of a draw that holds something."""
    sys.path.insert(0, str(TESTS))
    try:
        from blind.lab import Blindfolded, drawn
    finally:
        sys.path.remove(str(TESTS))
    k = next(k for k in range(100) if drawn("placing_sweep", [3, k], Blindfolded) is not None)
    path = tmp_path_factory.mktemp("case") / "case.json"
    path.write_text(json.dumps({"kind": "placing_sweep", "key": [3, k]}))
    return path


def recorded(case: Path, tmp_path: Path, text: str) -> "subprocess.CompletedProcess[str]":
    (tmp_path / "s.csv").write_text(HEAD + text)
    words = [
        sys.executable,
        "-m",
        "blind.lab",
        str(case),
        str(tmp_path / "s.csv"),
        str(tmp_path / "r.csv"),
    ]
    return subprocess.run(
        words, env={"PYTHONPATH": str(TESTS)}, capture_output=True, text=True, check=False
    )


def test_it_goes_where_it_is_told_and_writes_the_mounting_down(case: Path, tmp_path: Path) -> None:
    done = recorded(
        case,
        tmp_path,
        "1,remount,,,,,,Rz(180),\n2,move,30,,,20,4,,\n3,rest,,,,,3,,\n4,turn,390,,,40,4,,\n",
    )
    assert done.returncode == 0, done.stderr
    recording = read_recording(tmp_path / "r.csv")
    assert recording.metadata["mount"] == "Rz(180)"
    outer = np.degrees(np.asarray(recording.table("outer")))
    assert outer[-1] == pytest.approx(390, abs=1e-3)
    assert (np.abs(outer - 30) < 1e-3).sum() > 6.5 * 25


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,swing,30,,,20,4,,\n", "action swing"),
        (
            "1,move,30,,,20,4,,\n2,remount,,,,,,Rz(180),\n3,move,60,,,20,4,,\n",
            "remounts before a recording only",
        ),
    ],
)
def test_what_it_cannot_do_is_refused_and_nothing_written(
    case: Path, tmp_path: Path, text: str, said: str
) -> None:
    done = recorded(case, tmp_path, text)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "r.csv").exists()
