"""S2: attitudes unknown."""

import numpy as np
import pytest
from builders import ACCEL, G, setup_of
from logs import log_of, triad_readings
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

from tiltcal.calibration.methods import norm as norm_module
from tiltcal.calibration.methods.norm_iteration import product_and_sum
from tiltcal.calibration.methods.norm_model import names_of
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_up, sphere
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import find_segments
from tiltcal.validation.accuracy import normalised_error

SENSOR = ACCEL.model_copy(update={"rate_hz": 50.0})
SETUP = setup_of("handheld", SENSOR)
BIAS = np.array([0.12, -0.08, 0.15])
M = np.array([[1.004, 0.003, -0.0015], [0.003, 0.997, 0.0022], [-0.0015, 0.0022, 1.0025]])
DIRECTIONS = sphere(16)
SIGMA = 2e-3
FACES = np.vstack([np.eye(3), -np.eye(3)])


def log(up=DIRECTIONS, bias=BIAS, M=M, rng=None, dwell=60):
    clean = triad_readings(up, G, bias, M)
    rows = len(log_of(clean, SENSOR, dwell=dwell))
    noise = None if rng is None else rng.normal(0, SIGMA, (rows, 3))
    return log_of(clean, SENSOR, dwell=dwell, noise=noise)


def truth(terms: int) -> dict[str, float]:
    values = [*BIAS, *(np.diag(M) - 1), M[0, 1], M[0, 2], M[1, 2]]
    return (
        dict(zip(names_of("accel", 9), values, strict=True))
        if terms == 9
        else dict(zip(names_of("accel", 6), values[:6], strict=True))
    )


def test_exact_readings_give_exact_parameters_with_both_names_of_each_cross_term():
    found = calibrate("norm", log(), SETUP)
    for name, value in truth(9).items():
        assert found.value(name) == pytest.approx(value, abs=1e-9), name
    assert found.value("accel.cross_yx") == found.value("accel.cross_xy")
    assert found.dof == 16 - 9
    assert found.verdict == "good"


def test_a_temperature_that_was_never_read_is_not_stated(tmp_path):
    recording = log()
    named = {n: recording.column(n) for n in recording.column_names}
    found = []
    for value in (np.nan, 23.0):
        columns = named | {"temperature_degC": np.full(len(recording), value)}
        found.append(calibrate("norm", Recording.from_columns(recording.time, columns), SETUP))
        found[-1].save(tmp_path / "CAL.json")
    assert "temperature_degC" not in found[0].provenance
    assert found[1].provenance["temperature_degC"] == 23
    columns = named | {"temperature_degC": np.full(len(recording), 1e308)}
    with pytest.raises(TiltcalError, match=r"temperature_degC.*at most 1e"):
        calibrate("norm", Recording.from_columns(recording.time, columns), SETUP)


@pytest.mark.parametrize("sign", [1, -1])
def test_it_converges_from_half_the_scale_and_half_a_g_off(sign):
    rng = rng_of(f"far start {sign}")
    for _ in range(40):
        scale, bias = 1 + 0.5 * sign * rng.uniform(-1, 1, 3), 0.5 * G * rng.uniform(-1, 1, 3)
        found = calibrate("norm", log(bias=bias, M=np.diag(scale)), SETUP, terms=6)
        assert [found.value(f"accel.scale_{a}") for a in "xyz"] == pytest.approx(
            list(scale - 1), abs=1e-8
        )
        assert [found.value(f"accel.bias_{a}") for a in "xyz"] == pytest.approx(
            list(bias), abs=1e-7
        )


def test_all_draws_together_reach_the_bound_and_their_intervals_cover(monkeypatch):
    # costs most, changes no parameter
    monkeypatch.setattr(norm_module, "leave_directions_out", lambda *_: (0.0, 1.0))
    draws, names = draws_of(4000), list(truth(9))
    clean = log()
    segments = find_segments(clean)
    rng = rng_of("norm at its bound")
    columns = np.column_stack([clean.column(f"accel_{a}_m_s2") for a in "xyz"])
    values, nees, inside = np.empty((draws, 9)), np.empty(draws), np.zeros(9)
    for k in range(draws):
        noisy = columns + rng.normal(0, SIGMA, columns.shape)
        draw = type(clean).from_columns(
            clean.time, {f"accel_{a}_m_s2": noisy[:, i] for i, a in enumerate("xyz")}
        )
        found = calibrate("norm", draw, SETUP, segments=segments)
        values[k], nees[k] = [found.value(n) for n in names], normalised_error(found, truth(9))[0]
        sigma = np.array([found.parameters[n].sigma for n in names])
        inside += np.abs(values[k] - list(truth(9).values())) <= 1.959964 * sigma
    ratio = values.var(axis=0, ddof=1) / np.diag(_bound(segments))
    p = 1e-3 / 19 / 2  # one family: nine variances, nine coverages, the NEES
    low, high = chi2.ppf(p, draws - 1) / (draws - 1), chi2.isf(p, draws - 1) / (draws - 1)
    assert np.all((ratio > low) & (ratio < high)), ratio
    assert (
        chi2.ppf(p, 9 * draws) / (9 * draws)
        < nees.mean() / 9
        < chi2.isf(p, 9 * draws) / (9 * draws) * (1 + 2 / 1500)
    )
    least, most = binom.ppf([p, 1 - p], draws, 0.95)
    assert np.all((inside >= least) & (inside <= most)), inside / draws


def _bound(segments):
    """Only the radial part of the noise informs: F = sum N_k J' J / (s^2 v' v), rows from d|f|."""
    counts = np.array([s.last - s.first for s in segments if s.kind == "dwell"], dtype=float)
    inverse = np.linalg.inv(M)
    v = DIRECTIONS @ inverse
    f = G * DIRECTIONS
    pairs = [(0, 1), (0, 2), (1, 2)]
    J = np.hstack(
        [v, v * f, np.column_stack([v[:, i] * f[:, j] + v[:, j] * f[:, i] for i, j in pairs])]
    )
    weight = counts / (SIGMA**2 * (v * v).sum(axis=1))
    return np.linalg.inv(J.T @ (J * weight[:, None]))


def test_six_positions_cannot_tell_about_their_own_model():
    rng = rng_of("six positions")
    found = calibrate("norm", log(up=FACES, rng=rng), SETUP, terms=6)
    assert found.verdict == "cannot_tell"
    assert found.dof == 0
    # docs/physics.md, "Unknown attitudes": a shear of 1 mrad left out gives a zero residual,
    # and wrong parameters all the same
    sheared = np.eye(3)
    sheared[0, 1] = 1e-3
    wrong = calibrate("norm", log(up=sphere(6), bias=0 * BIAS, M=sheared), SETUP, terms=6)
    assert wrong.chi2_per_dof == 0
    assert max(abs(wrong.value(f"accel.scale_{a}")) for a in "xyz") > 1e-5
    assert wrong.verdict == "cannot_tell"


def test_random_positions_get_a_condition_verdict():
    rng = rng_of("condition of random positions")
    conditions = []
    for _ in range(60):
        up = rng.normal(size=(6, 3))
        up /= np.linalg.norm(up, axis=1)[:, None]
        found = calibrate("norm", log(up=up, bias=0 * BIAS, M=np.eye(3)), SETUP, terms=6)
        test = next(t for t in found.tests if t.name == "condition of the positions")
        assert test.passed == (test.statistic <= 100)
        conditions.append(test.statistic)
    assert np.median(conditions) > 5  # axis-aligned positions have 1
    best = calibrate("norm", log(up=FACES, bias=0 * BIAS, M=np.eye(3)), SETUP, terms=6)
    assert next(
        t for t in best.tests if t.name == "condition of the positions"
    ).statistic == pytest.approx(1.0, abs=0.01)


def test_six_directions_repeated_do_not_determine_nine_parameters():
    found = calibrate(
        "norm",
        log(up=np.vstack([FACES, FACES, FACES]), rng=rng_of("repeated faces")),
        SETUP,
        terms=9,
    )
    assert found.verdict == "cannot_tell"


def test_a_missing_cross_term_is_seen_and_called_suspect():
    found = calibrate("norm", log(rng=rng_of("missing cross term")), SETUP, terms=6)
    assert found.verdict == "suspect"
    assert not next(t for t in found.tests if t.name == "fit").passed
    assert any("widened" in w for w in found.warnings)


def test_the_scenario_decides_between_six_and_nine_parameters():
    narrow = setup_of("handheld", SENSOR.model_copy(update={"adjustable": ("bias", "scale")}))
    assert len(calibrate("norm", log(M=np.diag(np.diag(M))), narrow).parameters) == 6
    assert len(calibrate("norm", log(), SETUP).parameters) == 12


def test_too_few_dwells_wrong_terms_and_no_triad_are_refused_in_words():
    with pytest.raises(TiltcalError, match=r"found 8 dwells, need at least 9.*terms=6"):
        calibrate("norm", log(up=sphere(8)), SETUP)
    with pytest.raises(TiltcalError, match="found 7, need 6 or 9"):
        calibrate("norm", log(), SETUP, terms=7)
    two = SENSOR.model_copy(update={"axes": ("x", "y")})
    with pytest.raises(TiltcalError, match="found 2 axes"):
        calibrate("norm", log(), setup_of("handheld", two))


def near_faces(rng):
    """The faces, each some 15 deg off."""
    up = FACES + 0.25 * rng.normal(size=(6, 3))
    return up / np.linalg.norm(up, axis=1)[:, None]


def test_the_paper_s_iteration_multiplies_gains_and_adds_biases_in_about_three_steps():
    rng = rng_of("product and sum")
    steps = []
    for _ in range(100):
        gain, bias = 1 + 0.1 * rng.uniform(-1, 1, 3), 0.1 * G * rng.uniform(-1, 1, 3)
        found = product_and_sum(G * near_faces(rng) * gain + bias, G)
        assert found.converged
        np.testing.assert_allclose(found.gain, gain, rtol=1e-8)
        np.testing.assert_allclose(found.bias, bias, atol=1e-7)
        steps.append(sum(c > 1e-3 for c in found.corrections))
    assert np.median(steps) <= 3
    assert found.residuals[0] > 100 * found.residuals[2]


def test_the_paper_s_iteration_comes_home_from_half_the_scale_and_half_a_g_off():
    rng = rng_of("product and sum, far")
    home = 0
    for _ in range(200):
        gain, bias = 1 + 0.5 * rng.uniform(-1, 1, 3), 0.5 * G * rng.uniform(-1, 1, 3)
        found = product_and_sum(G * near_faces(rng) * gain + bias, G)
        home += found.converged and bool(np.allclose(found.gain, gain, rtol=1e-6))
    assert (
        home >= 180
        # of the few others the attitudes are badly conditioned: the likelihood fit starts from an
        # ellipsoid
    )


def test_the_iteration_that_does_not_converge_says_so():
    far = 300 * G * np.ones(3)
    assert not product_and_sum(G * FACES + far, G).converged
    found = calibrate("norm", log(bias=far, M=np.eye(3)), SETUP, terms=6)
    # the likelihood fit starts from an ellipsoid
    assert found.value("accel.bias_x") == pytest.approx(far[0], rel=1e-6)
    assert any("does not converge in 30 steps" in w for w in found.warnings)


def test_the_convergence_record_stands_beside_the_likelihood_fit():
    found = calibrate("norm", log(M=np.diag(np.diag(M)), rng=rng_of("record")), SETUP, terms=6)
    record = found.provenance["product_and_sum"]
    assert record[0]["correction"] > 1e-3 > record[-1]["correction"]
    assert found.to_json()["provenance"]["product_and_sum"] == record
    assert any(
        "converges in" in w and "differs from the maximum-likelihood fit by" in w
        for w in found.warnings
    )


def hint(found) -> np.ndarray:
    (text,) = [w for w in found.warnings if w.startswith("next best pose: ")]
    up = parse_up(text.removeprefix("next best pose: ").split(" up")[0])
    assert up is not None
    return up


def test_the_next_best_pose_is_the_one_that_is_missing():
    without = np.delete(FACES, 4, axis=0)  # no -y
    found = calibrate(
        "norm",
        log(up=np.vstack([without, without[:1]]), bias=0 * BIAS, M=np.eye(3)),
        SETUP,
        terms=6,
    )
    assert found.verdict == "cannot_tell"
    up = hint(found)
    # without it bias and scale of y are one unknown: what tells them apart is anything with -y in
    # it, the face itself best
    assert up[1] < -0.9


def test_adding_the_next_best_pose_lowers_the_uncertainty_more_than_a_repeat():
    up = sphere(9)
    base = calibrate("norm", log(up=up, bias=0 * BIAS, M=np.eye(3)), SETUP, terms=6)

    def worst(extra):
        found = calibrate(
            "norm",
            log(up=np.vstack([up, extra]), bias=0 * BIAS, M=np.eye(3), rng=rng_of("next")),
            SETUP,
            terms=6,
        )
        return max(e.sigma for n, e in found.parameters.items() if "scale" in n)

    assert worst(hint(base)) < worst(up[4])
