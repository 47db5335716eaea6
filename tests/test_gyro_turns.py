"""A gyro triad from rest-turn-rest by hand."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from outside_files import RECORDINGS, needs
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

import tiltcal as tc
from tiltcal.calibration.correction import corrected_columns
from tiltcal.calibration.methods import gyro_turns
from tiltcal.calibration.methods.gyro_model import TERMS, EarthRate, StaticRates, parameter_names
from tiltcal.calibration.methods.gyro_turns_model import Turns, solve
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG, G0
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.foreign_files import import_recording
from tiltcal.recordings.mapping import load_mapping
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import find_segments
from tiltcal.recordings.static_poses import Poses, PoseSpan
from tiltcal.setup.setup import Setup
from tiltcal.validation.accuracy import normalised_error, true_parameters

SCENARIO = load_scenario(folder("scenarios") / "gyro_turns_by_hand.toml")


FAMILY = 1e-3
TURNS, SAMPLES, STEP = 15, 8, 0.1  # 0.8 s each
# rad a rest's edge, rad/s a sample, rad/s a rest
DIRECTION, RATE_NOISE, REST_NOISE = (
    1e-4,
    5e-4,
    2e-5,
)
NAMES = parameter_names("gyro", TERMS)
TRUE = np.array(
    [
        5e-3,
        -3e-3,
        2e-3,
        6e-3,
        -4e-3,
        2.5e-3,
        3e-3,
        1e-3,
        -2e-3,
        0.5e-3,
        1.5e-3,
        -1e-3,
        60,
        5,
        -8,
        10,
        20,
        -40,
        7,
        30,
        -15,
    ]
)


def by_hand(values):
    """Bias, sensitivity and g-sensitivity (rad/s per g) of a vector in the order of NAMES, written
    out here once more.
    """
    M, G, off = np.diag(1 + values[3:6]), values[12:].reshape(3, 3) * DEG / 3600, iter(values[6:12])
    for i in range(3):
        for j in range(3):
            M[i, j] += 0.0 if i == j else next(off)
    return values[:3], M, G


def random_turns(rng):
    """Rate and up direction of each sample of some turns about two axes each, and the up direction
    at their ends.
    """
    axes = rng.normal(size=(TURNS, 2, 3))
    # 10 deg a sample
    w = np.repeat(axes / np.linalg.norm(axes, axis=2)[..., None] * 1.7, SAMPLES // 2, axis=1)
    up = np.empty((TURNS, SAMPLES + 1, 3))
    up[:, 0] = np.array([d / np.linalg.norm(d) for d in rng.normal(size=(TURNS, 3))])
    for k in range(SAMPLES):
        up[:, k + 1] = Rotation.from_rotvec(-w[:, k] * STEP).apply(up[:, k])
    return w, up


def drawn(rng, w, up):
    """Turns and rests as the laboratory would hand them to the fit; without rng exact."""
    noise = (
        (lambda *shape: np.zeros(shape)) if rng is None else (lambda *shape: rng.normal(size=shape))
    )
    bias, M, G = by_hand(TRUE)
    rate = w @ M.T + bias + up[:, :-1] @ G.T + RATE_NOISE * noise(TURNS, SAMPLES, 3)
    before, after = (d + DIRECTION * noise(TURNS, 3) for d in (up[:, 0], up[:, -1]))
    before, after = (d / np.linalg.norm(d, axis=1)[:, None] for d in (before, after))
    sigma = np.full(TURNS, np.sqrt(2 * DIRECTION**2 + SAMPLES * (RATE_NOISE * STEP) ** 2))
    still = up[:, 0] @ G.T + bias + REST_NOISE * noise(TURNS, 3)
    spans, ones = (PoseSpan(0, 1, ""),) * TURNS, np.ones((TURNS, 3))
    poses = Poses(
        SCENARIO.named("gyro"),
        spans,
        still,
        ones[:, 0],
        np.eye(3) * REST_NOISE**2,
        1.0,
        ones,
        {},
        ones,
        "",
        0 * ones,
        0 * ones,
    )
    step, still = np.full((TURNS, SAMPLES), STEP), EarthRate.none(TURNS, SAMPLES)
    turns = Turns(rate, up[:, :-1], step, before, after, sigma, still)
    return turns, StaticRates(poses, up[:, 0] * G0, EarthRate.none(len(up)))


def bound_of(w, up):
    """Covariance that no unbiased estimate beats, from rotations made one after the other and
    slopes by differences.
    """

    def observed(values):
        bias, M, G = by_hand(values)
        _, true_M, true_G = by_hand(TRUE)
        reading = w @ true_M.T + by_hand(TRUE)[0] + up[:, :-1] @ true_G.T
        true = (reading - bias - up[:, :-1] @ G.T) @ np.linalg.inv(M).T
        carried = up[:, 0]
        for k in range(SAMPLES):
            carried = Rotation.from_rotvec(-true[:, k] * STEP).apply(carried)
        sigma = np.sqrt(2 * DIRECTION**2 + SAMPLES * (RATE_NOISE * STEP) ** 2)
        return np.concatenate(
            [carried.ravel() / sigma, (bias + up[:, 0] @ G.T).ravel() / REST_NOISE]
        )

    steps = np.array([1e-6] * 12 + [0.1] * 9)
    J = np.array(
        [
            (observed(TRUE + h * e) - observed(TRUE - h * e)) / (2 * h)
            for h, e in zip(steps, np.eye(21), strict=True)
        ]
    )
    return np.linalg.inv(J @ J.T)


def test_variance_nees_and_coverage_of_the_fit_lie_in_one_band():
    """All 21 parameters over all draws of the turns and rests."""
    rng, draws = rng_of("turn statistics"), draws_of(4000)
    w, up = random_turns(rng)
    bound = np.diag(bound_of(w, up))
    errors, nees, inside = np.empty((draws, 21)), 0.0, np.zeros(21)
    for k in range(draws):
        fit, converged = solve(*drawn(rng, w, up), NAMES, TRUE)
        assert converged
        errors[k] = fit.values - TRUE
        nees += errors[k] @ np.linalg.solve(fit.covariance, errors[k])
        inside += np.abs(errors[k]) <= 1.96 * fit.sigmas
    p = FAMILY / 43 / 2  # 21 variances, 21 coverages, NEES
    ratio = (errors**2).sum(axis=0) / bound
    assert np.all((ratio > chi2.ppf(p, draws)) & (ratio < chi2.isf(p, draws))), ratio / draws
    assert chi2.ppf(p, 21 * draws) < nees < chi2.isf(p, 21 * draws), nees / 21 / draws
    low, high = binom.ppf([p, 1 - p], draws, 0.95)
    assert np.all((inside >= low) & (inside <= high)), inside / draws


def test_turns_worked_out_sample_by_sample_are_given_back_from_a_start_far_off():
    rng = rng_of("turns one by one")
    turns, rests = drawn(None, *random_turns(rng))
    fit, converged = solve(turns, rests, NAMES)
    assert converged
    assert (NAMES[3], NAMES[6], NAMES[-1]) == (
        "gyro.scale_x",
        "gyro.cross_xy",
        f"gyro.gsens_{AXES[2]}z",
    )
    np.testing.assert_allclose(fit.values, TRUE, rtol=1e-5, atol=1e-9)


def test_its_uncertainty_is_consistent_over_seeds(monkeypatch):
    # costs most, changes no parameter
    monkeypatch.setattr(gyro_turns, "_held_out", lambda *_: 0.0)
    total, dof = 0.0, 0
    for seed in range(12):
        found = calibrate(
            "gyro_turns", SimulatedLaboratory().record(SCENARIO, 700 + seed), SCENARIO
        )
        value, n = normalised_error(found, true_parameters(SCENARIO, SCENARIO.effects, found))
        total, dof = total + value, dof + n
    assert dof == 12 * 12
    assert chi2.ppf(5e-4, dof) < total < chi2.isf(5e-4, dof), total / dof


def test_a_noiseless_record_gives_back_what_was_injected():
    found = calibrate("gyro_turns", SimulatedLaboratory().record(SCENARIO), SCENARIO)
    for name, value in true_parameters(SCENARIO, SCENARIO.effects, found).items():
        # sums of 100 Hz samples stand for the integral
        assert found.value(name) == pytest.approx(value, abs=3e-5), name


def test_a_hand_that_still_turns_at_the_edges_of_a_rest_does_no_harm():
    """The edges of the rests are moved into the turns: the gyro carries each sample of the force to
    the instant.
    """
    quiet = SimulatedLaboratory().record(SCENARIO)
    dwells = [s for s in find_segments(quiet) if s.kind == "dwell"]
    wider = [
        replace(
            s, start=s.start - 0.3, end=s.end + 0.3, first=max(s.first - 30, 0), last=s.last + 30
        )
        for s in dwells
    ]
    found = calibrate("gyro_turns", quiet, SCENARIO, segments=wider)
    for name, value in true_parameters(SCENARIO, SCENARIO.effects, found).items():
        if ".bias_" not in name:  # the rests' means are those of moves by now
            assert found.value(name) == pytest.approx(value, abs=2e-4), name


def test_correction_takes_off_g_sensitivity_by_the_accelerometer_beside_it():
    names = [f"gyro.gsens_{a}{b}" for a in "xyz" for b in "xyz"]
    parameters = {n: Estimate(10.0 * (i + 1), 1.0, "deg_h_g") for i, n in enumerate(names)}
    calibration = Calibration("mine", "good", parameters, np.eye(9))
    still = SimulatedLaboratory().record(
        SCENARIO.model_copy(update={"effect": (), "sequence": SCENARIO.sequence[:4]})
    )
    columns = corrected_columns(still, calibration, SCENARIO)
    f = still.sensor(SCENARIO.named("accel")).values / G0
    pulled = f @ (10.0 * np.arange(1, 10).reshape(3, 3)).T / 3600  # deg/s
    read = np.column_stack([still.column(f"gyro_{a}_deg_s") for a in "xyz"])
    for i, a in enumerate("xyz"):
        assert columns[f"gyro_{a}_corrected_deg_s"] == pytest.approx(
            read[:, i] - pulled[:, i], abs=1e-12
        )
    bare = SCENARIO.model_copy(update={"sensor": (SCENARIO.named("gyro"),)})
    with pytest.raises(TiltcalError, match="no accelerometer triad with gyro"):
        corrected_columns(still, calibration, bare)


def test_wrong_terms_and_too_few_turns_are_refused_in_words():
    recording = SimulatedLaboratory().record(SCENARIO)
    with pytest.raises(TiltcalError, match="need some of bias, scale, cross_axis, gsens"):
        calibrate("gyro_turns", recording, SCENARIO, terms=["bias", "wobble"])
    short = SCENARIO.model_copy(update={"sequence": SCENARIO.sequence[:11]})
    few = SimulatedLaboratory().record(short)
    dwells = [s for s in find_segments(few) if s.kind == "dwell"]
    with pytest.raises(TiltcalError, match=r"dwells|turns"):
        calibrate("gyro_turns", few, SCENARIO, segments=dwells[:5])


@needs(RECORDINGS)
def test_on_a_real_log_cross_axis_terms_and_then_g_sensitivity_lower_the_held_out_error(
    monkeypatch,
):
    monkeypatch.setattr(gyro_turns, "FOLDS", 4)  # each leaves more out, and there are fewer
    here = folder("models").parent / "scenarios" / "real"
    recording = import_recording(
        RECORDINGS / "xsens_mti" / "xsens_acc.mat", load_mapping(here / "xsens_gyro_map.toml")
    )
    setup = load_scenario(here / "xsens_gyro.toml")
    terms = (
        ["bias", "scale"],
        ["bias", "scale", "cross_axis"],
        ["bias", "scale", "cross_axis", "gsens"],
    )
    plain, cross, gsens = (
        calibrate("gyro_turns", recording, setup, terms=t).heldout_rms["gyro"] / DEG for t in terms
    )
    assert plain > 3.0
    assert cross <= 0.55
    assert gsens <= 0.20


def test_the_earth_turns_with_the_body_and_is_no_misfit():
    """A quiet gyro sees the Earth's rate turn with the body: a constant bias does not hold it."""
    path = Path(__file__).parents[1] / "scenarios" / "gyro_turns_by_hand.toml"
    table = tomllib.loads(path.read_text())
    table["site"] |= {"latitude_deg": 39.9, "heading_deg": 70.0}
    for effect in table["effect"]:
        if effect["id"] == "gyr_noise":
            effect["white_deg_rth"] = 0.2
    scenario = tc.parse_scenario(table)
    for seed in range(4):
        recording = scenario.simulate(seed=300 + seed)
        found = scenario.calibrate(recording, "gyro_turns")
        assert found.verdict == "good", found.headline()
        bare = found.provenance["setup"]["site"]
        assert bare["latitude_deg"] == 39.9


def quarter_turns(rng, shear):
    """Quarter turns from face to face of a cube, in closed form at 50 Hz: gyro and accelerometer,
    whose cross-axis terms no norm of faces shows.
    """
    rate, turns = 50.0, [(0, 1)] * 4 + [(1, 1)] * 4 + [(0, 1)] + [(2, 1)] * 4
    turns += [(1, 1), (0, -1), (2, 1), (1, -1), (0, 1), (2, -1)]
    profile = np.sin(np.pi * (np.arange(100) + 0.5) / 100) ** 2
    profile *= np.pi / 2 / (profile.sum() / rate)
    parts = [np.zeros((400, 3))]
    for axis, way in turns:
        parts += [np.outer(profile, way * np.eye(3)[axis]), np.zeros((200, 3))]
    w = np.vstack(parts)
    middle = (w[1:] + w[:-1]) / 2 / rate
    attitude = [Rotation.identity()]
    for step in middle:
        attitude.append(attitude[-1] * Rotation.from_rotvec(step))
    body = Rotation.concatenate(attitude).inv()
    total = w + body.apply(np.tile(7.292115e-5 * np.array([0, 0.766, 0.643]), (len(w), 1)))
    M = np.diag([1.0, 1.0, 1.0])
    M += [[0.01, -0.003, 0.002], [0.001, -0.02, -0.002], [0.0015, -0.004, 0.03]]
    gyro = [0.01, -0.02, 0.005] + total @ M.T + rng.normal(0, 0.05 * DEG, w.shape)
    force = body.apply(np.tile([0, 0, 9.80123], (len(w), 1)))
    accel = force @ (np.eye(3) + shear).T + rng.normal(0, 5e-3, w.shape)
    columns = {f"gyro_{a}_rad_s": gyro[:, i] for i, a in enumerate("xyz")}
    columns |= {f"accel_{a}_m_s2": accel[:, i] for i, a in enumerate("xyz")}
    return Recording.from_columns(np.arange(len(w)) / rate, columns, source="cube.csv"), M


@pytest.mark.parametrize("size", [0.0, 4e-3])
def test_quarter_turns_on_faces_determine_the_gyro_and_say_what_they_leave_open(size):
    shear = size * np.array([[0, 1, -0.5], [1, 0, 0.8], [-0.5, 0.8, 0]])
    made, M = quarter_turns(rng_of(f"quarter turns {size}"), shear)
    site = {"gravity_m_s2": 9.80123, "latitude_deg": 40.0}
    triads = [
        {"name": "gyro", "kind": "gyro", "rate_hz": 50},
        {"name": "accel", "kind": "accelerometer", "rate_hz": 50},
    ]
    setup = Setup.model_validate({"site": site, "rig": {"table": "handheld"}, "sensor": triads})
    found = calibrate("gyro_turns", made, setup)
    assert found.verdict == "good", [t.statement for t in found.tests if not t.passed]
    assert any(
        "do not determine the cross-axis terms of the accelerometer" in w for w in found.warnings
    )
    for i, a in enumerate(AXES):
        estimate = found.parameters[f"gyro.scale_{a}"]
        assert estimate.sigma < 5e-4
        assert abs(estimate.value - (M[i, i] - 1)) < 4 * estimate.sigma
