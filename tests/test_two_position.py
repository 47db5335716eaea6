"""S4: reversal on a vertical table."""

import numpy as np
import pytest
from builders import INCL, setup_of
from logs import log_of
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Rig, Setup, Site

G = 9.80665
ACCEL = Sensor(name="accel", kind="accelerometer", axes=("x", "y"), rate_hz=20.0)
SETUP = Setup(site=Site(gravity_m_s2=G), rig=Rig(table="vertical"), sensor=(ACCEL,))
SAMPLES, SIGMA, BIAS = 200, 50e-6 * G0, 2e-3 * G0
P = 1e-3 / 2


def readings(roll: float, pitch: float, angles: np.ndarray, bias: float = BIAS) -> np.ndarray:
    """f_b = Rz(-a) R_base^T (0, 0, g), first two components, plus bias."""
    base = rotation("x", roll) @ rotation("y", pitch)
    return np.array(
        [(rotation("z", -a) @ base.T @ [0, 0, G])[:2] + bias for a in np.radians(angles)]
    )


def log(roll, pitch, angles=(0.0, 180.0), sensor=ACCEL, noise=None, dwell=SAMPLES, code=0.0):
    values = log_of(
        readings(roll, pitch, np.array(angles)),
        sensor,
        dwell=dwell,
        angles={"outer": np.array(angles)},
        noise=noise,
    )
    if code:
        columns = {
            n: np.round(values.column(n) / code) * code
            if n.startswith("accel")
            else values.column(n)
            for n in values.column_names
        }
        return type(values).from_columns(values.time, columns)
    return values


@pytest.mark.parametrize(("roll", "pitch"), [(15.0, 15.0), (-15.0, 15.0), (0.2, -0.1), (0.0, 0.0)])
def test_the_formula_is_exact_at_any_tilt(roll, pitch):
    found = calibrate("two_position", log(roll * DEG, pitch * DEG), SETUP)
    assert found.value("base.roll") == pytest.approx(roll * DEG, abs=1e-14)
    assert found.value("base.pitch") == pytest.approx(pitch * DEG, abs=1e-14)
    assert found.value("accel.bias_x") == pytest.approx(BIAS, abs=1e-13)


def test_any_two_opposite_angles_and_any_mounting_turn_serve():
    found = calibrate("two_position", log(0.01, -0.02, angles=(37.0, 217.0)), SETUP)
    assert found.value("base.roll") == pytest.approx(0.01, abs=1e-14)
    quarter, angles = rotation("z", np.pi / 2), np.array([0.0, 180.0])
    in_body = np.array(
        [(quarter.T @ np.append(r, 0.0))[:2] for r in readings(0.01, -0.02, angles, 0.0)]
    )
    turned = log_of(in_body, ACCEL, dwell=SAMPLES, angles={"outer": angles})
    mounted = Setup(site=SETUP.site, rig=Rig(table="vertical", mount="Rz(90)"), sensor=(ACCEL,))
    assert calibrate("two_position", turned, mounted).value("base.pitch") == pytest.approx(
        -0.02, abs=1e-14
    )


def monte_carlo(draws: int, name: str, estimator: str, code: float = 0.0) -> np.ndarray:
    """Errors of the roll, rad, (draws,), with 50 ug noise and 200 samples a position."""
    clean = log(0.0, 0.0)
    segments = [s for s in find_segments(clean, guard=0.0) if s.kind == "dwell"]
    segments = [
        type(s)(s.start, s.end, f, f + SAMPLES, "dwell")
        for s, f in zip(segments, (0, SAMPLES + 12), strict=True)
    ]
    rng = rng_of(name)
    errors = np.empty(draws)
    for k in range(draws):
        roll = rng.uniform(-0.02, 0.02)
        draw = log(roll, 0.0, noise=rng.normal(0, SIGMA, (len(clean), 2)), code=code)
        errors[k] = (
            calibrate("two_position", draw, SETUP, segments=segments, estimator=estimator).value(
                "base.roll"
            )
            - roll
        )
    return errors


def test_all_reversals_together_reach_the_bound_and_their_intervals_cover():
    """Half the difference and half the sum of two means: variance s^2/2 each; d roll = du_y / (g
    cos roll), and so on.
    """
    draws, roll, pitch, s2 = draws_of(4000), 0.01, -0.02, SIGMA**2 / SAMPLES / 2
    names, true = (
        ["base.roll", "base.pitch", "accel.bias_x", "accel.bias_y"],
        np.array([roll, pitch, BIAS, BIAS]),
    )
    slopes = np.array(
        [
            [0, 1 / np.cos(roll)],
            [-1 / (np.cos(roll) * np.cos(pitch)), np.tan(pitch) * np.tan(roll) / np.cos(roll)],
        ]
    )
    bound = np.append((slopes**2).sum(axis=1) * s2 / G**2, [s2, s2])
    clean, rng = log(roll, pitch), rng_of("reversal family")
    step = SAMPLES + 12
    segments = [
        Segment(k * step / 20, (k * step + SAMPLES - 1) / 20, k * step, k * step + SAMPLES, "dwell")
        for k in range(2)
    ]
    errors, nees, inside = np.empty((draws, 4)), 0.0, np.zeros(4)
    for k in range(draws):
        draw = log(roll, pitch, noise=rng.normal(0, SIGMA, (len(clean), 2)))
        found = calibrate("two_position", draw, SETUP, segments=segments)
        errors[k] = [found.value(n) for n in names] - true
        nees += errors[k] @ np.linalg.solve(found.covariance, errors[k])
        inside += np.abs(errors[k]) <= 1.959964 * np.array(
            [found.parameters[n].sigma for n in names]
        )
    p = 1e-3 / 9 / 2  # one family: four variances, four coverages, the NEES
    ratio = (errors**2).sum(axis=0) / bound
    assert np.all((ratio > chi2.ppf(p, draws)) & (ratio < chi2.isf(p, draws))), ratio / draws
    # of the noise: its inverse is that much larger on average, in two channels
    freedom = 2 * SAMPLES - 2
    assert chi2.ppf(p, 4 * draws) < nees < chi2.isf(p, 4 * draws) * freedom / (freedom - 3), (
        nees / 4 / draws
    )
    low, high = binom.ppf([p, 1 - p], draws, 0.95)
    assert np.all((inside >= low) & (inside <= high)), inside / draws


def test_the_median_reaches_what_physics_allows():
    """docs/physics.md, "Reversal": bound 0.516 arcsec; a median is sqrt(pi/2) worse."""
    bound = SIGMA / (G * np.sqrt(2 * SAMPLES))
    assert bound / ARCSEC == pytest.approx(0.516, abs=0.001)
    draws = draws_of(4000)
    band = chi2.ppf([P, 1 - P], draws) / draws
    median = np.mean(monte_carlo(draws, "reversal by median", "median") ** 2) / bound**2
    assert band[0] * np.pi / 2 < median * (1 + 1 / SAMPLES)
    assert median < band[1] * np.pi / 2


def test_a_median_of_codes_defeats_the_dither():
    """docs/two_position.md, "Which estimator": 16 bit over +-1 g, 50 ug noise: mean 0.52 arcsec,
    median 1.47 arcsec (400 trials by another program).
    """
    code = 30.5e-6 * G0
    draws = draws_of(2000)
    mean = np.sqrt(np.mean(monte_carlo(draws, "codes by mean", "mean", code) ** 2)) / ARCSEC
    median = np.sqrt(np.mean(monte_carlo(draws, "codes by median", "median", code) ** 2)) / ARCSEC
    spread = 3.29 * np.sqrt(1 / (2 * draws) + 1 / (2 * 400))  # both figures are Monte Carlo
    assert median == pytest.approx(1.47, rel=spread)
    quantised = np.hypot(SIGMA, code / np.sqrt(12)) / (G * np.sqrt(2 * SAMPLES)) / ARCSEC
    assert mean == pytest.approx(quantised, rel=3.29 / np.sqrt(2 * draws))


def test_the_uncertainty_is_consistent_for_an_inclinometer():
    setup = Setup(site=SETUP.site, rig=SETUP.rig, sensor=(INCL,))
    rng = rng_of("reversal consistency")
    angles = np.array([0.0, 180.0, 0.0])
    draws, total = draws_of(4000), 0.0
    for _ in range(draws):
        tilt = np.arcsin(readings(0.01, -0.02, angles, 1e-3) / G)
        draw = log_of(
            tilt,
            INCL,
            dwell=60,
            angles={"outer": angles},
            noise=rng.normal(0, 50e-6, (3 * 72 - 12, 2)),
        )
        found = calibrate("two_position", draw, setup)
        error = np.array([found.value("base.roll") - 0.01, found.value("base.pitch") + 0.02])
        total += error @ np.linalg.solve(found.covariance[:2, :2], error)
    low, high = chi2.ppf([P, 1 - P], 2 * draws) / (2 * draws)
    # noise estimated from some 250 residuals
    assert low < total / (2 * draws) < high * (1 + 2 / 250)


def test_a_median_that_sticks_to_codes_is_warned_about():
    rng = rng_of("sticky median")
    clean = log(0.003, 0.0)
    draw = log(0.003, 0.0, noise=rng.normal(0, SIGMA, (len(clean), 2)), code=30.5e-6 * G0)
    found = calibrate("two_position", draw, SETUP, estimator="median")
    assert found.verdict == "suspect"
    assert (
        "use the mean"
        in next(t for t in found.tests if t.name == "median against quantisation").statement
    )


def test_a_base_that_moved_is_seen_by_the_repeats():
    rng = rng_of("moved base")
    angles = np.array([0.0, 180.0, 0.0, 180.0])
    means = readings(0.01, -0.02, angles)
    means[2:] += 20 * ARCSEC * G
    draw = log_of(
        means,
        ACCEL,
        dwell=SAMPLES,
        angles={"outer": angles},
        noise=rng.normal(0, SIGMA, (4 * 212 - 12, 2)),
    )
    assert calibrate("two_position", draw, SETUP).verdict == "suspect"


def noisy(means, angles, name, dwell=SAMPLES):
    """A log of dwells at these means with 50 ug of noise."""
    noise = rng_of(name).normal(0, SIGMA, (len(angles) * (dwell + 12) - 12, 2))
    return log_of(means, ACCEL, dwell=dwell, angles={"outer": angles}, noise=noise)


def solved(means, angles, name):
    """The calibration of such a log, its dwells given."""
    step = SAMPLES + 12
    spans = [
        Segment(k * step / 20, (k * step + SAMPLES - 1) / 20, k * step, k * step + SAMPLES, "dwell")
        for k in range(len(angles))
    ]
    return calibrate("two_position", noisy(means, angles, name), SETUP, segments=spans)


def said(found, name):
    return next(t for t in found.tests if t.name == name)


def test_positions_in_the_wrong_order_are_named():
    angles = np.array([0.0, 180.0, 0.0, 180.0])
    means = readings(0.01, -0.02, np.array([0.0, 180.0, 180.0, 0.0]))
    found = solved(means, angles, "wrong order")
    assert found.verdict == "suspect"
    assert "positions 3 and 4 are in another order" in said(found, "fit").statement


def test_a_moved_base_is_named_with_where():
    angles = np.array([0.0, 180.0, 0.0, 180.0])
    means = readings(0.01, -0.02, angles)
    means[2:] = readings(0.011, -0.0195, angles)[2:]
    found = solved(means, angles, "moved where")
    assert "the base moved between positions 2 and 3" in said(found, "fit").statement


def test_a_position_that_was_not_where_it_says_is_named_with_its_angle():
    angles = np.array([0.0, 180.0, 0.0, 180.0, 90.0])
    means = readings(0.01, -0.02, np.array([0.0, 180.0, 0.0, 170.0, 90.0]))
    found = solved(means, angles, "not where it says")
    statement = said(found, "fit").statement
    assert "position 4 disagrees with the others" in statement
    assert "it fits -10.00 deg off its angle" in statement


def test_what_no_single_fault_explains_is_not_guessed():
    angles = np.array([0.0, 180.0, 0.0, 180.0, 0.0, 180.0])
    means = readings(0.01, -0.02, angles) + rng_of("no fault").normal(0, 30 * ARCSEC * G, (6, 2))
    assert "no single fault explains it" in said(solved(means, angles, "guess"), "fit").statement


def test_a_base_that_moves_during_a_position_is_seen_even_with_two():
    draw = log(0.01, -0.02, noise=rng_of("creeping").normal(0, SIGMA, (2 * SAMPLES + 12, 2)))
    creep = np.clip((draw.time - draw.time[-SAMPLES]) / 10.0, 0, 1) * 20 * ARCSEC * G
    columns = {
        n: draw.column(n) + (creep if n.startswith("accel_y") else 0.0) for n in draw.column_names
    }
    rows = ((0, SAMPLES), (SAMPLES + 12, 2 * SAMPLES + 12))
    segments = [Segment(draw.time[a], draw.time[b - 1], a, b, "dwell") for a, b in rows]
    found = calibrate(
        "two_position", Recording.from_columns(draw.time, columns), SETUP, segments=segments
    )
    assert found.verdict == "suspect"
    assert "moved during position 2" in said(found, "still while dwelling").statement


@pytest.mark.parametrize("full_scale", [None, 2.5])
def test_a_saturated_channel_is_named(full_scale):
    draw = log(0.01, 0.3, noise=rng_of("clipped").normal(0, SIGMA, (2 * SAMPLES + 12, 2)))
    columns = {
        n: np.minimum(draw.column(n), 2.5) if n.startswith("accel") else draw.column(n)
        for n in draw.column_names
    }
    setup = SETUP.model_copy(
        update={"sensor": (ACCEL.model_copy(update={"full_scale": full_scale}),)}
    )
    with pytest.raises(
        TiltcalError,
        match=r"found accel_x_m_s2: saturated at 2.5, or frozen at its extreme",
    ):
        calibrate("two_position", Recording.from_columns(draw.time, columns), setup)


@pytest.mark.parametrize("estimator", ["mean", "median", "huber", "tukey", "inliers"])
def test_every_estimator_finds_the_tilt_and_the_mean_says_when_another_is_better(estimator):
    rng = rng_of(f"estimators {estimator}")
    wide = rng.random((2 * SAMPLES + 12, 2)) < 0.2
    draw = log(0.0035, 0.0173, noise=rng.normal(size=wide.shape) * np.where(wide, 1e-3 * G0, SIGMA))
    found = calibrate("two_position", draw, SETUP, estimator=estimator)
    for name, value in (("base.roll", 0.0035), ("base.pitch", 0.0173)):
        assert abs(found.value(name) - value) < 4 * found.parameters[name].sigma
    tails = [w for w in found.warnings if "heavy tails" in w or "were rejected" in w]
    assert bool(tails) == (estimator in ("mean", "tukey", "inliers"))


def test_two_dwells_say_that_nothing_checks_them():
    found = calibrate("two_position", log(0.01, 0.0), SETUP)
    assert any("A-B-A" in w for w in found.warnings)


def test_a_turn_that_is_no_half_turn_is_named():
    found = calibrate("two_position", log(0.01, 0.0, angles=(0.0, 170.0)), SETUP)
    assert found.verdict == "suspect"
    assert "10 deg off 180" in next(t for t in found.tests if t.name == "half a turn").statement


def test_wrong_tables_options_and_missing_angles_are_refused_in_words():
    with pytest.raises(TiltcalError, match="need table vertical"):
        calibrate("two_position", log(0.0, 0.0), setup_of("dual", ACCEL))
    with pytest.raises(
        TiltcalError, match="found 'mode', need one of mean, median, huber, tukey, inliers"
    ):
        calibrate("two_position", log(0.0, 0.0), SETUP, estimator="mode")
    with pytest.raises(TiltcalError, match="need two positions half a turn apart"):
        calibrate("two_position", log(0.0, 0.0, angles=(0.0, 5.0)), SETUP)
    bare = log_of(readings(0.0, 0.0, np.array([0.0, 180.0])), ACCEL, dwell=SAMPLES)
    with pytest.raises(TiltcalError, match="without a readout of table_outer"):
        calibrate("two_position", bare, SETUP)
