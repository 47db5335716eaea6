"""A thermometer's codes are not its temperature."""

import numpy as np
import pytest

from tiltcal.recordings.temperature import smooth_temperature

TIME = np.arange(0.0, 400.0, 0.1)
TRUE = 25 + 2 * np.sin(2 * np.pi * TIME / 300) + TIME / 200


def slope_error(told, there):
    return float(np.std((np.gradient(told, TIME) - np.gradient(TRUE, TIME))[there]))


@pytest.mark.parametrize("every", [1, 20])
def test_rounded_readings_now_and_then_tell_the_rate_of_warming(every):
    read = np.full(len(TIME), np.nan)
    read[::every] = np.round(TRUE[::every], 2)
    told = smooth_temperature(TIME, read)
    read_there = TIME[::every][-1] >= TIME
    assert np.abs(told - TRUE)[read_there].max() < 0.03  # three codes, at the ends
    plain = np.interp(TIME, TIME[::every], read[::every])
    assert slope_error(told, read_there) < 0.5 * slope_error(plain, read_there)


def test_noise_is_taken_off_as_well(rng):
    told = smooth_temperature(TIME, TRUE + rng.normal(0, 0.02, len(TIME)))
    assert np.std(told - TRUE) < 0.005


@pytest.mark.parametrize("exact", [TRUE, 20 + 0.01 * TIME, np.full(len(TIME), 21.5)])
def test_a_temperature_that_was_computed_is_left_as_it_is(exact):
    np.testing.assert_array_equal(smooth_temperature(TIME, exact), exact)


def test_gaps_are_bridged_and_the_ends_held():
    read = np.where((TIME > 50) & (TIME < 350), 21.0, np.nan)
    np.testing.assert_array_equal(smooth_temperature(TIME, read), np.full(len(TIME), 21.0))


def test_the_rate_of_warming_goes_on_after_the_last_reading():
    """Read each 10 s, the last time at 300 s, where it rises by 0.047 K/s: held from there on, the
    rate would jump to nothing.
    """
    time, read = TIME[:3095], np.full(3095, np.nan)
    read[::100] = np.round(TRUE[:3095:100], 2)
    rate = np.gradient(smooth_temperature(time, read), time)
    assert 0.03 < rate[-1] == pytest.approx(rate[2990], rel=0.05)
