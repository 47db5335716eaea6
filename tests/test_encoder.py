"""Encoders that are read beside the command: what a drive leaves, as readings and as causes."""

import json

import numpy as np
import pytest

from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording_files import read_recording

STIFFNESS = 20000.0  # N m/rad
RATE = 30.0  # deg/s, of every move
STEP = 60.0  # deg
BENCH = """\
schema = 1
name = "drive"
seed = 7
[site]
gravity_m_s2 = 9.81
latitude_deg = 45
[rig]
table = "dual"
readout = "command"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 50
adjustable = ["bias", "scale", "cross_axis"]
[[sensor]]
name = "enc"
kind = "encoder"
axes = ["a"]
of = "outer"
rate_hz = 50
adjustable = ["bias"]
"""
MOTION = f"""\
[[sequence]]
action = "sweep"
outer_deg = 360
step_deg = {STEP}
rate_deg_s = {RATE}
dwell_s = 2
"""
NOISE = """\
[[effect]]
id = "acc_noise"
white_ug_rthz = 25
[[effect]]
id = "enc_noise"
white_arcsec_rthz = 0.3
"""


def effect(text):
    return f"[[effect]]\n{text}\n"


def simulated(folder, more="", name="run"):
    """A recording of the bench with more tables, and its path."""
    scenario, log = folder / f"{name}.toml", folder / f"{name}.csv"
    scenario.write_text(BENCH + MOTION + more)
    assert main(["simulate", str(scenario), "-o", str(log), "-q"]) == 0
    return read_recording(log), log


def deviation(recording):
    """What the encoder reads less the command, rad."""
    read = recording.column("enc_a_deg") - recording.column("table_outer_deg")
    return np.asarray(read) * DEG


def moving_steadily(recording):
    """Rows well inside a move at the steady rate."""
    command = np.asarray(recording.column("table_outer_deg"))
    rate = np.gradient(command, recording.time)
    steady = np.abs(rate - RATE) < 1e-6
    return np.convolve(steady, np.ones(5), "same") == 5


def test_without_errors_an_encoder_reads_the_command(tmp_path):
    recording, _ = simulated(tmp_path)
    assert np.abs(deviation(recording)).max() < 1e-12


@pytest.mark.parametrize(
    ("text", "moving", "still"),
    [
        ('id = "servo_lag"\naxis = "outer"\ntau_ms = 4', -0.004 * RATE * DEG, 0.0),
        (
            'id = "servo_friction_deadband"\naxis = "outer"\nwidth_arcsec = 30',
            -15 * ARCSEC,
            -15 * ARCSEC,
        ),
        ('id = "servo_inertia"\naxis = "outer"\ninertia_ms2 = 500', 0.0, 0.0),
        ('id = "table_encoder_eccentricity"\naxis = "outer"\ncos_arcsec = 50', 0.0, 0.0),
    ],
    ids=["lag", "friction", "inertia", "no drive"],
)
def test_it_reads_what_the_drive_leaves_and_nothing_of_the_readout(tmp_path, text, moving, still):
    recording, _ = simulated(tmp_path, effect(text))
    found = deviation(recording)
    np.testing.assert_allclose(found[moving_steadily(recording)], moving, atol=1e-9)
    np.testing.assert_allclose(found[-1], still, atol=1e-9)


def test_a_run_by_time_steps_has_the_lag_of_its_servo(tmp_path):
    """MuJoCo's own actuator lags by its damping over its stiffness, and by the bearing's."""
    stiffness, lags = 2e4, []
    for damping in (100.0, 300.0):
        servo = f"[dynamics]\nstiffness_N_m_rad = {stiffness}\ndamping_N_m_s_rad = {damping}\n"
        recording, _ = simulated(tmp_path, servo)
        lags.append(np.median(deviation(recording)[moving_steadily(recording)]))
    assert lags[0] - lags[1] == pytest.approx(200 / stiffness * RATE * DEG, rel=1e-3)
    assert -lags[0] > 100 / stiffness * RATE * DEG


@pytest.mark.parametrize(
    ("text", "read", "friction"),
    [
        ('id = "servo_droop"\ndroop_arcsec = 40', 40.0, 0.0),
        ('id = "table_backlash"\naxis = "outer"\nwidth_arcsec = 30', 0.0, 2.0 / STIFFNESS),
        ('id = "table_sag"\nsag_arcsec = 40', 0.0, 0.0),
        ('id = "table_encoder_eccentricity"\naxis = "outer"\ncos_arcsec = 50', 0.0, 0.0),
    ],
    ids=["droop", "backlash", "sag", "eccentricity"],
)
def test_a_run_by_time_steps_shows_it_the_motor_alone(tmp_path, text, read, friction):
    """MuJoCo's gravity on its servo, its play and its springs, at rest a second after each move.
    The load with play rubs with 2 N m, which the servo holds by friction over stiffness.
    """
    servo = f"[dynamics]\nstiffness_N_m_rad = {STIFFNESS}\ndamping_N_m_s_rad = 100.0\n"
    sound, _ = simulated(tmp_path, servo, "sound")
    recording, _ = simulated(tmp_path, servo + effect(text))
    command = np.asarray(recording.column("table_outer_deg"))
    moves = np.abs(np.gradient(command)) > 1e-9
    rest = np.convolve(moves, np.ones(101), "same") == 0
    found = np.abs(deviation(recording) - deviation(sound))[rest] / ARCSEC
    expected = np.abs(np.sin(np.radians(command[rest])))
    off = np.abs(found - read * expected)
    assert off.max() < 0.05 + friction / ARCSEC


@pytest.mark.parametrize(
    ("text", "name", "key", "value"),
    [
        ('id = "servo_lag"\naxis = "outer"\ntau_ms = 2', "servo_lag", "tau_ms", 2.0),
        ('id = "servo_droop"\ndroop_arcsec = 10', "servo_droop", "droop_arcsec", 10.0),
        (
            'id = "servo_inertia"\naxis = "outer"\ninertia_ms2 = 300',
            "servo_inertia",
            "inertia_ms2",
            300.0,
        ),
        (
            'id = "servo_ripple"\naxis = "outer"\nripple_ppm = 3000',
            "servo_ripple",
            "ripple_ppm",
            3000.0,
        ),
    ],
    ids=["lag", "droop", "inertia", "ripple"],
)
def test_a_drive_is_named_by_its_encoder(tmp_path, text, name, key, value):
    _, log = simulated(tmp_path, NOISE + effect(text))
    (tmp_path / "nominal.toml").write_text(BENCH)
    words = ["diagnose", str(log), "--scenario", str(tmp_path / "nominal.toml")]
    assert main([*words, "-o", str(tmp_path / "out"), "-q"]) in (0, 1)
    answer = json.loads((tmp_path / "out/diagnosis.json").read_text())
    (finding,) = answer["findings"]
    assert finding["effect"] == name
    size = finding["parameters"][key]
    assert abs(size["value"] - value) < 4 * size["sigma"]
    assert size["sigma"] < 0.01 * value


def test_a_sound_drive_is_not_accused(tmp_path):
    _, log = simulated(tmp_path, NOISE)
    (tmp_path / "nominal.toml").write_text(BENCH)
    words = ["diagnose", str(log), "--scenario", str(tmp_path / "nominal.toml")]
    assert main([*words, "-o", str(tmp_path / "out"), "-q"]) == 0
    assert json.loads((tmp_path / "out/diagnosis.json").read_text())["verdict"] == "match"


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('of = "outer"\n', "", "of ="),
        ('of = "outer"', 'of = "azimuth"', "no axis: outer, inner"),
        ('readout = "command"', 'readout = "encoder"', "readout = 'command'"),
        ('kind = "encoder"', 'kind = "gyro"', "axes of a gyro"),
        ('name = "accel"', 'name = "accel"\nof = "outer"', "no other sensor"),
    ],
)
def test_an_encoder_that_cannot_be_is_refused(old, new, text):
    import tomllib

    table = tomllib.loads(BENCH.replace(old, new, 1))
    with pytest.raises(TiltcalError, match=text):
        parse_scenario(table)


def test_other_commands_leave_an_encoder_alone(tmp_path):
    _, log = simulated(tmp_path, NOISE)
    (tmp_path / "nominal.toml").write_text(BENCH)
    about = ["--scenario", str(tmp_path / "nominal.toml")]
    found = tmp_path / "CAL.json"
    option = ["--option", 'terms=["bias"]']
    words = ["calibrate", str(log), *about, "--method", "six_position", *option]
    assert main([*words, "-o", str(found), "-q"]) in (0, 1)
    corrected = tmp_path / "corrected.csv"
    assert main(["correct", str(found), str(log), "-o", str(corrected), "-q"]) == 0
    before, after = read_recording(log), read_recording(corrected)
    np.testing.assert_array_equal(before.column("enc_a_deg"), after.column("enc_a_deg"))
