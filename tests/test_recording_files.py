"""Recordings as files: what is written reads back exactly, and every file that cannot be read says
where and why.
"""

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyarrow import parquet

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import SUFFIXES, write_recording

NUMBERS = (
    "accel_x_m_s2",
    "accel_y_ug",
    "gyro_z_deg_h",
    "table_outer_deg",
    "pressure_V",
    "temperature_degC",
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
WORD = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=12).map(
    lambda t: t if t.strip(" ") else None  # spaces only are an empty cell
)
KEY = st.text(st.characters(categories=("L", "N")), min_size=1, max_size=8)


@st.composite
def recordings(draw):
    """Several rates, gaps, odd words, irregular stamps of any epoch, extreme numbers."""
    n = draw(st.integers(1, 12))
    time = np.sort(draw(arrays(float, n, elements=FINITE)))
    columns = {}
    for name in draw(st.lists(st.sampled_from(NUMBERS), unique=True)):
        every, values = draw(st.sampled_from([1, 2, 3])), draw(arrays(float, n, elements=FINITE))
        values[np.arange(n) % every > 0] = np.nan
        columns[name] = (
            np.where(draw(arrays(bool, n)), np.nan, values) if draw(st.booleans()) else values
        )
    words = st.lists(WORD, min_size=n, max_size=n).map(lambda w: np.array(w, dtype=object))
    labels = draw(st.none() | words)
    extra = draw(st.dictionaries(st.sampled_from(["operator", 'said "so", he', "Prüfer"]), words))
    metadata = draw(st.dictionaries(KEY, WORD.map(lambda t: (t or "").strip())))
    return Recording.from_columns(time, columns, labels=labels, extra=extra, metadata=metadata)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_text_of_spaces_is_an_empty_cell(suffix, tmp_path):
    path = tmp_path / f"r{suffix}"
    words = np.array([" ", " " * 20, " a "], dtype=object)
    write_recording(Recording(np.arange(3.0), labels=words, extra={"operator": words}), path)
    again = read_recording(path)
    assert list(again.labels) == list(again.extra["operator"]) == [None, None, " a "]


def assert_same_bits(one, two):
    """Equal floats, the sign of zero included, NaN where NaN."""
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(np.signbit(one[~np.isnan(one)]), np.signbit(two[~np.isnan(two)]))


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(
    deadline=None,
    max_examples=120,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(original=recordings())
def test_what_is_written_reads_back_exactly(suffix, original, tmp_path):
    path = tmp_path / f"recording{suffix}"
    write_recording(original, path)
    again = read_recording(path)
    assert_same_bits(again.time, original.time)
    assert sorted(again.column_names) == sorted(original.column_names)
    for name in original.column_names:
        assert_same_bits(again.column(name), original.column(name))
    assert (again.labels is None) == (original.labels is None)
    assert original.labels is None or list(again.labels) == list(original.labels)
    assert {k: list(v) for k, v in again.extra.items()} == {
        k: list(v) for k, v in original.extra.items()
    }
    assert again.metadata == original.metadata
    assert again.source == f"recording {path.name}"


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "value", [-0.0, 5e-324, 1.7976931348623157e308, 0.1 + 0.2, 1 / 3, 1e22, -np.inf]
)
def test_hard_numbers_survive(suffix, value, tmp_path):
    path = tmp_path / f"r{suffix}"
    write_recording(
        Recording.from_columns(np.arange(2.0), {"accel_x_g": np.array([value, np.nan])}), path
    )
    assert_same_bits(read_recording(path).column("accel_x_g"), np.array([value, np.nan]))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_metadata_of_several_lines_leaves_the_recording_readable(suffix, tmp_path):
    path = tmp_path / f"r{suffix}"
    write_recording(Recording(np.arange(2.0), metadata={"scenario": "two\nlines"}), path)
    assert "two" in read_recording(path).metadata["scenario"]


def read_text(tmp_path, text, name="run7.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_recording(path)


def test_a_csv_from_anywhere_reads(tmp_path):
    head = "\ufeff# made by: a: logger\r\n#  mount :Rz(180)\r\n# no colon\r\n\r\n"
    text = head + "time_s, accel_x_g,label,note\r\n0, 1.5,+x,a\r\n1,,,\r\n"
    r = read_text(tmp_path, text)
    assert r.metadata == {"made by": "a: logger", "mount": "Rz(180)"}
    np.testing.assert_array_equal(r.column("accel_x_g"), [1.5, np.nan])
    assert list(r.labels) == ["+x", None]
    assert list(r.extra["note"]) == ["a", None]


# --------------------------------------------------------------------------------------------
# unusable files

HEAD = "# by: us\ntime_s,accel_x_g\n0,1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"recording run7\.csv: found an empty file, need a header and rows; record it again"),
        ("# only: metadata\n", r"found no header line, need column names; add the header"),
        ("time_s,accel_x_g\n", r"found a header and no rows, need at least one row"),
        ("time_s,accel_x_g", r"found a header and no rows, need at least one row"),
        (
            "t,accel_x_g\n0,1\n",
            r"found columns t, accel_x_g, need a column time_s; name the time column so",
        ),
        (
            "# a: b\ntime_s,accel_x_g,accel_x_g\n0,1,2\n",
            r"run7\.csv, line 2: found column accel_x_g twice, need each column once",
        ),
        (
            HEAD + "1,high\n",
            (
                r"run7\.csv, line 4, column accel_x_g: found the text 'high', need a number or an"
                r" empty cell"
            ),
        ),
        (HEAD + "1,1_000\n", r"run7\.csv, line 4, column accel_x_g: found the text '1_000'"),
        (HEAD + '1,"1,5"\n', r"line 4, column accel_x_g: found the text '1,5'"),
        (HEAD + "1\n", r"run7\.csv, line 4: found 1 cells, need 2 as in the header"),
        (HEAD + "1,2,3\n", r"line 4: found 3 cells, need 2"),
        (HEAD + ",2\n", r"run7\.csv, data row 2, column time_s: found no time, need a number"),
        (b"time_s,label\n0,caf\xe9\n", r"run7\.csv.*found .*UTF8.*need a CSV table"),
    ],
)
def test_a_csv_that_cannot_be_read_says_where(text, message, tmp_path):
    with pytest.raises(TiltcalError, match=message):
        read_text(tmp_path, text)


def test_a_cell_of_blanks_is_empty(tmp_path):
    np.testing.assert_array_equal(
        read_text(tmp_path, HEAD + "1, \n").column("accel_x_g"), [1, np.nan]
    )


@pytest.mark.parametrize("name", ["run7.txt", "run7", "run7.CSV.gz"])
def test_a_wrong_ending_names_the_right_ones(name, tmp_path):
    with pytest.raises(
        TiltcalError,
        match=r"need one of \.csv, \.parquet, \.npz; rename it, or bring a foreign format in",
    ):
        read_text(tmp_path, HEAD, name)
    with pytest.raises(
        TiltcalError, match=r"found the ending .*need one of \.csv, \.parquet, \.npz; rename it"
    ):
        write_recording(Recording(np.zeros(1)), tmp_path / name)


@pytest.mark.parametrize("name", ["run7.parquet", "run7.npz"])
@pytest.mark.parametrize("junk", [b"hello", b"PK\x03\x04 not quite", bytes(range(256)) * 8])
def test_junk_under_a_good_ending_is_refused(name, junk, tmp_path):
    with pytest.raises(TiltcalError, match=rf"recording {name}: found .*; check the file"):
        read_text(tmp_path, junk, name)


def npz(tmp_path, **members):
    np.savez(tmp_path / "r.npz", **members)
    return read_recording(tmp_path / "r.npz")


def test_arrays_of_different_length_are_refused(tmp_path):
    with pytest.raises(
        TiltcalError,
        match=(
            r"array accel_x_g: found 3 values, need as many as time_s, 2; write all arrays at one"
            r" length"
        ),
    ):
        npz(tmp_path, time_s=np.arange(2.0), accel_x_g=np.ones(3))


@pytest.mark.parametrize(
    "members",
    [
        {"time_s": np.array(["a", "b"])},
        {"time_s": np.arange(2.0), "accel_x_g": np.array([1, None], dtype=object)},
        {"time_s": np.arange(2.0), "tiltcal.metadata": np.array("{")},
        {"time_s": np.array(1.0)},
        {"time_s": np.arange(2.0), "note": np.array(3)},
        {"time_s": np.arange(2.0), "accel_x_g": np.ones((2, 2))},
    ],
    ids=[
        "text for numbers",
        "pickled objects",
        "broken metadata",
        "one number",
        "one word",
        "a matrix",
    ],
)
def test_arrays_that_are_no_columns_are_refused(members, tmp_path):
    with pytest.raises(TiltcalError, match=r"r\.npz"):
        npz(tmp_path, **members)


def test_a_bare_array_is_no_archive(tmp_path):
    np.save(tmp_path / "r.npy", np.arange(3.0))
    (tmp_path / "r.npy").rename(tmp_path / "r.npz")
    with pytest.raises(TiltcalError, match="need an NPZ archive"):
        read_recording(tmp_path / "r.npz")


def table(tmp_path, metadata=None, **columns):
    parquet.write_table(pa.table(columns).replace_schema_metadata(metadata), tmp_path / "r.parquet")
    return read_recording(tmp_path / "r.parquet")


def test_a_foreign_parquet_file_of_whole_numbers_reads(tmp_path):
    r = table(
        tmp_path,
        time_s=pa.array([0, 1]),
        accel_x_LSB=pa.array([33000, None], pa.int32()),
        label=pa.array(["a", "b"]).dictionary_encode(),
    )
    np.testing.assert_array_equal(r.column("accel_x_LSB"), [33000, np.nan])
    assert list(r.labels) == ["a", "b"]


@pytest.mark.parametrize(
    "bad", [pa.array(["1", "2"]), pa.array([0, 1], pa.timestamp("s"))], ids=["text", "dates"]
)
def test_parquet_columns_of_another_type_are_refused(bad, tmp_path):
    with pytest.raises(
        TiltcalError,
        match=(
            r"recording r\.parquet, column accel_x_g: found type .*, need numbers; convert that"
            r" column"
        ),
    ):
        table(tmp_path, time_s=pa.array([0.0, 1.0]), accel_x_g=bad)


@pytest.mark.parametrize(
    ("metadata", "note"),
    [
        ({"tiltcal.metadata": "{"}, pa.array(["a", "b"])),
        (None, pa.array([[1], [2]])),
        (None, pa.array([b"\xff", b"a"])),
    ],
    ids=["broken metadata", "lists", "bytes"],
)
def test_parquet_parts_that_do_not_read_are_refused(metadata, note, tmp_path):
    with pytest.raises(TiltcalError, match=r"r\.parquet"):
        table(tmp_path, metadata, time_s=pa.array([0.0, 1.0]), note=note)
