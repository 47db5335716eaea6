"""Every command on good input, end to end, as a user strings them together."""

import json
import subprocess
import sys

import numpy as np
import pytest
from scenario_files import FACES

from tiltcal.calibration.result import load_calibration
from tiltcal.cli import main
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording

SUFFIXES = (".csv", ".parquet", ".npz")


def answer(capsys, *words, status=0):
    """What a command says with --json."""
    capsys.readouterr()
    assert main([str(w) for w in (*words, "--json")]) == status
    return json.loads(capsys.readouterr().out)


# --------------------------------------------------------------------------------------------------
# ---- a first session


def test_the_first_steps_of_the_help_work_as_printed(here, capsys):
    assert main(["init", "-o", "bench.toml"]) == 0
    assert main(["simulate", "bench.toml", "-o", "run.csv", "--truth", "truth.json"]) == 0
    assert (
        main(
            [
                "calibrate",
                "run.csv",
                "--scenario",
                "bench.toml",
                "--method",
                "six_position",
                "-o",
                "CAL.json",
            ]
        )
        == 0
    )
    assert main(["correct", "CAL.json", "run.csv", "-o", "corrected.csv"]) == 0
    assert main(["run", "bench.toml"]) == 0
    assert "verdict: good" in capsys.readouterr().out
    assert {p.name for p in here.iterdir()} == {
        "bench.toml",
        "run.csv",
        "truth.json",
        "CAL.json",
        "corrected.csv",
    }


def test_init_writes_the_table_that_is_stated(here, good, capsys):
    """Also against the recording, which has the columns of two axes."""
    for source in ([], ["--from", str(good / "run.csv")]):
        assert (
            main(["init", *source, "--table", "handheld", "--latitude", "48", "-o", "h.toml"]) == 0
        )
        made = load_scenario(here / "h.toml")
        assert made.rig.table == "handheld"
        assert not made.sequence
    assert main(["init", "--table", "handhold", "--latitude", "48"]) == 2
    assert "did you mean 'handheld'" in capsys.readouterr().err


@pytest.mark.usefixtures("here")
def test_gravity_of_a_new_scenario_follows_latitude_and_height(capsys):
    main(["init", "--latitude", "45", "--height", "1000", "-o", "a.toml"])
    table = load_scenario("a.toml")
    assert table.site.latitude_deg == 45
    # WGS 84 at 45 deg; free air
    assert table.site.gravity == pytest.approx(9.8061978 - 1000 * 3.086e-6, abs=1e-6)
    capsys.readouterr()
    main(["init"])
    assert capsys.readouterr().out.startswith("# A tiltcal scenario")


def test_a_scenario_from_a_recording_fits_that_recording(good, here, capsys):
    recording = read_recording(good / "run.csv")
    more = (
        "oven_x_degC",
        "tilt_x_deg",
        "my_gyro_x_deg_s",
        "fog_a_deg_h",
        "incl_x_arcsec",
        "incl_y_arcsec",
    )
    write_recording(
        recording.with_columns({name: np.ones(len(recording)) for name in more}),
        here / "motley.csv",
    )
    assert main(["init", "--from", "motley.csv", "-o", "own.toml"]) == 0
    own = load_scenario("own.toml")
    assert (own.rig.table, [s.name for s in own.sensor]) == ("dual", ["accel", "fog", "incl"])
    assert own.named("accel").rate_hz == 50
    assert (
        main(
            [
                "calibrate",
                "motley.csv",
                "--scenario",
                "own.toml",
                "--method",
                "six_position",
                "--option",
                "sensor=accel",
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "columns that belong to no sensor of the scenario are ignored: " in said
    assert "oven_x_degC" in said


# --------------------------------------------------------------------------------------------------
# - simulate, segments


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_holds_the_same_simulated_recording(suffix, good, here):
    assert main(["simulate", str(good / "bench.toml"), "-o", f"run{suffix}"]) == 0
    first, second = read_recording(good / "run.csv"), read_recording(here / f"run{suffix}")
    for name in first.column_names:
        np.testing.assert_array_equal(first.column(name), second.column(name))
    assert second.labels.tolist() == first.labels.tolist()
    assert second.metadata == first.metadata


def test_without_an_output_the_csv_goes_to_stdout(good):
    words = [sys.executable, "-m", "tiltcal", "simulate", str(good / "bench.toml")]
    done = subprocess.run(words, capture_output=True, check=True)
    assert done.stdout == (good / "run.csv").read_bytes()


@pytest.mark.usefixtures("here")
def test_the_seed_decides_what_is_random_and_noise_off_leaves_nothing_random(good):
    def column(*words):
        main(["simulate", str(good / "bench.toml"), "-o", "a.csv", *words])
        return read_recording("a.csv").column("accel_x_m_s2")

    assert np.array_equal(column("--seed", "8"), column("--seed", "8"))
    assert not np.array_equal(column("--seed", "8"), column("--seed", "9"))
    assert np.array_equal(column("--seed", "8", "--noise", "off"), column("--noise", "off"))
    assert len(set(column("--noise", "off")[:100])) == 1


def test_the_truth_stands_apart_and_not_in_the_recording(good):
    truth = json.loads((good / "truth.json").read_text())
    assert [e["id"] for e in truth["effects"]] == ["acc_noise", "acc_bias", "acc_scale"]
    up = np.array([p["up"] for p in truth["poses"]])
    word = {"x": 0, "y": 1, "z": 2}
    stated = np.array(
        [np.eye(3)[word[label[1]]] * (1 if label[0] == "+" else -1) for _, _, label in FACES]
    )
    np.testing.assert_allclose(up, stated, atol=1e-12)
    recording = read_recording(good / "run.csv")
    assert set(recording.metadata) == {"scenario", "seed", "made by"}
    assert not any("3000" in value or "bias" in value for value in recording.metadata.values())
    assert sorted(recording.column_names) == sorted(
        [
            "table_outer_deg",
            "table_inner_deg",
            "temperature_degC",
            "accel_x_m_s2",
            "accel_y_m_s2",
            "accel_z_m_s2",
        ]
    )


def test_segments_go_out_are_edited_and_come_back(good, here, capsys):
    lines = (good / "SEG.csv").read_text().splitlines()
    assert lines[0] == "start_s,end_s,kind,label"
    dwells = [line for line in lines if ",dwell," in line]
    assert [line.rsplit(",", 1)[1] for line in dwells] == [label for _, _, label in FACES]
    (here / "edited.csv").write_text("\n".join([lines[0], *dwells[1:], "0.5,1.5,dwell,+z"]))
    words = (
        "calibrate",
        good / "run.csv",
        "--scenario",
        good / "bench.toml",
        "--method",
        "six_position",
    )
    found = answer(capsys, *words, "--segments", here / "edited.csv")
    spans = [(p["start_s"], p["end_s"]) for p in found["poses"]]
    assert (0.5, 1.5) in spans
    assert len(spans) == 6
    whole = answer(capsys, *words)
    ratio = (
        whole["parameters"]["accel.bias_z"]["sigma"] / found["parameters"]["accel.bias_z"]["sigma"]
    )
    assert ratio < 1  # a third of the first dwell knows less


# -------------------------------------------------------------------------------------------
# calibrate, correct, check


def test_the_file_of_a_calibration_is_what_json_prints(good, here, capsys):
    words = (
        "calibrate",
        good / "run.csv",
        "--scenario",
        good / "bench.toml",
        "--method",
        "six_position",
    )
    printed = answer(capsys, *words, "-o", here / "CAL.json")
    assert (
        printed
        == json.loads((here / "CAL.json").read_text())
        == json.loads((good / "CAL.json").read_text())
    )
    assert set(printed) >= {
        "schema",
        "method",
        "verdict",
        "equation",
        "inverse",
        "frames",
        "parameters",
        "covariance",
        "tests",
    }
    assert printed["provenance"]["setup"]["site"]["gravity_m_s2"] == 9.80123
    names, matrix = printed["covariance"]["names"], np.array(printed["covariance"]["matrix"])
    sigmas = [printed["parameters"][n]["sigma"] for n in names]
    np.testing.assert_allclose(np.sqrt(np.diag(matrix)), sigmas, rtol=1e-12)


@pytest.mark.parametrize(
    ("count", "method", "verdict"),
    [
        (5, "six_position", "suspect"),
        (2, "six_position", "cannot_tell"),
        (6, "norm", "cannot_tell"),
    ],
)
def test_what_is_not_good_ends_with_one(count, method, verdict, good, here, capsys):
    lines = (good / "SEG.csv").read_text().splitlines()
    dwells = [line for line in lines if ",dwell," in line][:count]
    (here / "few.csv").write_text("\n".join([lines[0], *dwells]))
    option = ["--option", "terms=6"] if method == "norm" else []
    words = [
        "calibrate",
        good / "run.csv",
        "--scenario",
        good / "bench.toml",
        "--method",
        method,
        *option,
    ]
    assert answer(capsys, *words, "--segments", here / "few.csv", status=1)["verdict"] == verdict


def with_strangers(recording):
    """Unknown columns of text and numbers, a second slower sensor, words that need quotes; in the
    file's own way.
    """
    n = len(recording)
    odd = np.where(np.arange(n) % 7 == 0, np.sqrt(np.arange(n)) / 3, np.nan)
    columns = {name: recording.column(name) for name in recording.column_names} | {
        "pressure_V": odd,
        "x_mV": np.arange(n) / 7,
    }
    words = np.array([None if i % 3 else f'note "{i}", done' for i in range(n)], dtype=object)
    return Recording.from_columns(
        recording.time,
        columns,
        labels=recording.labels,
        extra={"remark, free": words},
        metadata={"operator": "Ada"},
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_correcting_equals_the_calibration_in_memory_and_passes_all_else_through(
    suffix, good, here
):
    original = with_strangers(read_recording(good / "run.csv"))
    write_recording(original, here / f"in{suffix}")
    assert main(["correct", str(good / "CAL.json"), f"in{suffix}", "-o", "out.csv"]) == 0
    corrected, calibration = read_recording("out.csv"), load_calibration(good / "CAL.json")
    setup = load_scenario(good / "bench.toml")
    sensor = setup.named("accel")
    expected = calibration.correct(sensor, original.sensor(sensor).values, setup.site.gravity)
    for i, axis in enumerate("xyz"):
        np.testing.assert_array_equal(
            corrected.column(f"accel_{axis}_corrected_m_s2"), expected[:, i]
        )
    tilt = np.degrees(np.arcsin(expected[:, 0] / np.linalg.norm(expected, axis=1)))
    np.testing.assert_allclose(corrected.column("tilt_x_deg"), tilt, atol=1e-11)
    for name in original.column_names:
        np.testing.assert_array_equal(corrected.column(name), original.column(name))
    assert corrected.labels.tolist() == original.labels.tolist()
    assert corrected.extra["remark, free"].tolist() == original.extra["remark, free"].tolist()
    assert corrected.metadata == {"operator": "Ada"}
