"""``tiltcal estimate``: recorded files through estimators, sample by sample."""

import json

import examiner.judge  # noqa: F401  registers the makers
import numpy as np
import pytest
from examiner.case import MAKERS

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.cli import main
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording

BENCH = """
schema = 1
name = "field"
[site]
gravity_m_s2 = 9.80123
latitude_deg = 39.9
[rig]
table = "handheld"
[[sensor]]
name = "gyro"
kind = "gyro"
rate_hz = 100
[[sensor]]
name = "fog"
kind = "fog"
axes = ["a"]
input_axis = [1, 1, 1]
rate_hz = 100
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 100
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """A recording of hand turns beside a FOG, its scenario, and the truth."""
    folder = tmp_path_factory.mktemp("field")
    case = MAKERS["fog_scale"](np.random.default_rng(8), "clean")
    write_recording(Recording.from_columns(case.time, case.columns), folder / "run.csv")
    (folder / "bench.toml").write_text(BENCH)
    return folder, case.truth


def command(folder, *words):
    base = ["estimate", str(folder / "run.csv"), "--scenario", str(folder / "bench.toml")]
    return main([*base, *words, "-o", str(folder / "out.csv")])


def test_the_loop_on_line_ends_where_the_method_does(field, capsys):
    folder, truth = field
    assert command(folder, "--estimator", "field_scale", "--json") == 0
    found = json.loads(capsys.readouterr().out)["last"]
    setup = load_scenario(folder / "bench.toml")
    whole = calibrate("fog_scale", read_recording(folder / "run.csv"), setup)
    for axis in "xyz":
        name = f"gyro.scale_{axis}"
        sigma = whole.parameters[name].sigma
        online = found[f"scale_{axis}_ppm"] * 1e-6
        assert abs(online - whole.value(name)) < 4 * sigma
        assert abs(online - truth[name]) < 6 * sigma
    course = read_recording(folder / "out.csv").extra["scale_x_ppm"]
    assert not course[0]
    assert float(course[-1]) == pytest.approx(found["scale_x_ppm"])


def test_a_tilt_filter_runs_on_the_same_file(field):
    folder, _ = field
    assert command(folder, "--estimator", "complementary") == 0
    tilt = read_recording(folder / "out.csv")
    assert np.abs(tilt.column("tilt_x_deg")[:1000]).max() < 1.0


def test_a_rest_that_is_too_short_and_an_unknown_name_are_refused(field, capsys):
    folder, _ = field
    words = ["--estimator", "field_scale", "--option", "rest_s=0.01"]
    assert command(folder, *words) == 2
    assert "a first standstill of ten readings or more" in capsys.readouterr().err
    assert command(folder, "--estimator", "kalmann") == 2
    assert "did you mean 'kalman'?" in capsys.readouterr().err
