"""A gyro triad from rest-turn-rest by hand: gravity, seen by the accelerometer at each rest, is the
reference.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import (
    fitted_sensitivity,
    leave_out_rms,
    pick_sensor,
    wrap_up,
)
from tiltcal.calibration.methods.gyro_model import (
    PRIOR,
    TERMS,
    GyroModel,
    StaticRates,
    parameter_names,
    unit_of,
)
from tiltcal.calibration.methods.gyro_turns_model import (
    EDGE,
    Equations,
    Series,
    Turns,
    angle_causes,
    collect_turns,
    misfit_of_turns,
    propagated,
    solve,
    turn_errors,
    with_stated_angles,
)
from tiltcal.calibration.methods.norm import norm
from tiltcal.calibration.methods.terms import effect_of_term
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.causes import cause_test
from tiltcal.calibration.screen.columns import columns_test, unit_tests
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import tangents
from tiltcal.core.numerical import undetermined
from tiltcal.core.units import DEG, G0
from tiltcal.effects.base import Effect
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import ChangedRecording, References, log_reader, references
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit

NAME = "gyro_turns"
LEAST_TURNS = 6  # three biases and three scale factors at least, two equations a turn
FOLDS = 12
NORM_TERMS = 9  # of the accelerometer: bias, scale factor and cross-axis


def gyro_turns(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = TERMS[:3],
    angle_sigma_deg: float = 0.0,
) -> Calibration:
    """Bias, scale factor, cross-axis terms and, with ``gsens``, g-sensitivity of a gyro triad
    turned by hand.

    Model: ``reading = b + (I + S + C) w + G f``, all terms from rests and turns together. At rest
    the reading is b + G f; it includes the Earth's rate, whose direction is unknown. The integrated
    rate of a turn must propagate gravity's direction from one rest to the next, and turn by the
    angle that the label of its rows states, such as ``turn z 360``.

    Args:
        recording: rest, turn, rest, ... with an accelerometer triad beside the gyro triad.
        setup: with both.
        segments: dwells to use.
        sensor: which gyro, when several fit.
        terms: of bias, scale, cross_axis, gsens.
        angle_sigma_deg: standard uncertainty of a stated angle whose label has none, deg.

    Raises:
        TiltcalError: fewer than six turns, or an unknown term.

    Errors:
        A turn about the vertical does not change gravity's direction in the body: turn about each
            axis while it is horizontal, or state the angle. The accelerometer is calibrated by its
            norm first; its readings during the turns enter through G.

    Source: docs/physics.md, "Gyro triads by gravity and by a table".
    """
    _require_terms(terms)
    gyro = pick_sensor(setup, recording, ("gyro",), sensor, NAME)
    accel = pick_sensor(setup, recording, ("accelerometer",), None, NAME)
    live = data_tests(recording, gyro, accel)
    found = list(find_segments(recording)) if segments is None else list(segments)
    rests, turns, static = _turns_and_rests(recording, setup, found, gyro, accel)
    turns, counted = with_stated_angles(turns, rests, recording, angle_sigma_deg * DEG)
    names = [*parameter_names(gyro.name, terms), *turns.names]
    fit, converged = solve(turns, static, names)
    if setup.budget and not fit.dropped:
        x = np.array([fit.value(n) for n in names])
        equations = Equations(turns, static, names, np.ones(4), tangents(turns.after))
        uncertain = _references(recording, setup, found, (gyro, accel), equations, x)
        rests = replace(rests, references=uncertain)
        fit, converged = solve(turns, static, names, x, rests.references)
    heldout = _held_out(turns, static, names, fit)
    M = fitted_sensitivity(fit, gyro.name)
    tests = [_fit_test(turns, fit, names), _columns_test(turns, rests), *counted, *live]
    tests += unit_tests(gyro, M, recording.sensor(gyro).units[0])
    if not tests[0].passed:
        tried = misfit_of_turns(turns, static, names, fit, rests, gyro).explanations()
        tried += angle_causes(turns, static, names, fit, rests)
        tests.append(cause_test(tried, recording.source))
    warnings = _notes(setup, turns, GyroModel(fit, names), heldout)
    fit = fit.selected(np.array([not name.startswith(PRIOR) for name in fit.names]))
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


def _notes(setup: Setup, turns: Turns, model: GyroModel, heldout: float) -> list[str]:
    """What is fitted beside the terms, and how well turns agree. heldout: rms angle, rad."""
    return [
        f"held-out error of gravity's direction after a turn: {heldout / DEG:.3g} deg rms",
        _earth_note(setup),
        *_shear_notes(turns),
        *_angle_notes(turns, model),
    ]


def _angle_notes(turns: Turns, model: GyroModel) -> list[str]:
    """How well the stated angles agree with the integrated ones, if any is stated."""
    stated = turns.stated
    if not len(stated):
        return []
    errors = propagated(turns, [model])[1][0]
    worst = np.abs(errors).max() / DEG
    rms = np.sqrt(np.mean(errors**2)) / DEG
    return [
        f"the angle of {len(stated)} of {len(turns)} turns is stated: integrated to {rms:.3g} deg"
        f" rms, {worst:.3g} deg at worst"
    ]


def _shear_notes(turns: Turns) -> list[str]:
    """What the norm of the accelerometer leaves open, if anything."""
    if not turns.shear:
        return []
    return [
        "the rests do not determine the cross-axis terms of the accelerometer: each is fitted"
        f" beside the turns, with a standard deviation of {turns.shear * 1e6:g} ppm before; rest in"
        " oblique attitudes as well"
    ]


def _calibrated_by_norm(
    recording: Recording, setup: Setup, segments: Sequence[Segment], accel: Sensor
) -> tuple[Calibration, float]:
    """The accelerometer by its norm, and the standard deviation of each cross-axis term that this
    leaves open: rests on faces alone determine none.
    """
    rests = len(find_poses(recording, setup, accel, segments))
    if rests >= NORM_TERMS:
        whole = norm(recording, setup, segments=segments, sensor=accel.name, terms=NORM_TERMS)
        tests = {t.name: t.passed for t in whole.tests}
        if tests["condition of the positions"] and tests["converged"]:
            return whole, 0.0
    (term,) = effect_of_term("cross_axis", accel).parameters
    found = norm(recording, setup, segments=segments, sensor=accel.name, terms=6)
    return found, term.plausible[-1] * term.factor


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
) -> tuple[Poses, Turns, StaticRates]:
    """The rests, the turns and the static rates, with forces corrected by a norm calibration."""
    setup = setup.model_copy(update={"budget": ()})  # its part is in the residuals
    rests = find_poses(recording, setup, gyro, segments)
    _require_turns(rests, recording)
    by_norm, shear = _calibrated_by_norm(recording, setup, segments, accel)
    g = setup.site.gravity
    poses = find_poses(recording, setup, accel, segments)
    if len(rests) != len(poses):
        words = f"{len(rests)} standstills seen by {gyro.name}, {len(poses)} by {accel.name}"
        raise undetermined(recording.source, "the parameters of gyro_turns", words)
    sensed = recording.sensor(accel)
    force = Series(sensed.time, by_norm.correct(accel, sensed.values, g) / G0)
    # of gravity's direction at the edge of a rest: noise of its mean, and what the norm leaves
    noise = np.trace(poses.noise) / 3 * poses.inflation / max(EDGE * accel.rate_hz, 1.0)
    # a direction left out says nothing where the terms that it needs are fitted with the turns
    left_by_norm = 0.0 if shear else by_norm.heldout_rms.get(accel.name, 0.0)
    sigma = float(np.sqrt(noise + left_by_norm**2) / g)
    stated = setup.site.latitude_deg
    latitude = None if stated is None else stated * DEG
    turns, earth = collect_turns(recording, gyro, rests, force, sigma, latitude)
    turns = replace(turns, shear=shear)
    return rests, turns, StaticRates(rests, by_norm.correct(accel, poses.means, g), earth)


def _references(
    recording: Recording,
    setup: Setup,
    segments: Sequence[Segment],
    sensors: tuple[Sensor, Sensor],
    equations: Equations,
    x: Array,
) -> References:
    """What uncertain references add to the residuals, (q, n, 1): the readings are changed, and the
    accelerometer is calibrated again.

    Args:
        recording, setup, segments: of the calibration.
        sensors: gyro and accelerometer.
        equations: whose residuals.
        x: the estimate, (p,).
    """
    readers = []
    by_kind: dict[str, Array] = {}
    for sensor in sensors:
        time = recording.sensor(sensor).time
        for s in sensors:
            log = recording.sensor(s)
            by_kind[s.kind] = np.column_stack([np.interp(time, log.time, v) for v in log.values.T])
        readers.append(log_reader(recording, setup, sensor, time, by_kind))

    def evaluate(where: Setup, effect: Effect | None) -> Array:
        added = {
            s.name: read(where, effect) - read(setup, None)
            for s, read in zip(sensors, readers, strict=True)
        }
        changed = ChangedRecording.of(recording, added)
        _, turns, static = _turns_and_rests(changed, where, segments, *sensors)
        return equations.measuring(turns, static).residuals(x[None])[0][:, None]

    return references(setup, evaluate, np.full(1, -1))


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
