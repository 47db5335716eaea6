"""A long recording is diagnosed by averages over spans of time as it is sample by sample."""

import numpy as np
import pytest

from tiltcal.core.units import DEG
from tiltcal.diagnosis import diagnose as diagnosing
from tiltcal.diagnosis.data.block_grid import BlockGrid
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults import long_recordings
from tiltcal.diagnosis.data_faults.long_recordings import LongRecording, read_long
from tiltcal.diagnosis.data_faults.prepare import static_noise
from tiltcal.diagnosis.diagnose import diagnose, read_for_diagnosis, read_static
from tiltcal.diagnosis.hypotheses import block_averaging
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings import span_means
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording
from tiltcal.recordings.span_means import Spans
from tiltcal.statistics.noise_spectrum import WhiteFlickerWalk

POSES = [(0, 0), (90, 0), (180, 0), (-90, 0), (90, 90), (-90, 90), (45, 30), (0, 180)]


def tumble(effects=(), sequence=None, table="dual"):
    """Four minutes of a triad at 100 Hz on a table that moves every fifteen seconds."""
    step = {"action": "move", "rate_deg_s": 40, "dwell_s": 12}
    usual = [step | {"outer_deg": a, "inner_deg": b} for a, b in POSES * 2]
    return parse_scenario(
        {
            "schema": 1,
            "name": "tumble",
            "site": {"gravity_m_s2": 9.80123},
            "rig": {"table": table},
            "sensor": [
                {
                    "name": "accel",
                    "kind": "accelerometer",
                    "rate_hz": 100,
                    "adjustable": ["bias", "scale", "cross_axis"],
                }
            ],
            "sequence": usual if sequence is None else sequence,
            "effect": list(effects),
        }
    )


TRUTH = [
    {"id": "acc_noise", "white_ug_rthz": 40, "flicker_ug": 3},
    {"id": "acc_bias", "bias_x_ug": 300},
    {"id": "acc_K2", "k2_x_ug_g2": 150},
]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A recording with a quadratic term, and spikes."""
    recording = SimulatedLaboratory().record(tumble(TRUTH), 3)
    column = recording.column("accel_y_m_s2")
    column[np.random.default_rng(5).choice(len(column), 25, replace=False)] += 0.5
    write_recording(recording, path := tmp_path_factory.mktemp("long") / "run.csv")
    return path


@pytest.fixture
def short_is_long(monkeypatch):
    """Limits as if minutes were a day."""
    monkeypatch.setattr(span_means, "LONGEST", 15_000)
    monkeypatch.setattr(long_recordings, "LONGEST", 15_000)
    monkeypatch.setattr(diagnosing, "LONGEST", 15_000)
    monkeypatch.setattr(diagnosing, "AVERAGES", 11_000)
    monkeypatch.setattr(block_averaging, "MOST_ROWS", 8_000)
    monkeypatch.setattr(block_averaging, "ROWS", 4_500)
    monkeypatch.setattr(long_recordings, "PART", 10_000)


@pytest.mark.usefixtures("short_is_long")
def test_averages_tell_what_the_samples_tell(file):
    read = read_for_diagnosis(file, tumble())
    assert isinstance(read, LongRecording)
    assert 8_000 < len(read.recording) < 11_001  # so many that they are averaged in blocks, again
    assert [f.effect.id for f in read.faults] == ["data_outlier"]
    # events of an amended scenario find the recording that they were seen in
    assert read.recording.fingerprint == read_recording(file).fingerprint
    found = diagnose(tumble(), [read])
    whole = diagnose(tumble(), [read_recording(file)])
    assert found.statement.endswith("was read as averages over 0.03 s (3 samples).")
    assert found.verdict == whole.verdict
    for one, other in zip(found.findings, whole.findings, strict=True):
        assert (one.effect, set(one.names)) == (other.effect, set(other.names))
    assert [f.effect for f in found.findings] == ["data_outlier", "acc_K2"]
    value, sigma = found.findings[1].parameters["k2_x_ug_g2"]
    known, its_sigma = whole.findings[1].parameters["k2_x_ug_g2"]
    assert abs(value - known) < 0.3 * its_sigma
    assert sigma == pytest.approx(its_sigma, rel=0.1)


@pytest.mark.usefixtures("short_is_long")
def test_what_averages_do_not_keep_is_looked_for_in_the_beginning(file):
    def silent(said):
        pass

    read = read_long(file, tumble(), Spans(3, 0.01), lambda *_: False, silent)
    whole = read_recording(file)
    assert 0 < len(read.recording) < len(whole)
    np.testing.assert_array_equal(read.recording.time, whole.time[: len(read.recording)])
    assert "only the first" in read.said


@pytest.mark.usefixtures("short_is_long")
def test_what_is_not_averaged_is_read_to_a_stated_length(file, tmp_path):
    whole = read_recording(file)
    codes = {n: np.round(whole.column(n) / 0.006) * 0.006 for n in whole.column_names}
    angles = {n: whole.column(n) for n in codes if n.startswith("table")}
    coarse = Recording.from_columns(whole.time, codes | angles)
    write_recording(coarse, tmp_path / "coarse.npz")
    by_hand = tumble(sequence=[], table="handheld")
    for read, why in (
        (
            read_for_diagnosis(tmp_path / "coarse.npz", tumble()),
            "coarsely quantised readings are not averaged",
        ),
        (read_for_diagnosis(file, by_hand), "hand-held recordings are not averaged"),
        (read_static(file), "they are enough to tell the noise"),
    ):
        assert len(read.recording) == 15_000
        assert f"only the first 149.99 s were read, sample by sample: {why}" in read.said


def test_the_noise_of_a_static_record_is_that_of_the_averages_it_is_compared_with():
    rest = [{"action": "rest", "dwell_s": 150.0}]
    still = SimulatedLaboratory().record(tumble(TRUTH[:1], rest), 4)
    observations = observe(tumble(), [SimulatedLaboratory().record(tumble(TRUTH[:1]), 3)])
    single, blocks = (
        static_noise(o, still, WhiteFlickerWalk) for o in (observations, observations.averaged(5))
    )
    for one, five in zip(single, blocks, strict=True):
        assert five.model.white == pytest.approx(one.model.white / 5**0.5, rel=0.1)


def test_a_block_longer_than_a_move_is_asked_for_where_the_table_moves():
    time = np.arange(20_000) / 10
    stop = np.where(time % 100 < 4, -1, (time // 100).astype(int))
    turned = np.clip(time % 100, 0, 4) / 4
    angle = 70 * DEG * (time // 100 + turned)
    grids = {
        "middles": BlockGrid.middles(time, 130),
        "motion": BlockGrid.by_motion(time, 130, {"outer": angle}, stop),
    }
    starts = np.arange(0, len(time), 130)
    whole = np.add.reduceat(np.cos(2 * angle), starts) / np.diff(starts, append=len(time))
    off = {}
    for name, grid in grids.items():
        found = grid.means(np.cos(2 * np.interp(grid.time, time, angle)))
        assert len(found) in (len(whole), len(whole) - 1)
        off[name] = np.abs(found[:-1] - whole[: len(found) - 1]).max()
    assert len(grids["motion"].time) < 8 * len(starts)
    assert off["middles"] > 0.3
    assert off["motion"] < 0.05
