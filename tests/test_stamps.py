"""Stamps of a regular clock without the rounding that they were written with."""

import numpy as np
import pytest
from builders import FOG, setup_of

from tiltcal.core.units import ARCSEC
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.stamps import sampled_at, unrounded

ROW = np.arange(5000.0)


@pytest.mark.parametrize(("step", "decimals"), [(1 / 12, 4), (1 / 3, 3), (1 / 60, 3), (0.05, 2)])
@pytest.mark.parametrize("kept", [1.0, 0.9])
@pytest.mark.parametrize("epoch", [17.3, 1.7e9])
def test_a_regular_clock_is_told_beyond_its_rounding(step, decimals, kept, epoch, rng):
    time = (epoch + step * ROW)[rng.random(len(ROW)) < kept]
    read = np.round(time, decimals)
    rounded = np.abs(read - time).max()
    assert np.abs(unrounded(read) - time).max() <= max(rounded / 30, 1e-9, 2 * np.spacing(epoch))


def test_irregular_stamps_stay_as_they_are(rng):
    time = np.round(0.05 * ROW + 1e-3 * rng.standard_normal(len(ROW)), 4)
    assert unrounded(time) is time


def test_a_clock_that_bends_stays_as_it_is():
    """1 ppm of the recording at its middle is 60 us: more than the rounding."""
    time = np.round(0.05 * ROW + 6e-5 * np.sin(np.pi * ROW / len(ROW)), 5)
    assert unrounded(time) is time


@pytest.mark.parametrize("ticks", [False, True])
def test_rates_of_a_readout_do_not_follow_the_rounding_of_its_stamps(ticks, rng):
    """A swing of 30 deg, 12 samples a second: 33 us are 6 arcsec at its fastest. The stamps are
    written rounded, or the recorder's clock ticks every 0.1 ms and the rows are sampled then.
    """
    even = ROW[:1200] / 12
    written = np.round(even, 4)
    setup = setup_of("placing", FOG)
    error = []
    for time, stamps in ((even, even), (written if ticks else even, written)):
        angle = np.deg2rad(30) * np.sin(time) + 0.05 * ARCSEC * rng.standard_normal(len(time))
        columns = {"table_outer_deg": np.rad2deg(angle)}
        course = replay(Recording.from_columns(stamps, columns), setup)
        rate = course.drive(stamps).axes["outer"].v
        error.append(np.sqrt(np.mean((rate - np.deg2rad(30) * np.cos(time))[20:-20] ** 2)))
    assert error[1] < 1.2 * error[0]


@pytest.mark.parametrize("rows", [4, 5, 5000])
def test_of_a_readout_at_rest_the_clock_is_even(rows):
    time = np.round(ROW[:rows] / 12, 4)
    assert sampled_at(time, np.zeros_like(time)) == pytest.approx(ROW[:rows] / 12, abs=5e-5)


@pytest.mark.parametrize("ticks", [False, True])
def test_samples_that_were_lost_in_a_fast_turn_do_not_hide_how_the_clock_ticks(ticks, rng):
    """Across a lost row no readout is smooth: that says nothing of the stamps."""
    kept = rng.random(2000) > 0.005
    even = ROW[:2000][kept] / 36
    written = np.round(even, 4)
    sampled = written if ticks else even
    angle = np.deg2rad(60) * np.sin(0.5 * sampled) + 0.05 * ARCSEC * rng.standard_normal(kept.sum())
    assert sampled_at(written, angle) == pytest.approx(sampled, abs=2e-6)
