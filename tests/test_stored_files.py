"""Files that are read back: each is checked by its schema. Faults while one is written leave the
earlier file whole.
"""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenario_files import refusal

from tiltcal.calibration.result import calibration_from
from tiltcal.cli import main
from tiltcal.core import files
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import TEMPORARY, replacing, write_json
from tiltcal.core.numerical import determining
from tiltcal.diagnosis.investigation.stored import read_diagnosis, read_investigation
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.saving import write_recording

BIAS = {"value": 0.1, "sigma": 0.01, "unit": "m_s2"}
CAL = {
    "method": "six_position",
    "verdict": "good",
    "parameters": {"accel.bias_x": BIAS, "accel.bias_y": BIAS},
    "covariance": {
        "names": ["accel.bias_y", "accel.bias_x"],
        "matrix": [[1e-4, 5e-5], [5e-5, 1e-4]],
    },
}


def covariance(matrix, names=("accel.bias_y", "accel.bias_x")):
    return CAL | {"covariance": {"names": list(names), "matrix": matrix}}


def test_a_sound_calibration_reads_and_so_does_a_singular_covariance():
    assert calibration_from(CAL).covariance[0, 1] == 5e-5
    flat = covariance([[1e-4, 1e-4], [1e-4, 1e-4]])
    assert np.linalg.matrix_rank(calibration_from(flat).covariance) == 1


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (covariance([[1.0, float("nan")], [0.0, 1.0]]), "matrix.1.2: found nan"),
        (covariance([[1e-4, 2e-4], [2e-4, 1e-4]]), "negative eigenvalues"),
        (covariance([[1e-4, 5e-5], [0.0, 1e-4]]), "a symmetric matrix"),
        (covariance([[1e-4, 5e-5]]), "a matrix of 2 by 2"),
        (covariance([[1e-4, 0], [0, 1e-4]], ("a", "a")), "each name once"),
        (covariance([[1e300, 0], [0, 1e300]]), "sigmas of at most"),
        (covariance([[1e-4]], ("accel.bias_x",)), "accel.bias_y is not in it"),
        (CAL | {"parameters": {"a.b": {"value": float("inf")}}}, "parameters.a.b.value: found inf"),
        (CAL | {"parameters": {"a.b": {"value": 1, "sigma": -1}}}, "sigma: found -1"),
        (CAL | {"parameters": {"a.b": {"value": 10**400}}}, "thousands of digits|value"),
        (CAL | {"parameters": {"a.b": {"value": -1e300}}}, "parameters.a.b.value: found -1e"),
        (CAL | {"parameters": {"a.b": {"value": 1, "sigma": 1e300}}}, "sigma: found 1e"),
        (
            CAL | {"bias_tables": {"a.y": [{"angle_deg": 0, "value": 1e300, "unit": "m_s2"}]}},
            "bias_tables.a.y.1.value: found 1e",
        ),
        (CAL | {"provenance": {"columns": {"a": {}}}}, "provenance.columns.a: found {}"),
        (CAL | {"provenance": {"columns": "g"}}, "provenance.columns: found 'g'"),
        (CAL | {"provenance": {"undetermined": 3}}, "provenance.undetermined: found 3"),
        (CAL | {"poses": [{"start_s": 0}]}, "no key 'end_s'"),
        (CAL | {"lookup": "nearest"}, "lookup: found 'nearest'"),
        (CAL | {"warnings": "none"}, "warnings: found 'none'"),
        ({k: v for k, v in CAL.items() if k != "method"}, "no key 'method'"),
    ],
)
def test_a_damaged_calibration_is_refused_by_its_key(table, words):
    with pytest.raises(TiltcalError, match=words):
        calibration_from(table, "calibration CAL.json")


DIAGNOSIS = {"verdict": "ambiguous", "statement": "", "findings": []}
FINDING = {"effect": "a", "class": ["a", "b"], "next_measurement": ""}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (DIAGNOSIS | {"verdict": "fine"}, "key verdict: found 'fine'"),
        (DIAGNOSIS | {"findings": None}, "key findings: found None"),
        (DIAGNOSIS | {"findings": [{"effect": "a"}]}, "findings.1: found no key 'class'"),
        (DIAGNOSIS | {"findings": [FINDING | {"effect": "c"}]}, "a class that its effect is in"),
        (DIAGNOSIS | {"recordings": [1]}, "recordings.1: found 1"),
        (DIAGNOSIS | {"undetectable": ["acc_bias"]}, "undetectable.1: found 'acc_bias'"),
        (DIAGNOSIS | {"undetectable": [{"effect": None}]}, "undetectable.1.effect: found None"),
    ],
)
def test_a_damaged_diagnosis_is_refused_by_its_key(table, words, tmp_path):
    (tmp_path / "diagnosis.json").write_text(json.dumps(table))
    with pytest.raises(TiltcalError, match=words):
        read_diagnosis(tmp_path / "diagnosis.json")


BLOCK = {
    "block": "rest",
    "words": "",
    "minutes": 1.0,
    "confidence": 0.5,
    "sequence": "sequence_1.csv",
    "recording": "recording_1.csv",
}
STATE = {"given": ["a.csv"], "verdicts": ["match"], "blocks": [BLOCK], "statement": ""}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (STATE | {"given": "a.csv"}, "key given"),
        (STATE | {"verdicts": [3]}, "verdicts.1"),
        (STATE | {"blocks": [BLOCK | {"minutes": -1}]}, "blocks.1.minutes"),
        (STATE | {"blocks": [BLOCK | {"recording": "../../etc/passwd"}]}, "blocks.1.recording"),
    ],
)
def test_a_damaged_investigation_is_refused_by_its_key(table, words, tmp_path):
    (tmp_path / "investigation.json").write_text(json.dumps(table))
    with pytest.raises(TiltcalError, match=words):
        read_investigation(tmp_path / "investigation.json")


@pytest.mark.parametrize(
    "content", [b"{", b"[]", b"\xff\xfe", b"null", b"[" * 100_000, b'{"a": NaN}', b'{"a": 1e999}']
)
def test_what_is_no_table_is_refused(content, good, here, capsys):
    (here / "CAL.json").write_bytes(content)
    words = ["correct", "CAL.json", good / "run.csv", "-o", "out.csv"]
    assert "need a CAL.json as" in refusal(words, here, capsys)


# ---- numerical failure


def singular():
    np.linalg.inv(np.zeros((2, 2)))


@pytest.mark.parametrize(
    "failing",
    [singular, lambda: 1 / 0, lambda: 1e300**2, lambda: round(float("nan"))],
    ids=["singular", "divided by zero", "overflow", "not finite"],
)
def test_numerical_failure_is_told_in_one_way(failing):
    with (
        pytest.raises(TiltcalError, match=r"r\.csv: found that it does not determine the bias"),
        determining("r.csv", "the bias"),
    ):
        failing()


def test_other_errors_pass():
    with pytest.raises(ValueError, match="shape"), determining("r.csv", "the bias"):
        raise ValueError("shape")


@pytest.mark.parametrize("number", ["1e200", "inf", "-1e31"])
def test_a_reading_that_no_instrument_gives_is_named(number, good, here, capsys):
    lines = (good / "run.csv").read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    column = lines[head].split(",").index("accel_x_m_s2")
    cells = lines[head + 9].split(",")
    cells[column] = number
    lines[head + 9] = ",".join(cells)
    (here / "r.csv").write_text("\n".join(lines) + "\n")
    words = ["calibrate", "r.csv", "--scenario", good / "bench.toml", "--method", "six_position"]
    message = refusal(words, here, capsys)
    assert "accel_x_m_s2, at" in message
    assert "need a number of at most 1e+30" in message


# ---- faults while a file is written

OLD = "the earlier file"


def sound_recording() -> Recording:
    return Recording.from_columns(np.arange(1000.0), {"accel_x_g": np.ones(1000)})


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    """A folder with files that are to be replaced."""
    for name in ("r.csv", "r.npz", "r.parquet", "c.json"):
        (tmp_path / name).write_text(OLD)
    return tmp_path


WRITES = {
    "r.csv": lambda p: write_recording(sound_recording(), p),
    "r.npz": lambda p: write_recording(sound_recording(), p),
    "r.parquet": lambda p: write_recording(sound_recording(), p),
    "c.json": lambda p: write_json(p, {"a": 1}),
}


@pytest.mark.parametrize("name", WRITES)
@pytest.mark.parametrize(
    "error",
    [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt(), RuntimeError("lost")],
    ids=["no room", "interrupt", "fault"],
)
def test_a_fault_before_the_new_name_leaves_the_earlier_file_whole(
    name, error, earlier, monkeypatch
):
    def failing(*_):
        raise error

    monkeypatch.setattr(files.os, "replace", failing)
    with pytest.raises((TiltcalError, type(error))):
        WRITES[name](earlier / name)
    assert (earlier / name).read_text() == OLD
    assert not list(earlier.glob(f"{TEMPORARY}*"))


@pytest.mark.parametrize("name", WRITES)
def test_without_a_fault_the_new_file_takes_its_place(name, earlier):
    WRITES[name](earlier / name)
    assert (earlier / name).read_bytes() != OLD.encode()


def test_a_process_that_is_killed_in_the_middle_leaves_the_earlier_file_whole(earlier):
    code = (
        "import os, signal, sys; from pathlib import Path\n"
        "from tiltcal.core.files import replacing\n"
        "with replacing(Path(sys.argv[1])) as t:\n"
        "    t.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, earlier / "r.csv"], check=False)
    assert done.returncode == -signal.SIGKILL
    assert (earlier / "r.csv").read_text() == OLD


def test_a_full_disk_is_one_message(good, here):
    """The shell's limit of a file's size stands for the end of the disk."""
    code = (
        "import resource, signal, sys; from tiltcal.cli import main\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    words = ["simulate", str(good / "bench.toml"), "-o", "run.csv"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "file too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("name", ["a" * 255, "x" * 251 + ".csv", "a:b.csv"])
def test_names_as_long_as_they_may_be_and_like_addresses_are_written(name, tmp_path):
    with replacing(tmp_path / name) as temporary:
        temporary.write_text("whole")
    assert (tmp_path / name).read_text() == "whole"


@pytest.mark.parametrize("name", ["a" * 256, "a" * 5000])
def test_names_that_are_too_long_are_refused(name, here, good, capsys):
    for words in (
        ["simulate", good / "bench.toml", "-o", f"{name}.csv"],
        ["correct", name, good / "run.csv", "-o", "o.csv"],
        ["segments", f"{name}.csv"],
        ["run", good / "bench.toml", "-o", name],
    ):
        assert "name too long" in refusal(words, here, capsys)


def test_devices_and_pipes_are_neither_input_nor_output(here, good, capsys):
    os.mkfifo(here / "pipe.csv")
    for words in (
        ["segments", "pipe.csv"],
        ["segments", "/dev/zero"],
        ["simulate", good / "bench.toml", "-o", "pipe.csv"],
        ["calibrate", good / "run.csv", "--scenario", "/dev/null", "--method", "norm"],
    ):
        capsys.readouterr()
        assert main([str(w) for w in words]) == 2
        assert "a device or pipe" in capsys.readouterr().err
    assert Path("/dev/zero").is_char_device()
