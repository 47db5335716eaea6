"""Correcting a long recording: in fixed memory, with gaps that differ from chunk to chunk, whole or
not at all.
"""

import subprocess
import sys

import numpy as np
import pytest

from tiltcal.calibration.result import load_calibration
from tiltcal.cli import main
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording


def long_log(path, rows):
    """A log whose pressure is sampled from its second half on, so that gaps differ from chunk to
    chunk.
    """
    names = (
        "time_s",
        "accel_x_m_s2",
        "pressure_V",
        "accel_y_m_s2",
        "accel_z_m_s2",
        "label",
        "remark",
    )
    third = np.random.default_rng(1).normal(size=(rows, 3))
    with path.open("w") as out:
        out.write(",".join(names) + "\n")
        for i, (x, y, z) in enumerate(third.tolist()):
            pressure = i / 7 if i > rows // 2 else ""
            out.write(f"{i / 100},{x!r},{pressure},{y!r},{z + 9.8!r},+z,row {i}\n")
    return path


MEASURED = """
import resource, sys
from tiltcal.cli import main
status = main(sys.argv[1:])
print(status, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_of(*words):
    """Peak memory of a command, MiB."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, *map(str, words)],
        capture_output=True,
        text=True,
        check=True,
    )
    status, kibibytes = done.stdout.split()
    assert status == "0"
    return int(kibibytes) / 1024


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_long_recording_is_corrected_in_the_memory_of_a_short_one(suffix, good, here):
    peaks, sizes = [], []
    for rows in (40_000, 200_000):
        path = long_log(here / "long.csv", rows)
        sizes.append(path.stat().st_size)
        if suffix == ".parquet":
            write_recording(read_recording(path), path := here / "long.parquet")
        peaks.append(peak_of("correct", good / "CAL.json", path, "-o", "out.csv"))
    assert sizes[1] > 15e6
    assert peaks[1] - peaks[0] < 40, peaks
    original, corrected = read_recording(here / "long.csv"), read_recording("out.csv")
    for name in original.column_names:
        np.testing.assert_array_equal(corrected.column(name), original.column(name))
    assert corrected.extra["remark"].tolist() == original.extra["remark"].tolist()
    setup, calibration = load_scenario(good / "bench.toml"), load_calibration(good / "CAL.json")
    expected = calibration.correct(
        setup.sensor[0], original.sensor(setup.sensor[0]).values, setup.site.gravity
    )
    for i, axis in enumerate("xyz"):
        np.testing.assert_allclose(
            corrected.column(f"accel_{axis}_corrected_m_s2"), expected[:, i], rtol=0, atol=1e-13
        )


def test_a_bad_line_far_into_a_long_recording_is_named_and_leaves_nothing(good, here, capsys):
    lines = long_log(here / "long.csv", 40_000).read_text().splitlines()
    cells = lines[30_000].split(",")
    for bad, words in (
        (["oops", *cells[1:]], "line 30001, column time_s: found the text 'oops'"),
        (["7", *cells[1:]], "time"),
    ):
        text = [*lines[:30_000], ",".join(bad), *lines[30_001:]]
        (here / "long.csv").write_text("\n".join(text))
        assert main(["correct", str(good / "CAL.json"), "long.csv", "-o", "out.csv"]) == 2
        assert words in capsys.readouterr().err
        assert [p.name for p in here.iterdir()] == ["long.csv"]
