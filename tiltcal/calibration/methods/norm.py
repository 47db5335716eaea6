"""S2: attitudes unknown. At rest the length of the true specific force is g."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, wrap_up
from tiltcal.calibration.methods.norm_iteration import Iteration, product_and_sum
from tiltcal.calibration.methods.screening import require_unsaturated
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES, sphere
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses, group_directions
from tiltcal.setup.pose_schemes import label_of
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, gauss_newton

NAME = "norm"
PAIRS = ((0, 1), (0, 2), (1, 2))
BAD_CONDITION = 100.0  # the best six positions have 1, a fifth of random ones exceeds this
CANDIDATES = 200  # directions the next pose is chosen from
# a left-out direction predicted worse than this many sigmas of its own noise checks nothing
BLIND = 10.0


def norm(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: int | None = None,
) -> Calibration:
    """Bias, scale factor and (9 parameters) symmetric cross-axis terms from ``|f| = g`` at rest.

    Model: ``reading = b + M f`` with M symmetric, |f| = g; the direction of f is free at every
        pose. Maximum likelihood:
    only the radial part of the noise informs, with standard deviation sqrt(v' C v), v = M^-T f/|f|.

    Args:
        recording: a continuous log; the dwells are found, or given as ``segments``.
        setup: with an accelerometer triad.
        segments: dwells to use.
        sensor: which, when several fit.
        terms: 6 (bias, scale) or 9 (with cross-axis). Unless given: 9 where the scenario lets
            cross_axis be adjusted or says nothing, else 6.

    Raises:
        TiltcalError: terms is neither 6 nor 9, or there are fewer poses than parameters.

    Errors:
        Six poses and six parameters leave no residual: a wrong model cannot be seen. The mounting
            is invisible.

    Source: seed S2 (10.3969/j.issn1672-9730.2014.01.018); Won and Golnaraghi, IEEE TIM 59(8) 2010;
    PHYSICS 6 (2).
    """
    used = pick_sensor(setup, recording, ("accelerometer",), sensor, NAME)
    if len(used.axes) != 3:
        raise TiltcalError(
            f"method {NAME}",
            found=f"{len(used.axes)} axes of {used.name}",
            need="a triad",
            do="use six_position",
        )
    require_unsaturated(recording, used)
    if terms is None:
        terms = 9 if not used.adjustable or "cross_axis" in used.adjustable else 6
    if terms not in (6, 9):
        raise TiltcalError(
            f"method {NAME}, option terms", found=str(terms), need="6 or 9", do="correct it"
        )
    poses = find_poses(recording, setup, used, segments)
    if len(poses) < terms:
        raise TiltcalError(
            recording.source,
            found=f"{len(poses)} dwells",
            need=f"at least {terms} for {terms} parameters (12 are better)",
            do="record more positions"
            + (", or use --option terms=6" if terms == 9 and len(poses) >= 6 else ""),
        )
    g = setup.site.gravity
    fit, converged = solve(poses, g, terms)
    heldout, blindness = _leave_directions_out(poses, g, terms, fit)
    tests, determined = _tests(poses, fit, converged, blindness, terms)
    paper = product_and_sum(poses.means, g) if terms == 6 else None
    warnings = [
        "a rotation of the whole triad (mounting) does not change the norm and is not estimated"
    ]
    warnings += [
        next_pose(poses, fit, g, terms),
        *([_beside(paper, fit, used.name, g)] if paper else []),
    ]
    fit = mirrored(fit)
    units = ["m_s2" if ".bias_" in n else "1" for n in fit.names]
    result = wrap_up(
        NAME,
        verdict_of(tests, determined),
        fit,
        units,
        tests,
        warnings,
        poses,
        recording,
        equation=(
            f"{used.name}_i = bias_i + (1 + scale_i) f_i + sum_j cross_ij f_j, cross_ij = cross_ji,"
            " |f| = g"
        ),
        inverse="f = M^-1 (reading - bias)",
        heldout={} if heldout is None else {used.name: heldout},
    )
    return (
        replace(result, provenance={**result.provenance, "product_and_sum": paper.record})
        if paper
        else result
    )


def _beside(iteration: Iteration, fit: Fit, sensor: str, g: float) -> str:
    """The paper's iteration in words, against the maximum-likelihood fit."""
    steps = len(iteration.corrections)
    course = ", ".join(f"{c:.1g}" for c in iteration.corrections[:8])
    if not iteration.converged:
        return (
            f"the paper's product-and-sum iteration from G = 1, B = 0 does not converge in {steps}"
            f" steps (corrections {course})"
        )
    scale = max(
        abs(iteration.gain[i] - 1 - fit.value(f"{sensor}.scale_{a}")) for i, a in enumerate(AXES)
    )
    bias = max(abs(iteration.bias[i] - fit.value(f"{sensor}.bias_{a}")) for i, a in enumerate(AXES))
    return (
        f"the paper's product-and-sum iteration from G = 1, B = 0 converges in {steps} steps"
        f" (corrections {course}); it differs from the maximum-likelihood fit by {scale * 1e6:.2g}"
        f" ppm and {bias / g * 1e6:.2g} ug"
    )


def next_pose(poses: Poses, fit: Fit, g: float, terms: int) -> str:
    """The attitude that would tell most beside those recorded: where the norm is predicted worst
    against its own noise.
    """
    x = _full(fit, poses, terms)
    f, v = _directions(poses.means, x)
    rows = _slopes(f, v, terms) / _norm_sigma(poses, x)[:, None]
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1.0
    # what is not seen at all is seen first
    information = (rows / scale).T @ (rows / scale) + 1e-9 * np.eye(terms)
    candidates = np.vstack([np.eye(3), -np.eye(3), sphere(CANDIDATES)])
    inverse = np.linalg.inv(model_of(x)[1])
    new = (
        _slopes(g * candidates, candidates @ inverse, terms)
        / scale
        / np.sqrt(np.median(_norm_sigma(poses, x) ** 2))
    )
    told = np.einsum("ki,ij,kj->k", new, np.linalg.inv(information), new)
    best = int(np.argmax(told))
    return (
        f"next best pose: {label_of(np.round(candidates[best], 2))} up (its norm is now predicted"
        f" to {np.sqrt(told[best]):.2g} times its own noise)"
    )


def names_of(sensor: str, terms: int) -> list[str]:
    """Parameter names: biases, scales, and with nine the symmetric cross terms (each stands for
    cross_ij = cross_ji).
    """
    names = [f"{sensor}.bias_{a}" for a in AXES] + [f"{sensor}.scale_{a}" for a in AXES]
    return names + ([f"{sensor}.cross_{AXES[i]}{AXES[j]}" for i, j in PAIRS] if terms == 9 else [])


def mirrored(fit: Fit) -> Fit:
    """The fit with cross_ji named beside cross_ij: one number, two names, so that the equation can
    be applied as it stands.
    """
    twins = [(k, f"{n[:-2]}{n[-1]}{n[-2]}") for k, n in enumerate(fit.names) if ".cross_" in n]
    if not twins:
        return fit
    T = np.vstack([np.eye(len(fit.names)), np.eye(len(fit.names))[[k for k, _ in twins]]])
    names = (*fit.names, *(twin for _, twin in twins))
    return replace(fit, names=names, values=T @ fit.values, covariance=T @ fit.covariance @ T.T)


def model_of(x: Array) -> tuple[Array, Array]:
    """Bias (3,) and symmetric M (3, 3) of a parameter vector."""
    M = np.diag(1 + x[3:6])
    for value, (i, j) in zip(x[6:], PAIRS, strict=False):
        M[i, j] = M[j, i] = value
    return x[:3], M


def solve(poses: Poses, g: float, terms: int, start: Array | None = None) -> tuple[Fit, bool]:
    """Maximum likelihood from pose means; the fit and whether it converged.

    The noise of a norm depends a little on the parameters: it is taken from the last solution and
        kept while solving.
    """
    names = names_of(poses.sensor.name, terms)
    x = _start(poses.means, g, terms) if start is None else start
    for _ in range(3 if start is None else 1):
        sigma = _norm_sigma(poses, x)
        fit, converged = gauss_newton(names, x, lambda p, s=sigma: _whitened(poses.means, g, p, s))  # type: ignore[misc]
        if fit.dropped or not converged:
            break
        x = fit.values
    return fit, converged


def _directions(y: Array, x: Array) -> tuple[Array, Array]:
    """f (m, 3), and the rows v' = (f/|f|)' M^-1 (m, 3) through which readings and parameters act on
    |f|.
    """
    b, M = model_of(x)
    inverse = np.linalg.inv(M)
    f = (y - b) @ inverse.T
    return f, (f / np.linalg.norm(f, axis=1)[:, None]) @ inverse


def _norm_sigma(poses: Poses, x: Array) -> Array:
    """Standard deviation of each pose's norm, (m,)."""
    _, v = _directions(poses.means, x)
    return np.sqrt(np.einsum("ki,ij,kj->k", v, poses.noise * poses.inflation, v) / poses.counts)


def _slopes(f: Array, v: Array, terms: int) -> Array:
    """Derivative of |f| with the parameters, (m, terms)."""
    columns = [-v, -v * f]
    if terms == 9:
        columns.append(
            np.column_stack([-(v[:, i] * f[:, j] + v[:, j] * f[:, i]) for i, j in PAIRS])
        )
    return np.hstack(columns)


def _whitened(y: Array, g: float, x: Array, sigma: Array) -> tuple[Array, Array]:
    """Residuals (|f| - g) / sigma and their Jacobian."""
    f, v = _directions(y, x)
    return (np.linalg.norm(f, axis=1) - g) / sigma, _slopes(f, v, len(x)) / sigma[:, None]


def _start(y: Array, g: float, terms: int) -> Array:
    """Axis-aligned ellipsoid through the readings, by linear least squares; nominal where it is
    none.
    """
    x = np.zeros(terms)
    scaled = y / g
    design = np.hstack([scaled**2, scaled, np.ones((len(y), 1))])
    # a y^2 + c y + d = 0: also where the origin lies outside the ellipsoid
    coefficients = np.linalg.svd(design)[2][-1]
    squares, linear, constant = coefficients[:3], coefficients[3:6], coefficients[6]
    if not (np.all(squares > 0) or np.all(squares < 0)):
        return x
    centre = -linear / (2 * squares)
    scale2 = (np.sum(squares * centre**2) - constant) / squares
    if np.all((scale2 > 0.04) & (scale2 < 25)):
        x[:3], x[3:6] = centre * g, np.sqrt(scale2) - 1
    return x


def _leave_directions_out(
    poses: Poses, g: float, terms: int, fit: Fit
) -> tuple[float | None, float]:
    """Held-out rms of |f| - g over whole directions left out (SI), and how badly the worst
    direction is predicted.

    The second is the largest predicted standard deviation of a left-out norm residual over its own
    noise.
    """
    whole = _full(fit, poses, terms)
    group = group_directions(_directions(poses.means, whole)[0])
    residuals, worst = [], 0.0
    for k in range(group.max() + 1):
        rest, out = poses.subset(group != k), poses.subset(group == k)
        if len(rest) < terms:
            return None, np.inf
        part, _ = solve(rest, g, terms, whole)
        if part.dropped:
            return None, np.inf
        f, v = _directions(out.means, part.values)
        residuals.append(np.linalg.norm(f, axis=1) - g)
        slopes = _slopes(f, v, terms) / _norm_sigma(out, part.values)[:, None]
        worst = max(worst, float(np.einsum("ki,ij,kj->k", slopes, part.covariance, slopes).max()))
    return leave_out_rms(residuals), float(np.sqrt(worst))


def _full(fit: Fit, poses: Poses, terms: int) -> Array:
    return np.array([fit.value(n) for n in names_of(poses.sensor.name, terms)])


def _condition(poses: Poses, x: Array) -> float:
    """Condition number of the positions alone: of d|f|/g with bias/g, scale and cross terms, all
    poses weighing the same.
    """
    f, v = _directions(poses.means, x)
    g = np.linalg.norm(f, axis=1).mean()
    slopes = _slopes(f / g, v, len(x))
    s = np.linalg.svd(slopes, compute_uv=False)
    return float(s[0] / max(s[-1], 1e-12 * s[0]))


def _tests(
    poses: Poses, fit: Fit, converged: bool, blindness: float, terms: int
) -> tuple[list[Test], bool]:
    condition = _condition(poses, _full(fit, poses, terms))
    tests = [
        Test(
            "converged",
            float(fit.iterations),
            0,
            float(converged),
            converged,
            f"{fit.iterations} Gauss-Newton iterations",
        ),
        Test(
            "condition of the positions",
            condition,
            0,
            float(condition <= BAD_CONDITION),
            condition <= BAD_CONDITION,
            f"condition number {condition:.3g} (axis-aligned positions: 1; a fifth of random ones:"
            f" over {BAD_CONDITION:.0f})",
        ),
    ]
    if fit.dof > 0:
        tests.append(
            chi2_test(
                "fit",
                fit.chi2,
                fit.dof,
                f"{len(poses)} norms against {terms} parameters and the noise of the means",
            )
        )
    determined = converged and not fit.dropped and fit.dof > 0 and blindness <= BLIND
    seen = (
        "nothing is left over to check the model"
        if not np.isfinite(blindness)
        else f"{blindness:.3g} times its own noise"
    )
    tests.append(
        Test(
            "directions predict each other",
            min(blindness, 1e9),
            fit.dof,
            float(blindness <= BLIND),
            blindness <= BLIND,
            f"a direction left out is predicted to {seen}; above {BLIND:.0f} a wrong model could"
            " not be seen",
        )
    )
    return tests, determined
