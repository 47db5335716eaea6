"""The zero of an angle readout (tare) beside the terms of a sensor: fitted where it is stated."""

import numpy as np
import pytest
from builders import G, setup_of
from logs import log_of
from statistics_helpers import rng_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.units import ARCSEC
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.sources import SourceTable

LEVEL = Sensor(name="level", kind="accelerometer", axes=("x", "y"), rate_hz=50.0)
BIAS = np.array([0.06, -0.045])
M = np.array([[1.003, 0.0025, 0.0009], [-0.0012, 0.9975, -0.0015]])
SIGMA, DWELL = 1e-3, 200
WIDE, FOUR = np.arange(-60.0, 61.0, 15.0), (0.0, 90.0, 180.0, 270.0)
NAMES = ["bias_x", "bias_y", "scale_x", "scale_y"]
NAMES += ["cross_xy", "cross_xz", "cross_yx", "cross_yz"]
PRIOR = 3600.0


def up_of(outer, inner):
    """Up in the body behind a horizontal axis x, turned by ``outer``, and an axis z on it, turned
    by ``inner``, deg: (m, 3).
    """
    a, b = np.radians(outer), np.radians(inner)
    return np.column_stack([np.sin(a) * np.sin(b), np.sin(a) * np.cos(b), np.cos(a)])


def recorded(zero_arcsec, tilts=WIDE, headings=FOUR, seed="zero", bias=BIAS, gain=M):
    """A log of a level at known readouts, and the readouts of its poses, deg; true = readout less
    zero.
    """
    outer, inner = (v.ravel() for v in np.meshgrid(tilts, headings))
    readings = bias + G * up_of(outer - zero_arcsec / 3600, inner) @ gain.T
    rows = (DWELL + 12) * len(outer) - 12
    noise = rng_of(f"{seed} {zero_arcsec}").normal(0, SIGMA, (rows, 2))
    angles = {"outer": outer, "inner": inner}
    return log_of(readings, LEVEL, dwell=DWELL, noise=noise, angles=angles), outer, inner


def stating(size_arcsec=PRIOR) -> Setup:
    table = {"id": "table_encoder_zero", "outer_zero_arcsec": size_arcsec}
    budget = (SourceTable.model_validate(table),)
    return setup_of("dual", LEVEL).model_copy(update={"budget": budget})


def slopes_by_hand(outer, inner, names=NAMES):
    """Change of every mean per unit of each parameter, and per arcsec of the zero, (2 m, p + 1)."""
    f = G * up_of(outer, inner)
    found = []
    for name in names:
        term, _, axes = name.partition("_")
        column = np.ones(len(f)) if term == "bias" else f[:, "xyz".index(axes[-1])]
        found.append(np.outer(column, [axes[0] == "x", axes[0] == "y"]).ravel())
    step = 0.01
    pair = (G * up_of(outer - way * step / 3600, inner) @ M.T for way in (1, -1))
    up, down = (p.ravel() for p in pair)
    return np.column_stack([*found, (up - down) / (2 * step)])


def said(found: Calibration, start: str) -> str:
    (note,) = [w for w in found.warnings if w.startswith(start)]
    return note


@pytest.mark.parametrize("zero", [0.0, 40.0, -1800.0, 5400.0])
def test_a_stated_zero_is_fitted_and_leaves_the_terms_unharmed(zero):
    log, outer, inner = recorded(zero)
    found = calibrate("six_position", log, stating())
    assert found.verdict == "good", [t.statement for t in found.tests if not t.passed]
    (reference,) = found.references
    value, sigma = reference.posterior
    assert abs(value - zero) < 4 * sigma
    # beyond its first order a zero of 1.5 deg is a scale error of 343 ppm
    truth = [*BIAS, M[0, 0] - 1, M[1, 1] - 1, *M[0, 1:], M[1, 0], M[1, 2]]
    for name, true in zip(NAMES, truth, strict=True):
        estimate = found.parameters[f"level.{name}"]
        assert abs(estimate.value - true) < 4 * estimate.sigma, name
    A = slopes_by_hand(outer - zero / 3600, inner)
    used = np.mean([round((p.end_s - p.start_s) * 50) + 1 for p in found.poses])
    prior = np.diag([*np.zeros(len(NAMES)), PRIOR**-2])
    by_hand = np.sqrt(np.diag(np.linalg.inv(A.T @ A * used / SIGMA**2 + prior)))
    sigmas = [*(found.parameters[f"level.{n}"].sigma for n in NAMES), sigma]
    assert sigmas == pytest.approx(by_hand, rel=0.05)
    note = said(found, "table_encoder_zero outer_zero by this recording")
    assert "(stated: 0 +- 3600 arcsec)" in note


def test_an_unstated_zero_is_suspect_and_named_with_its_size():
    log, _, _ = recorded(600.0, seed="unstated")
    found = calibrate("six_position", log, setup_of("dual", LEVEL))
    assert found.verdict == "suspect"
    (cause,) = [t.statement for t in found.tests if t.name == "cause"]
    words, _, rest = cause.partition(" is off by ")
    assert words == "explained by one cause: the zero of the readout of axis outer"
    value, _, rest = rest.partition(" +- ")
    assert abs(float(value) - 600) < 4 * float(rest.split()[0])
    assert "state table_encoder_zero in [[budget]]" in cause


def test_at_one_heading_a_zero_is_a_turn_of_the_mount_and_the_method_says_so():
    """The zero turns every pose about one axis of the body: it is cross_yz and scale, exactly."""
    log, outer, inner = recorded(600.0, headings=(0.0,), gain=np.eye(3)[:2])
    names = ["bias_y", "scale_y", "cross_yz"]
    f = G * up_of(outer, inner)
    columns = np.column_stack([np.ones(len(f)), f[:, 1], f[:, 2]])
    zero = slopes_by_hand(outer, inner)[1::2, -1]
    left = zero - columns @ np.linalg.lstsq(columns, zero, rcond=None)[0]
    assert np.abs(left).max() < 1e-6 * np.abs(zero).max()  # no new direction
    found = calibrate("six_position", log, stating(), terms=["bias", "scale", "cross_axis"])
    note = said(found, "these readings do not distinguish table_encoder_zero outer_zero from")
    assert "from level.cross_yz: its 3600 arcsec stay in their uncertainty" in note
    (reference,) = found.references
    assert reference.posterior == pytest.approx((0.0, PRIOR), abs=0.01 * PRIOR)
    sigma = found.parameters["level.cross_yz"].sigma
    assert sigma == pytest.approx(PRIOR * ARCSEC, rel=0.01)
    assert abs(found.value("level.cross_yz")) == pytest.approx(600 * ARCSEC, rel=0.01)
    assert found.parameters[f"level.{names[0]}"].sigma < 1e-3


@pytest.mark.parametrize(("reach", "separate"), [(2.0, False), (60.0, True)])
def test_bias_and_zero_are_one_over_a_narrow_range_and_two_over_a_wide_one(reach, separate):
    """sin(a - z) = sin a - z cos a: against a bias stays the change of cos a, 1 - cos of the reach.

    A level on one axis, without cross-axis terms: 9 poses of a mean of 0.07 mm/s2 each.
    """
    stated = 600.0
    log, outer, inner = recorded(
        200.0, tilts=np.linspace(-reach, reach, 9), headings=(0.0,), gain=np.eye(3)[:2]
    )
    terms = ["bias", "scale"]
    found = calibrate("six_position", log, stating(stated), terms=terms)
    A = slopes_by_hand(outer, inner, NAMES[:4])[1::2][:, [1, 3, 4]]
    used = np.mean([round((p.end_s - p.start_s) * 50) + 1 for p in found.poses])
    information = A.T @ A * used / SIGMA**2 + np.diag([0, 0, stated**-2])
    by_hand = np.sqrt(np.diag(np.linalg.inv(information)))
    (reference,) = found.references
    value, sigma = reference.posterior
    assert sigma == pytest.approx(by_hand[2], rel=0.05)
    assert found.parameters["level.bias_y"].sigma == pytest.approx(by_hand[0], rel=0.05)
    assert (sigma < 0.02 * stated) is separate
    assert abs(value - 200) < 4 * sigma
    assert abs(found.value("level.bias_y") - BIAS[1]) < 4 * found.parameters["level.bias_y"].sigma
    start = "table_encoder_zero outer_zero by" if separate else "these readings do not distinguish"
    assert ("bias_y" in said(found, start)) is not separate
