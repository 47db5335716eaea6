"""S1: six positions and other known attitudes."""

import numpy as np
import pytest
from builders import ACCEL, G, setup_of
from logs import log_of, triad_readings
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

from tiltcal.calibration.methods import six_position
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.segmentation import find_segments
from tiltcal.validation.accuracy import normalised_error

FACES = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=float)
LABELS = ["+z", "-z", "+x", "-x", "+y", "-y"]
BIAS = np.array([0.12, -0.08, 0.15])
M = np.array([[1.004, 0.003, -0.0015], [0.0008, 0.997, 0.0022], [-0.0018, 0.0006, 1.0025]])
SIGMA, DWELL = 2e-3, 60
SETUP = setup_of("handheld", ACCEL.model_copy(update={"rate_hz": 50.0}))
SENSOR = SETUP.sensor[0]
FAMILY = 1e-3


def truth() -> dict[str, float]:
    names = {f"accel.bias_{a}": BIAS[i] for i, a in enumerate("xyz")}
    names |= {f"accel.scale_{a}": M[i, i] - 1 for i, a in enumerate("xyz")}
    return names | {
        f"accel.cross_{a}{b}": M[i, j]
        for i, a in enumerate("xyz")
        for j, b in enumerate("xyz")
        if a != b
    }


def noiseless(labels=LABELS, faces=FACES, **more):
    return log_of(triad_readings(faces, G, BIAS, M), SENSOR, dwell=DWELL, labels=labels, **more)


def test_exact_readings_give_exact_parameters():
    found = calibrate("six_position", noiseless(), SETUP)
    for name, value in truth().items():
        assert found.value(name) == pytest.approx(value, abs=1e-12), name
    assert found.verdict == "good"
    assert found.dof == 6


def test_the_sigmas_are_those_worked_out_by_hand():
    rng = rng_of("hand-worked sigmas")
    log = noiseless(noise=rng.normal(0, SIGMA, (len(noiseless()), 3)))
    found = calibrate("six_position", log, SETUP)
    used = np.mean([round((p.end_s - p.start_s) * 50) + 1 for p in found.poses])
    s = SIGMA / np.sqrt(used)
    # sd(M_ij) = s / (g sqrt 2), sd(b) = s / sqrt 6; the noise itself is estimated from some 900
    # samples
    assert found.parameters["accel.scale_x"].sigma == pytest.approx(s / (G * np.sqrt(2)), rel=0.15)
    assert found.parameters["accel.bias_z"].sigma == pytest.approx(s / np.sqrt(6), rel=0.15)


def test_all_draws_together_reach_the_bound_and_their_intervals_cover(monkeypatch):
    # these two cost most and change no parameter
    monkeypatch.setattr(six_position, "leave_directions_out", lambda *_: {})
    monkeypatch.setattr(six_position, "known_attitude_tests", lambda *_: [])
    draws, names = draws_of(10_000), list(truth())
    clean = noiseless()
    segments = find_segments(clean)
    rng = rng_of("six position at its bound")
    values, nees, inside = np.empty((draws, 12)), np.empty(draws), np.zeros(12)
    clean_values = np.column_stack([clean.column(f"accel_{a}_m_s2") for a in "xyz"])
    for k in range(draws):
        noisy = clean_values + rng.normal(0, SIGMA, clean_values.shape)
        log = type(clean).from_columns(
            clean.time,
            {f"accel_{a}_m_s2": noisy[:, i] for i, a in enumerate("xyz")},
            labels=clean.labels,
        )
        found = calibrate("six_position", log, SETUP, segments=segments)
        values[k] = [found.value(n) for n in names]
        nees[k] = normalised_error(found, truth())[0]
        sigma = np.array([found.parameters[n].sigma for n in names])
        inside += np.abs(values[k] - list(truth().values())) <= 1.959964 * sigma
    bound = _bound(segments, names)
    ratio = values.var(axis=0, ddof=1) / bound
    p = FAMILY / 13 / 2  # one family: twelve variances and the NEES
    low, high = chi2.ppf(p, draws - 1) / (draws - 1), chi2.isf(p, draws - 1) / (draws - 1)
    assert np.all((ratio > low) & (ratio < high)), ratio
    # the covariance comes from some hundred residuals, not from the truth
    estimated_noise = 1 + 2 / (3 * 5 * (DWELL - 20))
    assert low_nees(draws, p) < nees.mean() / 12 < high_nees(draws, p) * estimated_noise
    coverage = inside / draws
    least, most = binom.ppf([p, 1 - p], draws, 0.95) / draws  # of 10 000: 94 to 96 %
    assert np.all((coverage >= least) & (coverage <= most)), coverage


def low_nees(draws: int, p: float) -> float:
    return chi2.ppf(p, 12 * draws) / (12 * draws)


def high_nees(draws: int, p: float) -> float:
    return chi2.isf(p, 12 * draws) / (12 * draws)


def _bound(segments, names):
    """Cramer-Rao: sigma^2 (A' W A)^-1 with rows [1, f] weighted by the samples of each dwell."""
    counts = np.array([s.last - s.first for s in segments if s.kind == "dwell"], dtype=float)
    A = np.hstack([np.ones((6, 1)), G * FACES])
    C = SIGMA**2 * np.linalg.inv(A.T @ (A * counts[:, None]))
    column = {
        "bias": lambda _: 0,
        "scale": lambda a: 1 + "xyz".index(a),
        "cross": lambda a: 1 + "xyz".index(a[1]),
    }
    terms = [n.split(".")[1].split("_") for n in names]
    return np.array([C[column[t](a), column[t](a)] for t, a in terms])


def test_swapped_labels_are_named():
    found = calibrate("six_position", noiseless(labels=["+z", "-z", "-x", "+x", "+y", "-y"]), SETUP)
    assert found.verdict == "suspect"
    (test,) = [t for t in found.tests if t.name == "cause"]
    assert not test.passed
    first, second = (found.poses[k].start_s for k in (2, 3))
    assert f"these two are swapped: {first:.6g} s and {second:.6g} s" in test.statement
    # with one dwell a face, a reversed column fits alike
    assert "columns x, y, z hold the axes -x, y, z" in test.statement


def test_a_wrong_label_alone_is_not_called_a_swap():
    found = calibrate("six_position", noiseless(labels=["+z", "-z", "+y", "-x", "+y", "-y"]), SETUP)
    (test,) = [t for t in found.tests if t.name == "cause"]
    assert "stated +y but reads +x" in test.statement
    assert "swapped" not in test.statement


def test_a_forgotten_face_is_named():
    found = calibrate("six_position", noiseless(faces=FACES[:5], labels=LABELS[:5]), SETUP)
    assert found.verdict == "suspect"
    assert any("no pose within 60 deg of -y up" in t.statement for t in found.tests)


def test_a_second_order_term_does_not_close_the_spare_equations():
    K2 = 1e-3 / G  # 1 mg/g^2
    force = G * FACES
    rng = rng_of("second order seen")
    readings = BIAS + force @ M.T
    readings[:, 0] += K2 * force[:, 0] ** 2
    log = log_of(
        readings,
        SENSOR,
        dwell=DWELL,
        labels=LABELS,
        noise=rng.normal(0, SIGMA, (len(noiseless()), 3)),
    )
    found = calibrate("six_position", log, SETUP)
    assert found.verdict == "suspect"
    assert not next(t for t in found.tests if t.name == "second order").passed
    # docs/physics.md, "Six positions": the bias takes K2 g^2 / 3
    assert found.value("accel.bias_x") - BIAS[0] == pytest.approx(
        K2 * G**2 / 3, abs=6 * SIGMA / np.sqrt(6 * 35)
    )


def test_a_third_order_term_hides_in_the_scale_factor():
    K3 = 1e-3 / G**2
    force = G * FACES
    readings = BIAS + force @ M.T
    readings[:, 0] += K3 * force[:, 0] ** 3
    found = calibrate("six_position", log_of(readings, SENSOR, dwell=DWELL, labels=LABELS), SETUP)
    assert found.verdict == "good"
    assert found.value("accel.scale_x") - (M[0, 0] - 1) == pytest.approx(K3 * G**2, rel=1e-6)


def test_a_rotation_of_the_fixture_is_the_antisymmetric_part_of_the_cross_terms():
    e = np.array([1e-3, -2e-3, 5e-4])
    skew = np.array([[0, -e[2], e[1]], [e[2], 0, -e[0]], [-e[1], e[0], 0]])
    R = np.eye(3) + skew + skew @ skew / 2
    found = calibrate(
        "six_position",
        log_of(triad_readings(FACES @ R, G, BIAS, np.eye(3)), SENSOR, dwell=DWELL, labels=LABELS),
        SETUP,
    )
    for a, b, size in (("y", "z", e[0]), ("z", "x", e[1]), ("x", "y", e[2])):
        antisymmetric = (
            found.value(f"accel.cross_{a}{b}") - found.value(f"accel.cross_{b}{a}")
        ) / 2
        assert antisymmetric == pytest.approx(size, abs=1e-8)
        assert abs(found.value(f"accel.cross_{a}{b}") + found.value(f"accel.cross_{b}{a}")) < 1e-5
    (gauge,) = [w for w in found.warnings if "rotation common to all poses" in w]
    assert "here it would be a rotation of x 206.3 +- " in gauge  # 1 mrad
    assert "y -412.5 +- " in gauge


def test_a_table_with_one_axis_leaves_terms_undetermined_and_names_them():
    setup = setup_of("placing", SENSOR)
    angles = np.arange(0.0, 360.0, 30.0)
    up = np.column_stack([-np.sin(np.radians(angles)), 0 * angles, np.cos(np.radians(angles))])
    found = calibrate(
        "six_position",
        log_of(triad_readings(up, G, BIAS, M), SENSOR, dwell=DWELL, angles={"outer": angles}),
        setup,
    )
    assert found.verdict == "cannot_tell"
    assert any("accel.scale_y" in w for w in found.warnings)
    assert "accel.scale_y" not in found.parameters
    assert found.value("accel.scale_x") == pytest.approx(M[0, 0] - 1, abs=1e-10)


def test_dwells_without_any_attitude_are_refused_in_words():
    with pytest.raises(TiltcalError, match="without table readout or direction label"):
        calibrate("six_position", noiseless(labels=None), SETUP)


def test_an_unknown_term_or_option_is_named_with_the_nearest():
    with pytest.raises(TiltcalError, match=r"calibration term 'scael'.*did you mean 'scale'"):
        calibrate("six_position", noiseless(), SETUP, terms=["bias", "scael"])
    with pytest.raises(TiltcalError, match=r"option 'term'.*did you mean 'terms'"):
        calibrate("six_position", noiseless(), SETUP, term=["bias"])


def test_a_face_recorded_twice_instead_of_its_opposite_is_named_and_saved(tmp_path):
    faces = FACES.copy()
    faces[3] = faces[2]
    rng = rng_of("a face twice")
    labels = ["+z", "-z", "+x", "+x", "+y", "-y"]
    found = calibrate(
        "six_position",
        noiseless(labels=labels, faces=faces, noise=rng.normal(0, SIGMA, (len(noiseless()), 3))),
        SETUP,
    )
    assert found.verdict == "suspect"
    assert any("no pose within 60 deg of -x up" in t.statement for t in found.tests)
    assert all(np.isfinite([t.statistic, t.p_value]).all() for t in found.tests)
    found.save(tmp_path / "CAL.json")


def test_one_pose_determines_nothing_and_says_so_quietly():
    found = calibrate("six_position", noiseless(labels=["+z", "+z"], faces=FACES[[0, 0]]), SETUP)
    assert found.verdict == "cannot_tell"
    assert not found.parameters
    assert not any("widened" in w for w in found.warnings)


def test_a_table_column_that_was_never_read_leaves_the_labels():
    setup = setup_of("dual", SENSOR)
    log = noiseless()
    empty = np.full(len(log), np.nan)
    columns = {n: log.column(n) for n in log.column_names} | {
        "table_outer_deg": empty,
        "table_inner_deg": empty,
    }
    found = calibrate(
        "six_position", type(log).from_columns(log.time, columns, labels=log.labels), setup
    )
    assert found.verdict == "good"
    assert found.value("accel.scale_x") == pytest.approx(M[0, 0] - 1, abs=1e-10)


def test_a_face_that_was_recorded_twice_in_place_of_another_is_named():
    order = [0, 1, 2, 4, 2, 5]
    found = calibrate(
        "six_position", noiseless(faces=FACES[order], labels=[LABELS[k] for k in order]), SETUP
    )
    assert any(
        "of -x up, but +x 2 times: recorded twice instead?" in t.statement for t in found.tests
    )
