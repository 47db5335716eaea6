"""Foreign files that would keep a reader busy for ever, or fill the memory, end at once."""

import struct
import time

import h5py
import numpy as np
import pytest

from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.foreign_files import import_recording
from tiltcal.recordings.formats.bad_lines import find_bad_lines
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.registry import read_raw
from tiltcal.recordings.mapping import FileLayout, Mapping
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segment_files import read_segments
from tiltcal.setup.sequence_files import read_sequence

N = 50
AT_ONCE = 5.0  # s; a loop would take for ever


@pytest.fixture
def at_once():
    start = time.monotonic()
    yield
    assert time.monotonic() - start < AT_ONCE


def with_links(path):
    with h5py.File(path, "w") as file:
        file["t"] = np.arange(N) / 10
        first, second = file.create_group("a"), file.create_group("b")
        first["x"] = np.arange(N)
        return_to = {"root": file["/"], "own": first, "other": second}
        for name, group in return_to.items():
            first[name] = group
            second[name] = group
        second["circle"] = h5py.SoftLink("/b/circle")
        second["nowhere"] = h5py.SoftLink("/c")
        second["outside"] = h5py.ExternalLink("other.h5", "/t")
    with h5py.File(path.parent / "other.h5", "w") as file:
        file["t"] = np.arange(N)
    return path


@pytest.mark.usefixtures("at_once")
def test_links_of_hdf5_in_a_circle_are_entered_once_and_lost_ones_found(tmp_path):
    table = read_raw(with_links(tmp_path / "a.h5"), FileLayout()).tables[0]
    assert set(table.names) == {"t", "a/x"}
    (finding,) = find_bad_lines(table)
    assert "b/circle, b/nowhere, b/outside" in finding.statement


def test_an_hdf5_file_that_has_only_lost_links_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = h5py.SoftLink("/y")
    with pytest.raises(TiltcalError, match="no array of numbers"):
        read_raw(tmp_path / "a.h5", FileLayout())


@pytest.mark.parametrize("kind", ["f8", "S1", "string"])
def test_an_hdf5_file_that_unpacks_to_more_is_refused_before(kind, tmp_path):
    path, rows = tmp_path / "a.h5", 300_000
    dtype = h5py.string_dtype() if kind == "string" else kind
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (rows,), dtype, chunks=(1000,), compression="gzip")
        file["x"][:10] = b"1" if kind != "f8" else 1.0
    assert path.stat().st_size < 500_000
    least = 8 if kind == "f8" else 64
    read_raw(path, FileLayout(), ReadBudget(1.01 * least * rows / 1e9))
    with pytest.raises(TiltcalError, match="--memory-gb"):
        read_raw(path, FileLayout(), ReadBudget(0.99 * least * rows / 1e9))


MAGIC = b"ULog\x01\x12\x35"
FORMAT = b"a:uint64_t timestamp;float x;"


def message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    "content",
    [
        MAGIC + b"rio: bench\n# seed: 0\nt,x\n" + b"0.1,2.5\n" * 3000,
        MAGIC + bytes(9) + message("F", FORMAT),
        MAGIC + bytes(9) + message("F", FORMAT) + struct.pack("<HB", 60_000, 200) + b"cut",
        MAGIC + bytes(9) + message("F", FORMAT) + b"\xff" * 5000,
        MAGIC,
    ],
    ids=["text", "no data", "cut", "noise", "magic"],
)
def test_definitions_of_a_ulog_that_do_not_end_are_refused(content, tmp_path, capsys):
    (tmp_path / "a.ulg").write_bytes(content)
    assert main(["import", str(tmp_path / "a.ulg"), "--propose"]) == 2
    assert "found no message of data after the definitions" in capsys.readouterr().err


def test_a_ulog_with_messages_unknown_to_it_is_read(tmp_path):
    parts = [MAGIC + b"\x01" + struct.pack("<Q", 0), message("F", FORMAT), message("~", b"new")]
    parts.append(message("A", struct.pack("<BH", 0, 0) + b"a"))
    parts += [message("D", struct.pack("<HQf", 0, 10_000 * k, k)) for k in range(N)]
    (tmp_path / "a.ulg").write_bytes(b"".join(parts))
    assert len(read_raw(tmp_path / "a.ulg", FileLayout()).tables[0]) == N


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("skip", [4, 10**12])
def test_more_lines_to_skip_than_there_are_are_refused(skip, tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    with pytest.raises(TiltcalError, match=f"found 3 lines, need more than the {skip} of skip"):
        read_raw(tmp_path / "a.csv", FileLayout(skip_lines=skip))
    assert len(read_raw(tmp_path / "a.csv", FileLayout(skip_lines=1, header=False)).tables[0]) == 2


@pytest.mark.usefixtures("at_once")
def test_a_line_of_a_million_cells_is_refused_before_it_is_read(tmp_path):
    """Each of its columns would take some 18 kB."""
    (tmp_path / "log.txt").write_text(f"x,y\n{'1,' * 10**6}1\n1,2\n")
    with pytest.raises(TiltcalError, match="found 1000001 columns, need at most 4096"):
        read_raw(tmp_path / "log.txt", FileLayout(header=True))


@pytest.mark.filterwarnings("error")
def test_a_reading_that_its_scale_makes_too_large_is_named(tmp_path):
    (tmp_path / "log.txt").write_text("x\n1\n-1e308\n2\n")
    column = {"from": "x", "to": "accel_x_g", "scale": 3.0}
    table = {"file": {"header": True}, "time": {"rate_hz": 10}, "column": [column]}
    with pytest.raises(TiltcalError, match=r"column x, data row 2: found -1e\+308"):
        import_recording(tmp_path / "log.txt", Mapping.model_validate(table))


def test_a_bag_without_its_mark_is_refused_before_its_library_looks_for_it(tmp_path):
    """Zeros of 64 GiB that take no room on the disk: the library reads on to the first line end."""
    with (tmp_path / "a.bag").open("wb") as file:
        file.truncate(64 << 30)
    with pytest.raises(TiltcalError, match="does not begin with #ROSBAG V"):
        read_raw(tmp_path / "a.bag", FileLayout())


NOTHING = Recording.from_columns(np.arange(3.0), {"accel_x_g": np.ones(3)})


@pytest.mark.parametrize("read", [read_sequence, lambda path: read_segments(path, NOTHING)])
def test_a_table_that_is_read_whole_is_bounded(read, tmp_path):
    with (tmp_path / "a.csv").open("wb") as file:
        file.truncate(64 << 30)
    with pytest.raises(TiltcalError, match="68719476736 bytes, need at most"):
        read(tmp_path / "a.csv")
