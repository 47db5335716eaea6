"""A gyro triad from rest-turn-rest by hand: gravity, seen by the accelerometer at each rest, is the
reference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, wrap_up
from tiltcal.calibration.methods.norm import norm
from tiltcal.calibration.methods.screening import columns_test, require_unsaturated
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES, angle_between
from tiltcal.core.units import DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, gauss_newton

NAME = "gyro_turns"
LEAST_TURNS = 6
FOLDS = 12
CHANCE = 1e-3  # of calling noise a misfit
TOGETHER = 300_000  # samples that are turned at a time
BLOCK = 0.1  # s
EDGE = 0.5  # s of rest beside a turn whose mean is gravity's direction there
TERMS = ("bias", "scale", "cross_axis", "gsens")


@dataclass(frozen=True)
class Turns:
    """Turns between rests, padded to one length.

    Args:
        rate: gyro readings, rad/s, (m, n, 3).
        force: specific force as the calibrated accelerometer sees it, g, (m, n, 3).
        step: s each sample stands for, (m, n), 0 in the padding.
        before, after: gravity direction at the rests, unit vectors in the body frame, (m, 3).
        sigma: standard deviation of the carried against the measured direction, rad, (m,).
    """

    rate: Array
    force: Array
    step: Array
    before: Array
    after: Array
    sigma: Array

    def subset(self, mask: Array) -> "Turns":
        """Some of the turns."""
        return Turns(
            *(
                getattr(self, name)[mask]
                for name in ("rate", "force", "step", "before", "after", "sigma")
            )
        )

    def __len__(self) -> int:
        return len(self.sigma)


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

    Model: ``reading = b + (I + S + C) w + G f``, all terms from rests and turns together: at rest
    the reading is b + G f (with the Earth's rate in it: its direction is not known); the rate of a
    turn, integrated, has to carry gravity's direction from rest to rest.

    Args:
        recording: rest, turn, rest, ... with an accelerometer triad beside the gyro triad.
        setup: with both.
        segments: dwells to use.
        sensor: which gyro, when several fit.
        terms: of bias, scale, cross_axis, gsens.

    Raises:
        TiltcalError: fewer than six turns, or an unknown term.

    Errors:
        A turn about the vertical is not seen by gravity: turn about each axis while it is
            horizontal. The accelerometer is calibrated by its norm first; what it feels while
            turning acts through G.

    Source: PHYSICS 3.5; the comparison figures of the recordings' README.
    """
    unknown = [t for t in terms if t not in TERMS]
    if isinstance(terms, str) or unknown:
        raise TiltcalError(
            f"method {NAME}, option terms",
            found=str(terms),
            need="some of " + ", ".join(TERMS),
            do="correct it",
        )
    gyro = pick_sensor(setup, recording, ("gyro",), sensor, NAME)
    accel = pick_sensor(setup, recording, ("accelerometer",), None, NAME)
    for each in (gyro, accel):
        require_unsaturated(recording, each)
    found = list(find_segments(recording)) if segments is None else list(segments)
    level = norm(recording, setup, segments=found, sensor=accel.name)
    rests, force = (
        find_poses(recording, setup, gyro, found),
        find_poses(recording, setup, accel, found),
    )
    if len(rests) - 1 < LEAST_TURNS:
        raise TiltcalError(
            recording.source,
            found=f"{max(len(rests) - 1, 0)} turns",
            need=f"at least {LEAST_TURNS}, about all axes",
            do="rest, turn, rest again; look at `tiltcal segments`",
        )
    f = level.correct(accel, force.means, setup.site.gravity)
    sensed = recording.sensor(accel)
    felt = level.correct(accel, sensed.values, setup.site.gravity) / G0
    turns = collect_turns(
        recording,
        gyro,
        rests,
        (sensed.time, felt),
        _direction_sigma(force, level, setup, accel.rate_hz),
    )
    names = parameter_names(gyro.name, terms)
    fit, converged = solve(turns, _Rests(rests, f), names)
    heldout = _held_out(turns, _Rests(rests, f), names, fit)
    rms = np.sqrt(np.mean(turn_errors(turns, _Model(fit, names)) ** 2))
    statement = (
        f"{len(turns)} turns leave {rms / DEG:.3g} deg rms of gravity's direction, and the rests"
        " their static rates"
    )
    tests = [chi2_test("fit", fit.chi2, fit.dof, statement), _columns_test(turns, rests)]
    warnings = [
        f"held-out error of gravity's direction after a turn: {heldout / DEG:.3g} deg rms",
        "the Earth's rate is part of the bias and of the g-sensitivity: the heading is not known",
    ]
    units = ["rad_s" if ".bias_" in n else "deg_h_g" if ".gsens_" in n else "1" for n in fit.names]
    return wrap_up(
        NAME,
        verdict_of(tests, converged and not fit.dropped and fit.dof > 0),
        fit,
        units,
        tests,
        warnings,
        rests,
        recording,
        equation=f"{gyro.name} = bias + (I + scale + cross) w + gsens f",
        inverse="w = M^-1 (reading - bias - gsens f)",
        heldout={gyro.name: heldout},
    )


def _columns_test(turns: Turns, rests: Poses) -> Test:
    """On means of some 0.1 s of each turn, one turn after the other."""
    size = max(1, round(BLOCK / float(np.median(turns.step[turns.step > 0]))))
    m, n = len(turns), turns.step.shape[1] // size
    step = turns.step[:, : n * size].reshape(m, n, size)
    whole = (step > 0).all(axis=2)
    rate, force = (
        a[:, : n * size].reshape(m, n, size, 3).mean(axis=2)[whole]
        for a in (turns.rate, turns.force)
    )
    # no step from one turn to the next
    time = (np.cumsum(step.sum(axis=2), axis=1) + 1e3 * np.arange(m)[:, None])[whole]
    return columns_test(time, rate - rests.means.mean(axis=0), force)


def parameter_names(name: str, terms: Sequence[str]) -> list[str]:
    """Names of the parameters of some terms, in the order of the vector that is fitted."""
    found = {
        "bias": [f"{name}.bias_{a}" for a in AXES],
        "scale": [f"{name}.scale_{a}" for a in AXES],
        "cross_axis": [f"{name}.cross_{a}{b}" for a in AXES for b in AXES if a != b],
        "gsens": [f"{name}.gsens_{a}{b}" for a in AXES for b in AXES],
    }
    return [n for t in TERMS if t in terms or t == "bias" for n in found[t]]


class _Model:
    """Bias (3,), sensitivity M (3, 3) and g-sensitivity G (3, 3), rad/s per g, of a fit or a
    parameter vector.
    """

    def __init__(self, fit: Fit | Array, names: Sequence[str]) -> None:
        values = [fit.value(n) for n in names] if isinstance(fit, Fit) else fit
        self.bias, self.M, self.G = np.zeros(3), np.eye(3), np.zeros((3, 3))
        for name, value in zip(names, values, strict=True):
            term, _, axes = name.split(".")[1].partition("_")
            i, j = AXES.index(axes[0]), AXES.index(axes[-1])
            if term == "bias":
                self.bias[i] = value
            elif term == "gsens":
                self.G[i, j] = value * DEG / 3600
            else:
                self.M[i, j] += value

    def rate(self, reading: Array, force: Array) -> Array:
        """True rate, rad/s, from readings and the force in g, (..., 3)."""
        return (reading - self.bias - force @ self.G.T) @ np.linalg.inv(self.M).T


class _Rests:
    """Static rates with their whitening: what bias and g-sensitivity have to explain."""

    def __init__(self, rests: Poses, force: Array) -> None:
        self.means, self.force = rests.means, force / G0
        self.whiten = np.array(
            [np.linalg.inv(np.linalg.cholesky(rests.covariance(k))) for k in range(len(rests))]
        )

    def residual(self, model: _Model) -> Array:
        """Whitened, (3 m,)."""
        error = self.means - model.bias - self.force @ model.G.T
        return np.einsum("mij,mj->mi", self.whiten, error).ravel()


def _direction_sigma(poses: Poses, level: Calibration, setup: Setup, rate_hz: float) -> float:
    """Standard deviation of gravity's direction at the edge of a rest, rad: noise of its mean, and
    what the norm leaves.
    """
    own = np.trace(poses.noise) / 3 * poses.inflation / max(EDGE * rate_hz, 1.0)
    return float(
        np.sqrt(own + level.heldout_rms.get(poses.sensor.name, 0.0) ** 2) / setup.site.gravity
    )


def collect_turns(
    recording: Recording, gyro: Sensor, rests: Poses, felt: tuple[Array, Array], sigma: float
) -> Turns:
    """The gyro's readings from the end of each rest to the start of the next: a bias has no longer
    to act than the turn lasts.
    """
    samples = recording.sensor(gyro)
    complete = ~np.isnan(samples.values).any(axis=1)
    time, values = samples.time[complete], samples.values[complete]
    starts = np.searchsorted(time, [s.end_s for s in rests.spans[:-1]])
    ends = np.searchsorted(time, [s.start_s for s in rests.spans[1:]])
    m, n = len(starts), int((ends - starts).max())
    rate, sensed, step = np.zeros((m, n, 3)), np.zeros((m, n, 3)), np.zeros((m, n))
    known = ~np.isnan(felt[1]).any(axis=1)
    along = np.column_stack([np.interp(time, felt[0][known], felt[1][known, i]) for i in range(3)])
    spacing = np.gradient(time)
    for k in range(m):
        part, length = slice(starts[k], ends[k]), ends[k] - starts[k]
        rate[k, :length], sensed[k, :length], step[k, :length] = (
            values[part],
            along[part],
            spacing[part],
        )
    turning = time, values - _static(rests, felt, along)
    before = _edge_directions(
        felt, turning, [(s.end_s - EDGE, s.end_s, s.end_s) for s in rests.spans[:-1]]
    )
    after = _edge_directions(
        felt, turning, [(s.start_s, s.start_s + EDGE, s.start_s) for s in rests.spans[1:]]
    )
    # the gyro's own noise, integrated
    walk = np.trace(rests.noise) / 3 * rests.inflation * (step**2).sum(axis=1)
    return Turns(rate, sensed, step, before, after, np.sqrt(2 * sigma**2 + walk))


def carried(turns: Turns, models: Sequence[_Model]) -> Array:
    """Gravity's direction at the end of each turn, carried there by the integrated rate of each
    model, (k, m, 3).
    """
    k = len(models)
    rates = np.concatenate([model.rate(turns.rate, turns.force) for model in models])
    products = _products(rates, np.tile(turns.step, (k, 1)))
    return np.asarray(products @ np.tile(turns.before, (k, 1))[:, :, None]).reshape(
        k, len(turns), 3
    )


def _static(rests: Poses, felt: tuple[Array, Array], along: Array) -> Array:
    """What the gyro reads without turning at the force of each sample, rad/s, (n, 3): bias and G by
    the rests alone.
    """
    time, force = felt
    poses = np.array(
        [np.nanmean(force[(time >= s.start_s) & (time <= s.end_s)], axis=0) for s in rests.spans]
    )
    design = np.column_stack([np.ones(len(poses)), poses])
    return (
        np.column_stack([np.ones(len(along)), along])
        @ np.linalg.lstsq(design, rests.means, rcond=None)[0]
    )


def _edge_directions(
    felt: tuple[Array, Array],
    turning: tuple[Array, Array],
    spans: Sequence[tuple[float, float, float]],
) -> Array:
    """Mean direction of the force over short spans (from, to) at the edges of the rests, as it is
    at an instant, (m, 3).

    A hand never holds quite still there: each sample is carried to the instant by the gyro. Without
    that, the turn that goes on inside the spans was the largest error of all on a real log (0.22
    deg rms where 0.14 remains).
    """
    from scipy.spatial.transform import Rotation

    time, force = felt
    angle = np.vstack(
        [
            np.zeros(3),
            np.cumsum(
                (turning[1][1:] + turning[1][:-1]) / 2 * np.diff(turning[0])[:, None], axis=0
            ),
        ]
    )
    found = []
    for start, end, instant in spans:
        inside = (time >= start) & (time <= end) & ~np.isnan(force).any(axis=1)
        stamps = np.append(time[inside], instant)
        turned = np.column_stack([np.interp(stamps, turning[0], angle[:, i]) for i in range(3)])
        found.append(
            Rotation.from_rotvec(turned[:-1] - turned[-1]).apply(force[inside]).mean(axis=0)
        )
    return np.array(found) / np.linalg.norm(found, axis=1)[:, None]


def _rotations(w: Array, step: Array) -> Array:
    """R_(k+1)k of each sample: body components turn by minus the rate, (m, n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    flat = -(w * step[..., None]).reshape(-1, 3)
    return np.asarray(Rotation.from_rotvec(flat).as_matrix()).reshape(*w.shape[:2], 3, 3)


def _products(w: Array, step: Array) -> Array:
    """Product of all samples' rotations, newest first, (m, 3, 3), by halving."""
    R = _rotations(w, step)
    while R.shape[1] > 1:
        if R.shape[1] % 2:
            R = np.concatenate([R, np.broadcast_to(np.eye(3), (len(R), 1, 3, 3))], axis=1)
        R = R[:, 1::2] @ R[:, ::2]
    return np.asarray(R[:, 0])


def solve(
    turns: Turns, rests: "_Rests", names: Sequence[str], start: Array | None = None
) -> tuple[Fit, bool]:
    """All parameters from turns and rests together; the fit and whether it converged.

    Neither group fits to its noise where physics is left out; each is weighed by what the fit
    leaves of it.
    """
    basis = _tangents(turns.after)
    weight = np.ones(2)

    def residuals(X: Array) -> Array:
        models = [_Model(x, names) for x in X]
        error = carried(turns, models) - turns.after
        across = np.einsum("mij,kmj->kmi", basis, error) / turns.sigma[:, None]
        static = np.array([rests.residual(model) for model in models])
        return np.hstack([across.reshape(len(X), -1) * weight[0], static * weight[1]])

    def problem(x: Array) -> tuple[Array, Array]:
        parts = max(1, turns.step.size * 2 * len(x) // TOGETHER)
        return residuals(x[None])[0], _slopes(residuals, x, names, parts)

    x = np.zeros(len(names)) if start is None else start
    if start is None:
        x[:3] = rests.means.mean(axis=0)
    for _ in range(3):
        fit, converged = gauss_newton(names, x, problem, limit=15)
        x = np.array([fit.value(n) for n in names])
        left = np.split(
            fit.residuals / np.repeat(weight, [basis.shape[0] * 2, rests.means.size]),
            [basis.shape[0] * 2],
        )
        misfit = np.array([_misfit(part) for part in left])
        if fit.dropped or not converged or np.allclose(misfit * weight, 1.0, rtol=0.01):
            break
        weight = 1 / misfit
    # judged by their own noise, not by the weights
    return (
        replace(fit, residuals=np.concatenate(left)),
        converged,
    )


def _misfit(part: Array) -> float:
    """How many times its noise a group of whitened residuals is, 1 where chance explains it."""
    from scipy.stats import chi2

    total = float(part @ part)
    return float(np.sqrt(total / len(part))) if total > chi2.isf(CHANCE, len(part)) else 1.0


def _slopes(
    residuals: Callable[[Array], Array], x: Array, names: Sequence[str], parts: int
) -> Array:
    """Jacobian by central differences: 1e-5 of a ratio or rad/s, 1 deg/h/g; many at a time, where
    they are short.
    """
    steps = np.array([1.0 if ".gsens_" in n else 1e-5 for n in names])
    moved = np.vstack([x + np.diag(steps), x - np.diag(steps)])
    up, down = np.split(
        np.concatenate([residuals(part) for part in np.array_split(moved, parts)]), 2
    )
    return np.asarray(((up - down) / (2 * steps[:, None])).T)


def _tangents(up: Array) -> Array:
    """Two unit vectors across each direction, (m, 2, 3)."""
    helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(up, helper)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(up, first)], axis=1)


def turn_errors(turns: Turns, model: _Model) -> Array:
    """Angle between the carried and the measured gravity direction after each turn, rad, (m,)."""
    return angle_between(carried(turns, [model])[0], turns.after)


def _held_out(turns: Turns, rests: _Rests, names: Sequence[str], whole: Fit) -> float:
    """Rms angle over turns left out of the fit, in FOLDS parts, rad; each starts from the fit of
    the whole.
    """
    part, start = np.arange(len(turns)) % FOLDS, np.array([whole.value(n) for n in names])
    errors = []
    for k in range(FOLDS):
        fit, _ = solve(turns.subset(part != k), rests, names, start)
        errors.append(turn_errors(turns.subset(part == k), _Model(fit, names)))
    return leave_out_rms(errors)
