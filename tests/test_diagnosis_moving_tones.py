"""A tone whose frequency follows something is a ridge in the spectra of short stretches; noise of
any kind is none, nor is a steady tone or a burst.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten
from scipy.stats import gamma

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.residual_checks.oscillations import (
    EXCESS,
    LENGTHS,
    equalised,
    likeliest_ridge,
    log_excess_of_sums,
)
from tiltcal.diagnosis.search.explained import CLAIM, DOUBTED
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.noise_spectrum import WhiteFlickerWalk, estimate_noise

WHITE = 25e-6 * 9.81 * np.sqrt(25.0)  # of a sample, m/s2
CLAIMED, TOLD = (np.log(p / (1 - p) / 0.125 * 3) for p in (CLAIM, DOUBTED))
"""Least Bayes factors of one of three channels that is claimed, and that is told as a doubt."""
N = 4000
MOVING = np.arange(N) % 400 < 100
TIME = np.arange(N) / 25.0
FOLLOWED = {
    "time": TIME,
    "stops": np.repeat(np.random.default_rng(7).uniform(-1, 1, N // 100), 100),
    "temperature": np.sin(TIME / 40.0),
}


def best(signal):
    """Largest log Bayes factor of what the frequency may follow, and of every stretch, less the
    logarithm of their number; and what that is.
    """
    found = [
        (ridge.factor, name, ridge)
        for name, u in FOLLOWED.items()
        for length in LENGTHS
        if (ridge := likeliest_ridge(signal, u, MOVING, length)) is not None
    ]
    factor, name, ridge = max(found, key=lambda each: each[0])
    return factor - np.log(len(found)), name, ridge


def tone(u, size, low, slope):
    """A tone of this amplitude at low + slope u, Hz."""
    return size * np.sin(2 * np.pi * np.cumsum(low + slope * u) / 25.0)


def test_the_bayes_factor_is_the_ratio_of_gamma_densities():
    total, count = np.array([20.0, 40.0, 90.0]), 40
    with_more = [gamma.pdf(total, count, scale=1 + a) for a in EXCESS]
    expected = np.mean(with_more, axis=0) / gamma.pdf(total, count)
    np.testing.assert_allclose(np.exp(log_excess_of_sums(total, count)), expected, rtol=1e-9)


@pytest.mark.parametrize(
    "kind",
    ["white", "bursts", "heavy tails", "louder in motion", "red in motion", "walk", "steady tone"],
)
def test_what_is_no_moving_tone_holds_no_ridge(kind, rng):
    highest = -np.inf
    for _ in range(15):
        noise = rng.standard_normal(N)
        if kind == "bursts":
            for first in rng.integers(0, N - 200, 5):
                noise[first : first + 200] *= 6
        elif kind == "heavy tails":
            noise = rng.standard_t(2.5, N) / 2
        elif kind == "louder in motion":
            noise *= np.where(MOVING, 2.5, 1.0)
        elif kind == "red in motion":
            smooth = 3 * np.convolve(noise, np.full(9, 1 / 9), "same")
            noise = np.where(MOVING, smooth, noise)
        elif kind == "walk":
            noise += np.cumsum(0.05 * rng.standard_normal(N))
        elif kind == "steady tone":
            noise += tone(TIME, 1.0, 3.3, 0.0)
        left = cosines(noise - noise.mean())
        fit = estimate_noise(left, cosines(np.ones(N))[:, None], WhiteFlickerWalk)
        highest = max(highest, best(equalised(left / np.sqrt(fit.model.spectrum(N))))[0])
    assert highest < TOLD


@pytest.mark.parametrize(("name", "slope"), [("time", 0.02), ("stops", 2.0), ("temperature", 0.8)])
def test_a_tone_that_follows_something_is_told_with_its_frequencies(name, slope, rng):
    """Of energy 500: 0.5 of an amplitude in white noise of 1 over 4000 samples."""
    u = FOLLOWED[name]
    signal = rng.standard_normal(N) + tone(u, 0.5, 4.0, slope)
    factor, told, ridge = best(equalised(cosines(signal)))
    assert factor > CLAIMED
    assert told == name
    low, high = 4.0 + slope * np.array([u.min(), u.max()])
    assert ridge.low * 25.0 == pytest.approx(low, abs=0.6)
    assert ridge.high * 25.0 == pytest.approx(high, abs=0.6)


def test_a_tone_that_slides_with_the_input_is_a_finding_without_a_name():
    whole = recorded(bench(), 6)
    force = whole.column("accel_x_m_s2")
    phase = np.cumsum(2 * np.pi * (0.4 + 0.3 * np.abs(force)) * np.median(np.diff(whole.time)))
    found = diagnose(
        honest(bench()), [rewritten(whole, accel_x_m_s2=force + 0.7 * WHITE * np.sin(phase))]
    )
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert (finding.effect, finding.axes, finding.where.coordinate) == (None, ("x",), "frequency")
    # or its magnitude: a ridge is folded at nothing
    told = finding.statement
    assert "its own input, between" in told
    assert not finding.parts
