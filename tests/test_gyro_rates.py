"""A gyro triad against the rates of its table."""

import numpy as np
import pytest
from builders import setup_of
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

from tiltcal.calibration.methods.gyro_rates import fit_blocks
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.setup.sequence import Step
from tiltcal.validation.accuracy import normalised_error, true_parameters

FULL = load_scenario(folder("scenarios") / "gyro_rates_three.toml")
TERMS = ["bias", "scale", "cross_axis", "gsens"]
FAMILY = 1e-3


def turned(*steps, scenario=FULL, seed=4, **changed):
    sequence = tuple(
        Step(action="turn", axis=a, angle_deg=angle, rate_deg_s=60, dwell_s=3) for a, angle in steps
    )
    rest = (Step(action="rest", dwell_s=4),)
    copy = scenario.model_copy(update={"sequence": rest + sequence, **changed})
    copy.__dict__.pop("schedule", None)  # of the sequence that was copied
    return SimulatedLaboratory().record(copy, seed)


def test_a_noiseless_log_gives_back_what_was_injected():
    found = calibrate("gyro_rates", SimulatedLaboratory().record(FULL), FULL, terms=TERMS)
    for name, value in true_parameters(FULL, FULL.effects, found).items():
        assert found.value(name) == pytest.approx(value, abs=1e-7), name
    for name, value in (("xx", 60), ("yz", -40), ("zy", 30), ("xy", 0)):
        assert found.value(f"gyro.gsens_{name}") == pytest.approx(value, abs=0.05)


def test_the_earth_s_rate_is_part_of_the_reference_and_missing_it_is_said():
    site = FULL.site.model_copy(update={"latitude_deg": None})
    ignorant = FULL.model_copy(update={"site": site})
    quiet = SimulatedLaboratory().record(FULL)
    found = calibrate("gyro_rates", quiet, ignorant)
    assert any("no latitude" in w for w in found.warnings)
    assert (
        found.value("gyro.bias_z") - calibrate("gyro_rates", quiet, FULL).value("gyro.bias_z")
        > 1e-5
    )
    unknown = FULL.model_copy(
        update={"site": FULL.site.model_copy(update={"heading_deg": "unknown"})}
    )
    assert any("heading unknown" in w for w in calibrate("gyro_rates", quiet, unknown).warnings)


def test_variance_nees_and_coverage_of_the_fit_lie_in_one_band():
    """Six steady rates and a rest, twelve parameters; the bound is the inverse of the information,
    worked by sums.
    """
    rng, draws, blocks = rng_of("rates statistics"), draws_of(10_000), 70
    w = np.zeros((blocks, 3))
    for k, (i, rate) in enumerate((i, s) for i in range(3) for s in (-1.0, 1.0)):
        w[10 * (k + 1) : 10 * (k + 2), i] = rate
    names = [f"p{i}" for i in range(12)]
    columns = np.zeros((12, blocks, 3))
    for i in range(3):
        columns[i, :, i] = 1.0
        for j in range(3):
            columns[3 + 3 * i + j, :, i] = w[:, j]
    sigma = 1e-4
    # rates both ways: bias and slope do not mix
    variance = sigma**2 / np.array([blocks] * 3 + [20] * 9)
    errors, nees, inside = np.empty((draws, 12)), 0.0, np.zeros(12)
    for k in range(draws):
        fit = fit_blocks(names, columns, rng.normal(0, sigma, (blocks, 3)), np.eye(3) / sigma)
        errors[k] = fit.values
        nees += fit.values @ np.linalg.solve(fit.covariance, fit.values)
        inside += np.abs(fit.values) <= 1.96 * fit.sigmas
    p = FAMILY / 25 / 2
    ratio = (errors**2).sum(axis=0) / variance
    assert np.all((ratio > chi2.ppf(p, draws)) & (ratio < chi2.isf(p, draws))), ratio / draws
    assert chi2.ppf(p, 12 * draws) < nees < chi2.isf(p, 12 * draws)
    low, high = binom.ppf([p, 1 - p], draws, 0.95)
    assert np.all((inside >= low) & (inside <= high))


@pytest.mark.long
def test_the_whole_method_is_consistent_over_seeds():
    total, dof = 0.0, 0
    for seed in range(30):
        found = calibrate(
            "gyro_rates", SimulatedLaboratory().record(FULL, 300 + seed), FULL, terms=TERMS
        )
        nees, n = normalised_error(found, true_parameters(FULL, FULL.effects, found))
        total, dof = total + nees, dof + n
    assert chi2.ppf(FAMILY / 2, dof) < total < chi2.isf(FAMILY / 2, dof), total / dof


def test_g_sensitivity_left_out_shows_in_the_fit():
    assert calibrate("gyro_rates", SimulatedLaboratory().record(FULL, 1), FULL).verdict == "suspect"


def test_an_axis_that_is_turned_one_way_only_is_named():
    log = turned(("outer", 360), ("outer", -360), ("middle", 360), ("middle", -360), ("inner", 360))
    found = calibrate("gyro_rates", log, FULL, terms=TERMS)
    assert found.verdict == "suspect"
    assert (
        "turn about x both ways"
        in next(t for t in found.tests if t.name == "turned about x").statement
    )


def test_an_axis_that_is_not_turned_cannot_be_told():
    found = calibrate("gyro_rates", turned(("outer", 360), ("outer", -360)), FULL)
    assert found.verdict == "cannot_tell"
    assert any(
        "not determined: scale_x, scale_y" in w and "turn about those axes" in w
        for w in found.warnings
    )
    blind = FULL.model_copy(update={"site": FULL.site.model_copy(update={"latitude_deg": None})})
    found = calibrate("gyro_rates", turned(("outer", 360), ("outer", -360), scenario=blind), blind)
    assert found.verdict == "cannot_tell"
    assert any("ramps are used" in w for w in found.warnings)


def test_what_it_cannot_use_is_refused_in_words():
    log = turned(("outer", 360))
    with pytest.raises(TiltcalError, match="need a list with bias in it"):
        calibrate("gyro_rates", log, FULL, terms=["scale"])
    with pytest.raises(TiltcalError, match="no linear term of that name"):
        calibrate("gyro_rates", log, FULL, terms=["bias", "wobble"])
    with pytest.raises(TiltcalError, match="found no rate above"):
        calibrate("gyro_rates", turned(), FULL)
    with pytest.raises(TiltcalError, match="found table handheld, need the readout of a table"):
        calibrate("gyro_rates", log, setup_of("handheld", FULL.named("gyro")))
