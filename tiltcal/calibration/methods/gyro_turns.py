"""A gyro triad from rest-turn-rest by hand: gravity, seen by the accelerometer at each rest, is the
reference.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, wrap_up
from tiltcal.calibration.methods.gyro_model import (
    TERMS,
    GyroModel,
    StaticRates,
    parameter_names,
    unit_of,
)
from tiltcal.calibration.methods.hand_turns import (
    EDGE,
    Series,
    Turns,
    collect_turns,
    propagated,
    turn_errors,
)
from tiltcal.calibration.methods.norm import norm
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.channels import channel_tests
from tiltcal.calibration.screen.columns import columns_test
from tiltcal.calibration.validity import SIGNIFICANCE, Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import tangents
from tiltcal.core.numerical import undetermined
from tiltcal.core.units import DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, gauss_newton

NAME = "gyro_turns"
LEAST_TURNS = 6  # three biases and three scale factors at least, two equations a turn
FOLDS = 12
MEMORY_LIMIT = 300_000  # samples of all models that are integrated at a time


def gyro_turns(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = TERMS[:3],
) -> Calibration:
    """Bias, scale factor, cross-axis terms and, with ``gsens``, g-sensitivity of a gyro triad
    turned by hand.

    Model: ``reading = b + (I + S + C) w + G f``, all terms from rests and turns together. At rest
    the reading is b + G f; it includes the Earth's rate, whose direction is unknown. The integrated
    rate of a turn must propagate gravity's direction from one rest to the next.

    Args:
        recording: rest, turn, rest, ... with an accelerometer triad beside the gyro triad.
        setup: with both.
        segments: dwells to use.
        sensor: which gyro, when several fit.
        terms: of bias, scale, cross_axis, gsens.

    Raises:
        TiltcalError: fewer than six turns, or an unknown term.

    Errors:
        A turn about the vertical does not change gravity's direction in the body: turn about each
            axis while it is horizontal. The accelerometer is calibrated by its norm first; its
            readings during the turns enter through G.

    Source: docs/physics.md, "Gyro triads by gravity and by a table".
    """
    _require_terms(terms)
    gyro = pick_sensor(setup, recording, ("gyro",), sensor, NAME)
    accel = pick_sensor(setup, recording, ("accelerometer",), None, NAME)
    live = [t for each in (gyro, accel) for t in channel_tests(recording, each)]
    found = list(find_segments(recording)) if segments is None else list(segments)
    rests = find_poses(recording, setup, gyro, found)
    by_norm = norm(recording, setup, segments=found, sensor=accel.name)
    _require_turns(rests, recording)
    turns, static = _turns_and_rests(recording, setup, found, gyro, accel, rests, by_norm)
    names = parameter_names(gyro.name, terms)
    fit, converged = solve(turns, static, names)
    heldout = _held_out(turns, static, names, fit)
    tests = [_fit_test(turns, fit, names), _columns_test(turns, rests), *live]
    warnings = [
        f"held-out error of gravity's direction after a turn: {heldout / DEG:.3g} deg rms",
        "the Earth's rate is part of the bias and of the g-sensitivity: the heading is unknown",
    ]
    return wrap_up(
        NAME,
        verdict_of(tests, converged and not fit.dropped and fit.dof > 0),
        fit,
        [unit_of(n) for n in fit.names],
        tests,
        warnings,
        rests,
        recording,
        equation=f"{gyro.name} = bias + (I + scale + cross) w + gsens f",
        inverse="w = M^-1 (reading - bias - gsens f)",
        heldout={gyro.name: heldout},
    )


def _require_terms(terms: Sequence[str]) -> None:
    """Refuse anything but a list of known terms."""
    if isinstance(terms, str) or any(t not in TERMS for t in terms):
        raise TiltcalError(
            f"method {NAME}, option terms",
            found=str(terms),
            need="some of " + ", ".join(TERMS),
            do="correct it",
        )


def _require_turns(rests: Poses, recording: Recording) -> None:
    """Refuse a recording with too few turns."""
    if len(rests) - 1 < LEAST_TURNS:
        raise TiltcalError(
            recording.source,
            found=f"{max(len(rests) - 1, 0)} turns",
            need=f"at least {LEAST_TURNS}, about all axes",
            do="stand still, turn, stand still again; look at `tiltcal segments`",
        )


def _turns_and_rests(
    recording: Recording,
    setup: Setup,
    segments: Sequence[Segment],
    gyro: Sensor,
    accel: Sensor,
    rests: Poses,
    by_norm: Calibration,
) -> tuple[Turns, StaticRates]:
    """The turns and the static rates, with forces corrected by the norm calibration."""
    g = setup.site.gravity
    poses = find_poses(recording, setup, accel, segments)
    if len(rests) != len(poses):
        words = f"{len(rests)} standstills seen by {gyro.name}, {len(poses)} by {accel.name}"
        raise undetermined(recording.source, "the parameters of gyro_turns", words)
    static = StaticRates(rests, by_norm.correct(accel, poses.means, g))
    sensed = recording.sensor(accel)
    force = Series(sensed.time, by_norm.correct(accel, sensed.values, g) / G0)
    # of gravity's direction at the edge of a rest: noise of its mean, and what the norm leaves
    noise = np.trace(poses.noise) / 3 * poses.inflation / max(EDGE * accel.rate_hz, 1.0)
    left_by_norm = by_norm.heldout_rms.get(accel.name, 0.0)
    sigma = float(np.sqrt(noise + left_by_norm**2) / g)
    return collect_turns(recording, gyro, rests, force, sigma), static


def _fit_test(turns: Turns, fit: Fit, names: Sequence[str]) -> Test:
    rms = np.sqrt(np.mean(turn_errors(turns, GyroModel(fit, names)) ** 2))
    words = (
        f"gravity's direction after {len(turns)} turns to {rms / DEG:.3g} deg rms, and the static"
        " rates of the rests"
    )
    return chi2_test("fit", fit.chi2, fit.dof, words)


def _columns_test(turns: Turns, rests: Poses) -> Test:
    """Do gyro and accelerometer have the same columns? On means of 0.1 s of each turn."""
    size = max(1, round(0.1 / float(np.median(turns.step[turns.step > 0]))))
    m, n = len(turns), turns.step.shape[1] // size
    step = turns.step[:, : n * size].reshape(m, n, size)
    whole = (step > 0).all(axis=2)

    def block_means(values: Array) -> Array:
        return np.asarray(values[:, : n * size].reshape(m, n, size, 3).mean(axis=2)[whole])

    # 1000 s between turns, so that no difference is taken across them
    time = np.cumsum(step.sum(axis=2), axis=1) + 1e3 * np.arange(m)[:, None]
    rate = block_means(turns.rate) - rests.means.mean(axis=0)
    return columns_test(time[whole], rate, block_means(turns.force))


def solve(
    turns: Turns, static: StaticRates, names: Sequence[str], start: Array | None = None
) -> tuple[Fit, bool]:
    """All parameters from turns and rests together; the fit and whether it converged. start:
    parameters to start from, SI, (p,).

    Where the model is incomplete, neither group fits to its noise: each is weighted by the inverse
    of its own misfit. The residuals returned are those without the weights.
    """
    across = tangents(turns.after)
    equations = [2 * len(turns), static.means.size]
    weight = np.ones(2)

    def residuals(X: Array) -> Array:
        models = [GyroModel(x, names) for x in X]
        error = propagated(turns, models) - turns.after
        angles = np.einsum("mij,kmj->kmi", across, error) / turns.sigma[:, None]
        at_rest = np.array([static.residual(model) for model in models])
        return np.hstack([angles.reshape(len(X), -1) * weight[0], at_rest * weight[1]])

    def problem(x: Array) -> tuple[Array, Array]:
        parts = max(1, turns.step.size * 2 * len(x) // MEMORY_LIMIT)
        return residuals(x[None])[0], _slopes(residuals, x, names, parts)

    x = np.zeros(len(names)) if start is None else start
    if start is None:
        x[:3] = static.means.mean(axis=0)
    for _ in range(3):
        fit, converged = gauss_newton(names, x, problem, limit=15)
        x = np.array([fit.value(n) for n in names])
        unweighted = fit.residuals / np.repeat(weight, equations)
        misfit = np.array([_misfit(part) for part in np.split(unweighted, equations[:1])])
        if fit.dropped or not converged or np.allclose(misfit * weight, 1.0, rtol=0.01):
            break
        weight = 1 / misfit
    return replace(fit, residuals=unweighted), converged


def _misfit(part: Array) -> float:
    """Rms of a group of whitened residuals; 1 where it is not significantly above 1."""
    from scipy.stats import chi2

    total = float(part @ part)
    significant = total > chi2.isf(SIGNIFICANCE, len(part))
    return float(np.sqrt(total / len(part))) if significant else 1.0


def _slopes(
    residuals: Callable[[Array], Array], x: Array, names: Sequence[str], parts: int
) -> Array:
    """Jacobian by central differences, in several parts where the turns are long.

    The steps are 1e-5 of a ratio or rad/s, and 1 deg/h/g.
    """
    steps = np.array([1.0 if ".gsens_" in n else 1e-5 for n in names])
    moved = np.vstack([x + np.diag(steps), x - np.diag(steps)])
    found = np.concatenate([residuals(part) for part in np.array_split(moved, parts)])
    up, down = np.split(found, 2)
    return np.asarray(((up - down) / (2 * steps[:, None])).T)


def _held_out(turns: Turns, static: StaticRates, names: Sequence[str], whole: Fit) -> float:
    """Rms angle over turns left out of the fit, in FOLDS parts, rad; each fit starts from the fit
    of all turns.
    """
    part, start = np.arange(len(turns)) % FOLDS, np.array([whole.value(n) for n in names])
    errors = []
    for k in range(FOLDS):
        fit, _ = solve(turns.subset(part != k), static, names, start)
        errors.append(turn_errors(turns.subset(part == k), GyroModel(fit, names)))
    return leave_out_rms(errors)
