"""Poses of known attitude: tests of the fit, columns, units and faces; the fixture's rotation."""

from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import fitted_sensitivity
from tiltcal.calibration.methods.known_attitude_causes import (
    FACES,
    causes,
    gain,
    is_plausible,
)
from tiltcal.calibration.methods.known_attitude_model import DRIFT, Model, solve
from tiltcal.calibration.screen.columns import order_test
from tiltcal.calibration.screen.drift import slope_test
from tiltcal.calibration.screen.explanations import in_words
from tiltcal.calibration.screen.units import unit_test
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.core.units import ARCSEC
from tiltcal.recordings.static_poses import Poses, group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.least_squares import Fit


def known_attitude_tests(poses: Poses, model: Model, fit: Fit, unit: str) -> list[Test]:
    """Consistency of the poses with its most probable cause, second order, drift; for a triad
    unit, columns and faces.

    Args:
        poses: of known attitude.
        model, fit: of their means.
        unit: of the sensor's columns.
    """
    words = f"residuals of {fit.dof} redundant equations against the noise of the means"
    tests = [chi2_test("fit", fit.chi2, fit.dof, words), *_second_order(poses, model, fit)]
    if DRIFT not in model.terms:
        tests.append(slope_test(poses))
    if len(poses.sensor.axes) < 3:
        return tests
    M = fitted_sensitivity(fit, poses.sensor.name)
    linear = {"scale", "cross_axis"} <= set(model.terms) and not fit.dropped
    if linear:
        tests += [unit_test(poses.sensor, np.diag(M), unit), _order_test(M)]
    if not tests[0].passed or (linear and not is_plausible(M)):
        nothing = "no single cause that was tried explains it"
        why = in_words(causes(poses, model, fit), nothing)
        tests.append(threshold_test("cause", len(poses), False, why))
    return [*tests, _faces_complete(poses)]


def _order_test(M: Array) -> Test:
    """Does every channel follow its own axis, whatever the unit?"""
    return order_test(M / gain(M))


def _second_order(poses: Poses, model: Model, fit: Fit) -> list[Test]:
    """Does a quadratic term explain what the redundant equations leave?"""
    terms = model.terms
    if "K2" in terms or "bias" not in terms or fit.dof < 3 or fit.dropped:
        return []
    wider, _ = solve(poses, replace(model, terms=[*terms, "K2"]))
    gained = len(wider.names) - len(fit.names)
    # otherwise these poses cannot separate K2 from the linear terms
    if gained <= 0 or not set(fit.names) <= set(wider.names):
        return []
    drop = fit.chi2 - wider.chi2
    sizes = ", ".join(f"{n} {wider.value(n):.3g}" for n in wider.names if ".K2_" in n)
    words = f"a quadratic term (ug/g2: {sizes}) reduces chi2 by {drop:.3g}"
    return [chi2_test("second order", drop, gained, words)]


def _faces_complete(poses: Poses) -> Test:
    missing = [face for face, e in FACES.items() if np.max(poses.up @ e) < 0.5]
    words = "every axis was recorded up and down"
    if missing:
        words = f"no pose within 60 deg of {', '.join(missing)} up"
    group = group_directions(poses.up)
    first = np.unique(group, return_index=True)[1]
    repeated = [
        f"{_face(poses.up[k])} {n} times"
        for k, n in zip(first, np.bincount(group), strict=True)
        if n > 1
    ]
    if missing and repeated:
        words += f", but {', '.join(repeated)}: recorded twice instead?"
    return threshold_test("faces complete", len(missing), not missing, words, dof=6)


def _face(direction: Array) -> str:
    """The axis nearest to a direction, such as ``+x``."""
    i = int(np.argmax(np.abs(direction)))
    return ("+" if direction[i] > 0 else "-") + AXES[i]


def fixture_rotation(fit: Fit, sensor: Sensor) -> str:
    """The rotation of the fixture that would give the same antisymmetric cross-axis terms, in
    words.
    """
    words = (
        "a rotation common to all poses (fixture or mounting) cannot be distinguished from the"
        " antisymmetric part of the cross-axis terms"
    )
    pairs = [("yz", "zy"), ("zx", "xz"), ("xy", "yx")]
    names = [[f"{sensor.name}.cross_{ij}" for ij in pair] for pair in pairs]
    if not all(n in fit.names for pair in names for n in pair):
        return words
    sizes = []
    for axis, pair in zip(AXES, names, strict=True):
        i, j = (fit.names.index(n) for n in pair)
        C = fit.covariance
        angle = (fit.values[i] - fit.values[j]) / 2 / ARCSEC
        sigma = np.sqrt(C[i, i] + C[j, j] - 2 * C[i, j]) / 2 / ARCSEC
        sizes.append(f"{axis} {angle:.4g} +- {sigma:.2g}")
    return (
        f"{words}: here it would be a rotation of {', '.join(sizes)} arcsec; the symmetric part,"
        " scale and bias do not depend on it"
    )
