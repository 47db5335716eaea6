"""Judging: what is called the truth, the tilt error and the normalised error, by hand; and check's
own p-value.
"""

import numpy as np
import pytest
from builders import ACCEL, INCL, G, effect_of, setup_of
from logs import log_of, triad_readings
from scipy.stats import kstest
from statistics_helpers import rng_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import base_rotation, rotation, sphere
from tiltcal.core.units import ARCSEC, G0
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.setup import Setup
from tiltcal.validation.accuracy import (
    mount_rotation,
    normalised_error,
    tilt_error,
    true_parameters,
)
from tiltcal.validation.cross_check import check

SETUP = setup_of("handheld", ACCEL)
TRIAD_NAMES = [
    f"accel.{t}"
    for t in (
        "bias_x",
        "bias_y",
        "bias_z",
        "scale_x",
        "scale_y",
        "scale_z",
        "cross_xy",
        "cross_xz",
        "cross_yx",
        "cross_yz",
        "cross_zx",
        "cross_zy",
    )
]


def stating(
    values: dict[str, float], method: str = "six_position", sigma: float = 0.0
) -> Calibration:
    """A calibration of these values, all as uncertain."""
    estimates = {n: Estimate(v, sigma, "1") for n, v in values.items()}
    return Calibration(method, "good", estimates, sigma**2 * np.eye(len(values)))


def truth_of(
    *effects, setup: Setup = SETUP, method: str = "six_position", names=TRIAD_NAMES
) -> dict[str, float]:
    return true_parameters(setup, effects, stating(dict.fromkeys(names, 0.0), method))


# --------------------------------------------------------------------------------------------------
# ---------- the truth


def test_the_truth_of_a_bare_sensor_is_what_was_injected():
    bias = effect_of("acc_bias", SETUP, bias_x_ug=1000, bias_z_mg=-2)
    scale = effect_of("acc_scale", SETUP, scale_y_ppm=300)
    cross = effect_of("acc_cross_axis", SETUP, cross_zx_ppm=-500)
    truth = truth_of(bias, scale, cross)
    assert list(truth) == [n for n in truth if n in TRIAD_NAMES]
    expected = {
        "accel.bias_x": 1e-3 * G0,
        "accel.bias_z": -2e-3 * G0,
        "accel.scale_y": 3e-4,
        "accel.cross_zx": -5e-4,
    }
    for name in TRIAD_NAMES:
        assert truth[name] == pytest.approx(expected.get(name, 0.0), abs=1e-15), name


def test_a_turned_mounting_is_the_antisymmetric_part_of_the_truth():
    c = 200 * ARCSEC  # M = R': level, body x of the turned instrument looks down the slope
    truth = truth_of(effect_of("mount_misalignment", SETUP, tilt_z_arcsec=200))
    assert truth["accel.cross_xy"] == pytest.approx(np.sin(c))
    assert truth["accel.cross_yx"] == pytest.approx(-np.sin(c))
    assert truth["accel.scale_x"] == pytest.approx(np.cos(c) - 1)
    turns = mount_rotation(
        [effect_of("mount_misalignment", SETUP, tilt_x_deg=1, tilt_y_deg=2, tilt_z_deg=3)]
    )
    by_hand = (
        rotation("x", np.radians(1)) @ rotation("y", np.radians(2)) @ rotation("z", np.radians(3))
    )
    np.testing.assert_allclose(turns, by_hand, atol=1e-15)


def test_norm_sees_the_symmetric_factor_and_no_mounting():
    cross = effect_of("acc_cross_axis", SETUP, cross_xy_ppm=4000)
    turned = effect_of("mount_misalignment", SETUP, tilt_z_deg=20)
    for effects in ([cross], [cross, turned]):
        truth = truth_of(*effects, method="norm")
        # M = [[1, c], [0, 1]] and S S = M M' = [[1 + c^2, c], [c, 1]]; a 2x2 root is (A + sqrt(det)
        # I) / sqrt(tr + 2 sqrt(det))
        c = 4e-3
        root = np.sqrt(4 + c * c)
        assert truth["accel.cross_xy"] == pytest.approx(c / root, rel=1e-12)
        assert truth["accel.cross_yx"] == pytest.approx(c / root, rel=1e-12)
        assert truth["accel.scale_x"] == pytest.approx((2 + c * c) / root - 1, abs=1e-14)
        assert truth["accel.scale_y"] == pytest.approx(2 / root - 1, abs=1e-14)


def test_the_truth_of_a_base_is_its_levelling():
    setup = setup_of("vertical", INCL)
    levelling = effect_of("table_levelling", setup, tilt_east_arcsec=30, tilt_north_arcsec=-20)
    names = ["base.roll", "base.pitch", "incl.bias_x", "incl.bias_y"]
    truth = truth_of(levelling, setup=setup, names=names)
    assert truth == pytest.approx({"base.roll": 30 * ARCSEC, "base.pitch": -20 * ARCSEC})
    assert truth_of(setup=setup, names=names) == {"base.roll": 0.0, "base.pitch": 0.0}


# --------------------------------------------------------------------------------------------------
# ------ how far it is


def test_a_bias_tilts_by_its_part_across_up():
    bias = effect_of("acc_bias", SETUP, bias_x_ug=1000)
    error = tilt_error(SETUP, [bias], stating({"accel.bias_x": 0.0}))
    by_hand = 1e-3 * G0 / G * np.sqrt(2 / 3)  # the mean of sin^2 over the sphere is 2/3
    assert error.before == pytest.approx(by_hand, rel=2e-3)
    assert error.after == error.before
    assert tilt_error(SETUP, [bias], stating({"accel.bias_x": 1e-3 * G0})).after < 1e-12


def test_the_bound_is_what_the_covariance_makes_of_it():
    sigma = 1e-4 * G
    error = tilt_error(SETUP, [], stating({f"accel.bias_{a}": 0.0 for a in "xyz"}, sigma=sigma))
    assert error.bound == pytest.approx(np.sqrt(3 * 2 / 3) * 1e-4, rel=2e-3)


def test_a_common_rotation_is_not_the_fault_of_norm():
    turned = effect_of("mount_misalignment", SETUP, tilt_x_deg=2, tilt_z_deg=1)
    plain, free = (
        tilt_error(SETUP, [turned], stating({"accel.bias_x": 0.0}, method))
        for method in ("six_position", "norm")
    )
    assert plain.after > 0.02
    assert free.after < 1e-10
    assert free.over.endswith("after the best common rotation")


def test_the_error_of_a_base_is_the_angle_between_the_axes():
    setup = setup_of("vertical", INCL)
    levelling = effect_of("table_levelling", setup, tilt_east_deg=3, tilt_north_deg=4)
    found = stating({"base.roll": np.radians(3), "base.pitch": np.radians(4) + 1e-5}, sigma=1e-6)
    error = tilt_error(setup, [levelling], found)
    up = base_rotation(np.radians(3), np.radians(4))[2, 2]
    assert error.before == pytest.approx(np.arccos(up))
    # pitch turns about the base's own second axis
    assert error.after == pytest.approx(1e-5, rel=1e-6)
    assert error.bound == pytest.approx(np.sqrt(2) * 1e-6)


def test_the_normalised_error_is_a_mahalanobis_distance():
    covariance = np.array([[4.0, 1.0], [1.0, 1.0]])
    found = Calibration(
        "six_position", "good", {n: Estimate(1.0, 1.0, "1") for n in ("a.x", "a.y")}, covariance
    )
    value, dof = normalised_error(found, {"a.x": -1.0, "a.y": 0.0, "a.z": 5.0})
    # (2, 1) C^-1 (2, 1)', C^-1 = [[1, -1], [-1, 4]] / 3
    assert (value, dof) == (
        pytest.approx(4 / 3),
        2,
    )
    twins = Calibration("norm", "good", found.parameters, np.ones((2, 2)))
    # one number of two names
    assert normalised_error(twins, {"a.x": -2.0, "a.y": -2.0}) == (
        pytest.approx(9.0),
        1,
    )
    assert normalised_error(found, {}) == (0.0, 0)


# --------------------------------------------------------------------------------------------------
# ---------- the check

SENSOR = ACCEL.model_copy(update={"rate_hz": 50.0})
FACES = np.vstack([np.eye(3), -np.eye(3)])
LABELS = ["+x", "+y", "+z", "-x", "-y", "-z"]
BIAS = np.array([0.12, -0.08, 0.15])
M = np.array([[1.004, 0.003, -0.0015], [0.003, 0.997, 0.0022], [-0.0015, 0.0022, 1.0025]])
DWELL, MOVE, NOISE = 60, 12, 2e-3


def told(up, labels):
    """The dwells as an operator would list them."""
    starts = np.arange(len(up)) * (DWELL + MOVE)
    return [
        Segment(s / 50, (s + DWELL - 1) / 50, s, s + DWELL, "dwell", w)
        for s, w in zip(starts.tolist(), labels, strict=True)
    ]


def measured(up, rng):
    clean = triad_readings(up, G, BIAS, M)
    noise = rng.normal(0, NOISE, ((len(up) - 1) * (DWELL + MOVE) + DWELL, 3))
    return log_of(clean, SENSOR, dwell=DWELL, move=MOVE, noise=noise)


@pytest.mark.parametrize(
    ("method", "up", "other", "judged_by"),
    [
        ("six_position", FACES, FACES[[2, 0, 4, 5]], "tilt"),
        ("six_position", FACES, sphere(9), "norm"),
        pytest.param("norm", sphere(16), sphere(11), "norm", marks=pytest.mark.long),
        pytest.param("norm", sphere(16), FACES, "tilt", marks=pytest.mark.long),
    ],
)
def test_the_p_value_of_check_is_uniform_when_nothing_has_changed(method, up, other, judged_by):
    rng, setup = rng_of(f"check {method} {judged_by}"), setup_of("handheld", SENSOR)
    names = {tuple(f): w for f, w in zip(FACES.tolist(), LABELS, strict=True)}
    labels = [names.get(tuple(u)) for u in up.tolist()]
    seen = [names.get(tuple(u)) if judged_by == "tilt" else None for u in other.tolist()]
    p = []
    for _ in range(200):
        calibration = calibrate(method, measured(up, rng), setup, segments=told(up, labels))
        found = check(calibration, measured(other, rng), setup, segments=told(other, seen))
        assert found.judged_by == judged_by
        p.append(found.tests[0].p_value)
    assert kstest(p, "uniform").pvalue > 1e-3


def test_two_channels_without_attitudes_cannot_be_checked():
    setup = setup_of("handheld", INCL)
    log = log_of(np.zeros((1, 2)), INCL)
    dwell = [Segment(0, 2.95, 0, 60, "dwell", None)]
    with pytest.raises(
        TiltcalError,
        match=(
            r"found no known attitude, and 2 axes of incl, need table readout or direction labels"
        ),
    ):
        check(stating({"incl.bias_x": 0.0}), log, setup, segments=dwell)
