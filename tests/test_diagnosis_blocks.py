"""Long records are averaged in blocks: what is fitted to them is what would be fitted to every
sample.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from builders import ACCEL, GYRO, setup_of

from tiltcal.diagnosis.data.table_channels import TableObservations
from tiltcal.diagnosis.hypotheses.block_averaging import MOST_ROWS, READINGS, ROWS, block_of
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.effects import make_effect
from tiltcal.effects.learned import LearnedReading, LearnedTilt
from tiltcal.effects.spans import SpectralLines
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.span_means import AVERAGED

STEPS = [
    {
        "action": "move",
        "outer_deg": 100.0 * k % 360,
        "inner_deg": 70.0 * k % 360,
        "rate_deg_s": 40,
        "dwell_s": 6,
    }
    for k in range(5)
]


@pytest.fixture(scope="module")
def whole():
    setup = setup_of("dual", *(s.model_copy(update={"rate_hz": 100}) for s in (ACCEL, GYRO)))
    scenario = parse_scenario(
        {"schema": 1, **setup.model_dump(exclude_none=True), "sequence": STEPS}
    )
    return TableObservations(scenario, [SimulatedLaboratory().record(scenario, 3)], ())


def effect(whole, id, values, **where):
    return make_effect(id, values, whole.scenario, **where)


SLOW = ("acc_K2", {"k2_x_ug_g2": 300.0}, {"sensor": "accel"})
QUICK = (
    "settling_transient",
    {"amplitude_arcsec": 100.0, "frequency_hz": 9.0, "tau_s": 0.3},
    {"axis": "outer"},
)
SHARP = ("acc_bias_asym", {"bias_asym_x_ug": 300.0}, {"sensor": "accel"})


@pytest.mark.parametrize(
    ("case", "quick"), [(SLOW, False), (QUICK, True), (SHARP, True)], ids=["slow", "quick", "sharp"]
)
def test_a_block_is_predicted_as_the_mean_of_its_samples(whole, case, quick):
    id, values, where = case
    blocks, one = whole.averaged(8), effect(whole, id, values, **where)
    assert blocks.quick(one) is quick
    blocks.predict([])
    for mean, samples, nominal in zip(
        blocks.predict([one]), whole.predict([one]), whole.predict([]), strict=True
    ):
        starts = np.arange(0, len(samples), 8)
        exact = np.add.reduceat(samples, starts) / np.diff(starts, append=len(samples))
        assert np.abs(mean - exact).max() <= 0.01 * np.abs(samples - nominal).max() + 1e-12


@pytest.mark.parametrize("block", [5, 8])
def test_a_delay_changes_a_block_by_the_mean_of_its_changes(whole, block):
    """It goes with the rate, which half a sample changes most where a move begins."""
    blocks = whole.averaged(block)
    late = effect(whole, "data_latency", {"latency_ms": 1.0}, sensor="accel")
    for i, column in whole.changes(late, ()).items():
        starts = np.arange(0, len(column), block)
        exact = np.add.reduceat(column, starts) / np.diff(starts, append=len(column))
        assert np.abs(blocks.changes(late, ())[i] - exact).max() < 0.015 * np.abs(column).max()


def test_what_is_quick_changes_a_block_by_the_mean_of_its_changes(whole):
    id, values, where = QUICK
    blocks, one = whole.averaged(8), effect(whole, id, values, **where)
    for i, column in whole.changes(one, ()).items():
        starts = np.arange(0, len(column), 8)
        assert np.allclose(
            blocks.changes(one, ())[i],
            np.add.reduceat(column, starts) / np.diff(starts, append=len(column)),
        )


@pytest.mark.parametrize(
    "curve",
    [
        curve_over(LearnedTilt, "time", 4, period=0.3, slot="mount", turn="x", place="mount"),
        curve_over(LearnedReading, "time", 4, period=0.3, sensor="accel", axis="y"),
    ],
    ids=["tilt", "reading"],
)
def test_the_columns_of_a_quick_curve_are_the_changes_by_each_coefficient(whole, curve):
    blocks = whole.averaged(8)
    assert blocks.quick(curve.effect)
    found = blocks.columns(curve.effect, curve.names, ())
    assert found
    for k, name in enumerate(curve.names):
        expected = blocks.changes(curve.alone(name), ())
        for i, (which, rows) in found.items():
            np.testing.assert_allclose(rows[which.index(k)], expected[i], atol=1e-12)


def test_blocks_are_of_the_same_rows_whatever_cells_are_missing(whole):
    """Where each block were of so many readings of its own channel, those of a channel that lacks a
    few would come later and later.
    """
    recording, rng = whole.recordings[0], np.random.default_rng(5)
    lacking = rng.random(len(recording)) < 0.02
    every = {n: recording.column(n) for n in recording.column_names}
    cells = {n: np.where(lacking & n.startswith("gyro"), np.nan, c) for n, c in every.items()}
    lacks = Recording.from_columns(recording.time, cells, metadata=recording.metadata)
    some = TableObservations(whole.scenario, [lacks], ())
    blocks = some.averaged(8)
    larger = effect(whole, "gyr_scale", {"scale_x_ppm": 1000.0}, sensor="gyro")
    (i,) = some.changes(larger, ())
    where, column = blocks.channels[i], blocks.changes(larger, ())[i]
    full = whole.averaged(8)
    j = next(k for k, c in enumerate(full.channels) if c.name == where.name)
    complete = full.changes(larger, ())[j]
    here = where.rows // 8
    assert np.abs(column - complete[here]).max() < 1e-3 * np.abs(complete).max()
    said = blocks.predict([larger])[i] - full.predict([larger])[j][here]
    assert np.abs(said).max() < 0.1 * np.abs(full.predict([])[j]).max() / 8
    fewer = lacking[: 8 * len(full.channels[j].values)].reshape(-1, 8).any(axis=1)[here]
    assert where.spread is not None
    assert (where.spread[fewer] > 1.05).all()


def test_what_is_known_at_the_instants_of_a_model_is_known_at_those_of_the_blocks(whole):
    """The blocks of a file that was averaged as it was read have many instants where it moved."""
    recording = whole.recordings[0]
    columns = {n: recording.column(n) for n in recording.column_names}
    metadata = {**recording.metadata, AVERAGED: "0.06 s (6 samples)"}
    read = Recording.from_columns(recording.time, columns, metadata=metadata)
    blocks = TableObservations(whole.scenario, [read], ()).averaged(16)
    (watch,) = blocks.watches(())
    assert len(watch.time) > len(blocks.block_times(0))
    for i, channel in enumerate(blocks.channels):
        assert np.allclose(blocks.at_samples(i, watch.time), channel.time)
        assert np.allclose(blocks.block_times(0)[blocks.blocks(i)], channel.time)


class Long:
    """Observations of so many rows, at 100 Hz."""

    def __init__(self, rows, channels=1):
        time = np.arange(rows) / 100.0
        self.channels = [type("Channel", (), {"values": time})()] * channels
        self.samples = rows * channels
        self.recordings = [type("Recording", (), {"time": time})()]
        self.courses = []


def test_a_short_record_is_not_averaged():
    assert block_of(Long(2 * ROWS - 1), SpectralLines()) == 1


def test_a_long_record_keeps_as_many_rows_however_long_it_is():
    for rows in (8000, 30000, 60000, 240000):
        assert ROWS <= rows / block_of(Long(rows), SpectralLines()) <= 1.35 * ROWS


def test_of_many_channels_fewer_rows_are_kept():
    assert block_of(Long(2500, channels=7), SpectralLines()) == 1
    for rows in (9500, 60000):
        left = 7 * rows / block_of(Long(rows, channels=7), SpectralLines())
        assert READINGS <= left <= 1.2 * READINGS


def test_a_line_keeps_its_power_where_the_rows_allow_it():
    assert block_of(Long(MOST_ROWS), SpectralLines(tones=(40.0,))) == 1
    assert block_of(Long(60000), SpectralLines()) == 20
    assert block_of(Long(60000), SpectralLines(tones=(2.2,))) == 11
    assert block_of(Long(60000), SpectralLines(tones=(4.5,))) == 5
    # a mean over ten samples would hold three whole periods, and nothing
    assert block_of(Long(60000), SpectralLines(tones=(30.0,))) == 5


def test_a_block_is_short_beside_the_motion():
    """A table that swings keeps its rates: half of a swing in one block would leave none."""
    long = Long(60000)
    time = long.recordings[0].time

    def block_beside(hz):
        drive = SimpleNamespace(axes={"outer": SimpleNamespace(v=np.sin(2 * np.pi * hz * time))})
        long.courses = [SimpleNamespace(time=time, drive=lambda _: drive)]
        return block_of(long, SpectralLines())

    assert block_beside(0.1) == 20
    assert block_beside(2.2) == 11
