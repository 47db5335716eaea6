"""Effects without a fixed signature: a wrong angle of one stop, random setting at every stop,
random stamps.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.channels import changed, without_readout
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.data_quality.flat_and_repeated import Fault
from tiltcal.diagnosis.model.cosine_basis import basis_of, cosines, project
from tiltcal.diagnosis.model.fitted_model import (
    FittedModel,
    models,
    noise_under,
    noise_within_stops,
    refit,
)
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.forward_selection import (
    ALPHA,
    finding_log_p_values,
    findings,
    log_tail,
)
from tiltcal.effects.data.labelling_faults import DataPoseLabel
from tiltcal.effects.table.readout import EncoderZero, IndexError_
from tiltcal.effects.timing.delays import DataJitter, DataLatency
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.noise_spectrum import NoiseFit, robust_white

APART = 25.0  # times the misfit of others: five times as far off
MARGIN = 4  # rows beside a stop that its wrong readout spoils


def find_wrong_stop(
    observations: Observations, fitted: FittedModel
) -> tuple[Fault, tuple[Recording, ...]] | None:
    """One stop whose written angle is wrong: it is far off where the others are not, and one other
    angle takes that away.
    """
    worst = stop_misfits(observations, fitted) if observations.courses else {}
    if not worst:
        return None
    (number, stop), largest = max(worst.items(), key=lambda item: item[1])
    others = sorted(v for k, v in worst.items() if k != (number, stop))
    if largest < 400 or not others or largest < APART * max(float(np.median(others)), 1.0):
        return None
    return _rewritten(observations, fitted, number, stop)


def stop_misfits(observations: Observations, fitted: FittedModel) -> dict[tuple[int, int], float]:
    """Misfit of each stop of each recording, in squares of the noise."""
    worst: dict[tuple[int, int], float] = {}
    for channel, r in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        noise = robust_white(r)
        for stop in range(int(channel.stop.max(initial=-1)) + 1):
            there = channel.stop == stop
            if there.sum() >= 4:
                z = float(np.median(r[there]) ** 2 * there.sum()) / noise**2
                worst[channel.recording, stop] = worst.get((channel.recording, stop), 0.0) + z
    return worst


def stands_alone(observations: Observations, mended: Observations, fitted: FittedModel) -> bool:
    """Whether a stop is far off what all others are, once one that was wrong no longer spoils the
    fitted model.
    """
    rest = stop_misfits(mended, fitted)
    return max(stop_misfits(observations, fitted).values()) > APART * max(
        rest.values(), default=1.0
    )


def _rewritten(
    observations: Observations, fitted: FittedModel, number: int, stop: int
) -> tuple[Fault, tuple[Recording, ...]] | None:
    """The axis and error that take the misfit of a stop away; None when none does."""
    course = observations.courses[number]
    rows = course.stop == stop
    best: tuple[float, float, str] | None = None
    before = _misfit(observations, fitted, number, stop, course.angles)
    for axis in observations.scenario.rig.axis_names:
        errors: Array = np.linspace(-np.pi, np.pi, 361)[1:]
        for width in (0.0, 2e-2, 2e-3, 2e-4, 2e-5):
            if width and best is not None and best[2] == axis:
                errors = best[1] + np.linspace(-width, width, 21)
            elif width:
                break
            for error in errors:
                angles = {**course.angles, axis: course.angles[axis] - error * rows}
                value = _misfit(observations, fitted, number, stop, angles)
                if best is None or value < best[0]:
                    best = (value, float(error), axis)
    if best is None or best[0] > 0.02 * before:
        return None
    _, error, axis = best
    repaired = list(observations.recordings)
    fault, repaired[number] = mistyped(
        observations, number, repaired[number], rows, axis, error, 2e-5
    )
    return fault, tuple(repaired)


def mistyped(
    observations: Observations,
    number: int,
    recording: Recording,
    rows: Mask,
    axis: str,
    error: float,
    sigma: float,
) -> tuple[Fault, Recording]:
    """The fault of a wrong angle (rad) written on some rows, (n,) mask, of one stop, and the
    recording without its readout.
    """
    stop = (
        observations.courses[number].stop[: np.argmax(rows)].max(initial=-1) + 1
    )  # it need not have been found itself
    time = recording.time[rows] - recording.time[0]
    effect = DataPoseLabel(
        {"error": error, "stop": float(stop)}, None, axis, "found", seen_in=recording.fingerprint
    )
    names = tuple(dict.fromkeys(c.sensor for c in observations.channels))
    axes = tuple(dict.fromkeys(c.axis for c in observations.channels))
    interval = (float(time[0]), float(time[-1]))
    words = (
        f"The {axis} angle written from {interval[0]:.1f} s to {interval[1]:.1f} s is"
        f" {np.degrees(error):.5g} deg off."
    )
    spoiled = np.convolve(rows, np.ones(2 * MARGIN + 1), "same") > 0
    return Fault(effect, names, axes, words, interval, sigma={"error": sigma}), without_readout(
        recording, np.flatnonzero(spoiled)
    )


def _misfit(
    observations: Observations,
    fitted: FittedModel,
    number: int,
    stop: int,
    angles: dict[str, Array],
) -> float:
    """Misfit of one stop, in squares of the noise, when its angles are these."""
    from tiltcal.forward.signal_chain import readings

    course = observations.courses[number]
    middle = np.flatnonzero(course.stop == stop)
    row = middle[len(middle) // 2 : len(middle) // 2 + 1]
    one = replace(
        course,
        time=course.time[row],
        angles={k: v[row] for k, v in angles.items()},
        known=course.known[row],
        temperature=course.temperature[row],
        stop=course.stop[row],
    )
    total = 0.0
    names = sorted({c.sensor for c in observations.channels})
    predicted = readings(observations.scenario, one, dict.fromkeys(names, one.time), fitted.effects)
    for c in observations.channels:
        there = c.stop == stop
        if c.recording == number and there.any():
            total += float((np.median(c.values[there]) - predicted[c.sensor][0, c.column]) ** 2)
    return total


def find_setting_error(
    fitted: FittedModel, start: FittedModel, whitened: WhitenedModel, total: int
) -> tuple[Fault, list[Columns]] | None:
    """Random setting of an axis: every stop is off by a rotation of its own, and nothing smooth
    takes half of it away.

    Returns:
        The fault, and the change of the readings by each stop's own rotation; None when the stops
        agree.
    """
    observations = whitened.observations
    noise = noise_within_stops(fitted, whitened)
    if noise is None:
        return None
    trials = {
        axis: _stop_columns(observations, axis, fitted)
        for axis in observations.scenario.rig.axis_names
    }
    trials = {axis: columns for axis, columns in trials.items() if len(columns) >= 8}
    limit = float(np.log(ALPHA) - np.log(max(total, 1)))
    chances = {
        axis: _chance(columns, fitted, whitened, noise, limit) for axis, columns in trials.items()
    }
    axis = min(chances, key=lambda a: chances[a], default=None)
    if axis is None or chances[axis] > limit:
        return None
    columns, within = trials[axis], whitened.under(models(noise))
    gain, values, variances = _stops(columns, refit(fitted, within), within)
    first = _stops(columns, refit(start, within), within)[0]
    free = max(
        len(columns) - sum(len(t.names) for t in fitted.terms), 1
    )  # so many sizes take their share of chance as well
    if gain / free < 0.5 * first / len(columns):
        return None
    spread = float(np.mean(values**2 - variances))
    if spread <= 0:
        return None
    sigma = float(np.sqrt(spread))
    names = tuple(dict.fromkeys(c.sensor for c in observations.channels))
    axes = tuple(dict.fromkeys(c.axis for c in observations.channels))
    effect = IndexError_({"sigma": sigma}, None, axis, "found")
    words = (
        f"The {axis} axis stops elsewhere by chance, {np.degrees(sigma) * 3600:.3g} arcsec rms:"
        " each stop is a rotation of its own."
    )
    error = sigma / np.sqrt(2 * len(values))
    return Fault(effect, names, axes, words, sigma={"sigma": error}), columns


def _chance(
    stops: Sequence[Columns],
    fitted: FittedModel,
    whitened: WhitenedModel,
    noise: Sequence[NoiseFit],
    limit: float,
) -> float:
    """Logarithm of the chance of what the stops' own rotations explain, in the noisiest way that
    the stops allow.

    Once it is above the limit it is not worked out further.

    What differs from stop to stop but is no rotation about the axis tells how much noise there is
    that the stops by themselves
    do not show: the rotations have to stand out of that too.
    """
    levels = [{i: np.asarray(column[i] != 0, float)} for column in stops for i in column]
    worst = -np.inf
    for side in (0, 1):
        bound = whitened.under([fit.bounds()[side] for fit in noise])
        at_this = refit(fitted, bound)
        gain, _, _ = _stops(stops, at_this, bound)
        worst = max(worst, log_tail(gain, len(stops)))
        if worst > limit:
            break
        other = _stops([*stops, *levels], at_this, bound)[0] - gain
        free = len(levels) - len(stops) - at_this.basis[0].shape[1]
        worst = max(worst, log_ratio(gain, len(stops), other, free) if free > 0 else -np.inf)
    return worst


def log_ratio(gain: float, dof: int, other: float, free: int) -> float:
    """Logarithm of the chance that a ratio of mean squares exceeds that of ``gain`` over
    ``other``.
    """
    from scipy.special import fdtrc

    return float(np.log(max(float(fdtrc(dof, free, gain / dof / max(other / free, 1.0))), 1e-300)))


def lawful_part(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model without its nameless curves, where these have as many numbers together as
    there
    are stops: each tells its own.
    """
    named = tuple(t for t in fitted.terms if (t.host or t.hypothesis).listed)
    sizes = sum(len(t.names) for t in fitted.terms) - sum(len(t.names) for t in named)
    few = sizes < sum(int(stop.max(initial=-1)) + 1 for stop in whitened.observations.stops)
    return fitted if few else refit(replace(fitted, terms=named), whitened)


def beside_stops(
    fitted: FittedModel, stops: Sequence[Columns], whitened: WhitenedModel, total: int
) -> FittedModel:
    """The fitted model without the findings that rotations of every stop explain as well."""
    lengths = [len(c.values) for c in whitened.observations.channels]
    extra = {
        i: np.column_stack([cosines(c.get(i, np.zeros(n))) for c in stops])
        for i, n in enumerate(lengths)
    }
    beside = whitened.under(models(noise_under(fitted, whitened.columns, extra, whitened.law)))
    values = finding_log_p_values(fitted, beside, total, stops)
    kept = [
        k
        for places, value in zip(findings(fitted), values, strict=True)
        if value < np.log(ALPHA)
        for k in places
    ]
    return refit(replace(fitted, terms=tuple(fitted.terms[k] for k in kept)), whitened)


def _stop_columns(observations: Observations, axis: str, fitted: FittedModel) -> list[Columns]:
    """Change of the readings per radian of one axis at one stop, for each stop; on the way it goes
    over into the next.
    """
    zero = EncoderZero({f"{axis}_zero": 1e-4}, None, None, "found")
    whole = observations.changes(zero, fitted.effects)
    found = []
    for number, course in enumerate(observations.courses):
        resting = np.flatnonzero(course.stop >= 0)
        for stop in range(int(course.stop.max(initial=-1)) + 1):
            weight = np.interp(
                np.arange(len(course.stop)), resting, (course.stop[resting] == stop).astype(float)
            )
            part = {
                i: column * weight[observations.channels[i].rows] / -1e-4
                for i, column in whole.items()
                if observations.channels[i].recording == number
            }
            if any(np.any(c) for c in part.values()):
                found.append(part)
    return found


def _stops(
    columns: Sequence[Columns], fitted: FittedModel, whitened: WhitenedModel
) -> tuple[float, Array, Array]:
    """Fall of the deviance by a free angle at each stop, those angles, rad, and their variances."""
    lengths = [len(c.values) for c in whitened.observations.channels]
    residual = whitened.residual(fitted.effects)
    scaled = [whitened.whiten(c) for c in columns]
    left = project(fitted.basis, residual)
    parts = [
        dict(
            enumerate(project(fitted.basis, [w.get(i, np.zeros(n)) for i, n in enumerate(lengths)]))
        )
        for w in scaled
    ]
    Q = basis_of(parts, lengths)
    along = np.sum([q.T @ r for q, r in zip(Q, left, strict=True)], axis=0)
    energy = np.array([sum(float(c @ c) for c in w.values()) for w in scaled])
    values = np.array([sum(float(c @ left[i]) for i, c in w.items()) for w in scaled]) / np.maximum(
        energy, 1e-300
    )
    return float(along @ along), values, 1 / np.maximum(energy, 1e-300)


def find_stamp_jitter(fitted: FittedModel, observations: Observations) -> Fault | None:
    """Stamps that are wrong by chance: the residual's variance grows with the square of how fast
    the reading moves.
    """
    if not observations.courses:
        return None
    late = DataLatency({"latency": 1e-3}, None, None, "found")
    slopes = observations.changes(late, fitted.effects)
    noises = [
        _quiet_noise(r, c.stop)
        for r, c in zip(observations.residuals(fitted.effects), observations.channels, strict=True)
    ]
    top = bottom = smooth = 0.0
    energy: dict[tuple[str, str], float] = {}
    for i, r in enumerate(observations.residuals(fitted.effects)):
        if i not in slopes:
            continue
        channel = observations.channels[i]
        noise = noises[i]
        s2 = (slopes[i] / 1e-3 / noise) ** 2
        excess = np.minimum((r / noise) ** 2, 400.0) - 1
        top += float(excess @ s2)
        next_to = np.sqrt(s2[1:] * s2[:-1])
        smooth += float(
            np.clip(r[1:] * r[:-1] / noise**2, -400.0, 400.0) @ next_to
        )  # a smooth misfit is like its neighbour
        bottom += float(s2 @ s2)
        energy[channel.sensor, channel.axis] = float(s2.sum())
    if bottom <= 0:
        return None
    value, sigma = (
        top / bottom,
        np.sqrt(4.0 / bottom),
    )  # heavier than Gaussian tails double the variance of a square
    if value < 8 * sigma or smooth > 0.3 * top:
        return None
    strong = [
        k
        for k, e in sorted(energy.items(), key=lambda item: -item[1])
        if e > 0.05 * sum(energy.values())
    ]
    effect = DataJitter({"jitter": float(np.sqrt(value))}, strong[0][0], None, "found")
    words = (
        f"Stamps are wrong by chance, {1e3 * np.sqrt(value):.3g} ms rms: the residual grows with"
        " the rate of the reading."
    )
    return Fault(
        effect,
        tuple(dict.fromkeys(s for s, _ in strong)),
        tuple(dict.fromkeys(a for _, a in strong)),
        words,
        sigma={"jitter": float(sigma / (2 * np.sqrt(value)))},
    )


def _quiet_noise(residual: Array, stop: Index) -> float:
    """Standard deviation of a residual at rest; of its second differences where it never rests."""
    still = stop >= 0
    return float(np.std(residual[still])) if still.sum() > 32 else robust_white(residual)


SPOILS = 0.3  # of the noise: a sample that a random stamp moves by more is left out


def at_rest_only(
    observations: Observations, fitted: FittedModel, jitter: float
) -> tuple[Recording, ...]:
    """The recordings without the samples that random stamps (s, rms) spoil."""
    late = DataLatency({"latency": 1e-3}, None, None, "found")
    recordings = list(observations.recordings)
    residuals = observations.residuals(fitted.effects)
    for i, slope in observations.changes(late, fitted.effects).items():
        channel = observations.channels[i]
        spoiled = np.abs(slope) / 1e-3 * jitter > SPOILS * _quiet_noise(residuals[i], channel.stop)
        sensor = observations.scenario.named(channel.sensor)
        recordings[channel.recording] = changed(
            recordings[channel.recording], sensor, channel.axis, channel.rows[spoiled], np.nan
        )
    return tuple(recordings)
