"""An oscillation that keeps no phase is a band of frequencies with more power than the noise beside
it; noise of any kind is none.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten
from scipy.stats import f as f_distribution

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.residual_checks.oscillations import EXCESS, _likeliest, log_excess
from tiltcal.diagnosis.search.explained import CLAIM, DOUBTED
from tiltcal.statistics.cosine_transform import cosines

WHITE = 25e-6 * 9.81 * np.sqrt(25.0)  # of a sample, m/s2
CLAIMED, TOLD = (np.log(p / (1 - p) / 0.125 * 3) for p in (CLAIM, DOUBTED))
"""Least Bayes factors of one of three channels that is claimed, and that is told as a doubt."""
FREQUENCY = 1.37  # Hz


def hunting(time, rng, size: float, keeps: float = 12.0):
    """A tone of this amplitude whose phase is drawn anew every so many seconds."""
    phase = rng.uniform(0, 2 * np.pi, int(np.ptp(time) / keeps) + 1)
    begun = ((time - time[0]) / keeps).astype(int)
    return size * np.sin(2 * np.pi * FREQUENCY * time + phase[begun])


def test_the_bayes_factor_is_the_ratio_of_f_densities():
    times, width = np.array([0.4, 1.0, 1.9, 5.0]), 32
    with_more = [f_distribution.pdf(times / (1 + a), width, width) / (1 + a) for a in EXCESS]
    expected = np.mean(with_more, axis=0) / f_distribution.pdf(times, width, width)
    np.testing.assert_allclose(np.exp(log_excess(times, width)), expected, rtol=1e-9)


@pytest.mark.parametrize("kind", ["white", "bursts", "heavy tails", "louder while moving"])
def test_noise_of_any_kind_holds_no_band(kind, rng):
    highest = -np.inf
    for _ in range(60):
        noise = rng.standard_normal(6000)
        if kind == "bursts":
            for first in rng.integers(0, 5700, 5):
                noise[first : first + 200] *= 6
        elif kind == "heavy tails":
            noise = rng.standard_t(2.5, 6000) / 2
        elif kind == "louder while moving":
            noise *= np.where(np.arange(6000) % 400 < 60, 2.5, 1.0)
        highest = max(highest, _likeliest(cosines(noise), np.ones(6000))[3])
    assert highest < TOLD


def test_no_band_is_claimed_at_the_edge_of_coloured_noise(rng):
    """Pink from 0.5 Hz on and nothing of it below, 36 % of the variance at 20 Hz: of sixty, one at
    most is so much as doubted.
    """
    low, factors = int(2 * 6000 * 0.5 / 20.0), []
    for _ in range(60):
        pink = rng.standard_normal(6000) / np.sqrt(np.arange(1, 6001))
        pink[:low] = 0.0
        waves = 0.8 * rng.standard_normal(6000) + 0.6 * pink * np.sqrt(6000 / (pink @ pink))
        factors.append(_likeliest(waves, np.ones(6000))[3])
    assert max(factors) < CLAIMED
    assert sum(factor > TOLD for factor in factors) <= 1


def test_a_tone_that_loses_its_phase_is_a_band(rng):
    """Its energy of 490 is spread over some 60 of 8000 coefficients, nine times their noise."""
    time = np.arange(8000) / 20.0
    left = cosines(rng.standard_normal(8000) + hunting(time, rng, 0.35))
    first, width, times, factor = _likeliest(left, np.ones(8000))
    assert factor > CLAIMED
    assert times > 2
    low, high = (k / (2 * 8000) * 20.0 for k in (first, first + width))
    assert low < FREQUENCY < high
    assert high - low < 1.0


def test_bands_of_coloured_noise_are_not_looked_at(rng):
    """Where the noise of the model falls with the frequency, a band lies on its slope."""
    time = np.arange(8000) / 20.0
    left = cosines(rng.standard_normal(8000) + hunting(time, rng, 0.35))
    coloured = np.where(np.arange(8000) < 1600, 3.0, 1.0)  # up to 2 Hz
    assert _likeliest(left, coloured)[3] < TOLD


def test_a_table_that_hunts_is_a_finding_without_a_name(rng):
    whole = recorded(bench(), 6)
    x = whole.column("accel_x_m_s2") + hunting(whole.time, rng, 0.5 * WHITE, keeps=4.0)
    found = diagnose(honest(bench()), [rewritten(whole, accel_x_m_s2=x)])
    assert found.verdict == "unlisted"
    (finding,) = found.findings
    assert finding.effect is None
    assert finding.axes == ("x",)
    assert "oscillation of accel x without a steady phase" in finding.statement
    assert not finding.parts
