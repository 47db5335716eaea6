"""Recordings in pieces: several files with times of their own, several instruments in one table,
one row a pose.
"""

import json

import numpy as np
import pytest

from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.foreign_files import import_file
from tiltcal.recordings.mapping import parse_mapping
from tiltcal.recordings.means_table import MeansTable, read_log_or_means
from tiltcal.recordings.proposal.propose import propose_mapping
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording

RNG = np.random.default_rng(11)


def write(path, names, *columns):
    rows = [",".join(f"{v:.12g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


def force(n, gain=1.0):
    faces = np.vstack([np.eye(3), -np.eye(3)])[np.arange(n) * 6 // n]
    return gain * 9.8 * faces + RNG.normal(0, 0.01, (n, 3))


TIMES = np.arange(600) / 60, np.arange(2000) / 200


def phone(folder, times=TIMES, name="seconds_elapsed"):
    """Accelerometer and gyro of a phone, each in a file of its own."""
    for kind, t in zip(("Accelerometer", "Gyroscope"), times, strict=True):
        values = force(len(t)) if kind[0] == "A" else RNG.normal(0, 0.01, (len(t), 3))
        write(folder / f"{kind}.csv", f"{name},z,y,x", t, *values.T[::-1])
    return folder / "Accelerometer.csv", folder / "Gyroscope.csv"


MAP = '[time]\ncolumn = "seconds_elapsed"\n' + "".join(
    f'[[column]]\n{file}from = "{a}"\nto = "{sensor}_{a}_{unit}"\n'
    for file, sensor, unit in (
        ("", "accel", "m_s2"), ('file = "Gyroscope.csv"\n', "gyro", "rad_s"),
    )
    for a in "xyz"
)  # fmt: skip


def test_files_with_times_of_their_own_are_joined_on_all_stamps(tmp_path):
    accel, gyro = phone(tmp_path)
    recording = import_file(accel, parse_mapping(MAP, "m")).recording
    a, w = np.loadtxt(accel, delimiter=",", skiprows=1), np.loadtxt(gyro, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(recording.time, np.union1d(a[:, 0], w[:, 0]))
    for sensor, unit, rows in (("accel", "m_s2", a), ("gyro", "rad_s", w)):
        values = recording.column(f"{sensor}_x_{unit}")
        known = np.isfinite(values)
        np.testing.assert_array_equal(recording.time[known], rows[:, 0])
        np.testing.assert_array_equal(values[known], rows[:, 3])


def test_files_with_as_many_rows_but_other_stamps_are_not_put_side_by_side(tmp_path):
    t = np.arange(600) / 60
    accel, _ = phone(tmp_path, (t, t + 0.005))
    recording = import_file(accel, parse_mapping(MAP, "m")).recording
    assert len(recording) == 1200


def test_a_second_file_without_times_needs_the_same_rows(tmp_path):
    t = np.arange(600) / 60
    accel = write(tmp_path / "accel.csv", "seconds_elapsed,x,y,z", t, *force(600).T)
    mapping = parse_mapping(MAP, "m")
    write(tmp_path / "Gyroscope.csv", "x,y,z", *force(600).T)
    assert len(import_file(accel, mapping).recording) == 600
    write(tmp_path / "Gyroscope.csv", "x,y,z", *force(500).T)
    with pytest.raises(TiltcalError, match="found 500 rows, need 600 as in accel"):
        import_file(accel, mapping)


def test_several_files_are_proposed_in_one_mapping_and_imported_with_it(tmp_path, capsys):
    (tmp_path / "other").mkdir()
    accel, gyro = phone(tmp_path)
    gyro = gyro.rename(tmp_path / "other" / "Gyroscope.csv")
    files, map_file = [str(accel), str(gyro)], tmp_path / "m.toml"
    assert main(["import", *files, "--propose", "-o", str(map_file)]) == 0
    text = map_file.read_text()
    assert text.count('file = "Gyroscope.csv"') == 3
    map_file.write_text(text.replace("_?", "_rad_s"))
    out = tmp_path / "run.csv"
    words = ["import", *files, "--map", str(map_file), "--join", "time", "-o", str(out)]
    assert main(words) == 0
    recording = read_recording(out)
    assert np.isfinite(recording.column("gyro_x_rad_s")).sum() == 2000
    assert np.isfinite(recording.column("accel_x_m_s2")).sum() == 600
    capsys.readouterr()
    extra = write(tmp_path / "Magnetometer.csv", "a,b", np.arange(3), np.arange(3))
    assert main([*words, str(extra)]) == 2
    assert "Magnetometer.csv: found no column of the mapping" in capsys.readouterr().err


def test_files_of_different_layout_are_refused(tmp_path):
    accel, gyro = phone(tmp_path)
    gyro.write_text(gyro.read_text().replace(",", ";"))
    with pytest.raises(TiltcalError, match="of different layout"):
        propose_mapping(accel, more=[gyro])


def two(path, name="I", equal_stamps=True, values=(0, 1)):
    """Two accelerometers whose rows alternate."""
    n = 600
    t = np.repeat(np.arange(n) / 50, 2)
    both = np.empty((2 * n, 3))
    both[::2], both[1::2] = force(n), force(n, 1.01)
    if not equal_stamps:
        t = np.arange(2 * n) / 100
    return write(path, f"time_s,{name},acc_x,acc_y,acc_z", t, np.tile(values, n), *both.T)


def test_two_instruments_in_one_table_have_to_be_chosen(tmp_path, capsys):
    path = two(tmp_path / "a.csv")
    proposal = propose_mapping(path)
    assert any("column I alternates 0, 1; choose one" in doubt for doubt in proposal.doubts)
    with pytest.raises(TiltcalError, match="several instruments share the table"):
        parse_mapping(proposal.toml(), "m")
    (tmp_path / "m.toml").write_text(proposal.toml())
    for k, gain in ((0, 1.0), (1, 1.01)):
        words = ["import", str(path), "--map", str(tmp_path / "m.toml"), "--instance", str(k)]
        assert main([*words, "-o", str(tmp_path / "r.csv")]) == 0
        recording = read_recording(tmp_path / "r.csv").require_increasing()
        norm = np.linalg.norm([recording.column(f"accel_{a}_m_s2") for a in "xyz"], axis=0)
        assert len(recording) == 600
        assert norm.mean() == pytest.approx(9.8 * gain, abs=0.002)
    capsys.readouterr()
    assert main(["import", str(path), "--propose", "--instance", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert 'instance = { column = "I", value = 1 }' in found["mapping"]
    assert not any("instruments" in doubt for doubt in found["cannot_know"])
    assert found["findings"] == []


@pytest.mark.parametrize(
    ("name", "equal_stamps", "values", "common"),
    [
        ("I", True, (0, 1), True),
        ("instance", False, (0, 1), True),
        ("which", True, (1, 2), True),
        ("heartbeat", False, (0, 1), False),
        ("I", True, (3, 3), False),
    ],
)
def test_what_alternates_is_an_instance_by_its_name_or_by_equal_stamps(
    name, equal_stamps, values, common, tmp_path
):
    proposal = propose_mapping(two(tmp_path / "a.csv", name, equal_stamps, values))
    assert (proposal.instance is not None) == common


def test_an_instance_that_is_not_there_is_refused(tmp_path, capsys):
    path = two(tmp_path / "a.csv")
    assert main(["import", str(path), "--propose", "--instance", "7"]) == 2
    assert "found no row with 7, need one of 0, 1" in capsys.readouterr().err
    accel, _ = phone(tmp_path)
    assert main(["import", str(accel), "--propose", "--instance", "0"]) == 2
    assert "no column that tells several instruments apart" in capsys.readouterr().err
    (tmp_path / "m.toml").write_text(MAP)
    words = ["import", str(accel), "--map", str(tmp_path / "m.toml"), "--instance", "0"]
    assert main([*words, "-o", str(tmp_path / "r.csv")]) == 2
    assert 'need [file] instance = { column = "I", value = 0 }' in capsys.readouterr().err


@pytest.mark.parametrize("clock", ["", "t,"])
def test_a_row_a_pose_is_noted_and_imported_as_a_table_of_means(clock, tmp_path):
    labels = ["+x", "+y", "+z", "-x", "-y", "-z"] * 3
    means = np.tile(force(6), (3, 1)) + 1.5  # an offset: its norm is no gravity
    rows = [
        f"{f'{60 * k},' if clock else ''}{x:.5f},{y:.5f},{z:.5f},{label}"
        for k, ((x, y, z), label) in enumerate(zip(means, labels, strict=True))
    ]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([f"{clock}acc_x [m/s2],acc_y [m/s2],acc_z [m/s2],label", *rows]))
    proposal = propose_mapping(path)
    assert "# note: each row has a label" in proposal.toml()
    imported = import_file(path, parse_mapping(proposal.toml(), "m"))
    assert not (*proposal.findings, *imported.findings)
    write_recording(imported.recording, tmp_path / "r.csv")
    assert isinstance(read_log_or_means(tmp_path / "r.csv"), MeansTable)
    path.write_text(
        "\n".join([f"{clock}acc_x,acc_y,acc_z,label", *(r for r in rows for _ in "123456789")])
    )
    assert "# note" not in propose_mapping(path).toml()


def test_an_instance_may_be_named_by_a_text(tmp_path):
    rows = [f"{k // 2 / 50},{'ab'[k % 2]},{k % 2 + 1}" for k in range(20)]
    (tmp_path / "a.csv").write_text("\n".join(["t,unit,x", *rows]) + "\n")
    text = '[file]\ninstance = {{ column = "unit", value = "{}" }}\n[time]\ncolumn = "t"\n'
    text += '[[column]]\nfrom = "x"\nto = "a_x_g"\n'
    recording = import_file(tmp_path / "a.csv", parse_mapping(text.format("b"), "m")).recording
    assert len(recording) == 10
    assert set(recording.column("a_x_g")) == {2.0}
    with pytest.raises(TiltcalError, match="found no row with c, need one of a, b"):
        import_file(tmp_path / "a.csv", parse_mapping(text.format("c"), "m"))
