"""Long recordings as averages over spans of time: what the samples say, in bounded memory."""

import json
import re
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from tiltcal.api.calibrating import estimate
from tiltcal.cli import main
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings import span_means
from tiltcal.recordings.pieces import part_of, writing
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.rest_noise import rest_noise, rest_noise_of
from tiltcal.recordings.saving import write_recording
from tiltcal.recordings.span_means import AVERAGED, Spans, averaged, read_averaged, whole_spans
from tiltcal.statistics.allan import RunningAllan, allan_deviation

SPANS = Spans(10, 0.01)


def log(rows=5000):
    """A triad on every row, a gyro on every third, a table read on all, a gap of seven seconds."""
    rng = np.random.default_rng(1)
    time = np.arange(rows) / 100 + np.where(np.arange(rows) < rows // 2, 0.0, 7.0)
    columns = {f"accel_{a}_m_s2": rng.normal(0, 1, rows) for a in "xyz"}
    columns["gyro_z_deg_s"] = np.where(np.arange(rows) % 3, np.nan, rng.normal(0, 1, rows))
    columns["table_outer_deg"] = 5 * time
    columns["temperature_degC"] = np.where(np.arange(rows) % 50, np.nan, 20 + time / 10)
    return Recording.from_columns(time, columns, labels=np.full(rows, "+x", dtype=object))


def test_a_span_holds_the_mean_of_its_rows_and_of_the_angles_beside_them():
    found = averaged(recording := log(), SPANS)
    there = ~np.isnan(found.column("accel_x_m_s2"))
    assert there.sum() == 500
    own = recording.column("accel_x_m_s2")[:10].mean()
    assert found.column("accel_x_m_s2")[there][0] == pytest.approx(own)
    turn = found.column("table_outer_deg")
    np.testing.assert_allclose(turn[there], 5 * found.time[there], rtol=1e-12)
    warm = ~np.isnan(found.column("temperature_degC"))
    np.testing.assert_allclose(
        found.column("temperature_degC")[warm], 20 + found.time[warm] / 10, rtol=1e-12
    )
    turned = ~np.isnan(found.column("gyro_z_deg_s"))
    rows = np.arange(0, 5000, 3)
    first = rows[SPANS.numbers(recording.time[rows]) == SPANS.numbers(recording.time[:1])]
    assert found.time[turned][0] == pytest.approx(recording.time[first].mean())
    assert set(found.labels) == {"+x"}


def test_averages_do_not_depend_on_the_pieces():
    recording = log()
    cuts = [0, 13, 700, 701, 2499, 5000]
    pieces = [part_of(recording, a, b) for a, b in pairwise(cuts)]
    for rows in (1, 1000):
        parts = list(whole_spans(pieces, SPANS, rows))
        assert sum(len(p) for p in parts) == len(recording)
        assert min(len(p) for p in parts) >= rows
        numbers = [SPANS.numbers(p.time) for p in parts]
        assert all(a[-1] < b[0] for a, b in pairwise(numbers))
        means = np.concatenate([averaged(p, SPANS).column("accel_x_m_s2") for p in parts])
        whole = averaged(recording, SPANS).column("accel_x_m_s2")
        np.testing.assert_allclose(
            means[~np.isnan(means)], whole[~np.isnan(whole)], rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_short_recording_and_one_of_coarse_codes_are_taken_as_they_are(
    suffix, tmp_path, monkeypatch
):
    write_recording(log(), path := tmp_path / f"log{suffix}")
    assert AVERAGED not in read_averaged(path).metadata
    assert read_averaged(path).fingerprint == read_recording(path).fingerprint
    monkeypatch.setattr(span_means, "LONGEST", 1000)
    assert read_averaged(path).metadata[AVERAGED] in ("0.05 s (5 samples)", "0.06 s (6 samples)")
    rng = np.random.default_rng(1)
    coarse = {"accel_x_LSB": np.round(rng.normal(0, 0.5, 5000)) + 7 * (np.arange(5000) // 999)}
    write_recording(Recording.from_columns(np.arange(5000) / 100, coarse), path)
    assert AVERAGED not in read_averaged(path).metadata


def test_coarse_codes_of_more_rows_than_there_is_memory_for_are_refused(
    tmp_path, monkeypatch, capsys
):
    """They are not averaged: the whole recording would be in memory."""
    rows, rng = 30_000, np.random.default_rng(1)
    coarse = {"accel_x_LSB": np.round(rng.normal(0, 0.5, rows))}
    write_recording(Recording.from_columns(np.arange(rows) / 100, coarse), tmp_path / "coarse.npz")
    monkeypatch.setattr(span_means, "LONGEST", 10_000)
    command = ["noise", str(tmp_path / "coarse.npz"), "--allow-memory", "2"]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "whose quantisation is coarse, so that it is not averaged" in said
    assert "cut it into shorter recordings, or allow it with --allow-memory 3" in said
    assert main([*command[:-1], "4"]) == 0


def test_allan_deviation_in_pieces_is_that_of_the_whole():
    rng = np.random.default_rng(4)
    values = 3.0 + rng.normal(0, 1, 100_000) + np.cumsum(rng.normal(0, 1e-3, 100_000))
    running = RunningAllan(len(values))
    for piece in np.split(values, [1, 40, 41, 7000, 7001, 65_000]):
        running.add(piece)
    found, whole = running.deviation(100.0), allan_deviation(values, 100.0)
    np.testing.assert_array_equal(found.tau, whole.tau)
    dense = found.tau <= 0.64
    np.testing.assert_allclose(found.deviation[dense], whole.deviation[dense], rtol=1e-9)
    np.testing.assert_allclose(found.deviation, whole.deviation, rtol=0.01)


def tumble():
    """Ten minutes of a triad at 100 Hz."""
    step = {"action": "move", "rate_deg_s": 40, "dwell_s": 20}
    poses = [(0, 0), (90, 0), (180, 0), (-90, 0), (90, 90), (-90, 90), (45, 30), (0, 180)]
    return parse_scenario(
        {
            "schema": 1,
            "name": "tumble",
            "site": {"gravity_m_s2": 9.80123},
            "rig": {"table": "dual"},
            "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": 100}],
            "sequence": [step | {"outer_deg": a, "inner_deg": b} for a, b in poses * 3],
            "effect": [
                {"id": "acc_noise", "white_ug_rthz": 40, "flicker_ug": 3},
                {"id": "acc_bias", "bias_x_ug": 300},
            ],
        }
    )


def test_a_calibration_by_averages_is_that_by_samples(tmp_path, monkeypatch):
    scenario = tumble()
    write_recording(SimulatedLaboratory().record(scenario, 3), path := tmp_path / "run.parquet")
    whole, _ = estimate("six_position", read_averaged(path), scenario, {})
    monkeypatch.setattr(span_means, "LONGEST", 10_000)
    found, _ = estimate("six_position", recording := read_averaged(path), scenario, {})
    assert len(recording) < 10_001
    assert f"was read as averages over {recording.metadata[AVERAGED]}" in found.warnings[-1]
    assert (found.verdict, len(found.poses)) == (whole.verdict, len(whole.poses))
    for name, one in whole.parameters.items():
        other = found.parameters[name]
        assert abs(other.value - one.value) < 0.2 * one.sigma
        assert other.sigma == pytest.approx(one.sigma, rel=0.1)


def at_rest(rows):
    """A triad at rest."""
    rng = np.random.default_rng(2)
    values = {f"accel_{a}_m_s2": rng.normal(0, 1e-3, rows) for a in "xyz"}
    return Recording.from_columns(np.arange(rows) / 100, values)


def test_noise_of_a_long_recording_is_that_of_its_samples_and_says_how(
    tmp_path, monkeypatch, capsys
):
    write_recording(at_rest(60_000), path := tmp_path / "rest.csv")
    whole = rest_noise(read_recording(path)).models
    assert not any(model.notes for model in whole.values())
    monkeypatch.setattr(span_means, "LONGEST", 10_000)
    said = (
        r"rest\.csv was read as averages over 0\.0[67] s \([67] samples\) to find its standstills"
    )
    assert main(["noise", str(path)]) == 0
    assert len(re.findall(said, " ".join(capsys.readouterr().out.split()))) == 1
    assert main(["noise", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["channels"]
    assert all(re.search(said, model["notes"][0]) for model in told.values())
    for name, model in rest_noise_of(path).models.items():
        assert model.values["N"] == pytest.approx(whole[name].values["N"], rel=1e-3)
        assert model.held == whole[name].held


PEAK = """
import json, resource, sys
from tiltcal.cli import main
from tiltcal.recordings import span_means
from tiltcal.recordings.rest_noise import rest_noise_of
span_means.LONGEST = 50_000
span_means.read_averaged(sys.argv[1])
rest_noise_of(sys.argv[1])
print(json.dumps(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss))
"""


def test_memory_does_not_grow_with_the_rows(tmp_path):
    peaks, rows = [], (200_000, 800_000)
    recording = at_rest(rows[1])
    for n in rows:
        with writing(path := tmp_path / f"{n}.parquet") as write:
            for piece in np.array_split(np.arange(n), n // 50_000):
                write(part_of(recording, piece[0], piece[-1] + 1))
        done = subprocess.run(
            [sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True
        )
        peaks.append(1024 * json.loads(done.stdout))
    # one column of the samples alone takes 8 bytes a row
    assert (peaks[1] - peaks[0]) / (rows[1] - rows[0]) < 16
