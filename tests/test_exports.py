"""What is exported for other programs means there what it means here."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from builders import ACCEL, GYRO, G, setup_of
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML
from scenario_files import refusal

from tiltcal.calibration.autopilot_exports import (
    TriadNoise,
    ardupilot_parameters,
    kalibr_yaml,
    px4_parameters,
    sdf_imu,
)
from tiltcal.calibration.methods.registry import _with_setup
from tiltcal.calibration.result import calibration_from
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG, G0
from tiltcal.recordings.foreign_files import import_recording
from tiltcal.recordings.formats.mcap_writer import write_mcap
from tiltcal.recordings.mapping import parse_mapping
from tiltcal.recordings.proposal.propose import propose_mapping
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording

SETUP = setup_of("dual", ACCEL, GYRO)
BIAS = {"accel": (0.031, -0.112, 0.204), "gyro": (0.011, -0.007, 0.0023)}
SCALE = {"accel": (0.012, -0.021, 0.004), "gyro": (0.0, 0.0, 0.0)}


def calibration(**more):
    units = {"accel": "m_s2", "gyro": "rad_s"}
    parameters = {
        f"{s}.{term}_{axis}": {"value": values[s][k], "unit": units[s] if term == "bias" else "1"}
        for s in ("accel", "gyro")
        for term, values in (("bias", BIAS), ("scale", SCALE))
        for k, axis in enumerate("xyz")
    }
    parameters |= {n: {"value": v, "unit": "1"} for n, v in more.items()}
    table = {"method": "norm", "verdict": "good", "parameters": parameters}
    return _with_setup(calibration_from(table), SETUP)


# --------------------------------------------------------------------------------------------------
# ---- autopilots


def test_what_an_autopilot_does_not_take_is_refused():
    """Readings of another full-scale range, calibrated as a scale factor of two."""
    doubled = calibration(**{"accel.scale_y": 1.006})
    for export in (px4_parameters, ardupilot_parameters):
        with pytest.raises(TiltcalError, match=r"axis y: found offset .* and scale 0\.4985"):
            export(doubled)


def px4(text):
    rows = [x.split("\t") for x in text.splitlines() if not x.startswith("#")]
    assert all(len(r) == 5 and r[:2] == ["1", "1"] and r[4] == "9" for r in rows)
    return {r[2]: float(r[3]) for r in rows}


def ardupilot(text):
    rows = [x.split(",") for x in text.splitlines() if not x.startswith("#")]
    return {name: float(value) for name, value in rows}


NAMES = {
    "px4": (px4_parameters, px4, "CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF"),
    "ardupilot": (
        ardupilot_parameters, ardupilot, "INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}",
    ),
}  # fmt: skip


@pytest.mark.parametrize("system", NAMES)
def test_an_autopilot_corrects_as_the_corrector_does(system, rng):
    write, parse, offset, scale, gyro = NAMES[system]
    found = parse(write(calibration()))
    assert len(found) == 9
    raw = rng.normal(0, 9, (500, 3))
    # corrected = (raw - offset) * scale, as both autopilots have it
    by_autopilot = np.column_stack([
        (raw[:, k] - found[offset.format(a)]) * found[scale.format(a)] for k, a in enumerate("XYZ")
    ])  # fmt: skip
    sensor = SETUP.named("accel")
    np.testing.assert_allclose(
        by_autopilot, calibration().correct(sensor, raw, G), rtol=0, atol=2e-7
    )
    turned = np.column_stack([raw[:, k] - found[gyro.format(a)] for k, a in enumerate("XYZ")])
    sensor = SETUP.named("gyro")
    np.testing.assert_allclose(turned, calibration().correct(sensor, raw, G), rtol=0, atol=2e-7)


@pytest.mark.parametrize("write", [px4_parameters, ardupilot_parameters])
def test_what_an_autopilot_cannot_hold_is_said(write):
    plain = write(calibration())
    assert "left out" not in plain
    said = write(calibration(**{"accel.cross_xy": 0.0025, "gyro.scale_x": 0.003}))
    assert "# left out, accel: cross-axis terms up to 0.0025, up to 0.0245 m/s2 at 1 g" in said
    assert "# left out, gyro: scale errors up to 0.003" in said


def test_a_calibration_without_a_triad_has_no_parameters(good, tmp_path, capsys):
    two = ACCEL.model_copy(update={"axes": ("x", "y")})
    table = {"method": "m", "verdict": "good", "parameters": {"accel.bias_x": {"value": 1.0}}}
    found = _with_setup(calibration_from(table), setup_of("dual", two))
    found.save(tmp_path / "CAL.json")
    message = refusal(["export", tmp_path / "CAL.json", "--format", "px4"], tmp_path, capsys)
    assert "no accelerometer or gyro with three axes" in message
    message = refusal(["export", good / "run.csv", "--format", "px4"], tmp_path, capsys)
    assert "need a calibration, CAL.json" in message


# --------------------------------------------------------------------------------------------------
# ---- noise

DENSITY, WALK, RATE = 1.5e-3, 2e-4, 50.0  # m/s2/rtHz, m/s3/rtHz, Hz


def at_rest(path, rng, n=120_000):
    """An IMU at rest with known white noise; the accelerometer also walks."""
    white = rng.normal(size=(n, 6)) * np.sqrt(RATE)
    walk = np.cumsum(rng.normal(size=(n, 3)), axis=0) / np.sqrt(RATE) * WALK
    columns = {f"accel_{a}_m_s2": DENSITY * white[:, k] + walk[:, k] for k, a in enumerate("xyz")}
    columns["accel_z_m_s2"] += G
    columns |= {f"gyro_{a}_deg_s": 0.01 * white[:, 3 + k] for k, a in enumerate("xyz")}
    write_recording(Recording.from_columns(np.arange(n) / RATE, columns), path)
    return path


def test_kalibr_and_sdf_get_the_noise_that_is_there(rng, tmp_path, capsys):
    path = at_rest(tmp_path / "rest.parquet", rng)
    assert main(["export", str(path), "--format", "kalibr", "-o", str(tmp_path / "imu.yaml")]) == 0
    found = YAML(typ="safe").load((tmp_path / "imu.yaml").read_text())
    assert list(found) == [
        "accelerometer_noise_density",
        "accelerometer_random_walk",
        "gyroscope_noise_density",
        "gyroscope_random_walk",
        "rostopic",
        "update_rate",
    ]
    assert found["accelerometer_noise_density"] == pytest.approx(DENSITY, rel=0.03)
    assert found["accelerometer_random_walk"] == pytest.approx(WALK, rel=0.3)
    assert found["gyroscope_noise_density"] == pytest.approx(0.01 * DEG, rel=0.03)
    assert found["update_rate"] == pytest.approx(RATE)
    calibration().save(tmp_path / "CAL.json")
    capsys.readouterr()
    words = ["export", str(path), "--format", "sdf", "--calibration", str(tmp_path / "CAL.json")]
    assert main(words) == 0
    imu = ET.fromstring("<sensor>" + capsys.readouterr().out + "</sensor>").find("imu")
    for k, axis in enumerate("xyz"):
        noise = imu.find(f"linear_acceleration/{axis}/noise")
        assert noise.get("type") == "gaussian"
        stddev = float(noise.findtext("stddev"))
        assert stddev == pytest.approx(DENSITY * np.sqrt(RATE), rel=0.05)
        assert float(noise.findtext("mean")) == pytest.approx(BIAS["accel"][k])
        assert float(noise.findtext("bias_stddev")) == 0.0
        gyro = imu.find(f"angular_velocity/{axis}/noise")
        assert float(gyro.findtext("mean")) == pytest.approx(BIAS["gyro"][k])


def test_a_walk_that_is_not_visible_is_an_upper_limit():
    noise = TriadNoise(np.full(3, 1e-3), np.full(3, 2e-5), True, (), 100.0)
    imu = {"acceleration": noise, "rate": noise}
    assert kalibr_yaml(imu, "/imu").count("# upper limit: not visible in this recording") == 2
    assert "dynamic_bias" not in sdf_imu(imu, {})


def test_noise_that_is_none_of_the_three_kinds_is_named_in_the_file():
    noise = TriadNoise(np.full(3, 1e-3), np.full(3, 2e-5), True, ("gyro_y_rad_s",), 100.0)
    for text in (kalibr_yaml({"rate": noise}, "/imu"), sdf_imu({"rate": noise}, {})):
        assert "gyro_y_rad_s: white noise, flicker and walk do not fit; upper limits" in text


@pytest.mark.parametrize(("kept", "missing"), [("gyro", "accelerometer"), ("accel", "gyroscope")])
def test_one_sensor_alone_is_exported_and_the_other_one_named(rng, tmp_path, kept, missing):
    run = read_recording(at_rest(tmp_path / "rest.parquet", rng, 20_000))
    columns = {name: run.column(name) for name in run.column_names if name.startswith(kept)}
    write_recording(Recording.from_columns(run.time, columns), path := tmp_path / "one.parquet")
    assert main(["export", str(path), "--format", "kalibr", "-o", str(tmp_path / "imu.yaml")]) == 0
    text = (tmp_path / "imu.yaml").read_text()
    assert f"# {missing}: missing" in text
    found = YAML(typ="safe").load(text)
    assert not [key for key in found if key.startswith(missing)]
    assert found["update_rate"] == pytest.approx(RATE)
    assert len(found) == 4
    assert main(["export", str(path), "--format", "sdf", "-o", str(tmp_path / "imu.sdf")]) == 0
    imu = ET.parse(tmp_path / "imu.sdf").getroot()
    assert [
        tag for tag in ("angular_velocity", "linear_acceleration") if imu.find(tag) is not None
    ] == ["angular_velocity" if kept == "gyro" else "linear_acceleration"]


def test_noise_wants_a_recording_at_rest(good, tmp_path, capsys):
    for chosen in ("kalibr", "sdf"):
        words = ["export", good / "CAL.json", "--format", chosen]
        assert "need a recording at rest" in refusal(words, tmp_path, capsys)


def test_a_dead_axis_is_named_where_no_triad_is_left(rng, tmp_path, capsys):
    run = read_recording(at_rest(tmp_path / "rest.parquet", rng, 20_000))
    columns = {name: run.column(name) for name in run.column_names if name.startswith("gyro")}
    columns["gyro_y_deg_s"] = np.full(len(run), 0.25)
    write_recording(Recording.from_columns(run.time, columns), path := tmp_path / "dead.parquet")
    said = refusal(["export", path, "--format", "kalibr"], tmp_path, capsys)
    assert "gyro_y_deg_s: its reading never changes" in said


# --------------------------------------------------------------------------------------------------
# ---- recordings


def recording(n=50):
    rng = np.random.default_rng(2)
    return Recording.from_columns(
        np.arange(n) * 0.01,
        {f"accel_{a}_g": rng.normal(size=n) for a in "xyz"}
        | {f"gyro_{a}_deg_s": rng.normal(size=n) for a in "xyz"}
        | {"temperature_degC": np.where(np.arange(n) % 10, np.nan, 25.0 + np.arange(n))}
        | {"table_outer_deg": np.linspace(0, 90, n), "table_inner_deg": np.linspace(10, 20, n)},
        metadata={"time zero": "1777896000 s", "operator": "B"},
    )


def test_mcap_is_read_by_rosbags_and_by_its_own_library(tmp_path):
    run = recording()
    write_mcap(run, tmp_path / "a.mcap")
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        got = [
            (t, reader.deserialize(raw, c.msgtype))
            for c, t, raw in reader.messages()
            if c.topic == "/imu"
        ]
        table = [
            reader.deserialize(raw, c.msgtype)
            for c, _, raw in reader.messages()
            if c.topic == "/table"
        ]
    assert kinds == {
        "/imu": "sensor_msgs/msg/Imu",
        "/temperature": "sensor_msgs/msg/Temperature",
        "/table": "sensor_msgs/msg/JointState",
    }
    assert len(got) == len(table) == len(run)
    stamp, message = got[7]
    assert stamp == 1777896000_070000000
    header = message.header.stamp
    assert header.sec * 10**9 + header.nanosec == stamp
    assert message.linear_acceleration.y == pytest.approx(run.column("accel_y_g")[7] * G0)
    assert message.angular_velocity.z == pytest.approx(run.column("gyro_z_deg_s")[7] * DEG)
    assert message.orientation_covariance[0] == -1.0  # not measured
    assert table[7].name == ["outer", "inner"]
    assert table[7].position[0] == pytest.approx(run.column("table_outer_deg")[7] * DEG)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert reader.get_summary().statistics.message_count == 105
        assert next(iter(reader.iter_metadata())).metadata["operator"] == "B"


def test_what_is_written_as_mcap_comes_back(tmp_path):
    run = recording()
    write_mcap(run, tmp_path / "a.mcap")
    text = propose_mapping(tmp_path / "a.mcap").toml().replace("accel_x_?", "accel_x_m_s2")
    text = text.replace("accel_y_?", "accel_y_m_s2").replace("accel_z_?", "accel_z_m_s2")
    again = import_recording(tmp_path / "a.mcap", parse_mapping(text, "m"))
    assert again.metadata["time zero"] == "1777896000 s"
    np.testing.assert_allclose(again.time, run.time, atol=1e-9)
    outer = again.column("table_outer_rad")
    np.testing.assert_allclose(outer, run.column("table_outer_deg") * DEG, rtol=1e-14)
    warm = again.column("temperature_degC")
    np.testing.assert_array_equal(warm, run.column("temperature_degC"))
    back = again.column("accel_x_m_s2")
    np.testing.assert_allclose(back, run.column("accel_x_g") * G0, rtol=1e-15)


def test_triads_without_a_partner_have_topics_of_their_own(tmp_path):
    n = 20
    columns = {f"accel_{a}_m_s2": np.where(np.arange(n) % 2, np.nan, 1.0) for a in "xyz"}
    columns |= {f"gyro_{a}_rad_s": np.where(np.arange(n) % 2, 0.5, np.nan) for a in "xyz"}
    write_mcap(Recording.from_columns(np.arange(n) * 1.0, columns), tmp_path / "a.mcap")
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    assert set(messages) == {"/accel", "/gyro"}
    assert messages["/accel"].angular_velocity_covariance[0] == -1.0
    assert messages["/gyro"].linear_acceleration_covariance[0] == -1.0
    assert messages["/gyro"].angular_velocity.x == 0.5


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz", ".mcap"])
def test_a_recording_is_exported_by_the_ending(suffix, tmp_path, capsys):
    write_recording(recording(), tmp_path / "run.csv")
    out = tmp_path / f"out{suffix}"
    assert main(["export", str(tmp_path / "run.csv"), "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"output": str(out), "rows": 50}
    assert out.stat().st_size > 1000


def test_a_recording_that_mcap_cannot_hold_is_refused(tmp_path, capsys):
    counts = Recording.from_columns(np.arange(3.0), {f"a_{x}_LSB": np.ones(3) for x in "xyz"})
    write_recording(counts, tmp_path / "counts.csv")
    before = Recording.from_columns(np.arange(3.0) - 10, {f"a_{x}_g": np.ones(3) for x in "xyz"})
    write_recording(before, tmp_path / "before.csv")
    for name, words in (
        ("counts", "no accelerometer or gyro with the axes x, y, z"),
        ("before", "found times from -10 s"),
    ):
        line = ["export", tmp_path / f"{name}.csv", "-o", tmp_path / "a.mcap"]
        assert words in refusal(line, tmp_path, capsys)
    assert "no -o" in refusal(["export", tmp_path / "counts.csv"], tmp_path, capsys)
    line = ["export", tmp_path / "counts.csv", "-o", tmp_path / "a.xls"]
    assert "the ending '.xls'" in refusal(line, tmp_path, capsys)
