"""S4: reversal on a vertical table."""

import numpy as np
import pytest
from builders import INCL, setup_of
from logs import log_of
from scipy.stats import chi2
from statistics_helpers import rng_of

from tiltcal.errors import TiltcalError
from tiltcal.frames import rotation
from tiltcal.methods.registry import calibrate
from tiltcal.segments import find_segments
from tiltcal.setup import Rig, Sensor, Setup, Site
from tiltcal.units import ARCSEC, DEG, G0

G = 9.80665
ACCEL = Sensor(name="accel", kind="accelerometer", axes=("x", "y"), rate_hz=20.0)
SETUP = Setup(site=Site(gravity_m_s2=G), rig=Rig(table="vertical"), sensor=(ACCEL,))
SAMPLES, SIGMA, BIAS = 200, 50e-6 * G0, 2e-3 * G0
P = 1e-3 / 2


def readings(roll: float, pitch: float, angles: np.ndarray, bias: float = BIAS) -> np.ndarray:
    """f_b = Rz(-a) R_base^T (0, 0, g), first two components, plus bias."""
    base = rotation("x", roll) @ rotation("y", pitch)
    return np.array([(rotation("z", -a) @ base.T @ [0, 0, G])[:2] + bias for a in np.radians(angles)])


def log(roll, pitch, angles=(0.0, 180.0), sensor=ACCEL, noise=None, dwell=SAMPLES, code=0.0):
    values = log_of(readings(roll, pitch, np.array(angles)), sensor, dwell=dwell, angles={"outer": np.array(angles)}, noise=noise)
    if code:
        columns = {
            n: np.round(values.column(n) / code) * code if n.startswith("accel") else values.column(n) for n in values.column_names
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
    in_body = np.array([(quarter.T @ np.append(r, 0.0))[:2] for r in readings(0.01, -0.02, angles, 0.0)])
    turned = log_of(in_body, ACCEL, dwell=SAMPLES, angles={"outer": angles})
    mounted = Setup(site=SETUP.site, rig=Rig(table="vertical", mount="Rz(90)"), sensor=(ACCEL,))
    assert calibrate("two_position", turned, mounted).value("base.pitch") == pytest.approx(-0.02, abs=1e-14)


def monte_carlo(draws: int, name: str, estimator: str, code: float = 0.0) -> np.ndarray:
    """Errors of the roll, rad, (draws,), with 50 ug noise and 200 samples a position."""
    clean = log(0.0, 0.0)
    segments = [s for s in find_segments(clean, guard=0.0) if s.kind == "dwell"]
    segments = [type(s)(s.start, s.end, f, f + SAMPLES, "dwell") for s, f in zip(segments, (0, SAMPLES + 12), strict=True)]
    rng = rng_of(name)
    errors = np.empty(draws)
    for k in range(draws):
        roll = rng.uniform(-0.02, 0.02)
        draw = log(roll, 0.0, noise=rng.normal(0, SIGMA, (len(clean), 2)), code=code)
        errors[k] = calibrate("two_position", draw, SETUP, segments=segments, estimator=estimator).value("base.roll") - roll
    return errors


@pytest.mark.slow
def test_mean_and_median_reach_what_physics_allows():
    """PHYSICS 6 (4): bound 0.516 arcsec; a median is sqrt(pi/2) worse."""
    bound = SIGMA / (G * np.sqrt(2 * SAMPLES))
    assert bound / ARCSEC == pytest.approx(0.516, abs=0.001)
    draws = 4000
    band = chi2.ppf([P, 1 - P], draws) / draws
    mean = np.mean(monte_carlo(draws, "reversal by mean", "mean") ** 2) / bound**2
    assert band[0] < mean < band[1]
    median = np.mean(monte_carlo(draws, "reversal by median", "median") ** 2) / bound**2
    assert band[0] * np.pi / 2 < median * (1 + 1 / SAMPLES)
    assert median < band[1] * np.pi / 2


@pytest.mark.slow
def test_a_median_of_codes_defeats_the_dither():
    """PHYSICS 0.9: 16 bit over +-1 g, 50 ug noise: mean 0.52 arcsec, median 1.47 arcsec (400 trials there)."""
    code = 30.5e-6 * G0
    draws = 2000
    mean = np.sqrt(np.mean(monte_carlo(draws, "codes by mean", "mean", code) ** 2)) / ARCSEC
    median = np.sqrt(np.mean(monte_carlo(draws, "codes by median", "median", code) ** 2)) / ARCSEC
    spread = 3.29 * np.sqrt(1 / (2 * draws) + 1 / (2 * 400))  # both figures are Monte Carlo
    assert median == pytest.approx(1.47, rel=spread)
    quantised = np.hypot(SIGMA, code / np.sqrt(12)) / (G * np.sqrt(2 * SAMPLES)) / ARCSEC
    assert mean == pytest.approx(quantised, rel=3.29 / np.sqrt(2 * draws))


@pytest.mark.slow
def test_the_uncertainty_is_consistent_for_an_inclinometer():
    setup = Setup(site=SETUP.site, rig=SETUP.rig, sensor=(INCL,))
    rng = rng_of("reversal consistency")
    angles = np.array([0.0, 180.0, 0.0])
    draws, total = 4000, 0.0
    for _ in range(draws):
        tilt = np.arcsin(readings(0.01, -0.02, angles, 1e-3) / G)
        draw = log_of(tilt, INCL, dwell=60, angles={"outer": angles}, noise=rng.normal(0, 50e-6, (3 * 72 - 12, 2)))
        found = calibrate("two_position", draw, setup)
        error = np.array([found.value("base.roll") - 0.01, found.value("base.pitch") + 0.02])
        total += error @ np.linalg.solve(found.covariance[:2, :2], error)
    low, high = chi2.ppf([P, 1 - P], 2 * draws) / (2 * draws)
    assert low < total / (2 * draws) < high * (1 + 2 / 250)  # noise estimated from some 250 residuals


def test_a_median_that_sticks_to_codes_is_warned_about():
    rng = rng_of("sticky median")
    clean = log(0.003, 0.0)
    draw = log(0.003, 0.0, noise=rng.normal(0, SIGMA, (len(clean), 2)), code=30.5e-6 * G0)
    found = calibrate("two_position", draw, SETUP, estimator="median")
    assert found.verdict == "suspect"
    assert "use the mean" in next(t for t in found.tests if t.name == "median against codes").statement


def test_a_base_that_moved_is_seen_by_the_repeats():
    rng = rng_of("moved base")
    angles = np.array([0.0, 180.0, 0.0, 180.0])
    means = readings(0.01, -0.02, angles)
    means[2:] += 20 * ARCSEC * G
    draw = log_of(means, ACCEL, dwell=SAMPLES, angles={"outer": angles}, noise=rng.normal(0, SIGMA, (4 * 212 - 12, 2)))
    assert calibrate("two_position", draw, SETUP).verdict == "suspect"


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
    with pytest.raises(TiltcalError, match="found mode, need mean or median"):
        calibrate("two_position", log(0.0, 0.0), SETUP, estimator="mode")
    with pytest.raises(TiltcalError, match="need two positions half a turn apart"):
        calibrate("two_position", log(0.0, 0.0, angles=(0.0, 5.0)), SETUP)
    bare = log_of(readings(0.0, 0.0, np.array([0.0, 180.0])), ACCEL, dwell=SAMPLES)
    with pytest.raises(TiltcalError, match="without a readout of table_outer"):
        calibrate("two_position", bare, SETUP)
