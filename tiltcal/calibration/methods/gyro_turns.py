"""A gyro triad from rest-turn-rest by hand: gravity, seen by the accelerometer at each rest, is the
reference.

Turns by hand between rests: the gyro's readings during each, and gravity's direction before and
after.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, without, wrap_up
from tiltcal.calibration.methods.gyro_model import (
    EARTH,
    TERMS,
    EarthRate,
    GyroModel,
    StaticRates,
    earth_in_body,
    parameter_names,
    unit_of,
)
from tiltcal.calibration.methods.norm import norm
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.channels import channel_tests
from tiltcal.calibration.screen.columns import columns_test
from tiltcal.calibration.validity import SIGNIFICANCE, Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import angle_between, tangents
from tiltcal.core.numerical import undetermined
from tiltcal.core.units import DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, gauss_newton

EDGE = 0.5  # s of rest beside a turn over which gravity's direction is averaged


@dataclass(frozen=True)
class Turns:
    """Turns between rests, padded to one length.

    Args:
        rate: gyro readings, rad/s, (m, n, 3).
        force: specific force by the calibrated accelerometer, g, (m, n, 3).
        step: time interval of each sample, s, (m, n), 0 in the padding.
        before, after: gravity direction at the rests, unit vectors in the body frame, (m, 3).
        sigma: standard deviation of the propagated less the measured direction, rad, (m,).
        earth: the Earth's rate at each sample, (m, n).
    """

    rate: Array
    force: Array
    step: Array
    before: Array
    after: Array
    sigma: Array
    earth: EarthRate

    def subset(self, mask: Array) -> "Turns":
        """Some of the turns. mask: (turns,)."""
        return Turns(
            self.rate[mask],
            self.force[mask],
            self.step[mask],
            self.before[mask],
            self.after[mask],
            self.sigma[mask],
            self.earth.subset(mask),
        )

    def __len__(self) -> int:
        return len(self.sigma)


@dataclass(frozen=True)
class Series:
    """A vector against time: s, (n,), and its components, (n, 3), NaN where it is unknown."""

    time: Array
    values: Array

    @property
    def known(self) -> "Series":
        """The samples without NaN."""
        complete = ~np.isnan(self.values).any(axis=1)
        return Series(self.time[complete], self.values[complete])

    def at(self, time: Array) -> Array:
        """Linear interpolation, (m, 3)."""
        return np.column_stack([np.interp(time, self.time, v) for v in self.values.T])

    def between(self, start: float, end: float) -> "Series":
        """The samples of an interval, both ends included. start, end: s."""
        inside = (self.time >= start) & (self.time <= end)
        return Series(self.time[inside], self.values[inside])


def collect_turns(
    recording: Recording,
    gyro: Sensor,
    rests: Poses,
    force: Series,
    sigma: float,
    latitude: float | None,
) -> tuple[Turns, EarthRate]:
    """The gyro's readings from the end of each rest to the start of the next; and the Earth's rate
    at each rest.

    Args:
        recording: of the gyro.
        gyro: a triad.
        rests: of the gyro, with its noise.
        force: specific force by the calibrated accelerometer, g.
        sigma: standard deviation of gravity's direction at the edge of a rest, rad.
        latitude: rad; None: not known.
    """
    samples = recording.sensor(gyro)
    reading = Series(samples.time, samples.values).known
    time = reading.time
    starts = np.searchsorted(time, [s.end_s for s in rests.spans[:-1]])
    ends = np.searchsorted(time, [s.start_s for s in rests.spans[1:]])
    m, n = len(starts), int((ends - starts).max())
    rate, sensed, step = np.zeros((m, n, 3)), np.zeros((m, n, 3)), np.zeros((m, n))
    force_at_gyro = force.known.at(time)
    interval = np.gradient(time)
    for k in range(m):
        part, length = slice(starts[k], ends[k]), ends[k] - starts[k]
        rate[k, :length] = reading.values[part]
        sensed[k, :length] = force_at_gyro[part]
        step[k, :length] = interval[part]
    turning = Series(time, reading.values - _static_rate(rests, force, force_at_gyro))
    angle = _integrated(turning)
    ends_of_rests = [(s.end_s - EDGE, s.end_s, s.end_s) for s in rests.spans[:-1]]
    starts_of_rests = [(s.start_s, s.start_s + EDGE, s.start_s) for s in rests.spans[1:]]
    before = _edge_directions(force, angle, ends_of_rests)
    after = _edge_directions(force, angle, starts_of_rests)
    # the integrated noise of the gyro
    walk = np.trace(rests.noise) / 3 * rests.inflation * (step**2).sum(axis=1)
    offset = np.median(reading.values - turning.values, axis=0)
    at_rest, during = _attitudes(rate - offset, step, before, after)
    turns = Turns(
        rate,
        sensed,
        step,
        before,
        after,
        np.sqrt(2 * sigma**2 + walk),
        earth_in_body(during, latitude),
    )
    return turns, earth_in_body(at_rest, latitude)


def _attitudes(rate: Array, step: Array, before: Array, after: Array) -> tuple[Array, Array]:
    """Attitude of the body by the integrated rate, levelled by gravity at each rest: body
    components of two horizontal directions and of up, one column each.

    Args:
        rate: without bias, rad/s, (m, n, 3).
        step: s, (m, n).
        before, after: up at the ends of each turn, body frame, (m, 3).

    Returns:
        At each rest, (m + 1, 3, 3), and at each sample of the turns, (m, n, 3, 3).
    """
    from scipy.spatial.transform import Rotation

    small = Rotation.from_rotvec(-(rate * step[..., None]).reshape(-1, 3)).as_matrix()
    small = small.reshape(*rate.shape[:2], 3, 3)
    level = tangents(before[:1])[0]
    now = np.column_stack([level[0], level[1], before[0]])
    rests, during = [], np.empty((*rate.shape[:2], 3, 3))
    for k in range(len(rate)):
        now = _levelled(now, before[k])
        rests.append(now)
        for i in range(rate.shape[1]):
            now = small[k, i] @ now
            during[k, i] = now
    rests.append(_levelled(now, after[-1]))
    return np.array(rests), during


def _levelled(attitude: Array, up: Array) -> Array:
    """An attitude, (3, 3), turned by the least angle so that its third column is up, (3,)."""
    from scipy.spatial.transform import Rotation

    axis = np.cross(attitude[:, 2], up)
    sine, cosine = float(np.linalg.norm(axis)), float(attitude[:, 2] @ up)
    turn = axis / max(sine, 1e-300) * np.arctan2(sine, cosine)
    return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ attitude)


def _static_rate(rests: Poses, force: Series, force_at_gyro: Array) -> Array:
    """Bias and g-sensitivity of the rests alone, applied to the force at each sample, rad/s,
    (n, 3).
    """
    poses = [np.nanmean(force.between(s.start_s, s.end_s).values, axis=0) for s in rests.spans]
    design = np.column_stack([np.ones(len(poses)), np.array(poses)])
    coefficients = np.linalg.lstsq(design, rests.means, rcond=None)[0]
    return np.column_stack([np.ones(len(force_at_gyro)), force_at_gyro]) @ coefficients


def _integrated(rate: Series) -> Series:
    """The integral of a rate by the trapezoidal rule, 0 at the first sample."""
    middle = (rate.values[1:] + rate.values[:-1]) / 2
    steps = middle * np.diff(rate.time)[:, None]
    return Series(rate.time, np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]))


def _edge_directions(
    force: Series, angle: Series, spans: Iterable[tuple[float, float, float]]
) -> Array:
    """Mean direction of the force over short spans at the edges of rests, (m, 3).

    A hand is never quite at rest there: each sample is rotated to the instant of the edge by the
    integrated rate. Without that, the rotation inside the spans was the largest error of all on a
    real log (0.22 deg rms against 0.14 deg).

    Args:
        force: g.
        angle: integrated rate, rad.
        spans: start, end, and the instant to which the direction refers, s.
    """
    from scipy.spatial.transform import Rotation

    found = []
    for start, end, instant in spans:
        edge = force.between(start, end).known
        turned = angle.at(np.append(edge.time, instant))
        back = Rotation.from_rotvec(turned[:-1] - turned[-1])
        found.append(back.apply(edge.values).mean(axis=0))
    return np.array(found) / np.linalg.norm(found, axis=1)[:, None]


def propagated(turns: Turns, models: Sequence[GyroModel]) -> Array:
    """Gravity's direction at the end of each turn by the integrated rate of each model,
    (k, m, 3).
    """
    k = len(models)
    rates = np.concatenate(
        [model.rate(turns.rate, turns.force) - turns.earth.rate(model.earth) for model in models]
    )
    rotations = _products(rates, np.tile(turns.step, (k, 1)))
    before = np.tile(turns.before, (k, 1))[:, :, None]
    return np.asarray(rotations @ before).reshape(k, len(turns), 3)


def _products(rate: Array, step: Array) -> Array:
    """Product of the rotations of all samples, newest first, (m, 3, 3), by halving."""
    from scipy.spatial.transform import Rotation

    # components in the body frame turn by minus the rate
    flat = -(rate * step[..., None]).reshape(-1, 3)
    R = np.asarray(Rotation.from_rotvec(flat).as_matrix()).reshape(*rate.shape[:2], 3, 3)
    while R.shape[1] > 1:
        if R.shape[1] % 2:
            R = np.concatenate([R, np.broadcast_to(np.eye(3), (len(R), 1, 3, 3))], axis=1)
        R = R[:, 1::2] @ R[:, ::2]
    return np.asarray(R[:, 0])


def turn_errors(turns: Turns, model: GyroModel) -> Array:
    """Angle between the propagated and the measured gravity direction after each turn, rad,
    (m,).
    """
    return angle_between(propagated(turns, [model])[0], turns.after)


NAME = "gyro_turns"
LEAST_TURNS = 6  # three biases and three scale factors at least, two equations a turn
FOLDS = 12
STEPS = {"gsens": 1.0, "earth": 0.1}  # deg/h/g; of the Earth's rate
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
    names += turns.earth.names
    fit, converged = solve(turns, static, names)
    heldout = _held_out(turns, static, names, fit)
    tests = [_fit_test(turns, fit, names), _columns_test(turns, rests), *live]
    warnings = [
        f"held-out error of gravity's direction after a turn: {heldout / DEG:.3g} deg rms",
        _earth_note(setup),
    ]
    fit = without(fit, EARTH)
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


def _earth_note(setup: Setup) -> str:
    """What is taken off as the Earth's rate."""
    if setup.site.latitude_deg is None:
        return "no latitude: all components of the Earth's rate are fitted beside the terms"
    return (
        f"the Earth's rate at {setup.site.latitude_deg:g} deg is taken off, its horizontal part"
        " with a fitted heading"
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
    sensed = recording.sensor(accel)
    force = Series(sensed.time, by_norm.correct(accel, sensed.values, g) / G0)
    # of gravity's direction at the edge of a rest: noise of its mean, and what the norm leaves
    noise = np.trace(poses.noise) / 3 * poses.inflation / max(EDGE * accel.rate_hz, 1.0)
    left_by_norm = by_norm.heldout_rms.get(accel.name, 0.0)
    sigma = float(np.sqrt(noise + left_by_norm**2) / g)
    stated = setup.site.latitude_deg
    latitude = None if stated is None else stated * DEG
    turns, earth = collect_turns(recording, gyro, rests, force, sigma, latitude)
    return turns, StaticRates(rests, by_norm.correct(accel, poses.means, g), earth)


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
    prior = [k for k, name in enumerate(names) if name.startswith(EARTH)]
    equations = [2 * len(turns), static.means.size, len(prior)]
    weight = np.ones(3)

    def residuals(X: Array) -> Array:
        models = [GyroModel(x, names) for x in X]
        error = propagated(turns, models) - turns.after
        angles = np.einsum("mij,kmj->kmi", across, error) / turns.sigma[:, None]
        at_rest = np.array([static.residual(model) for model in models])
        return np.hstack([angles.reshape(len(X), -1) * weight[0], at_rest * weight[1], X[:, prior]])

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
        parts = np.split(unweighted, np.cumsum(equations[:2]))
        misfit = np.array([*(_misfit(part) for part in parts[:2]), 1.0])
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

    The steps are 1e-5 of a ratio or rad/s, or of ``STEPS``.
    """
    steps = np.array([STEPS.get(n.partition(".")[2].partition("_")[0], 1e-5) for n in names])
    steps = np.where([n.startswith(EARTH) for n in names], STEPS["earth"], steps)
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
