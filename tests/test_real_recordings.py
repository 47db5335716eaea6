"""Real logs as their owners published them: hand-turned instruments, judged by the norm of
gravity.
"""

import json
from pathlib import Path

import pytest
from outside_files import RECORDINGS, needs

from tiltcal.cli import main
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segmentation import dwells, find_segments

WORDS = Path(__file__).parents[1] / "scenarios" / "real"
MILLI_G = 9.80665e-3
# file, mapping and scenario, least dwells, held-out residual of a careful fit in mg with 9
# parameters
LOGS = {
    "xsens": ("xsens_mti/xsens_acc.mat", "xsens", 37, 0.18),
    "mpu0": ("mpu9150/imu0.log", "mpu9150", 19, 0.36),
    "mpu1": ("mpu9150/imu1.log", "mpu9150", 19, 0.32),
}

pytestmark = needs(RECORDINGS)


def imported(file, words, out):
    assert (
        main(
            [
                "import",
                str(RECORDINGS / file),
                "--map",
                str(WORDS / f"{words}_map.toml"),
                "-o",
                str(out),
            ]
        )
        == 0
    )
    return out


@pytest.fixture(scope="module", params=LOGS)
def log(request, tmp_path_factory):
    """The imported recording with what is known of it."""
    file, words, least, limit = LOGS[request.param]
    path = imported(file, words, tmp_path_factory.mktemp(request.param) / "run.csv")
    return path, WORDS / f"{words}.toml", least, limit


def calibrated(capsys, path, scenario, *more, status):
    capsys.readouterr()
    words = [
        "calibrate",
        str(path),
        "--scenario",
        str(scenario),
        "--method",
        "norm",
        "--json",
        *map(str, more),
    ]
    assert main(words) == status
    found = json.loads(capsys.readouterr().out)
    return found, found["fit"]["heldout_rms"]["accel"] / MILLI_G


def test_the_dwells_are_found_by_themselves(log):
    path, scenario, least, _ = log
    recording = read_recording(path)
    found = dwells(find_segments(recording))
    assert least <= len(found) <= least + 5  # hands rest between poses as well
    assert len(recording) > 100 * sum(s.end - s.start for s in found) > 0.4 * len(recording)
    assert load_scenario(scenario).rig.table == "handheld"


def test_nine_parameters_reach_the_careful_fit_on_directions_left_out(log, capsys):
    path, scenario, _, limit = log
    found, heldout = calibrated(capsys, path, scenario, status=0)
    assert found["verdict"] == "good"
    assert heldout <= limit
    pairs = {n: p["value"] for n, p in found["parameters"].items() if ".cross_" in n}
    assert max(abs(v) for v in pairs.values()) > 1e-3  # what six parameters leave out


def test_the_answer_hardly_depends_on_the_detector_s_window(log, tmp_path, capsys):
    path, scenario, *_ = log
    reached = []
    for window in (0.5, 1, 2):
        assert (
            main(["segments", str(path), "--window", str(window), "-o", str(tmp_path / "SEG.csv")])
            == 0
        )
        reached.append(
            calibrated(capsys, path, scenario, "--segments", tmp_path / "SEG.csv", status=0)[1]
        )
    assert max(reached) / min(reached) < 1.2


def test_six_parameters_are_not_enough_and_called_suspect(log, capsys):
    path, scenario, _, limit = log
    found, heldout = calibrated(capsys, path, scenario, "--option", "terms=6", status=1)
    assert found["verdict"] == "suspect"
    assert [t["name"] for t in found["tests"] if not t["passed"]] == ["fit", "cause"]
    assert heldout > 3 * limit


def test_one_unit_s_calibration_does_not_fit_the_other(tmp_path, capsys):
    runs = [
        imported(LOGS[unit][0], "mpu9150", tmp_path / f"{unit}.csv") for unit in ("mpu0", "mpu1")
    ]
    scenario = WORDS / "mpu9150.toml"
    calibrated(capsys, runs[0], scenario, "-o", tmp_path / "CAL.json", status=0)
    assert (
        main(["check", str(tmp_path / "CAL.json"), str(runs[0]), "--scenario", str(scenario)]) == 0
    )
    assert (
        main(["check", str(tmp_path / "CAL.json"), str(runs[1]), "--scenario", str(scenario)]) == 1
    )


@pytest.mark.parametrize("terms", [6, 9])
def test_six_directions_by_the_norm_alone_cannot_be_told(terms, tmp_path, capsys):
    path = imported(
        "ferraris_session/example_ferraris_session.csv", "ferraris", tmp_path / "run.csv"
    )
    found, _ = calibrated(
        capsys, path, WORDS / "ferraris.toml", "--option", f"terms={terms}", status=1
    )
    assert found["verdict"] == "cannot_tell"
    blind = next(t for t in found["tests"] if t["name"] == "directions predict each other")
    assert not blind["passed"]
