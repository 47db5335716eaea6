"""S3: the scale factors of a MEMS gyro triad in the field, by turning it by hand beside one
fibre-optic gyro.

Field calibrations of several days as one: common scale factors, each day its own bias.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import pick_sensor, require_triad, wrap_up
from tiltcal.calibration.methods.field_log import (
    FieldLog,
    errors_of_difference,
    field_log,
    hand_turns,
    log_references,
    rests_with_motion,
)
from tiltcal.calibration.methods.fog_checks import LEAST_COMPONENT, fog_notes, log_tests, still_test
from tiltcal.calibration.methods.fog_filter import (
    Filtered,
    Problem,
    augmented_problem,
    batch,
    kalman,
)
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.calibration.screen.columns import common_gain, unit_test
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.validity import SIGNIFICANCE, VERDICTS, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG, DEG_H, EARTH_RATE
from tiltcal.recordings.joining import joins_of, parts_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import References
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.static_poses import Poses, PoseSpan, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import CommonErrors, Fit


def axis_covariance(axis: Array, error: float) -> Array:
    """Covariance of the scale factors by an error of the FOG's axis: ``-du_i / u_i``, du across u.

    Args:
        axis: input axis of the FOG, (3,).
        error: its standard uncertainty in each direction across it, rad.
    """
    u = np.where(axis == 0, np.inf, axis)
    across = np.eye(3) - np.outer(axis, axis)
    return np.asarray(error**2 * across / np.outer(u, u))


def combined(days: Sequence[Calibration], gyro: str, common: Array) -> Calibration:
    """The weighted mean of the scale factors, with a test that the days agree; the bias is that of
    the last day.

    Args:
        days: calibrations by ``fog_scale``, in order.
        gyro: name of the triad.
        common: covariance of the scale factors that all days share: it does not average, (3, 3).
    """
    scale = [f"{gyro}.scale_{a}" for a in AXES]
    values, weights = [], []
    for day in days:
        place = [list(day.parameters).index(n) for n in scale]
        values.append(np.array([day.value(n) for n in scale]))
        weights.append(np.linalg.inv(np.asarray(day.covariance)[np.ix_(place, place)]))
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    mean = covariance @ np.sum([w @ v for w, v in zip(weights, values, strict=True)], axis=0)
    spread = [float((v - mean) @ w @ (v - mean)) for v, w in zip(values, weights, strict=True)]
    words = f"the scale factors of {len(days)} recordings agree within their noise"
    agree = chi2_test("recordings agree", sum(spread), 3 * (len(days) - 1), words)
    last = days[-1]
    place = [list(last.parameters).index(n) for n in scale]
    whole = np.array(last.covariance)
    whole[np.ix_(place, place)] = covariance + common
    sigmas = np.sqrt(np.diag(covariance + common))
    found = {
        n: Estimate(float(v), float(s), "1") for n, v, s in zip(scale, mean, sigmas, strict=True)
    }
    tests = [agree]
    for k, day in enumerate(days):
        tests += [replace(t, name=f"{t.name}, recording {k + 1}") for t in day.tests]
    verdicts = [day.verdict for day in days] + ["good" if agree.passed else "suspect"]
    return replace(
        last,
        verdict=max(verdicts, key=VERDICTS.index),
        parameters={**last.parameters, **found},
        covariance=whole,
        tests=tests,
        poses=[p for day in days for p in day.poses],
        dof=sum(day.dof for day in days),
        warnings=[*last.warnings, *(_bias(k, day, gyro) for k, day in enumerate(days))],
    )


def _bias(number: int, day: Calibration, gyro: str) -> str:
    """The bias of one recording in words."""
    sizes = ", ".join(f"{day.value(f'{gyro}.bias_{a}') / DEG_H:.4g}" for a in AXES)
    return f"bias of recording {number + 1}: {sizes} deg/h; that of the last is kept"


NAME = "fog_scale"
UNCERTAIN = 0.01  # standard uncertainty of a scale factor whose axis counts as not turned


def fog_scale(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    fog: str | None = None,
    axis_error_deg: float = 0.0,
) -> Calibration:
    """Scale factors (and the day's bias) of a gyro triad against one FOG on an oblique axis, from
    turns by hand.

    Model: ``gyro_i = b_i + (1 + S_i) w_i``, ``fog = b_F + u . w``. Both rest means are subtracted,
    so that the Earth's rate cancels; ``u . r - F = sum_i u_i r_i S_i/(1 + S_i) + c + h . f`` is
    estimated by a Kalman filter with the error c of the rest means and (with an accelerometer
    triad) the g-sensitivity h = u' G as further states.

    Args:
        recording: rest of 20 s or more, then turns of more than 360 deg about x, y and z; rests
            between turns help. Of several joined ones each has its own bias.
        setup: with a gyro triad and a FOG, ``input_axis`` stated; an accelerometer triad if there
            is one.
        segments: dwells to use.
        sensor: which gyro triad, when several fit.
        fog: which FOG, when several fit.
        axis_error_deg: standard uncertainty of the direction of the FOG's axis, across it; its
            share is then in the sigmas of the scale factors.

    Raises:
        TiltcalError: no triad, no FOG, no rest, or no turn.

    Errors:
        An error du of the FOG's axis becomes scale, S_i - du_i/u_i; a cross-coupling M_ij of the
            gyro becomes S_j + sum_i (u_i/u_j) M_ij; a scale error of the FOG is common to all. The
            fit shows none of them.
        Faster turns are better until a sensor saturates: var S_i = N^2/(u_i^2 w A) + s_c^2
            (A/w)^2/(u_i A)^2 for angle A.

    Source: docs/sources.md, "Gyro triad in the field"; docs/physics.md, "Gyro triad against one
    FOG"; Rauch, Tung and Striebel (1965).
    """
    gyro = pick_sensor(setup, recording, ("gyro",), sensor, NAME)
    if len(joins_of(recording)):
        return _several_days(recording, setup, gyro, fog, axis_error_deg * DEG)
    require_triad(gyro, NAME, "add the others")
    reference = pick_sensor(setup, recording, ("fog",), fog, NAME)
    live = data_tests(recording, gyro, reference)
    found = list(find_segments(recording)) if segments is None else _with_moves(segments, recording)
    rests = dwells(found)
    log = field_log(recording, setup, gyro, reference, found)
    walk = _walk(log)
    uncertain = log_references(log, recording, setup, gyro, reference)
    errors = errors_of_difference(log, uncertain)
    problem = augmented_problem(log, walk, stated=errors.columns[:, errors.fitted])
    state = kalman(problem)
    tests = [
        *log_tests(log, problem, state, gyro, recording.source),
        still_test(rests_with_motion(recording, setup, reference, rests)),
        unit_test(gyro, common_gain(np.diag(1 + state.scale)), recording.sensor(gyro).units[0]),
        *live,
    ]
    poses = find_poses(recording, setup, gyro, rests)
    residuals = (problem.z - problem.H @ state.x) / np.sqrt(problem.R)
    noise = _scale_and_bias(gyro.name, log, state, poses, residuals, axis_error_deg * DEG)
    seen = np.abs(reference.input_vector) >= LEAST_COMPONENT
    determined = seen & (np.sqrt(np.diag(state.scale_covariance)) < UNCERTAIN)
    result = wrap_up(
        NAME,
        verdict_of(tests, bool(determined.all())),
        _with_references(noise, log, problem, uncertain, errors),
        ["1"] * 3 + ["rad_s"] * 3,
        tests,
        fog_notes(log, state, walk, determined),
        replace(poses, references=uncertain),
        recording,
        equation=f"{gyro.name}_i = bias_i + (1 + scale_i) w_i",
        inverse="w = (reading - bias) / (1 + scale)",
    )
    turns = [PoseSpan(t.start, t.end, f"turn {t.words()}") for t in hand_turns(log)]
    ratio = state.chi2 / max(state.used, 1)
    return replace(result, poses=[*result.poses, *turns], chi2_per_dof=ratio, dof=state.used)


def _several_days(
    recording: Recording, setup: Setup, gyro: Sensor, fog: str | None, axis_error: float
) -> Calibration:
    """Joined recordings, each with its own bias; uncertain references are those of the last, and do
    not average. axis_error: of the FOG's axis, rad.
    """
    parts = parts_of(recording)
    alone = setup.model_copy(update={"budget": ()})
    days = [fog_scale(part, alone, sensor=gyro.name, fog=fog) for part in parts]
    axis = pick_sensor(setup, recording, ("fog",), fog, NAME).input_vector
    result = combined(days, gyro.name, axis_covariance(axis, axis_error))
    if not setup.budget:
        return result
    last = fog_scale(parts[-1], setup, sensor=gyro.name, fog=fog)
    covariance = result.covariance + last.covariance - days[-1].covariance
    sigmas = np.sqrt(np.diag(covariance)).tolist()
    return replace(
        result,
        covariance=covariance,
        parameters={
            name: replace(e, sigma=sigma)
            for (name, e), sigma in zip(result.parameters.items(), sigmas, strict=True)
        },
        references=last.references,
        assumed_covariance=last.assumed_covariance,
    )


def _scale_and_bias(
    gyro: str, log: FieldLog, state: Filtered, poses: Poses, residuals: Array, axis_error: float
) -> Fit:
    """Scale factors by the filter and biases by the first rest, as one fit. axis_error: of the
    FOG's axis, rad.
    """
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = state.scale_covariance + axis_covariance(log.axis, axis_error)
    # the rest mean includes the Earth's rate, whose direction is unknown
    covariance[3:, 3:] = poses.covariance(0) + np.eye(3) * EARTH_RATE**2 / 3
    names = [f"{gyro}.{term}_{a}" for term in ("scale", "bias") for a in AXES]
    values = np.concatenate([state.scale, log.bias[:3]])
    return Fit(tuple(names), values, covariance, residuals)


def _with_references(
    fit: Fit, log: FieldLog, problem: Problem, uncertain: References, errors: CommonErrors
) -> Fit:
    """The fit with what each uncertain reference changes: the scale factors are linear in the
    measurements, a bias is the mean of the first rest.
    """
    if not len(errors.fitted):
        return fit
    X = np.array([batch(replace(problem, z=column)).x[:3] for column in errors.columns.T])
    scale = X.T * (1 + fit.values[:3, None]) ** 2  # S = X / (1 - X): dS/dX = (1 + S)^2
    first = np.flatnonzero(log.rest == 0)
    bias = uncertain.columns[:, first, :3].mean(axis=1).T
    covariance = fit.covariance.copy()
    covariance[3:, 3:] += bias[:, errors.fitted] @ bias[:, errors.fitted].T
    return replace(fit, covariance=covariance, contributions=np.concatenate([scale, bias]))


def _with_moves(segments: Sequence[Segment], recording: Recording) -> list[Segment]:
    """Given dwells with the moves between them, where only dwells were given."""
    if any(s.kind == "move" for s in segments):
        return list(segments)
    ends = [(s.end, s.last) for s in segments]
    starts = [(s.start, s.first) for s in segments[1:]]
    starts.append((float(recording.time[-1]), len(recording)))
    gaps = zip(ends, starts, strict=True)
    moves = [Segment(a, b, i, j, "move") for (a, i), (b, j) in gaps if j > i]
    return sorted([*segments, *moves], key=lambda s: s.first)


def _walk(log: FieldLog) -> float:
    """Variance that the zero gains a second, (rad/s)^2/s, from the means of the rests; 0 unless
    they differ significantly.
    """
    from scipy.special import chdtrc

    problem = augmented_problem(log)
    left = log.difference - problem.H @ batch(problem).x
    inside = [log.rest == k for k in range(log.rest.max() + 1)]
    inside = [rest for rest in inside if rest.sum() >= 5]
    if len(inside) < 3:
        return 0.0
    means = np.array([left[rest].mean() for rest in inside])
    noise = np.array([log.density / log.span[rest].sum() for rest in inside])
    times = np.array([log.time[rest].mean() for rest in inside])
    chi2 = np.sum((means - np.average(means, weights=1 / noise)) ** 2 / noise)
    if chdtrc(len(inside) - 1, float(chi2)) > SIGNIFICANCE:
        return 0.0
    excess = np.diff(means) ** 2 - noise[1:] - noise[:-1]
    return float(max(np.mean(excess / np.diff(times)), 0.0))
