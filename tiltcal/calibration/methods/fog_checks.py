"""What the log of a gyro triad beside a FOG says of its own calibration: tests and notes.

The FOG's axis against gravity: the scale factors that it gives must carry the accelerometer's
direction of up through every turn.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.field_log import BIAS_SPAN, FieldLog, hand_turns
from tiltcal.calibration.methods.fog_filter import (
    Filtered,
    Problem,
    augmented_problem,
    batch,
    kalman,
    patent_problem,
    smoothed,
)
from tiltcal.calibration.screen.causes import (
    Misfit,
    cause_test,
    lacking_terms,
    part_words,
)
from tiltcal.calibration.screen.columns import column_orders, columns_in_words, columns_test
from tiltcal.calibration.validity import SIGNIFICANCE, Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG, DEG_H, G0
from tiltcal.effects.sense import Sense
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.sensor import Sensor

NAME = "axis of the FOG"
# rad: of a direction by an accelerometer that is not calibrated: 5 mg of bias, scale and axes
DIRECTION = 5e-3
STEP = 1e-4  # of a scale factor, for its slope
LEAST_TURN = 30 * DEG


def axis_test(log: FieldLog, state: Filtered) -> Test:
    """Do the scale factors by the FOG carry gravity as the accelerometer sees it?

    An error du of the FOG's axis is -du_i / u_i of scale; the gyro's cross-coupling adds to it.
    """
    turns = _turns(log)
    if log.force is None or len(turns) < 2:
        words = "not tested: it needs an accelerometer triad and turns between standstills"
        return threshold_test(NAME, 0.0, True, words)
    base = _carried(log, turns, state.scale)
    slopes = np.array(
        [(_carried(log, turns, state.scale + STEP * e) - base) / STEP for e in np.eye(3)]
    )
    seen = np.array([_up(log, after) for _, after in turns])
    sigma = DIRECTION * np.sqrt(2)
    A, r = slopes.reshape(3, -1).T / sigma, (seen - base).ravel() / sigma
    information = A.T @ A
    if np.linalg.cond(information) > 1e8:
        words = "not tested: every turn was about the vertical"
        return threshold_test(NAME, 0.0, True, words)
    covariance = np.linalg.inv(information)
    off = covariance @ A.T @ r
    total = covariance + state.scale_covariance
    statistic = float(off @ np.linalg.solve(total, off))
    sizes = ", ".join(
        f"{a} {v * 1e6:.0f} +- {s * 1e6:.0f}"
        for a, v, s in zip(AXES, off, np.sqrt(np.diag(total)), strict=True)
    )
    words = f"gravity asks for scale factors that differ by {sizes} ppm"
    test = chi2_test(NAME, statistic, 3, words)
    if test.passed:
        return test
    lean = float(np.linalg.norm(off * log.axis)) / DEG
    causes = (
        f": the FOG's input_axis is off (by {lean:.2g} deg), its scale factor is, or the gyro's"
        " axes are not orthogonal"
    )
    return chi2_test(NAME, statistic, 3, words + causes)


def _turns(log: FieldLog) -> list[tuple[int, int]]:
    """Numbers of the rests before and after each turn."""
    found = []
    for k in range(int(log.rest.max())):
        rows = _between(log, k)
        angle = np.abs(log.turned[rows] * log.span[rows, None]).sum(axis=0).max(initial=0.0)
        if angle > LEAST_TURN:
            found.append((k, k + 1))
    return found


def _between(log: FieldLog, k: int) -> Array:
    """Rows from the end of a rest to the beginning of the next; none where either is missing."""
    before, after = np.flatnonzero(log.rest == k), np.flatnonzero(log.rest == k + 1)
    if not len(before) or not len(after):
        return np.zeros(0, dtype=np.intp)
    return np.arange(before[-1] + 1, after[0])


def _up(log: FieldLog, k: int) -> Array:
    """Direction of up at a rest, body frame, (3,)."""
    assert log.force is not None
    mean = log.force[log.rest == k].mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _carried(log: FieldLog, turns: list[tuple[int, int]], scale: Array) -> Array:
    """Up after each turn by the gyro alone, from the accelerometer's before it, (m, 3)."""
    from scipy.spatial.transform import Rotation

    found = []
    for k, _ in turns:
        rows = _between(log, k)
        angles = log.turned[rows] / (1 + scale) * log.span[rows, None]
        up = _up(log, k)
        for R in Rotation.from_rotvec(-angles).as_matrix():
            up = R @ up
        found.append(up)
    return np.array(found)


FULL_TURN = 360 * DEG
LEAST_COMPONENT = 0.05  # of the FOG's axis along a gyro axis whose scale factor it determines
IMPLAUSIBLE = 0.2  # scale error that is due to wrong columns, signs or units, not to the gyro


def log_tests(
    log: FieldLog, problem: Problem, state: Filtered, gyro: Sensor, source: str
) -> list[Test]:
    """The tests of a log by itself: filter, cause of a misfit, turns, first rest, scale, latency,
    columns.

    Args:
        log: of gyro and FOG.
        problem, state: of the filter.
        gyro: the triad.
        source: of the recording.
    """
    twin = batch(problem)
    tests = filter_tests(log, state, twin)
    if not tests[0].passed:
        found = misfit_of_log(log, problem, twin, gyro).explanations()
        tests.append(cause_test(found, source))
    tests += [
        *turn_tests(log),
        rest_test(log),
        scale_test(log, state),
        latency_test(log, problem),
        axis_test(log, state),
    ]
    if log.force is not None:
        tests.append(columns_test(log.time, log.rate - log.bias[:3], log.force))
    return tests


def filter_tests(log: FieldLog, state: Filtered, twin: Filtered) -> list[Test]:
    """Innovations against the noise of the rests, and the filter against the batch solution."""
    from scipy.special import fdtrc

    dof = state.used - len(state.x)
    ratio = state.chi2 / max(dof, 1)
    # the noise is itself estimated from the rests: an F test
    p = float(fdtrc(dof, log.freedom, ratio)) if dof > 0 else 1.0
    words = (
        f"{state.used} innovations of the filter have {np.sqrt(ratio):.3g} times the noise at rest"
    )
    worst = float(np.max(np.abs(state.x - twin.x) / np.sqrt(np.diag(twin.P))))
    agree = f"they agree to {worst:.2g} sigma"
    return [
        Test("fit", state.chi2, dof, p, p > SIGNIFICANCE, words),
        threshold_test("filter and batch", worst, worst < 0.01, agree),
    ]


def misfit_of_log(log: FieldLog, problem: Problem, twin: Filtered, gyro: Sensor) -> Misfit:
    """What the scale factors leave of the difference of gyro and FOG.

    Args:
        log: of both.
        problem: of the filter.
        twin: the batch solution.
        gyro: the triad.
    """
    weight = 1 / np.sqrt(problem.R)[:, None]
    force = np.zeros_like(log.turned) if log.force is None else log.force * G0
    rate = log.turned / (1 + twin.scale)
    sense = replace(
        Sense.at_rest(gyro, G0, force),
        time=log.time,
        elapsed=log.time - log.time[0],
        rate=rate,
    )
    late = np.zeros((1, 1, len(log.time), 4))
    late[0, 0, :, 3] = np.gradient(log.fog, log.time)
    part = np.cumsum(np.diff(log.rest, prepend=log.rest[0]) != 0, dtype=np.intp)
    within = [np.flatnonzero(part == k) for k in range(part[-1] + 1)]
    variance = log.variance[:, None] * np.ones(4)
    return Misfit(
        [*(f"{gyro.name}_{a}" for a in AXES), "the FOG"],
        log.time,
        np.column_stack([log.rate, log.fog]),
        np.column_stack([rate, rate @ log.axis]),
        np.sqrt(variance),
        part,
        [
            part_words("turn" if log.rest[rows[0]] < 0 else "standstill", *log.time[rows[[0, -1]]])
            for rows in within
        ],
        weight[:, 0] * (problem.z - problem.H @ twin.x),
        weight * problem.H,
        lambda errors: weight * (errors @ np.append(log.axis, -1.0)).T,
        {"latency of gyro or FOG": late, **lacking_terms(gyro, sense, 4)},
        freedom=log.freedom,
    )


def turn_tests(log: FieldLog) -> list[Test]:
    """More than a full turn about each axis."""
    tests = []
    for axis, angle in zip(AXES, log.angles(), strict=True):
        words = f"turned {angle / DEG:.0f} deg about {axis}"
        if angle < FULL_TURN:
            words += f", {(FULL_TURN - angle) / DEG:.2g} deg short of a full turn: turn again"
            words += f" about {axis}"
        name = f"turned about {axis}"
        tests.append(threshold_test(name, angle / DEG, angle >= FULL_TURN, words))
    return tests


def rest_test(log: FieldLog) -> Test:
    """A rest before the first turn that is long enough for the bias."""
    length = float(log.span[log.rest == 0].sum())
    enough = length >= BIAS_SPAN - 0.5
    words = f"{length:.3g} s at rest before the first turn"
    if not enough:
        words += f", need {BIAS_SPAN:.0f} s, better 20 s: stand still longer"
    return threshold_test("standstill before the turns", length, enough, words)


def still_test(moved: Sequence[tuple[Segment, float]]) -> Test:
    """No motion in any rest. moved: rests with motion and its rate, rad/s."""
    name = "still at standstill"
    if not moved:
        return threshold_test(name, 0.0, True, "the FOG sees no motion in any standstill")
    s, rate = moved[0]
    words = (
        f"moved during the standstill from {s.start:.4g} to {s.end:.4g} s: the FOG turns at"
        f" {rate / DEG_H:.3g} deg/h; stand still again"
    )
    return threshold_test(name, rate / DEG_H, False, words)


def scale_test(log: FieldLog, state: Filtered) -> Test:
    """No implausible scale error; where there is one, the columns and signs that would make it
    small.
    """
    worst = float(np.max(np.abs(state.x[:3])))
    if worst < IMPLAUSIBLE:
        words = f"no scale is off by more than {IMPLAUSIBLE:.0%}"
        return threshold_test("plausible scale", worst, True, words)
    words = f"a scale is off by {worst:.0%}: check units, columns and the FOG's input_axis"
    for order, signs in column_orders():
        columns = list(order)
        bias = np.append(np.array(signs) * log.bias[columns], log.bias[3])
        other = replace(log, rate=np.array(signs) * log.rate[:, columns], bias=bias)
        if np.max(np.abs(batch(augmented_problem(other)).x[:3])) < IMPLAUSIBLE / 4:
            renamed = columns_in_words(order, signs)
            words += f"; it would fit if the columns x, y, z were {renamed}"
            break
    return threshold_test("plausible scale", worst, False, words)


def latency_test(log: FieldLog, problem: Problem) -> Test:
    """Does the FOG follow the gyro without delay? A delay d adds ``d dF/dt`` to the difference of
    the two: it is fitted beside the states of the filter.
    """
    change = np.gradient(log.fog, log.time)
    weight = 1 / np.sqrt(problem.R)
    prior = np.diag(1 / np.sqrt(problem.prior))
    design = np.vstack([problem.H * weight[:, None], prior])
    target = np.concatenate([problem.z * weight, np.zeros(len(prior))])
    column = np.concatenate([change * weight, np.zeros(len(prior))])
    plain = np.linalg.lstsq(design, np.column_stack([target, column]), rcond=None)[0]
    left, seen = (np.column_stack([target, column]) - design @ plain).T
    if not seen @ seen > 0:
        return threshold_test("latency", 0.0, True, "the FOG does not move: its latency is unknown")
    late = float(seen @ left / (seen @ seen))
    scatter = max(float(left @ left) / len(log.time), 1.0)
    z = late * np.sqrt(float(seen @ seen) / scatter)
    words = f"the FOG lags by {late * 1e3:.3g} +- {abs(late / z) * 1e3:.2g} ms to the gyro"
    test = chi2_test("latency", z * z, 1, words)
    if not test.passed:
        more = ": latency of one of them; shift its stamps, or state it in the scenario"
        test = replace(test, statement=words + more)
    return test


def fog_notes(log: FieldLog, state: Filtered, walk: float, determined: Mask) -> list[str]:
    """What the user should know beside the numbers.

    Args:
        log: of the calibration.
        state: of the filter at the end.
        walk: variance that the zero gains a second, (rad/s)^2/s.
        determined: axes whose scale factor is, (3,).
    """
    notes = [
        f"not determined about {a}: turn again about {a}"
        for a, ok in zip(AXES, determined, strict=True)
        if not ok
    ]
    notes += [
        f"the FOG's axis has only {part:.2g} along {a}: mount it obliquely, as (1, 1, 1)"
        for a, part in zip(AXES, log.axis, strict=True)
        if abs(part) < LEAST_COMPONENT
    ]
    turns = ", ".join(t.words() for t in hand_turns(log)) or "none"
    before, after = attitude_errors(state)
    limit = np.max(0.1 * DEG / np.maximum(np.abs(log.axis), 1e-9))
    notes += [
        f"turns found: {turns}",
        f"attitude after one full turn is wrong by {before / DEG:.3g} deg rms as it reads, by"
        f" {after / DEG:.2g} deg corrected",
        _patent_note(log),
        "an error that no fit shows: 0.1 deg of the FOG's axis is up to"
        f" {limit * 1e6:.0f} ppm of scale (-du_i/u_i)",
        "bias is the mean of the first standstill; it includes the Earth's rate",
    ]
    if walk:
        notes.append(_walk_note(log, walk))
    if log.force is None:
        notes.append(
            "no accelerometer triad: g-sensitivity cannot be separated from scale unless the turns"
            " are whole"
        )
    return notes


def _patent_note(log: FieldLog) -> str:
    plain = kalman(patent_problem(log))
    sigmas = np.sqrt(np.diag(plain.P)[:3])
    claims = ", ".join(
        f"{a} {v * 1e6:.0f} +- {s * 1e6:.0f}"
        for a, v, s in zip(AXES, plain.x[:3], sigmas, strict=True)
    )
    return (
        f"the filter of the patent gives and claims, in ppm: {claims}; it neglects the error of the"
        " standstill mean and S^2"
    )


def _walk_note(log: FieldLog, walk: float) -> str:
    course = smoothed(augmented_problem(log, walk))[0][:, 3]
    return (
        f"the zero drifts: {np.sqrt(walk * 3600) / DEG_H:.3g} deg/h per square root of an hour"
        f" between rests, {np.ptp(course) / DEG_H:.3g} deg/h over this log by the smoother; the"
        " filter models it as a random walk"
    )


def attitude_errors(state: Filtered) -> tuple[float, float]:
    """Error of attitude after one turn about each axis, rms of three, rad: before and after the
    correction.
    """
    before = FULL_TURN * np.sqrt(np.mean(state.scale**2))
    return float(before), float(FULL_TURN * np.sqrt(np.mean(np.diag(state.scale_covariance))))
