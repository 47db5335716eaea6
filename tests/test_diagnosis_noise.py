"""The noise of a recording: exact in the cosine basis, estimated without bias, bounded honestly;
and why it decides.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, shorter
from scipy.fft import dct, idct
from scipy.stats import binom
from statistics_helpers import FALSE_ALARM, mean_band, variance_band

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.noise_spectrum import NoiseFit, WhiteFlickerWalk, estimate_noise

CONSTANT = cosines(np.ones(2000))[:, None]


def walk_of(rng, n, white, walk):
    return white * rng.normal(size=n) + walk * np.cumsum(rng.normal(size=n))


def test_a_random_walk_with_a_free_level_is_diagonal_in_the_cosine_basis(rng):
    n, draws = 64, 6000
    walks = dct(np.cumsum(rng.normal(size=(draws, n)), axis=1), axis=1, norm="ortho")[:, 1:]
    variance = WhiteFlickerWalk(0.0, 0.0, 1.0).spectrum(n)[1:]
    low, high = variance_band(draws, n - 1)
    # the walk's own level leaks into the low coefficients alone: the precision of the differences
    # is D'D
    steps = np.diff(np.eye(n), axis=0)
    C = dct(np.eye(n), axis=0, norm="ortho")
    np.testing.assert_allclose(np.diag(C @ steps.T @ steps @ C.T)[1:], 1 / variance, rtol=1e-9)
    high_half = slice(n // 2, None)
    ratio = walks[:, high_half].var(axis=0) / variance[high_half]
    assert ((ratio > 0.5 * low) & (ratio < 4 * high)).all()


def test_whitening_makes_the_noise_white(rng):
    model = WhiteFlickerWalk(1.0, 0.0, 0.2)
    z = np.array([model.whiten(walk_of(rng, 400, 1.0, 0.2)) for _ in range(400)])[:, 1:]
    low, high = variance_band(z.size // 2)
    assert low * 0.98 < z.var() < high * 1.02


def test_white_noise_and_walk_are_found(rng):
    fits = [
        estimate_noise(cosines(walk_of(rng, 2000, 1.0, 0.05)), CONSTANT, WhiteFlickerWalk).model
        for _ in range(60)
    ]
    white = np.array([f.white for f in fits])
    assert abs(white.mean() - 1) < mean_band(white) + 0.01
    # together, where they are alike
    slow = np.array([np.sqrt(f.flicker**2 / 0.02 + f.walk**2 / 0.02**2) for f in fits])
    assert 0.7 < np.median(slow) / (0.05 / 0.02) < 1.4


@pytest.mark.parametrize(
    ("truth", "worst"),
    [
        (WhiteFlickerWalk(1.0, 0.0, 0.01), np.sqrt(variance_band(75)[1])),
        (WhiteFlickerWalk(1.0, 0.08), 0.8),
    ],
)
def test_channels_that_are_alike_tell_together_where_a_walk_began(truth, worst, rng):
    """A walk begins at nothing, flicker does not: what takes all slow noise for a walk is right of
    a walk, and of that only.
    """
    n, units = 2000, np.array([1.0, 2.0, 0.5])
    slow = np.sqrt(WhiteFlickerWalk(0.0, truth.flicker).spectrum(n))
    together, walk_only = [], []
    for _ in range(25):
        whole = np.array(
            [
                walk_of(rng, n, 1.0, truth.walk) + idct(slow * rng.normal(size=n), norm="ortho")
                for _ in units
            ]
        )
        means = whole.mean(axis=1)
        left = [
            cosines(unit * (x - mean)) for unit, x, mean in zip(units, whole, means, strict=True)
        ]
        fits = [estimate_noise(e, CONSTANT, WhiteFlickerWalk) for e in left]
        alike = NoiseFit.alike(fits, WhiteFlickerWalk).model
        for e, unit, mean, fit in zip(left, units, means, fits, strict=True):
            together.append(
                mean + idct(e * alike.drift_spectrum(n) / alike.spectrum(n), norm="ortho")[0] / unit
            )
            walk_only.append(
                mean
                + idct(e * (1 - fit.model.white**2 / fit.model.spectrum(n)), norm="ortho")[0] / unit
            )
    assert np.sqrt(np.mean(np.square(together))) < worst * np.sqrt(np.mean(np.square(walk_only)))


def test_the_bound_of_a_walk_holds_the_truth_nearly_always(rng):
    draws, truth = 120, 0.03
    inside = 0
    for _ in range(draws):
        fit = estimate_noise(cosines(walk_of(rng, 2000, 1.0, truth)), CONSTANT, WhiteFlickerWalk)
        inside += fit.bounds()[1].walk >= truth
    assert inside >= binom.ppf(FALSE_ALARM, draws, 0.95)


def test_a_mean_model_costs_its_degrees_of_freedom_and_nothing_more(rng):
    n = 600
    mean = rng.normal(size=(n, 60))
    fits = [
        estimate_noise(cosines(rng.normal(size=n)), cosines_of(mean), WhiteFlickerWalk).model.white
        for _ in range(40)
    ]
    assert abs(np.mean(fits) - 1) < mean_band(np.array(fits)) + 0.01


def cosines_of(columns):
    return np.column_stack([cosines(c) for c in columns.T])


def test_a_random_walk_alone_is_no_finding_but_would_be_if_all_noise_were_taken_for_white(
    monkeypatch,
):
    """The guard and its guard: the same recordings, whitened as white noise only, raise alarms."""
    truth = bench(
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 25.0, "walk_ug_rts": 12.0},
        noise=False,
    )
    truth = shorter(truth, 8)
    recordings = [recorded(truth, seed) for seed in range(2)]
    assert [diagnose(honest(truth), [r]).verdict for r in recordings] == ["match"] * 2

    usual = NoiseSource.noise

    def as_white(self, *about):
        fits = usual(self, *about)
        return [NoiseFit.known(WhiteFlickerWalk(fit.model.white)) for fit in fits]

    monkeypatch.setattr(NoiseSource, "noise", as_white)
    assert any(diagnose(honest(truth), [r]).verdict != "match" for r in recordings)
