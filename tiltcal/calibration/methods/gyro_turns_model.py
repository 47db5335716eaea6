"""Turns by hand between rests: the gyro's readings during each, gravity's direction before and
after, and the fit that carries one into the other.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest

import numpy as np

from tiltcal.calibration.methods.gyro_model import (
    FORCE,
    PRIOR,
    SHEARS,
    EarthRate,
    GyroModel,
    StaticRates,
    earth_in_body,
    parameter_names,
)
from tiltcal.calibration.methods.stated_angles import NO_ANGLES, StatedAngles, stated_angles
from tiltcal.calibration.screen.causes import Misfit, lacking_terms, part_words
from tiltcal.calibration.screen.explanations import Explanation, explanation
from tiltcal.calibration.validity import SIGNIFICANCE, Test, threshold_test
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.frames import AXES, angle_between, tangents
from tiltcal.core.units import DEG, G0
from tiltcal.effects.sense import Sense
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import NO_REFERENCES, References
from tiltcal.recordings.static_poses import Poses
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.least_squares import CommonErrors, Fit, gauss_newton

RATE_STEP = 1e-5  # rad/s: of an error of the readings, for its derivative
STEPS = {"gsens": 1.0, "prior": 0.1}  # deg/h/g; of the size of a prior
MEMORY_LIMIT = 300_000  # samples of all models that are integrated at a time
ANOTHER_TURN = np.pi  # rad: a scale error of a quarter over two turns
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
        shear: standard deviation of each cross-axis term of the accelerometer that its norm does
            not determine; 0 where it determines them.
        stated: total angles of some of the turns.
    """

    rate: Array
    force: Array
    step: Array
    before: Array
    after: Array
    sigma: Array
    earth: EarthRate
    shear: float = 0.0
    stated: StatedAngles = NO_ANGLES

    @property
    def names(self) -> list[str]:
        """Of what is fitted beside the terms, with a prior."""
        return [*self.earth.names, *(f"{FORCE}{p}" for p in SHEARS if self.shear)]

    def subset(self, mask: Mask) -> "Turns":
        """Some of the turns. mask: (turns,)."""
        return Turns(
            self.rate[mask],
            self.force[mask],
            self.step[mask],
            self.before[mask],
            self.after[mask],
            self.sigma[mask],
            self.earth.subset(mask),
            self.shear,
            self.stated.subset(mask),
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
    offset = np.median(reading.values - turning.values, axis=0)
    at_rest, during = _attitudes(rate - offset, step, before, after)
    turns = Turns(
        rate,
        sensed,
        step,
        before,
        after,
        np.sqrt(2 * sigma**2 + integrated_noise(rests, step)),
        earth_in_body(during, latitude),
    )
    return turns, earth_in_body(at_rest, latitude)


def integrated_noise(rests: Poses, step: Array) -> Array:
    """Variance of each component of the integrated rate by the noise of the gyro, rad^2, (m,).

    Args:
        rests: of the gyro.
        step: time interval of each sample of the turns, s, (m, n).
    """
    return np.asarray(np.trace(rests.noise) / 3 * rests.inflation * (step**2).sum(axis=1))


def with_stated_angles(
    turns: Turns, rests: Poses, recording: Recording, sigma: float
) -> tuple[Turns, list[Test]]:
    """The turns with the angles that labels state, but for those of another number of turns, and
    the test that names these; the noise of the gyro is in the uncertainty of an angle.

    Args:
        turns: of the recording.
        rests: of the gyro.
        recording: with labels.
        sigma: standard uncertainty of an angle whose label states none, rad.
    """
    found = stated_angles(recording, rests.spans, sigma)
    if not len(found):
        return turns, []
    noise = integrated_noise(rests, turns.step)[found.turn]
    found = replace(found, sigma=np.sqrt(found.sigma**2 + noise))
    names = parameter_names(rests.sensor.name, ["bias"])
    plain = GyroModel(rests.means.mean(axis=0), names)
    every = replace(turns, earth=EarthRate.none(*turns.step.shape), stated=found)
    errors = propagated(every, [plain])[1][0]
    other = np.abs(errors) > ANOTHER_TURN
    words = [_stated_words(found, int(j), float(errors[j]), rests) for j in np.flatnonzero(other)]
    statement = "; ".join(words) or "the gyro turned as often as stated"
    test = threshold_test("number of turns", len(words), not words, statement)
    return replace(turns, stated=found.at(~other)), [test]


def _stated_words(stated: StatedAngles, j: int, error: float, rests: Poses) -> str:
    """A turn with its stated and its integrated angle. j: number of the angle; error: rad."""
    k, axis, angle = stated.turn[j], AXES[int(np.argmax(stated.axis[j]))], stated.angle[j] / DEG
    turn = part_words("turn", rests.spans[k].end_s, rests.spans[k + 1].start_s)
    return f"{turn} is stated as {angle:g} deg about {axis}, and was {angle - error / DEG:.5g}"


def angle_causes(
    turns: Turns, static: StaticRates, names: Sequence[str], fit: Fit, rests: Poses
) -> list[Explanation]:
    """Each stated angle as the one that is wrong, with the angle that the others make of it.

    Args:
        turns, static: that were fitted.
        names: of the parameters.
        fit: of them.
        rests: of the gyro.
    """
    x, stated = np.array([fit.value(n) for n in names]), turns.stated
    found = []
    for j in range(len(stated)):
        others = replace(turns, stated=stated.at(np.arange(len(stated)) != j))
        part, _ = solve(others, static, names, x)
        error = propagated(turns, [GyroModel(part, names)])[1][0, j]
        words = _stated_words(stated, j, float(error), rests)
        found.append(explanation(words, part, len(stated), readings=len(fit.residuals)))
    return found


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


def propagated(turns: Turns, models: Sequence[GyroModel]) -> tuple[Array, Array]:
    """Gravity's direction at the end of each turn by the integrated rate of each model, (k, m, 3),
    and the error of each stated angle, rad, (k, q).
    """
    k, m = len(models), len(turns)
    rates = np.concatenate(
        [model.rate(turns.rate, turns.force) - turns.earth.rate(model.earth) for model in models]
    )
    step = np.tile(turns.step, (k, 1))
    rotations = _products(rates, step).reshape(k, m, 3, 3)
    before = np.array([m.directions(turns.before, turns.shear) for m in models])
    integrals = np.einsum("min,mi->mn", rates, step).reshape(k, m, 3)
    after = np.einsum("kmij,kmj->kmi", rotations, before)
    return np.asarray(after), turns.stated.errors(rotations, integrals)


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
    after = model.directions(turns.after, turns.shear)
    return angle_between(propagated(turns, [model])[0][0], after)


@dataclass(frozen=True)
class Equations:
    """Residuals of turns, stated angles, rests and priors.

    Args:
        turns, static: readings.
        names: of the parameters, (p,).
        weight: of the four groups, (4,).
        across: directions in which those of the turns are taken, (m, 2, 3); across those after
            unless given.
    """

    turns: Turns
    static: StaticRates
    names: Sequence[str]
    weight: Array
    across: Array | None = None

    @property
    def prior(self) -> list[int]:
        """Places of the parameters that have one."""
        return [k for k, name in enumerate(self.names) if name.startswith(PRIOR)]

    @property
    def sizes(self) -> list[int]:
        """Number of equations of the four groups."""
        return [
            2 * len(self.turns),
            len(self.turns.stated),
            self.static.means.size,
            len(self.prior),
        ]

    @property
    def weights(self) -> Array:
        """Of every equation, (n,)."""
        return np.repeat(self.weight, self.sizes)

    def common(self, uncertain: References) -> CommonErrors:
        """What uncertain references add to the residuals; theirs without weights, (q, n, 1)."""
        return uncertain.along(self.weights[:, None])

    def residuals(self, X: Array) -> Array:
        """In units of their noise, under some parameter vectors: (k, p) -> (k, n)."""
        models = [GyroModel(x, self.names) for x in X]
        turns = self.turns
        across = tangents(turns.after) if self.across is None else self.across
        after = np.array([model.directions(turns.after, turns.shear) for model in models])
        carried, stated = propagated(turns, models)
        error = carried - after
        angles = np.einsum("mij,kmj->kmi", across, error) / turns.sigma[:, None]
        at_rest = np.array([self.static.residual(model) for model in models])
        weight = self.weight
        groups = [angles.reshape(len(X), -1), stated / turns.stated.sigma, at_rest]
        return np.hstack([*(g * w for g, w in zip(groups, weight, strict=False)), X[:, self.prior]])

    def measuring(self, turns: Turns, static: StaticRates) -> "Equations":
        """Of changed readings, in units of the same noise and along the same directions."""
        static = static.moved(np.zeros_like(static.means))
        static.whiten = self.static.whiten
        turns = replace(turns, sigma=self.turns.sigma, stated=self.turns.stated)
        return replace(self, turns=turns, static=static)

    def slopes(self, x: Array) -> Array:
        """Derivatives by the parameters, (n, p)."""
        parts = max(1, self.turns.step.size * 2 * len(x) // MEMORY_LIMIT)
        return _slopes(self.residuals, x, self.names, parts)

    def response(self, x: Array, turning: Array, resting: Array) -> Array:
        """Derivatives by errors of the readings, (n, q).

        Args:
            x: parameters, (p,).
            turning, resting: errors during turns (q, m, n, 3) and rests (q, m + 1, 3), rad/s.
        """
        found = []
        for errors, means in zip(turning, resting, strict=True):
            size = max(float(np.abs(errors).max()), float(np.abs(means).max()), 1e-300)
            step = RATE_STEP / size
            up, down = (
                replace(
                    self,
                    turns=replace(self.turns, rate=self.turns.rate + way * step * errors),
                    static=self.static.moved(way * step * means),
                ).residuals(x[None])[0]
                for way in (1, -1)
            )
            found.append((up - down) / (2 * step))
        return np.array(found).T


def solve(
    turns: Turns,
    static: StaticRates,
    names: Sequence[str],
    start: Array | None = None,
    uncertain: References = NO_REFERENCES,
) -> tuple[Fit, bool]:
    """All parameters from turns and rests together; the fit and whether it converged.

    Where the model is incomplete, neither group fits to its noise: each is weighted by the inverse
    of its own misfit. The residuals returned are those without the weights.

    Args:
        turns, static: the measurement.
        names: of the parameters.
        start: parameters to start from, SI, (p,).
        uncertain: what references add to the residuals, (q, n, 1).
    """
    equations = Equations(turns, static, names, np.ones(4))

    def problem(x: Array) -> tuple[Array, Array]:
        return equations.residuals(x[None])[0], equations.slopes(x)

    x = np.zeros(len(names)) if start is None else start
    if start is None:
        x[:3] = static.means.mean(axis=0)
    for _ in range(3):
        common = equations.common(uncertain)
        fit, converged = gauss_newton(names, x, problem, common=common, limit=15)
        x = np.array([fit.value(n) for n in names])
        unweighted = fit.residuals / equations.weights
        parts = np.split(unweighted, np.cumsum(equations.sizes[:3]))
        misfit = np.array([*(_misfit(part) for part in parts[:3]), 1.0])
        if fit.dropped or not converged or np.allclose(misfit * equations.weight, 1.0, rtol=0.01):
            break
        equations = replace(equations, weight=1 / misfit)
    return replace(fit, residuals=unweighted), converged


def misfit_of_turns(
    turns: Turns, static: StaticRates, names: Sequence[str], fit: Fit, rests: Poses, gyro: Sensor
) -> Misfit:
    """What the fit of turns and rests leaves: the readings of all turns, one after the other, then
    the mean of each rest.

    Args:
        turns, static: that were fitted.
        names: of the parameters.
        fit: of them.
        rests: of the gyro.
        gyro: the triad.
    """
    x = np.array([fit.value(n) for n in names])
    model = GyroModel(x, names)
    m, n = turns.step.shape
    equations = Equations(turns, static, names, np.ones(4))
    begins = np.array([s.end_s for s in rests.spans[:-1]])
    time = (begins[:, None] + np.cumsum(turns.step, axis=1)).ravel()
    rest_time = np.array([(s.start_s + s.end_s) / 2 for s in rests.spans])
    inputs = np.vstack([model.rate(turns.rate, turns.force).reshape(-1, 3), np.zeros((m + 1, 3))])
    order = np.argsort(np.append(time, rest_time), kind="stable")
    force = np.vstack([turns.force.reshape(-1, 3), static.force]) * G0
    every = np.append(time, rest_time)[order]
    sense = replace(
        Sense.at_rest(gyro, G0, force[order]),
        time=every,
        elapsed=every - every[0],
        rate=inputs[order],
    )
    part = np.append(np.repeat(2 * np.arange(m) + 1, n), 2 * np.arange(m + 1))[order]
    readings = np.vstack([turns.rate.reshape(-1, 3), static.means])[order]

    def respond(errors: Array) -> Array:
        back = np.empty_like(errors)
        back[:, order] = errors
        return equations.response(x, back[:, : m * n].reshape(-1, m, n, 3), back[:, m * n :])

    common = equations.common(rests.references)
    return Misfit(
        [f"{gyro.name}_{a}" for a in gyro.axes],
        every,
        readings,
        inputs[order],
        np.broadcast_to(np.sqrt(np.diag(rests.noise) * rests.inflation), readings.shape),
        part,
        _part_words(rests),
        common.weight(equations.residuals(x[None])[0]),
        equations.slopes(x),
        respond,
        lacking_terms(gyro, sense),
        cuts=np.flatnonzero(np.diff(part)) + 1,
    ).sharing(common)


def _part_words(rests: Poses) -> list[str]:
    """Rests and the turns between them, in order."""
    spans = rests.spans
    words = [part_words("standstill", s.start_s, s.end_s) for s in spans]
    turns = [part_words("turn", a.end_s, b.start_s) for a, b in pairwise(spans)]
    return [w for each in zip_longest(words, turns) for w in each if w]


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
    steps = np.where([n.startswith(PRIOR) for n in names], STEPS["prior"], steps)
    moved = np.vstack([x + np.diag(steps), x - np.diag(steps)])
    found = np.concatenate([residuals(part) for part in np.array_split(moved, parts)])
    up, down = np.split(found, 2)
    return np.asarray(((up - down) / (2 * steps[:, None])).T)
