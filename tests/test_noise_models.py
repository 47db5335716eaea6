"""A noise model is one class: laws that each has to keep, and one from outside in a diagnosis."""

import numpy as np
import pytest
from autoregressive_noise import AutoRegressive2
from diagnosis_fixtures import bench, honest, recorded
from scipy.signal import lfilter

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.statistics.dwell_noise import white_at_standstill
from tiltcal.statistics.noise_spectrum import (
    CONFIDENCE,
    LEAST_WHITE,
    NoiseFit,
    WhiteFlickerWalk,
    cosines,
    deviance,
    estimate_noise,
)

MODELS = [
    WhiteFlickerWalk(1.0),
    WhiteFlickerWalk(0.8, 0.3),
    WhiteFlickerWalk(1.0, 0.05, 0.02),
    AutoRegressive2(1.0, 0.5, -0.3),
    AutoRegressive2(2.0, 1.2, -0.5),
]


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_a_scaled_model_has_a_scaled_spectrum(model):
    np.testing.assert_allclose(model.scaled(3.0).spectrum(500), 9 * model.spectrum(500))


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_an_excess_raises_the_weighed_spectrum_by_itself(model):
    weights = np.linspace(0.0, 1.0, 400)
    before, after = (m.spectrum(400) for m in (model, model.with_excess(weights, 7.0)))
    assert weights @ after - weights @ before == pytest.approx(7.0)


@pytest.mark.parametrize("model", MODELS, ids=str)
def test_the_fit_is_no_less_likely_than_the_truth_and_its_bounds_as_stated(model, rng):
    n = 4000
    e = rng.normal(size=n) * np.sqrt(model.spectrum(n))
    fit = NoiseFit.of(e, np.ones(n), type(model))

    def deviance(noise):
        S = noise.spectrum(n)[1:]
        return float((np.log(S) + e[1:] ** 2 / S).sum())

    assert deviance(fit.model) < deviance(model) + 1.0
    for bound in fit.bounds():  # the spectrum is binned: the deviance is that of the bins
        assert deviance(bound) - deviance(fit.model) < CONFIDENCE + 1.0
    assert any(bound != fit.model for bound in fit.bounds())


def test_the_most_probable_noise_beside_a_pure_random_walk_keeps_the_least_white_part(rng):
    """Its likelihood grows as the white part goes to nothing: a spectrum of nothing weighs no
    reading.
    """
    n = 2000
    e = rng.normal(size=n) * np.sqrt(WhiteFlickerWalk(0.0, 0.0, 1e-3).spectrum(n))
    fit = NoiseFit.of(e, np.ones(n), WhiteFlickerWalk)

    def price(model):
        along = np.array([0.0, 0.0, 0.5])
        cost = 1e3 * model.walk
        return cost, cost * along, cost * np.diag(along / 2)

    found = fit.model.most_probable(fit.bins, price)
    assert found.white**2 >= (1 - 1e-9) * LEAST_WHITE * fit.bins.scale
    assert found.white <= 1.1 * fit.model.white


@pytest.mark.parametrize("sizes", [(1.0, 0.0, 0.0), (1.0, 0.2, 0.0), (1.0, 0.05, 0.01)])
def test_no_model_nearby_is_more_probable_than_the_most_probable_one(rng, sizes):
    """By its deviance and a price that draws the slow noise to sizes of its own, over steps of each
    variance up and down, from a tenth to ten times.
    """
    n = 4000
    noise = WhiteFlickerWalk(*sizes)
    fit = NoiseFit.of(rng.normal(size=n) * np.sqrt(noise.spectrum(n)), np.ones(n), type(noise))
    usual = np.log([1.0, 1e-2, 1e-5])

    def logs(model):
        return np.log(np.maximum([model.white, model.flicker, model.walk], 1e-100)) * 2

    def price(model):
        off = np.clip((logs(model) - usual) * [0.0, 1.0, 1.0], -50, 50)
        return 0.05 * float(off @ off), 0.1 * off, np.diag([0.0, 0.1, 0.1])

    def cost(model):
        variances = np.exp(logs(model)) / fit.bins.scale
        return deviance(fit.bins, variances) / 2 + price(model)[0]

    found = fit.model.most_probable(fit.bins, price)
    assert cost(found) <= cost(fit.model)
    for step in np.log(10.0) * np.linspace(-1, 1, 21):
        for k in range(3):
            moved = logs(found) + step * np.eye(3)[k]
            assert cost(found) < cost(WhiteFlickerWalk(*np.exp(moved / 2))) + 2e-3


def test_an_autoregressive_process_has_the_spectrum_that_the_class_says(rng):
    """scipy's filter makes the process; the class has to find its coefficients again."""
    x = lfilter([1.0], [1.0, -1.2, 0.5], rng.normal(0.0, 0.3, 20000))
    found = estimate_noise(cosines(x), cosines(np.ones(len(x)))[:, None], AutoRegressive2).model
    error = 3 / np.sqrt(len(x))  # the Cramer-Rao bound of a coefficient is sqrt((1 - a2^2) / n)
    assert (found.a1, found.a2) == pytest.approx((1.2, -0.5), abs=error)
    assert found.white == pytest.approx(0.3, rel=3 / np.sqrt(2 * len(x)))


def test_a_diagnosis_takes_another_noise_model_as_an_argument():
    hidden = bench({"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 400.0})
    found = diagnose(honest(hidden), [recorded(hidden, 3)], noise=AutoRegressive2)
    assert [f.effect for f in found.findings] == ["acc_K2"]


def test_noise_at_rest_is_that_of_the_stops_whatever_their_levels(rng):
    """Thirty-six poses of 10 m/s2 about each other, in noise of 5e-4 m/s2."""
    stop = np.repeat(np.arange(36), 100)
    stop[np.arange(len(stop)) % 100 > 80] = -1
    values = rng.uniform(-10, 10, 36)[np.maximum(stop, 0)] + 5e-4 * rng.standard_normal(len(stop))
    assert white_at_standstill(values, stop) == pytest.approx(5e-4, rel=0.1)
