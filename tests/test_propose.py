"""`tiltcal import --propose`: right, or "cannot know", for fifty variants of one log and for real
ones; never wrong.
"""

import contextlib
import json
import tomllib
from collections import Counter

import numpy as np
import pytest
from foreign_logs import VARIANTS, Log, score
from outside_files import RECORDINGS, reason_without

from tiltcal.api.simulating import simulator
from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import split_unit
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.foreign_files import import_recording
from tiltcal.recordings.mapping import load_mapping, parse_mapping
from tiltcal.recordings.proposal.propose import propose_mapping
from tiltcal.recordings.saving import write_recording

MOST_UNKNOWN = 0.15  # share of "cannot know" among all that is proposed


def proposed(log, tmp_path):
    return propose_mapping(log.write(tmp_path / "log.txt")).toml()


def test_no_line_of_a_proposal_is_wrong_and_most_are_known(tmp_path):
    assert len(VARIANTS) >= 40
    count, wrong = Counter(), {}
    for name, log in VARIANTS.items():
        scored = score(log, proposed(log, tmp_path))
        count += Counter(how for _, how in scored)
        wrong[name] = [item for item, how in scored if how == "wrong"]
    assert not any(wrong.values()), wrong
    assert count["cannot know"] < MOST_UNKNOWN * sum(count.values()), count


REAL = {
    "xsens_mti/xsens_acc.mat": (
        {"column": 1, "unit": "s"},
        {2: "accel_x_LSB", 3: "accel_y_LSB", 4: "accel_z_LSB"},
        ("zero and scale", "no magnetometer"),
    ),
    "xsens_mti/xsens_gyro.mat": (
        {"column": 1, "unit": "s"},
        {2: "gyro_x_LSB", 3: "gyro_y_LSB", 4: "gyro_z_LSB"},
        ("zero and scale",),
    ),
    "mpu9150/imu0.log": (
        {"rate_hz": "?"},
        dict(enumerate(
            [f"accel_{a}_m_s2" for a in "xyz"] + [f"gyro_{a}_?" for a in "xyz"], start=1)),
        ("sample rate", "about 94 Hz as rad_s"),
    ),
    "thermal_cycle/imu_raw_data.csv": (
        {"column": "timestamp", "unit": "?"},
        {f"imu.gyro.{a}": f"gyro_{a}_?" for a in "xyz"}
        | {f"imu.acc.{a}": f"accel_{a}_m_s2" for a in "xyz"}
        | {"imu.temperature": "temperature_degC"},
        ("1.979 Hz as us, 1979 Hz as ns", "rad/s or deg/s"),
    ),
    "ferraris_session/example_ferraris_session.csv": (
        {"rate_hz": "?"},
        {f"gyr_{a}": f"gyro_{a}_deg_s" for a in "xyz"}
        | {f"acc_{a}": f"accel_{a}_m_s2" for a in "xyz"},
        ("n_samples only counts samples",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("file", REAL)
def test_a_published_recording_is_proposed_as_its_owner_describes_it(file):
    path = RECORDINGS / file
    if (reason := reason_without(path)) is not None:
        pytest.skip(reason)
    time, columns, doubts = REAL[file]
    text = propose_mapping(path).toml()
    found = tomllib.loads(text)
    assert found["time"] == time
    assert {c["from"]: c["to"] for c in found["column"]} == columns
    unknown = "\n".join(x for x in text.splitlines() if x.startswith("# cannot know"))
    assert all(word in unknown for word in doubts), unknown


def test_what_is_proposed_is_imported_without_a_change(tmp_path):
    log = Log(separator="semicolon", decimal="comma", time="iso", table="dual", rates="deg_s")
    path = log.write(tmp_path / "log.txt")
    mapping = parse_mapping(propose_mapping(path).toml(), "proposal")
    recording = import_recording(path, mapping)
    t, force, rate, angles = log.readings()
    assert recording.metadata["time zero"].endswith(" s")
    np.testing.assert_allclose(np.diff(recording.time), np.diff(t), atol=2e-6)
    np.testing.assert_allclose(recording.column("accel_y_m_s2"), force[:, 1], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(recording.column("gyro_z_deg_s"), rate[:, 2], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(recording.column("table_outer_deg"), angles[:, 0], atol=1e-3)


def test_the_table_of_a_proposal_reaches_the_scenario(tmp_path, capsys):
    path = Log(table="placing", rates="deg_s").write(tmp_path / "log.txt")
    (tmp_path / "m.toml").write_text(propose_mapping(path).toml())
    out = str(tmp_path / "run.csv")
    assert main(["import", str(path), "--map", str(tmp_path / "m.toml"), "-o", out]) == 0
    capsys.readouterr()
    assert main(["init", "--from", out]) == 0
    assert tomllib.loads(capsys.readouterr().out)["rig"]["table"] == "placing"


def test_an_open_question_in_a_mapping_is_refused_until_it_is_answered(tmp_path, capsys):
    path = Log(time="none", header="none", separator="space").write(tmp_path / "log.txt")
    where = tmp_path / "map.toml"
    assert main(["import", str(path), "--propose", "-o", str(where)]) == 0
    words = ["import", str(path), "--map", str(where), "-o", str(tmp_path / "run.csv")]
    assert main(words) == 2
    message = capsys.readouterr().err
    assert "rate_hz is '?': the file does not state it; fill it in" in message
    assert "the unit of 'gyro_x_?' is not known from the file; fill it in" in message
    answered = where.read_text().replace('rate_hz = "?"', "rate_hz = 100").replace("_?", "_rad_s")
    where.write_text(answered)
    assert main(words) == 0
    assert load_mapping(where).time.rate_hz == 100


def table_of(path, names, *columns):
    rows = [",".join(f"{v:.6g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    return path


def six_faces(n=600, size=9.81):
    """Rests on the six faces, (n, 3)."""
    faces = np.vstack([np.eye(3), -np.eye(3)])
    return size * faces[np.arange(n) * 6 // n] + np.random.default_rng(3).normal(0, 0.01, (n, 3))


def test_a_unit_that_gravity_contradicts_is_not_believed(tmp_path):
    f = six_faces()
    names = ["t", "acc_x [g]", "acc_y [g]", "acc_z [g]"]
    path = table_of(tmp_path / "a.csv", names, np.arange(600) / 100, *f.T)
    text = propose_mapping(path).toml()
    assert 'to = "accel_x_?"' in text
    assert "the file states g, but the norm at rest 9.81 is not 1" in text


def test_two_triads_of_even_norm_without_names_are_told_apart_by_nobody(tmp_path):
    names = [f"ch{k}" for k in range(7)]
    path = table_of(
        tmp_path / "a.csv", names, np.arange(600) / 100, *six_faces(size=1.0).T,
        *six_faces(size=0.99).T,
    )  # fmt: skip
    with pytest.raises(TiltcalError, match="none of which is like a sensor"):
        propose_mapping(path)


def test_two_accelerometers_in_m_s2_are_two_and_a_third_triad_is_not(tmp_path):
    names = [f"ch{k}" for k in range(10)]
    f = six_faces()
    path = table_of(
        tmp_path / "a.csv", names, np.arange(600) / 100, *f.T, *(f * 1.01).T, *(f / 9.81 * 0.99).T
    )
    found = {c["from"]: c["to"] for c in tomllib.loads(propose_mapping(path).toml())["column"]}
    assert found == {
        f"ch{k + 1}": f"{name}_{a}_m_s2"
        for k, (name, a) in enumerate((n, a) for n in ("accel", "accel2") for a in "xyz")
    }


def test_an_acceleration_without_gravity_is_left_out(tmp_path):
    f, rng = six_faces(), np.random.default_rng(1)
    names = ["t", "acc_x", "acc_y", "acc_z", "local_acc_x", "local_acc_y", "local_acc_z"]
    free = rng.normal(0, 0.02, (600, 3))
    path = table_of(tmp_path / "a.csv", names, np.arange(600) / 100, *f.T, *free.T)
    text = propose_mapping(path).toml()
    assert [c["from"] for c in tomllib.loads(text)["column"]] == names[1:4]
    assert "local_acc_x (accel)" in text


def test_gyro_readings_without_motion_have_no_unit(tmp_path):
    rng = np.random.default_rng(5)
    f, w = (
        np.tile([0, 0, 9.81], (900, 1)) + rng.normal(0, 0.01, (900, 3)),
        rng.normal(0.01, 0.001, (900, 3)),
    )
    names = ["t", "ax", "ay", "az", "gx", "gy", "gz"]
    path = table_of(tmp_path / "a.csv", names, np.arange(900) / 100, *f.T, *w.T)
    text = propose_mapping(path).toml()
    assert 'to = "gyro_x_?"' in text
    assert "may be rad/s or deg/s, and nothing turns" in text


def test_kelvin_and_fahrenheit_become_celsius(tmp_path):
    f, k = six_faces(), np.linspace(295, 305, 600)
    names = ["t", "acc_x", "acc_y", "acc_z"]
    for name, values in (("temperature", k), ("temp [°F]", (k - 273.15) * 1.8 + 32)):
        path = table_of(tmp_path / "a.csv", [*names, name], np.arange(600) / 100, *f.T, values)
        mapping = parse_mapping(propose_mapping(path).toml(), "proposal")
        got = import_recording(path, mapping).column("temperature_degC")
        np.testing.assert_allclose(got, k - 273.15, atol=2e-3)


def test_the_proposal_as_json_lists_what_it_cannot_know(tmp_path, capsys):
    path = VARIANTS["1000 Hz"].write(tmp_path / "log.txt")
    assert main(["import", str(path), "--propose", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert tomllib.loads(found["mapping"])["time"]["unit"] == "?"
    assert any("1000 Hz as us" in doubt for doubt in found["cannot_know"])


LOGGERS = {
    "EuRoC": (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]", "gf", "epoch_ns", "m_s2", "rad_s",
    ),
    "phyphox": (
        '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)",'
        '"Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)"',
        "fg", "s", "m_s2", "rad_s",
    ),
    "WIT": (
        "Chip Time,ax(g),ay(g),az(g),wx(deg/s),wy(deg/s),wz(deg/s)", "fg", "date", "g", "deg_s",
    ),
    "Arduino": ("millis,aX,aY,aZ,gX,gY,gZ", "fg", "ms", "g", "deg_s"),
    "MPU": ("Timestamp(us),AcX,AcY,AcZ,GyX,GyY,GyZ", "fg", "us", "LSB", "LSB"),
    "axis first": (
        "Time,X_GYRO_OUT,Y_GYRO_OUT,Z_GYRO_OUT,X_ACCL_OUT,Y_ACCL_OUT,Z_ACCL_OUT",
        "gf", "s", "LSB", "LSB",
    ),
    "ArduPilot": ("TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "gf", "us", "m_s2", "rad_s"),
    "units at the end": (
        "time_ms,AccelX_mg,AccelY_mg,AccelZ_mg,GyroX_dps,GyroY_dps,GyroZ_dps",
        "fg", "ms", "mg", "deg_s",
    ),
    "German": (
        "Zeit,Beschl X,Beschl Y,Beschl Z,Drehrate X,Drehrate Y,Drehrate Z",
        "fg", "s", "m_s2", "deg_s",
    ),
    "axes backwards": ("t,s1 z,s1 y,s1 x,s2 z,s2 y,s2 x", "FG", "s", "m_s2", "deg_s"),
}  # fmt: skip


@pytest.mark.parametrize("name", LOGGERS)
def test_names_of_other_loggers_are_understood(name, tmp_path):
    header, order, clock, force, rates = LOGGERS[name]
    log = Log(time=clock, force=force, rates=rates)
    t, f, w, _ = log.readings()
    parts = {"f": f, "g": w, "F": f[:, ::-1], "G": w[:, ::-1]}
    cells = [log.clock(t), *([f"{v:.8g}" for v in x] for k in order for x in parts[k].T)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *map(",".join, zip(*cells, strict=True))]) + "\n")
    found = tomllib.loads(propose_mapping(path).toml())
    axes = "zyx" if name == "axes backwards" else "xyz"
    to = {"f": [f"accel_{a}_{force}" for a in axes], "g": [f"gyro_{a}_{rates}" for a in axes]}
    expected = [x for k in order for x in to[k.lower()]]
    assert {c["to"] for c in found["column"]} == set(expected)
    names = [n.strip('"').lstrip("#") for n in header.split(",")]
    assert {c["from"]: c["to"] for c in found["column"]} == dict(
        zip(names[1:], expected, strict=True)
    )
    assert found["time"]["column"] == names[0]


def test_nothing_in_a_log_makes_a_proposal_break(tmp_path):
    rng = np.random.default_rng(20)
    whole = Log(separator="semicolon", decimal="comma").write(tmp_path / "a.txt").read_bytes()
    pieces = [b"nan", b";;;", b"\n\n", b"1e400", b"inf", b'"', b"\x00\x00", b"# hi\n", b"\xff\xfe"]
    outcomes, refusals = [], []
    for _ in range(40):
        data = bytearray(whole[:60_000])
        for _ in range(rng.integers(1, 30)):
            at = int(rng.integers(len(data)))
            if rng.random() < 0.4:
                data[at : at + int(rng.integers(1, 60))] = b""
            else:
                data[at:at] = pieces[rng.integers(len(pieces))]
        (tmp_path / "a.txt").write_bytes(bytes(data))
        try:
            outcomes.append(tomllib.loads(propose_mapping(tmp_path / "a.txt").toml()))
        except TiltcalError as error:
            refusals.append(str(error))
    assert outcomes
    assert all("need" in words for words in refusals)
    assert all({"file", "time", "column"} <= set(mapping) for mapping in outcomes)


def test_sensors_that_were_sampled_in_turn_are_understood(tmp_path):
    log = Log(rates="deg_s", table="dual")
    t, f, w, angles = log.readings()
    every = np.arange(len(t)) % 2 == 0
    f, w = np.where(every[:, None], f, np.nan), np.where(every[:, None], np.nan, w)
    angles = np.where((np.arange(len(t)) % 5 == 0)[:, None], angles, np.nan)
    names = ["t", "ax", "ay", "az", "gx", "gy", "gz", "encoder 1", "encoder 2"]
    path = table_of(tmp_path / "a.csv", names, t, *f.T, *w.T, *angles.T)
    found = {c["from"]: c["to"] for c in tomllib.loads(propose_mapping(path).toml())["column"]}
    assert found["ax"] == "accel_x_m_s2"
    assert found["gz"] == "gyro_z_deg_s"
    assert found["encoder 1"] == "table_outer_deg"
    assert found["encoder 2"] == "table_inner_deg"


def test_a_comma_before_three_digits_everywhere_may_group_thousands(tmp_path):
    rows = [f"{k / 100:.3f};{x:.3f};{y:.3f};{z:.3f}" for k, (x, y, z) in enumerate(six_faces())]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(["t;ax;ay;az", *rows]).replace(".", ",") + "\n")
    found = propose_mapping(path)
    assert found.dialect.layout.decimal == "comma"
    assert any("groups thousands" in doubt for doubt in found.doubts)
    path.write_text(path.read_text().replace("9,81", "9,8"))
    assert not any("groups thousands" in doubt for doubt in propose_mapping(path).doubts)


SIMULATED = (
    "six_faces_dual",
    "gyro_rates_three",
    "gyro_turns_by_hand",
    "fog_scale_by_hand",
    "norm_by_hand",
    "placing_table_one_axis",
    "two_position_level",
    "tumble_inclinometer",
)


@pytest.mark.parametrize("silent", [False, True], ids=["without units", "without names"])
@pytest.mark.parametrize("name", SIMULATED)
def test_recordings_of_the_simulator_without_their_units_are_never_taken_wrong(
    name, silent, tmp_path
):
    run = simulator().record(load_scenario(folder("scenarios") / f"{name}.toml"))
    path = tmp_path / "run.csv"
    write_recording(run, path)
    lines = [x for x in path.read_text().splitlines() if not x.startswith("#")]
    truth = lines[0].split(",")
    shown = [
        f"c{k}" if silent and not t.startswith("table") else split_unit(t)[0]
        for k, t in enumerate(truth)
    ]
    path.write_text("\n".join([",".join(shown), *lines[1:]]) + "\n")
    found = None
    with contextlib.suppress(TiltcalError):
        found = tomllib.loads(propose_mapping(path).toml())
    if found is None:
        assert silent  # neither names nor numbers tell a sensor
        return
    known = dict(zip(shown, truth, strict=True))
    assert known[found["time"]["column"]] == "time_s"
    assert found["time"]["unit"] in ("s", "?")
    for c in found["column"]:
        unknown = c["to"].endswith("_?") and known[c["from"]].startswith(c["to"][:-1])
        assert unknown or c["to"] == known[c["from"]]


def proposed_names(tmp_path, names, *columns):
    path = table_of(tmp_path / "a.csv", ["t", *names], np.arange(len(columns[0])) / 100, *columns)
    text = propose_mapping(path).toml()
    return {str(c["from"]): c["to"] for c in tomllib.loads(text)["column"]}, text


def test_what_no_sensor_reads_is_none(tmp_path):
    """Beside an accelerometer: flags, commands, the output of a filter, a unit vector, and a
    quaternion without names, all of which have an even norm or stand still at rest.
    """
    f, rng = six_faces(), np.random.default_rng(7)
    turn = np.linspace(0, 2, len(f))
    unit = f / np.linalg.norm(f, axis=1)[:, None]
    quaternion = [np.cos(turn), 0.6 * np.sin(turn), 0.8 * np.sin(turn), 0 * turn]
    quaternion = [q + 0 * rng.normal(size=len(f)) for q in quaternion]
    flags = [np.float64(turn > k / 2) for k in range(1, 4)]
    motors = [1000 + 200 * np.floor(4 * turn + k) for k in range(3)]
    names = ["acc_x", "acc_y", "acc_z", "b1", "b2", "b3", "motor_x", "motor_y", "motor_z"]
    names += ["accFilt_x", "accFilt_y", "accFilt_z", "u", "v", "w", "c1", "c2", "c3", "c4"]
    found, text = proposed_names(tmp_path, names, *f.T, *flags, *motors, *f.T, *unit.T, *quaternion)
    assert found == {f"acc_{a}": f"accel_{a}_m_s2" for a in "xyz"}
    assert "motor_x (a command, no reading)" in text
    assert "accFilt_x (an estimate or the output of a filter, no reading)" in text
    assert "# cannot know: what b1, b2, b3, u, v, w" in text


def test_linear_acceleration_that_holds_gravity_is_an_accelerometer(tmp_path):
    f = six_faces()
    found, text = proposed_names(tmp_path, [f"lin_acc_{a}" for a in "xyz"], *f.T)
    assert found == {f"lin_acc_{a}": f"accel_{a}_m_s2" for a in "xyz"}
    assert "whatever its name" in text


def test_a_tilt_sensor_on_a_dividing_head_is_one_and_the_head_is_the_table(tmp_path):
    """Two columns of counts, one of which follows the sine of a typed angle."""
    rng = np.random.default_rng(9)
    angle = np.repeat(np.tile([0.0, 5, 10, 20, -5, -10, -20, 30], 4), 100)
    x = np.round(8192 * np.sin(np.radians(angle)) + 3 * rng.normal(size=len(angle)))
    y = np.round(60 + 3 * rng.normal(size=len(angle)))
    found, text = proposed_names(tmp_path, ["Teilkopf [deg]", "RohX", "RohY"], angle, x, y)
    head = {"Teilkopf [deg]": "table_outer_deg"}
    assert found == head | {"RohX": "incl_x_LSB", "RohY": "incl_y_LSB"}
    assert "whether it reads the tilt or its sine" in text
    alone, text = proposed_names(tmp_path, ["temp [degC]", "RohX", "RohY"], 20 + 0 * x, x, y)
    assert set(alone) == {"temp [degC]"}
    assert "# cannot know: what RohX and RohY hold" in text
