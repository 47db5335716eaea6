"""White noise that grows while a table moves, or with the input, told from the differences of
successive readings.
"""

import numpy as np
import pytest
from scipy.stats import binom
from statistics_helpers import FALSE_ALARM, draws_of

from tiltcal.statistics.noise_in_motion import noise_growth

N = 6000
ROW = np.arange(N)
MOVING = ROW % 100 >= 60
STOP = np.where(MOVING, -1, ROW // 100)
SPEED = MOVING * np.sin(np.pi * (ROW % 100 - 60) / 40)
LEVEL = 0.01
MAGNITUDE = np.abs(np.sin(ROW // 100))  # another one at each stop, and in the move after it


def grown(rng, size, law=0.0):
    """What is told of noise with a standard deviation, (n,), beside a law that no model has."""
    values = size * rng.standard_normal(N) + law
    return noise_growth(values, np.zeros(N), STOP, SPEED, MAGNITUDE, LEVEL)


@pytest.mark.parametrize(
    "law",
    [0.0, 50 * np.sin(2 * np.pi * ROW / 100) * MOVING, 0.1 * ROW * MOVING],
    ids=["nothing else", "a law of the moves", "a drift between moves"],
)
def test_noise_of_one_size_grows_with_nothing(law, rng):
    draws = draws_of(400)
    found = sum(grown(rng, np.ones(N), law) is not None for _ in range(draws))
    assert found <= binom.isf(FALSE_ALARM, draws, LEVEL)


@pytest.mark.parametrize("spoilt", [0, 60], ids=["clean", "1 % outliers"])
def test_its_growth_with_the_speed_is_told(spoilt, rng):
    size = np.where(MOVING, np.exp(0.3 + 0.6 * SPEED), 1.0)
    law = np.zeros(N)
    law[rng.integers(0, N, spoilt)] = 100.0
    growth = grown(rng, size, law)
    assert growth is not None
    np.testing.assert_array_equal(growth[~MOVING], 1.0)
    # three coefficients of some 1200 logarithms, each with a standard deviation of 1.11
    assert np.abs(np.log(growth / size)).max() < 4 * 1.11 * np.sqrt(3 / 480) + 0.1 * (spoilt > 0)


def test_noise_below_the_codes_at_rest_grows_no_further_than_to_the_rounding(rng):
    """At rest the same code again and again; while moving the rounding is noise."""
    values = np.round(40 * np.cumsum(SPEED) / 100 + 0.01 * rng.standard_normal(N))
    growth = noise_growth(values, 40 * np.cumsum(SPEED) / 100, STOP, SPEED, MAGNITUDE, LEVEL)
    assert growth is None or growth.max() < 2


def test_a_record_without_rests_tells_nothing(rng):
    noise = rng.standard_normal(N)
    assert noise_growth(noise, np.zeros(N), np.full(N, -1), SPEED, MAGNITUDE, LEVEL) is None


@pytest.mark.parametrize("too", [0.0, 0.6], ids=["alone", "with the speed, too"])
def test_its_growth_with_the_input_is_told(too, rng):
    size = np.exp(MAGNITUDE + too * MOVING * (1 + SPEED))
    growth = grown(rng, size)
    assert growth is not None
    size = size / size[~MOVING].min()
    assert np.abs(np.log(growth / size)).max() < 4 * 1.11 * np.sqrt(4 / 480)
