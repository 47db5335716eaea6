"""The algebra beneath a diagnosis: sparse designs and column store of columns say what dense
matrices say, and noise is fitted best.
"""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded
from scipy.optimize import minimize
from threadpoolctl import threadpool_info, threadpool_limits

from tiltcal.core.numerical import one_thread
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.hypothesis import listed_hypotheses
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.effects.spans import SpectralLines
from tiltcal.statistics.noise_spectrum import NoiseFit, WhiteFlickerWalk, deviance

LENGTHS = (40, 30, 50)


def dense(columns):
    return np.vstack(
        [np.column_stack([c.get(i, np.zeros(n)) for c in columns]) for i, n in enumerate(LENGTHS)]
    )


def drawn(rng, *channels):
    """A column that changes these channels."""
    return {i: rng.normal(size=LENGTHS[i]) for i in channels}


@pytest.mark.parametrize(
    ("shape", "rank"),
    [
        (((0,), (0,), (1,), (2,)), 4),  # each changes one channel
        (((0,), (1,), (0, 1), (0, 1, 2)), 4),
        (((0, 1, 2), (0, 1, 2)), 2),
    ],
)
def test_a_design_says_what_its_dense_matrix_says(shape, rank, rng):
    columns = [drawn(rng, *channels) for channels in shape]
    design, J, vector = (
        BlockDesignMatrix(columns, LENGTHS),
        dense(columns),
        [rng.normal(size=n) for n in LENGTHS],
    )
    np.testing.assert_allclose(design.gram, J.T @ J, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(
        design.along(vector), J.T @ np.concatenate(vector), rtol=1e-12, atol=1e-12
    )
    Q = np.vstack(design.basis())
    assert Q.shape[1] == rank
    np.testing.assert_allclose(Q.T @ Q, np.eye(rank), atol=1e-12)
    np.testing.assert_allclose(Q @ (Q.T @ J), J, atol=1e-10)


def test_a_column_that_others_make_up_is_no_direction_of_its_own(rng):
    one, other, both = drawn(rng, 0), drawn(rng, 1), drawn(rng, 0, 1)
    within = {0: 2 * one[0], 1: -3 * other[1]}
    nearly = {i: part + 1e-7 * both[i] for i, part in within.items()}
    assert (
        np.vstack(BlockDesignMatrix([one, other, within, nearly, both], LENGTHS).basis()).shape[1]
        == 3
    )
    assert np.vstack(BlockDesignMatrix([], LENGTHS).basis()).shape == (sum(LENGTHS), 0)


def test_scores_are_those_of_the_columns_themselves_under_each_noise_in_turn(rng):
    truth = bench({"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 300.0})
    found = prepare(honest(truth), [recorded(truth, 5)])
    whitened, fitted = found.whitened, found.start
    hypotheses = list(
        listed_hypotheses(
            found.observations.scenario, ranges_of(found.observations, SpectralLines())
        )
    )[:40]
    for hypothesis in hypotheses:
        whitened.columns.add(hypothesis, fitted.effects)
    lengths = [len(c.values) for c in found.observations.channels]
    asked = {id(s) for s in whitened.hypotheses[::3]}
    noisy = tuple(root * rng.uniform(1.0, 3.0, len(root)) for root in whitened.roots)
    quiet = whitened
    for whitened in (quiet, replace(quiet, roots=noisy), quiet):
        basis = BlockDesignMatrix(
            [whitened.whiten({i: rng.normal(size=n)}) for i, n in enumerate(lengths)], lengths
        ).basis()
        residual = [rng.normal(size=n) for n in lengths]
        scores = whitened.scores(basis, residual, lambda s: id(s) in asked)
        assert {id(s.hypothesis) for s in scores} == asked
        Q, r = np.vstack(basis), np.concatenate(residual)
        for score in scores:
            columns = [
                whitened.weighed(whitened.columns.waves(score.hypothesis, name, fitted.effects))
                for name in score.names
            ]
            U = np.column_stack(
                [
                    np.concatenate([c.get(i, np.zeros(n)) for i, n in enumerate(lengths)])
                    for c in columns
                ]
            )
            left = U - Q @ (Q.T @ U)
            scale = np.sqrt(np.where(score.raw > 0, score.raw, 1.0))
            np.testing.assert_allclose(score.raw, (U**2).sum(axis=0), rtol=1e-4)
            np.testing.assert_allclose(
                score.A / scale, left.T @ r / scale, atol=2e-4 * np.linalg.norm(r)
            )
            np.testing.assert_allclose(
                score.B / np.outer(scale, scale), left.T @ left / np.outer(scale, scale), atol=1e-4
            )


@pytest.mark.parametrize(
    "truth",
    [
        WhiteFlickerWalk(1.0),
        WhiteFlickerWalk(1.0, 0.3),
        WhiteFlickerWalk(1.0, 0.05, 0.02),
        WhiteFlickerWalk(1.0, 0.0, 0.3),
    ],
)
def test_no_general_minimiser_finds_a_likelier_noise(truth, rng):
    n = 3000
    for _ in range(5):
        coefficients = rng.normal(size=n) * np.sqrt(truth.spectrum(n))
        fit = NoiseFit.of(coefficients, np.ones(n), WhiteFlickerWalk)
        bins = fit.bins
        best = np.array([fit.model.white, fit.model.flicker, fit.model.walk]) ** 2 / bins.scale
        starts = [np.log(np.maximum(best, 1e-20)), *rng.uniform((-2, -12, -20), (1, 0, -5), (4, 3))]
        others = [
            minimize(lambda p, b=bins: deviance(b, np.exp(p)), start, method="Nelder-Mead")
            for start in starts
        ]
        assert deviance(bins, best) < min(o.fun for o in others) + 1e-3
        flicker, walk = (
            np.maximum(
                np.array([m.white, m.flicker, m.walk]) ** 2 / bins.scale, np.finfo(float).tiny
            )
            for m in fit.bounds(3.84)
        )
        for bound in (flicker, walk):  # as far as the likelihood lets it go
            rise = deviance(bins, bound) - deviance(bins, np.maximum(best, np.finfo(float).tiny))
            assert rise == pytest.approx(3.84, abs=0.3)


def test_a_diagnosis_leaves_linear_algebra_its_threads():
    def threads():
        return {
            library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
        }

    with threadpool_limits(2, user_api="blas"):
        with one_thread():
            assert threads() == {1}
        assert threads() == {2}
