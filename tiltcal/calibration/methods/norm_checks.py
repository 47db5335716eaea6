"""Checks of the norm method: held-out directions, condition of the positions, next pose.

The norm method with a linear drift of each bias, seen inside the dwells and between them.
"""

from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms
from tiltcal.calibration.methods.norm_iteration import Iteration
from tiltcal.calibration.methods.norm_model import (
    Further,
    common_errors,
    directions,
    model_of,
    norm_sigma,
    slopes_of_norm,
    solve,
    vector_of,
)
from tiltcal.calibration.screen.causes import Misfit, at_poses
from tiltcal.calibration.screen.columns import unit_tests
from tiltcal.calibration.screen.drift import mean_slope
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.frames import AXES, angle_between, sphere
from tiltcal.core.units import DEG
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses, group_directions
from tiltcal.setup.pose_schemes import label_of
from tiltcal.statistics.least_squares import Fit

# of the positions: the best six have 1, a fifth of random ones exceed this
BAD_CONDITION = 100.0
# a held-out direction predicted to more than this many sigmas of its own noise tests nothing
UNTESTED = 10.0
REPEATED = 5 * DEG
CANDIDATES = 200  # directions from which the next pose is chosen


def norm_tests(
    poses: Poses, fit: Fit, converged: bool, prediction: float, terms: int
) -> tuple[list[Test], bool]:
    """The tests, and whether the poses determine the model. prediction: of a held-out direction,
    in units of its own noise.
    """
    condition = _condition(poses, vector_of(fit, poses, terms))
    steps = f"{fit.iterations} Gauss-Newton iterations"
    words = (
        f"condition number {condition:.3g} (axis-aligned positions: 1; a fifth of random ones: over"
        f" {BAD_CONDITION:.0f})"
    )
    tests = [
        threshold_test("converged", fit.iterations, converged, steps),
        threshold_test("condition of the positions", condition, condition <= BAD_CONDITION, words),
    ]
    if fit.dof > 0:
        words = f"{len(poses)} norms against {terms} parameters and the noise of the means"
        tests.append(chi2_test("fit", fit.chi2, fit.dof, words))
    tests.append(_prediction_test(prediction, fit.dof))
    determined = converged and not fit.dropped and fit.dof > 0 and prediction <= UNTESTED
    return tests, determined


def plausibility_tests(poses: Poses, fit: Fit, terms: int, unit: str) -> list[Test]:
    """Whether the solution is a sensor's: its unit, no mirrored axis; and whether every side was
    up, so that the model was tested there.
    """
    x = vector_of(fit, poses, terms)
    M = model_of(x)[1]
    least = float(np.linalg.eigvalsh(M).min())
    words = "no axis of the solution is mirrored"
    if least <= 0:
        words = f"an axis of the solution is mirrored (1 + scale {least:.3g}): no sensor is so"
    up = directions(poses.means, x)[0]
    up = up / np.linalg.norm(up, axis=1)[:, None]
    faces = {
        f"{sign}{a}": (1 if sign == "+" else -1) * up[:, AXES.index(a)]
        for a in AXES
        for sign in "+-"
    }
    missing = [face for face, towards in faces.items() if towards.max() < 0.5]
    sides = "every axis was recorded up and down"
    if missing:
        sides = (
            f"no pose within 60 deg of {', '.join(missing)} up: the model was not tested there;"
            " record such poses"
        )
    return [
        *unit_tests(poses.sensor, M, unit),
        threshold_test("not mirrored", least, least > 0, words),
        threshold_test("faces complete", len(missing), not missing, sides, dof=6),
    ]


def norm_notes(poses: Poses, fit: Fit, g: float, terms: int) -> list[str]:
    """What the norm cannot see, and the next pose."""
    notes = [
        "a rotation of the whole triad (mounting) does not change the norm and is not estimated",
        next_pose(poses, fit, g, terms),
    ]
    up = directions(poses.means, vector_of(fit, poses, terms))[0]
    near = angle_between(up[:, None], up[None]) < REPEATED
    if not np.any(np.triu(near, 2)):
        notes.append(
            "no attitude was repeated later: a drift of the bias is seen inside the dwells only"
        )
    return notes


def _prediction_test(prediction: float, dof: int) -> Test:
    words = "no redundant pose is left to test the model"
    if np.isfinite(prediction):
        words = f"a direction left out is predicted to {prediction:.3g} times its own noise"
    words += f"; above {UNTESTED:.0f} a wrong model could not be detected"
    name, ok = "directions predict each other", prediction <= UNTESTED
    return threshold_test(name, min(prediction, 1e9), ok, words, dof=dof)


def leave_directions_out(
    poses: Poses, g: float, terms: int, fit: Fit
) -> tuple[float | None, float]:
    """Held-out rms of |f| - g over whole directions left out (SI), and the prediction of the worst
    direction.

    The second is the largest predicted standard deviation of a left-out norm over its own noise.
    """
    whole = vector_of(fit, poses, terms)
    group = group_directions(directions(poses.means, whole)[0])
    residuals, worst = [], 0.0
    for k in range(group.max() + 1):
        rest, out = poses.subset(group != k), poses.subset(group == k)
        if len(rest) < terms:
            return None, np.inf
        part, _ = solve(rest, g, terms, whole)
        if part.dropped:
            return None, np.inf
        f, v = directions(out.means, part.values)
        residuals.append(np.linalg.norm(f, axis=1) - g)
        slopes = slopes_of_norm(f, v, terms) / norm_sigma(out, part.values)[:, None]
        variances = np.einsum("ki,ij,kj->k", slopes, part.covariance, slopes)
        worst = max(worst, float(variances.max()))
    return leave_out_rms(residuals), float(np.sqrt(worst))


def _condition(poses: Poses, x: Array) -> float:
    """Condition number of d|f|/g by bias/g, scale and cross terms, all poses of equal weight."""
    f, v = directions(poses.means, x)
    g = np.linalg.norm(f, axis=1).mean()
    s = np.linalg.svd(slopes_of_norm(f / g, v, len(x)), compute_uv=False)
    return float(s[0] / max(s[-1], 1e-12 * s[0]))


def next_pose(poses: Poses, fit: Fit, g: float, terms: int) -> str:
    """The pose that would add most information: where the norm is predicted worst relative to its
    own noise.
    """
    x = vector_of(fit, poses, terms)
    f, v = directions(poses.means, x)
    sigma = norm_sigma(poses, x)
    rows = slopes_of_norm(f, v, terms) / sigma[:, None]
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    rows = rows / scale
    # the small ridge makes a parameter that is not observed at all come first
    information = rows.T @ rows + 1e-9 * np.eye(terms)
    candidates = np.vstack([np.eye(3), -np.eye(3), sphere(CANDIDATES)])
    inverse = np.linalg.inv(model_of(x)[1])
    slopes = slopes_of_norm(g * candidates, candidates @ inverse, terms)
    new = slopes / scale / np.sqrt(np.median(sigma**2))
    variance = np.einsum("ki,ij,kj->k", new, np.linalg.inv(information), new)
    best = int(np.argmax(variance))
    return (
        f"next best pose: {label_of(np.round(candidates[best], 2))} up (its norm is now predicted"
        f" to {np.sqrt(variance[best]):.2g} times its own noise)"
    )


def compared_with_iteration(iteration: Iteration, fit: Fit, sensor: str, g: float) -> str:
    """The paper's iteration against the maximum-likelihood fit, in words."""
    steps = len(iteration.corrections)
    course = ", ".join(f"{c:.1g}" for c in iteration.corrections[:8])
    start = "the paper's product-and-sum iteration from G = 1, B = 0"
    if not iteration.converged:
        return f"{start} does not converge in {steps} steps (corrections {course})"
    gain = np.array([1 + fit.value(f"{sensor}.scale_{a}") for a in AXES])
    bias = np.array([fit.value(f"{sensor}.bias_{a}") for a in AXES])
    scale_ppm = np.abs(iteration.gain - gain).max() * 1e6
    bias_ug = np.abs(iteration.bias - bias).max() / g * 1e6
    return (
        f"{start} converges in {steps} steps (corrections {course}); it differs from the"
        f" maximum-likelihood fit by {scale_ppm:.2g} ppm and {bias_ug:.2g} ug"
    )


def solve_with_drift(
    poses: Poses, g: float, terms: int, start: float, length: float
) -> tuple[Fit, bool]:
    """Maximum likelihood of ``|f| = g`` with bias + drift (t - start) / length.

    The mean slope inside the dwells enters as a measurement of the drift: m norms and three slopes
    for ``terms`` + 3 parameters.

    Args:
        poses: means and slopes.
        g: m/s2.
        terms: 6 or 9.
        start, length: of the recording, s.
    """
    elapsed = _elapsed(poses, start, length)
    slope, sigma = mean_slope(poses)
    names = tuple(f"{poses.sensor.name}.drift_{a}" for a in AXES)
    columns = np.eye(3)[:, None, :] * elapsed[None, :, None]
    return solve(poses, g, terms, further=Further(names, columns, slope * length, sigma * length))


def misfit_of_norm(poses: Poses, fit: Fit, g: float, terms: int, recording: Recording) -> Misfit:
    """What a fit of norms leaves.

    Args:
        poses: means, without a fitted drift.
        fit: of them.
        g: m/s2.
        terms: 6 or 9.
        recording: that the poses are of.
    """
    x = vector_of(fit, poses, terms)
    f, v = directions(poses.means, x)
    sigma = norm_sigma(poses, x)

    def refit(columns: Array, kept: Mask) -> Misfit:
        rest, further = poses.subset(kept), Further.unknown(columns[:, kept])
        found, _ = solve(rest, g, terms, x, further)
        sizes = np.array([found.value(n) for n in further.names])
        level = replace(rest, means=further.taken_off(rest.means, sizes))
        return misfit_of_norm(level, found, g, terms, recording)

    common = common_errors(poses, x, sigma)
    return at_poses(
        poses,
        recording,
        g,
        f,
        common.weight((np.linalg.norm(f, axis=1) - g) / sigma),
        slopes_of_norm(f, v, terms) / sigma[:, None],
        lambda errors: np.einsum("mi,qmi->mq", v / sigma[:, None], errors),
        refit,
    ).sharing(common)


def without_slope(poses: Poses, fit: Fit, start: float, length: float) -> Poses:
    """The poses with the fitted drift taken off their means. start, length: of the recording, s."""
    drift = np.array([fit.value(f"{poses.sensor.name}.drift_{a}") for a in AXES])
    return replace(poses, means=_level(poses, drift, _elapsed(poses, start, length)))


def _level(poses: Poses, drift: Array, elapsed: Array) -> Array:
    return np.asarray(poses.means - elapsed[:, None] * drift)


def _elapsed(poses: Poses, start: float, length: float) -> Array:
    middles = np.array([(s.start_s + s.end_s) / 2 for s in poses.spans])
    return np.asarray((middles - start) / length)
