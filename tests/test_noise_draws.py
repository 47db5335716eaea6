"""What the noise effects draw has the Allan variance that their equation promises."""

from math import log, pi

import numpy as np
import pytest
from builders import effect_of, read_poses, setup_of, still
from scipy.linalg import toeplitz
from statistics_helpers import mean_band, rng_of, variance_band

from tiltcal.core.units import ARCSEC, DEG, DEG_H, G0
from tiltcal.effects.sensor.noise import FLICKER_TAUS, draw_flicker, draw_noise
from tiltcal.setup.sensor import Sensor

RATE, CHANNELS = 2.0, 400  # Hz


def channels(rng, n, white=0.0, flicker=0.0, walk=0.0, rate=RATE, count=CHANNELS):
    """Independent channels, (count, n)."""
    return np.array(
        [draw_noise(n, rate, white, flicker, walk, stream) for stream in rng.spawn(count)]
    )


def allan_variance(noise, m):
    """Of each channel at tau = m samples, without overlap, (count,). noise: (count, n)."""
    means = noise[:, : noise.shape[1] // m * m].reshape(len(noise), -1, m).mean(axis=2)
    return 0.5 * np.mean(np.diff(means, axis=1) ** 2, axis=1)


def test_white_noise_has_the_variance_of_its_density(rng):
    noise = channels(rng, 100, white=3.0)
    low, high = variance_band(noise.size)
    assert low < noise.var() / (9 * RATE) < high
    assert np.abs(noise.mean()) < mean_band(noise.ravel())


@pytest.mark.parametrize("m", [1, 4, 16])
def test_white_noise_averages_down_as_one_over_tau(m, rng):
    estimate = allan_variance(channels(rng, 256, white=3.0), m)
    assert abs(estimate.mean() - 9 * RATE / m) < mean_band(estimate)  # N^2 / tau


@pytest.mark.parametrize("m", [16, 64, 256])
def test_a_random_walk_climbs_as_tau_over_three(m, rng):
    estimate = allan_variance(channels(rng, 1024, walk=0.2), m)
    tau = m / RATE
    # K^2 tau / 3, of a sum of steps
    assert abs(estimate.mean() - 0.04 * tau / 3 * (1 + 0.5 / m**2)) < mean_band(estimate)


def test_a_random_walk_spreads_with_the_square_root_of_time(rng):
    noise = channels(rng, 512, walk=0.2)
    low, high = variance_band(CHANNELS - 1, comparisons=3)
    for k in (32, 128, 512):
        assert low < noise[:, k - 1].var(ddof=1) / (0.04 * k / RATE) < high


def flicker_allan(m):
    """Exact Allan variance at m samples of the sampled processes that make up a unit flicker."""
    weights = np.repeat([-1 / m, 1 / m], m)
    covariance = sum(toeplitz(np.exp(-np.arange(2 * m) / (RATE * t))) for t in FLICKER_TAUS)
    return 0.5 * log(4) / pi * weights @ covariance @ weights


@pytest.mark.parametrize("m", [4, 32, 256])
def test_flicker_has_the_allan_variance_of_its_processes(m, rng):
    estimate = allan_variance(channels(rng, 4096, flicker=5.0), m)
    assert abs(estimate.mean() - 25 * flicker_allan(m)) < mean_band(estimate)


def test_the_flicker_floor_is_the_bias_instability_well_inside_the_corners():
    floor = [flicker_allan(m) for m in (32, 64, 128, 256, 512)]  # 16 ... 256 s of 1 ... 1024 s
    # six processes for one straight spectrum
    np.testing.assert_allclose(np.sqrt(floor), np.sqrt(2 * log(2) / pi), rtol=0.05)


def test_flicker_starts_stationary(rng):
    noise = np.array([draw_flicker(2048, RATE, 5.0, stream) for stream in rng.spawn(CHANNELS)])
    variance = 25 * log(4) / pi * len(FLICKER_TAUS)
    low, high = variance_band(CHANNELS - 1, comparisons=3)
    for k in (0, 100, 2047):
        assert low < noise[:, k].var(ddof=1) / variance < high


def test_flicker_is_drawn_for_a_single_sample_too(rng):
    first = np.array([draw_flicker(1, RATE, 1.0, stream)[0] for stream in rng.spawn(CHANNELS)])
    low, high = variance_band(CHANNELS - 1)
    assert low < first.var(ddof=1) / (log(4) / pi * len(FLICKER_TAUS)) < high


def test_the_parts_add_in_one_channel(rng):
    estimate = allan_variance(channels(rng, 1024, white=2.0, walk=0.3), 32)
    tau = 32 / RATE
    assert abs(estimate.mean() - (4 / tau + 0.09 * tau / 3)) < mean_band(estimate)


def test_no_noise_is_nothing(rng):
    assert not draw_noise(50, RATE, 0, 0, 0, rng).any()


# ------------------------------------------------------------------------------------ as effects of
# a sensor

SENSORS = {
    "accelerometer": (
        Sensor(name="s", kind="accelerometer", rate_hz=RATE),
        "acc_noise",
        {"white_ug_rthz": 50},
        50e-6 * G0,
    ),
    "inclinometer": (
        Sensor(name="s", kind="inclinometer", axes=("x", "y"), rate_hz=RATE),
        "acc_noise",
        {"white_ug_rthz": 50},
        50e-6,
    ),
    "gyro": (
        Sensor(name="s", kind="gyro", rate_hz=RATE),
        "gyr_noise",
        {"white_deg_rth": 0.6},
        0.01 * DEG,
    ),
    "fog": (
        Sensor(name="s", kind="fog", axes=("a",), input_axis=(0, 0, 1), rate_hz=RATE),
        "gyr_noise",
        {"white_deg_rth": 0.6},
        0.01 * DEG,
    ),
}


@pytest.mark.parametrize("kind", SENSORS)
def test_a_sensor_is_as_noisy_as_its_unit_says_and_its_channels_are_independent(kind):
    sensor, id, words, density = SENSORS[kind]
    setup = setup_of("vertical", sensor)
    drive = still(setup, outer=np.zeros(4000))
    noise = read_poses(setup, drive, effect_of(id, setup, **words), seed=11)["s"]
    noise = noise - read_poses(setup, drive)["s"]
    low, high = variance_band(len(noise), comparisons=noise.shape[1])
    for channel in noise.T:
        assert low < np.mean(channel**2) / (density**2 * RATE) < high
    correlation = np.corrcoef(noise.T)
    limit = mean_band(rng_of("correlation").normal(size=4000), comparisons=3) * 1.1
    assert noise.shape[1] == 1 or np.abs(np.triu(correlation, 1)).max() < limit


def test_flicker_and_walk_units_are_those_of_the_allan_deviation():
    setup = setup_of("vertical", SENSORS["gyro"][0])
    effect = effect_of("gyr_noise", setup, flicker_deg_h=10, walk_deg_h_rth=30)
    assert effect.values == {
        "flicker": pytest.approx(10 * DEG_H),
        "walk": pytest.approx(30 * DEG_H / 60),
    }
    assert pytest.approx(180 * 3600 / pi) == 1 / ARCSEC
