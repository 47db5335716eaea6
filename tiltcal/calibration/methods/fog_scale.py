"""S3: the scale factors of a MEMS gyro triad in the field, by turning it by hand beside one
fibre-optic gyro.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from tiltcal.calibration.methods.common import pick_sensor, wrap_up
from tiltcal.calibration.methods.field_log import (
    BIAS_SPAN,
    FieldLog,
    field_log,
    hand_turns,
    restless,
)
from tiltcal.calibration.methods.fog_filter import (
    Filtered,
    augmented_problem,
    batch,
    kalman,
    patent_problem,
    smoothed,
)
from tiltcal.calibration.methods.screening import columns_test, require_unsaturated
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG, DEG_H, EARTH_RATE
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.static_poses import PoseSpan, find_poses
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit

NAME = "fog_scale"
FULL_TURN = 360 * DEG
LEAST_COMPONENT = 0.05  # of the FOG's axis along a gyro axis: less of it shows nothing
LOST = 0.01  # standard uncertainty of a scale factor above which its axis counts as not turned
IMPLAUSIBLE = 0.2  # scale error beyond which columns, signs or units are wrong rather than the gyro


def fog_scale(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    fog: str | None = None,
) -> Calibration:
    """Scale factors (and the day's bias) of a gyro triad against one FOG on an oblique axis, from
    turns by hand.

    Model: ``gyro_i = b_i + (1 + S_i) w_i``, ``fog = b_F + u . w``. Both rest means are taken off,
    so that the Earth's rate cancels; ``u . r - F = sum_i u_i r_i S_i/(1 + S_i) + c + h . f`` is
    estimated by a Kalman filter with the error c of the rest means and (where an accelerometer
    triad stands beside) the g-sensitivity h = u' G as further states.

    Args:
        recording: rest of 20 s or more, then turns of more than 360 deg about x, y and z; rests
            between turns help.
        setup: with a gyro triad and a FOG, ``input_axis`` stated; an accelerometer triad if there
            is one.
        segments: dwells to use.
        sensor: which gyro triad, when several fit.
        fog: which FOG, when several fit.

    Raises:
        TiltcalError: no triad, no FOG, no rest, or no turn.

    Errors:
        An error du of the FOG's axis becomes scale, S_i - du_i/u_i; a cross-coupling M_ij of the
            gyro becomes S_j + sum_i (u_i/u_j) M_ij; a scale error of the FOG is common to all. None
            of them shows in the fit.
        Faster turns are better until a sensor saturates: var S_i = N^2/(u_i^2 w A) + s_c^2
            (A/w)^2/(u_i A)^2 for angle A.

    Source: seed S3 (patent, composite instrument); PHYSICS 6 (3); Rauch, Tung and Striebel (1965).
    """
    gyro = pick_sensor(setup, recording, ("gyro",), sensor, NAME)
    if len(gyro.axes) != 3:
        raise TiltcalError(
            f"method {NAME}",
            found=f"{len(gyro.axes)} axes of {gyro.name}",
            need="a triad",
            do="add the others",
        )
    reference = pick_sensor(setup, recording, ("fog",), fog, NAME)
    for each in (gyro, reference):
        require_unsaturated(recording, each)
    found = list(find_segments(recording)) if segments is None else _with_moves(segments, recording)
    log = field_log(recording, setup, gyro, reference, found)
    problem = augmented_problem(log)
    walk = _walk(log, batch(problem).x, problem.H)
    problem = augmented_problem(log, walk)
    state, twin = kalman(problem), batch(problem)
    tests = [
        _fit_test(log, state),
        _twin_test(state, twin),
        *_turn_tests(log),
        _rest_test(log),
        _still_test(restless(recording, setup, reference, dwells(found))),
        _scale_test(log, state),
    ]
    if log.force is not None:
        tests.append(columns_test(log.time, log.rate - log.bias[:3], log.force))
    poses = find_poses(recording, setup, gyro, dwells(found))
    # the Earth's rate is in the rest mean, direction unknown
    rest_noise = poses.covariance(0) + np.eye(3) * EARTH_RATE**2 / 3
    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = state.scale_covariance, rest_noise
    names = [f"{gyro.name}.{term}_{a}" for term in ("scale", "bias") for a in AXES]
    residuals = (problem.z - problem.H @ state.x) / np.sqrt(problem.R)
    fit = Fit(tuple(names), np.concatenate([state.scale, log.bias[:3]]), covariance, residuals)
    spread = np.sqrt(np.diag(state.scale_covariance))
    seen = np.abs(reference.input_vector) >= LEAST_COMPONENT
    result = wrap_up(
        NAME,
        verdict_of(tests, bool(np.all(seen & (spread < LOST)))),
        fit,
        ["1"] * 3 + ["rad_s"] * 3,
        tests,
        _notes(log, state, walk, seen & (spread < LOST)),
        poses,
        recording,
        equation=f"{gyro.name}_i = bias_i + (1 + scale_i) w_i",
        inverse="w = (reading - bias) / (1 + scale)",
    )
    return replace(
        result,
        poses=[*result.poses, *_turn_spans(log)],
        chi2_per_dof=state.chi2 / max(state.used, 1),
        dof=state.used,
    )


def _with_moves(segments: Sequence[Segment], recording: Recording) -> list[Segment]:
    """Given dwells with the moves between them, where only dwells were given."""
    if any(s.kind == "move" for s in segments):
        return list(segments)
    ends = [(s.end, s.last) for s in segments]
    starts = [(s.start, s.first) for s in segments[1:]] + [
        (float(recording.time[-1]), len(recording))
    ]
    moves = [
        Segment(a, b, i, j, "move") for (a, i), (b, j) in zip(ends, starts, strict=True) if j > i
    ]
    return sorted([*segments, *moves], key=lambda s: s.first)


def _turn_spans(log: FieldLog) -> list[PoseSpan]:
    return [PoseSpan(t.start, t.end, f"turn {t.words()}") for t in hand_turns(log)]


def _walk(log: FieldLog, x: Array, H: Array) -> float:
    """Variance that the zero gains a second, from what rests differ by beyond their noise; 0 unless
    significant (0.1 %).
    """
    from scipy.special import chdtrc

    left = log.difference - H @ x
    rests = [k for k in range(log.rest.max() + 1) if np.sum(log.rest == k) >= 5]
    if len(rests) < 3:
        return 0.0
    means = np.array([left[log.rest == k].mean() for k in rests])
    noise = np.array([log.density / log.span[log.rest == k].sum() for k in rests])
    when = np.array([log.time[log.rest == k].mean() for k in rests])
    if (
        chdtrc(
            len(rests) - 1,
            float(np.sum((means - np.average(means, weights=1 / noise)) ** 2 / noise)),
        )
        > 1e-3
    ):
        return 0.0
    return float(max(np.mean((np.diff(means) ** 2 - noise[1:] - noise[:-1]) / np.diff(when)), 0.0))


def _fit_test(log: FieldLog, state: Filtered) -> Test:
    """Innovations against noise that is itself estimated from the rests: an F test."""
    from scipy.special import fdtrc

    dof = state.used - len(state.x)
    ratio = state.chi2 / max(dof, 1)
    p = float(fdtrc(dof, log.freedom, ratio)) if dof > 0 else 1.0
    words = (
        f"{state.used} innovations of the filter have {np.sqrt(ratio):.3g} times the noise seen at"
        " rest"
    )
    return Test("fit", state.chi2, dof, p, p > 1e-3, words)


def _twin_test(state: Filtered, twin: Filtered) -> Test:
    worst = float(np.max(np.abs(state.x - twin.x) / np.sqrt(np.diag(twin.P))))
    return Test(
        "filter and batch",
        worst,
        0,
        float(worst < 0.01),
        worst < 0.01,
        f"they agree to {worst:.2g} sigma",
    )


def _turn_tests(log: FieldLog) -> list[Test]:
    """More than a full turn about each axis."""
    tests = []
    for axis, angle in zip(AXES, log.angles(), strict=True):
        enough = bool(angle >= FULL_TURN)
        words = f"turned {angle / DEG:.0f} deg about {axis}" + (
            "" if enough else f", need 360 deg: turn again about {axis}"
        )
        tests.append(
            Test(f"turned about {axis}", float(angle / DEG), 0, float(enough), enough, words)
        )
    return tests


def _rest_test(log: FieldLog) -> Test:
    length = float(log.span[log.rest == 0].sum())
    enough = length >= BIAS_SPAN - 0.5
    words = f"{length:.3g} s at rest before the first turn" + (
        "" if enough else f", need {BIAS_SPAN:.0f} s, better 20 s: rest again"
    )
    return Test("rest before the turns", length, 0, float(enough), enough, words)


def _still_test(moved: Sequence[tuple[Segment, float]]) -> Test:
    if not moved:
        return Test("still while resting", 0.0, 0, 1.0, True, "the FOG sees no motion in any rest")
    s, rate = moved[0]
    words = (
        f"moved during the rest from {s.start:.4g} to {s.end:.4g} s: the FOG turns at"
        f" {rate / DEG_H:.3g} deg/h; rest again"
    )
    return Test("still while resting", rate / DEG_H, 0, 0.0, False, words)


def _scale_test(log: FieldLog, state: Filtered) -> Test:
    """A scale off by a fifth is a wrong column: which order and signs of the columns would make it
    small?
    """
    worst = float(np.max(np.abs(state.x[:3])))
    if worst < IMPLAUSIBLE:
        return Test(
            "plausible scale",
            worst,
            0,
            1.0,
            True,
            f"no scale is off by more than {IMPLAUSIBLE:.0%}",
        )
    words = f"a scale is off by {worst:.0%}: check units, columns and the FOG's input_axis"
    for order in permutations(range(3)):
        for signs in np.array(np.meshgrid(*[[1, -1]] * 3)).T.reshape(-1, 3):
            other = replace(
                log,
                rate=signs * log.rate[:, order],
                bias=np.append(signs * log.bias[list(order)], log.bias[3]),
            )
            if np.max(np.abs(batch(augmented_problem(other)).x[:3])) < IMPLAUSIBLE / 4:
                columns = ", ".join(
                    f"{'-' if s < 0 else ''}{AXES[i]}" for s, i in zip(signs, order, strict=True)
                )
                words += f"; it would fit if the columns x, y, z were {columns}"
                return Test("plausible scale", worst, 0, 0.0, False, words)
    return Test("plausible scale", worst, 0, 0.0, False, words)


def _notes(
    log: FieldLog, state: Filtered, walk: float, seen: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
) -> list[str]:
    """What the user should know beside the numbers."""
    notes = [
        f"not determined about {a}: turn again about {a}"
        for a, ok in zip(AXES, seen, strict=True)
        if not ok
    ]
    for a, part in zip(AXES, log.axis, strict=True):
        if abs(part) < LEAST_COMPONENT:
            notes.append(
                f"the FOG's axis has only {part:.2g} along {a}: mount it obliquely, as (1, 1, 1)"
            )
    turns = ", ".join(t.words() for t in hand_turns(log)) or "none"
    before, after = attitude_errors(state)
    plain = kalman(patent_problem(log))
    claims = ", ".join(f"{a} {v * 1e6:.0f} +- {s * 1e6:.0f}" for a, v, s in _claims(plain))
    limit = np.max(0.1 * DEG / np.maximum(np.abs(log.axis), 1e-9))
    notes += [
        f"turns found: {turns}",
        (
            f"attitude after one full turn is wrong by {before / DEG:.3g} deg rms as it reads, by"
            f" {after / DEG:.2g} deg corrected"
        ),
        (
            f"the patent's own filter gives and claims, in ppm: {claims}; it knows no error of the"
            " rest mean and no S^2"
        ),
        (
            "limit that no fit shows: an error of 0.1 deg of the FOG's axis is up to"
            f" {limit * 1e6:.0f} ppm of scale (-du_i/u_i)"
        ),
        "bias is the mean of the first rest, with the Earth's rate in it",
    ]
    if walk:
        course = smoothed(augmented_problem(log, walk))[0][:, 3]
        notes.append(
            f"the zero wanders: {np.sqrt(walk * 3600) / DEG_H:.3g} deg/h per square root of an hour"
            f" between rests, {np.ptp(course) / DEG_H:.3g} deg/h over this log by the smoother; the"
            " filter allows for it"
        )
    if log.force is None:
        notes.append(
            "no accelerometer triad beside: g-sensitivity is not told from scale unless the turns"
            " are whole"
        )
    return notes


def _claims(plain: Filtered) -> list[tuple[str, float, float]]:
    return list(zip(AXES, plain.x[:3], np.sqrt(np.diag(plain.P)[:3]), strict=True))


def attitude_errors(state: Filtered) -> tuple[float, float]:
    """Error of attitude after one turn about each axis, rms of three, rad: by the scale that was
    found, and by what it lacks.
    """
    before = FULL_TURN * np.sqrt(np.mean(state.scale**2))
    return float(before), float(FULL_TURN * np.sqrt(np.mean(np.diag(state.scale_covariance))))
