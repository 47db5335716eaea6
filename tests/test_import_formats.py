"""Formats that are recognised by their content: MATLAB 4, objects of MATLAB, workbooks, ArduPilot,
lines of a serial monitor; and headings with the word axis.
"""

import struct
import tomllib
import zipfile
import zlib

import numpy as np
import pytest
from scipy import io

from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.foreign_files import import_recording
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import RAGGED
from tiltcal.recordings.formats.registry import format_of, read_raw
from tiltcal.recordings.mapping import FileLayout, parse_mapping
from tiltcal.recordings.proposal.propose import propose_mapping

N = 400
RNG = np.random.default_rng(2)
TIME = np.arange(N) / 100
FORCE = np.tile([0.1, -0.2, 9.79], (N, 1)) + RNG.normal(0, 0.01, (N, 3))


@pytest.mark.parametrize("name", ["a.mat", "a.dat"])
def test_matlab_4_is_read(name, tmp_path):
    path = tmp_path / name
    io.savemat(tmp_path / "a.mat", {"t": TIME, "acc": FORCE}, format="4")
    (tmp_path / "a.mat").rename(path)
    recording = import_recording(path, parse_mapping(propose_mapping(path).toml(), "m"))
    np.testing.assert_array_equal(recording.column("accel_z_m_s2"), FORCE[:, 2])
    with pytest.raises(TiltcalError, match="--memory-gb"):
        read_raw(path, FileLayout(), ReadBudget(1e-6))


def test_a_text_called_mat_stays_text(tmp_path):
    (tmp_path / "a.mat").write_text("0 1 2\n1 2 3\n2 3 5\n3 4 6\n")
    assert format_of(tmp_path / "a.mat").name == "text"


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def timetable(name, kind="timetable"):
    """A variable of MATLAB 5 that is an object, as MATLAB writes it."""
    parts = element(6, struct.pack("<II", 17, 0)) + element(1, name.encode())
    parts += struct.pack("<HH4s", 1, 4, b"MCOS") + element(1, kind.encode())
    parts += element(
        14,
        element(6, struct.pack("<II", 13, 0))
        + element(5, struct.pack("<ii", 6, 1))
        + element(1, b"")
        + element(6, struct.pack("<6I", 3707764736, 2, 1, 1, 1, 1)),
    )
    return element(14, parts)


def matlab_5(path, *variables, compressed):
    io.savemat(path, {})
    with path.open("ab") as file:
        for variable in variables:
            packed = zlib.compress(variable)
            file.write(struct.pack("<II", 15, len(packed)) + packed if compressed else variable)
    return path


@pytest.mark.parametrize("compressed", [False, True])
def test_objects_of_matlab_5_are_named_with_the_lines_that_save_them(compressed, tmp_path):
    path = matlab_5(
        tmp_path / "a.mat", timetable("Acceleration"), timetable("Gyro"), compressed=compressed
    )
    with pytest.raises(TiltcalError) as caught:
        read_raw(path, FileLayout())
    words = str(caught.value)
    assert "Acceleration (timetable), Gyro (timetable)" in words
    assert words.count("\n") == 4
    assert "timetable2table(Acceleration);" in words
    path = matlab_5(tmp_path / "a.mat", timetable("T1", "table"), compressed=compressed)
    with pytest.raises(TiltcalError, match="T = T1;\n"):
        read_raw(path, FileLayout())


def test_arrays_beside_an_object_of_matlab_are_read(tmp_path):
    io.savemat(tmp_path / "a.mat", {"t": TIME, "acc": FORCE})
    with (tmp_path / "a.mat").open("ab") as file:
        file.write(timetable("TT"))
    path = tmp_path / "a.mat"
    assert set(read_raw(path, FileLayout()).tables[0].names) == {"t", "acc_1", "acc_2", "acc_3"}
    with pytest.raises(TiltcalError, match="--memory-gb"):
        read_raw(path, FileLayout(), ReadBudget(1e-6))


def test_workbooks_and_dataflash_logs_are_named_with_the_way_out(tmp_path, capsys):
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    (tmp_path / "a.xls").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600))
    (tmp_path / "a.bin").write_bytes(b"\xa3\x95\x80\x80\x59FMT\x00BBnNZ" + bytes(100))
    for name, words in (
        ("a.xlsx", "save the sheet as CSV"), ("a.xls", "an Excel workbook"),
        ("a.bin", "mavlogdump.py --types IMU --format csv a.bin"),
    ):  # fmt: skip
        assert main(["import", str(tmp_path / name), "--propose"]) == 2
        assert words in capsys.readouterr().err
    np.savez(tmp_path / "a.npz", t=TIME)
    assert format_of(tmp_path / "a.npz").name == "NPZ"


PRINTED = {
    "x: {:.4f} y: {:.4f} z: {:.4f}": ("x", "y", "z"),
    "ax={:.4f}, ay={:.4f}, az={:.4f}": ("ax", "ay", "az"),
    "Accel X: {:.4f} m/s^2 Y: {:.4f} m/s^2 Z: {:.4f} m/s^2": ("Accel X", "Accel Y", "Accel Z"),
    "ax:{:.4f}\tay:{:.4f}\taz:{:.4f}": ("ax", "ay", "az"),
    "AccX: {:.4f} g, AccY: {:.4f} g, AccZ: {:.4f} g": ("AccX", "AccY", "AccZ"),
}


@pytest.mark.parametrize("clock", [False, True])
@pytest.mark.parametrize("form", PRINTED)
def test_lines_of_a_serial_monitor_are_read_as_columns(form, clock, tmp_path):
    in_g = " g" in form
    values = FORCE / 9.80665 if in_g else FORCE
    stamps = [f"12:34:{5 + t:06.3f} -> " if clock else "" for t in TIME]
    lines = [s + form.format(*row) for s, row in zip(stamps, values, strict=True)]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(["Booting, version=3", *lines[:200], "E: lost", *lines[200:]]))
    table = read_raw(path, FileLayout()).tables[0]
    assert tuple(table.names) == (("received",) if clock else ()) + PRINTED[form]
    assert table.metadata[RAGGED] == "2"
    np.testing.assert_allclose(
        np.column_stack([c for _, c in table.columns[-3:]]), values, atol=6e-5
    )
    found = tomllib.loads(propose_mapping(path).toml())
    assert [c["to"] for c in found["column"]] == [
        f"accel_{a}_{'g' if in_g else 'm_s2'}" for a in "xyz"
    ]
    assert not clock or (found["time"]["column"], found["time"]["unit"]) == ("received", "s")


@pytest.mark.parametrize(
    "content",
    ["t,a,b\n0,1,2\n1,2,3\n2,3,4\n", "rate: 100\nx: 1\n0;1;2\n1;2;3\n2;3;4\n", "a: 1 b: 2\n"],
)
def test_other_texts_are_no_lines_of_a_serial_monitor(content, tmp_path):
    (tmp_path / "a.txt").write_text(content)
    assert format_of(tmp_path / "a.txt").name == "text"


HEADINGS = {
    "elapsed (s),x-axis (g),y-axis (g),z-axis (g)": "g",
    "Time,X-Axis [m/s2],Y-Axis [m/s2],Z-Axis [m/s2]": "m_s2",
    "Timestamp,Accelerometer X,Accelerometer Y,Accelerometer Z": "m_s2",
    "Time (s),Linear Acceleration x (m/s^2),Linear Acceleration y (m/s^2),"
    "Linear Acceleration z (m/s^2)": "m_s2",
    "t,acc axis x,acc axis y,acc axis z": "m_s2",
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_headings_with_an_axis_and_a_unit_are_understood(heading, tmp_path):
    unit = HEADINGS[heading]
    values = FORCE / 9.80665 if unit == "g" else FORCE
    rows = [f"{t:.2f},{x:.5f},{y:.5f},{z:.5f}" for t, (x, y, z) in zip(TIME, values, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([heading, *rows]) + "\n")
    found = tomllib.loads(propose_mapping(path).toml())
    assert [c["to"] for c in found["column"]] == [f"accel_{a}_{unit}" for a in "xyz"]
    assert found["time"]["column"] == heading.partition(",")[0]
