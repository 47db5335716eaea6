"""Allan variance: closed forms and confidence."""

from math import log, pi

import numpy as np
import pytest
from scipy.stats import chi2
from statistics_helpers import rng_of

from tiltcal.core.errors import TiltcalError
from tiltcal.effects.sensor.noise import FLICKER_TAUS, draw_noise
from tiltcal.statistics.allan import allan_deviation

RATE = 100.0


def test_it_is_the_textbook_sum_on_a_short_record():
    y = rng_of("textbook").normal(size=64)
    for m in (1, 3, 8):
        means = np.convolve(y, np.full(m, 1 / m), "valid")
        expected = np.mean((means[m:] - means[:-m]) ** 2) / 2
        found = allan_deviation(y, RATE, np.array([m / RATE]))
        assert found.deviation[0] ** 2 == pytest.approx(expected, rel=1e-9)


def test_a_ramp_has_its_closed_form_to_better_than_one_per_cent():
    t = np.arange(100_000) / RATE
    curve = allan_deviation(3e-4 * t, RATE)
    assert curve.deviation == pytest.approx(3e-4 * curve.tau / np.sqrt(2), rel=1e-6)


@pytest.mark.parametrize(("white", "walk"), [(2e-3, 0.0), (0.0, 4e-4)])
def test_white_noise_and_random_walk_average_to_their_closed_forms(white, walk):
    """The mean over many records is within one per cent, or within what chance leaves if that is
    more.
    """
    draws, n = 60, 40_000
    rng = rng_of(f"closed form {white} {walk}")
    tau = np.array([0.04, 0.32, 2.56])
    curves = [
        allan_deviation(draw_noise(n, RATE, white, 0.0, walk, rng), RATE, tau) for _ in range(draws)
    ]
    mean = np.mean([c.deviation**2 for c in curves], axis=0)
    m = tau * RATE
    # the walk is sampled: (2 m^2 + 1) / (6 m)
    expected = white**2 / tau + walk**2 * tau / 3 * (1 + 1 / (2 * m**2))
    freedom = curves[0].freedom * draws
    chance = np.array([chi2.isf(1e-4, f) / f - 1 for f in freedom * (1.0 if white else 0.25)])
    assert np.all(np.abs(mean / expected - 1) < np.maximum(chance, 0.01)), mean / expected


def test_synthetic_flicker_averages_to_its_closed_form_within_one_per_cent():
    """Gaussian noise shaped to the one-sided density B^2/(pi f); sqrt(2 ln 2 / pi) B at every
    averaging time.
    """
    B, n, draws = 2e-3, 1 << 16, 500
    rng = rng_of("shaped flicker")
    f = np.fft.rfftfreq(n, 1 / RATE)
    shape = np.zeros(len(f))
    shape[1:] = np.sqrt(B**2 / (pi * f[1:]) * n * RATE / 4)
    tau = np.array([0.32, 1.28, 5.12])
    total = np.zeros(3)
    for _ in range(draws):
        spectrum = shape * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f)))
        total += allan_deviation(np.fft.irfft(spectrum, n), RATE, tau).deviation ** 2
    assert np.sqrt(total / draws) == pytest.approx(np.sqrt(2 * log(2) / pi) * B, rel=0.01)


def test_flicker_drawn_by_the_laboratory_is_found_again():
    B, n = 5e-3, 1_200_000
    curve = allan_deviation(
        draw_noise(n, 10.0, 0.0, B, 0.0, rng_of("flicker")), 10.0, np.geomspace(4, 250, 12)
    )
    floor = np.sqrt(2 * log(2) / pi) * B
    assert FLICKER_TAUS[0] < 4 < 250 < FLICKER_TAUS[-1]
    # a sum of six processes ripples by some per cent
    assert np.median(curve.deviation) == pytest.approx(floor, rel=0.1)


def test_the_interval_covers_the_truth_as_often_as_it_says():
    rng, n, hits = rng_of("interval"), 4096, 0
    tau = np.array([0.16])
    for _ in range(800):
        low, high = allan_deviation(rng.normal(size=n) * np.sqrt(RATE), RATE, tau).interval(0.68)
        hits += low[0] <= 1 / np.sqrt(tau[0]) <= high[0]
    assert hits / 800 == pytest.approx(0.68, abs=3.9 * np.sqrt(0.68 * 0.32 / 800))


def test_a_record_that_is_too_short_is_refused():
    with pytest.raises(TiltcalError, match="found 9 samples, need at least 16"):
        allan_deviation(np.zeros(9), RATE)
