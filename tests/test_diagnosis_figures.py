"""The figures of a diagnosis: the fit under a noise that is fixed beforehand, the noise itself with
its intervals, and slow variation that no instrument has.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from autoregressive_noise import AutoRegressive2
from diagnosis_fixtures import NOISE, SENSORS, bench, honest, recorded, rewritten, shorter
from scipy.stats import binom, norm
from statistics_helpers import FALSE_ALARM

from tiltcal.diagnosis.conclusions.finding import Fitness
from tiltcal.diagnosis.conclusions.fit_figures import under_fixed_white, white_level
from tiltcal.diagnosis.conclusions.noise_figures import NoiseReport, noise_dependences
from tiltcal.diagnosis.conclusions.other_findings import nameless_doubts, nameless_findings
from tiltcal.diagnosis.conclusions.statements import doubted, summary
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.residual_checks.slow_variation import SlowVariation, slow_variations
from tiltcal.diagnosis.search.explained import CLAIM
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.statistics.cosine_transform import cosines, quick_length
from tiltcal.statistics.noise_spectrum import (
    NoiseFit,
    WhiteFlickerWalk,
    estimate_noise,
    white_noise,
)

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 400.0}
WHITE, RATE = 25.0, 10.0
SAMPLE = WHITE * 1e-6 * 9.80665 * np.sqrt(RATE)


def noisy(walk, white=WHITE):
    return {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": white, "walk_ug_rts": walk}


def interval_of(fit, name):
    found = fit.amplitudes[name]
    assert found.low <= found.value <= found.high
    return found.low, found.high


def test_the_white_level_is_that_of_the_noise_whatever_is_slow(rng):
    n, draws = 4000, 40
    slow = 30 * np.sin(np.arange(n) / 200) + np.cumsum(rng.normal(0, 0.02, n))
    found = np.array([white_level(slow + rng.normal(0, 2.0, n)) for _ in range(draws)])
    # second differences of n samples are as good as n / 1.94 independent ones
    each = np.sqrt(1.94 / (2 * n))
    assert found.mean() == pytest.approx(2.0, rel=4 * each / np.sqrt(draws) + 2e-3)
    assert found.std() / 2.0 < 2 * each
    wild = rng.normal(0, 2.0, n)
    wild[::400] += 500.0
    assert white_level(wild) == pytest.approx(2.0, rel=0.05)


def test_codes_much_coarser_than_the_noise_leave_a_white_level(rng):
    coarse = np.round(rng.normal(0, 0.1, 3000) / 1.0)
    coarse[::50] += 1.0
    assert 0 < white_level(coarse) < 1


def by_noise(walk):
    """What is said of a recording of noise alone."""
    truth = bench(noisy(walk), noise=False)
    return diagnose(honest(truth), [recorded(truth, 11)])


@pytest.fixture(scope="module")
def white():
    return by_noise(0.0)


@pytest.fixture(scope="module")
def walking():
    return by_noise(12.0)


@pytest.mark.parametrize(("which", "walk"), [("white", 0.0), ("walking", 12.0)])
def test_chi_square_is_not_one_by_construction(which, walk, request):
    """Slow noise raises it by its share; under white noise alone it is 1 to the level's own
    uncertainty.
    """
    found = request.getfixturevalue(which)
    assert found.verdict == "match"
    after = found.after.chi2_per_dof
    slow = sum(c.slow for c in found.noise.channels.values())
    share = slow / sum(c.energy for c in found.noise.channels.values())
    assert after * (1 - share) == pytest.approx(1.0, abs=0.1)
    assert (share > 0.5) == (after > 1.5) == (walk > 0)
    assert f"{after:.4g} of the sensors' white noise" in found.statement
    assert ("mostly walk" in found.statement) == (walk > 0)


def test_both_figures_are_under_the_same_noise_and_likelihoods_under_their_own():
    truth = bench(K2, noisy(12.0), noise=False)
    found = diagnose(honest(truth), [recorded(truth, 11)])
    assert found.findings
    prepared = prepare(honest(truth), [recorded(truth, 11)])
    level = [m.white for m in under_fixed_white(prepared.start, prepared.whitened).noise]
    assert level == pytest.approx([SAMPLE] * 3, rel=0.08)
    for fit in (found.before, found.after):
        rms = np.array([fit.rms[f"accel_{a}_m_s2"] for a in "xyz"])
        assert fit.chi2_per_dof == pytest.approx(np.mean((rms / level) ** 2), rel=0.01)
    assert found.after.chi2_per_dof < found.before.chi2_per_dof
    assert found.after.log_likelihood > found.before.log_likelihood


def test_delta_bic_is_that_of_the_likelihoods_beside_it():
    """Of a single finding: the model without it is the scenario as it is."""
    truth = bench({"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 2000.0})
    found = diagnose(honest(truth), [recorded(truth, 1)])
    (finding,) = found.findings
    rows = 3 * len(recorded(truth, 1))
    rise = found.after.log_likelihood - found.before.log_likelihood
    sizes = sum(len(part.parameters or part.curve["coefficients"]) for part in finding.parts)
    assert finding.delta_bic == pytest.approx(sizes * np.log(rows) - 2 * rise, abs=1)
    assert finding.heldout_gain == pytest.approx(rise, rel=0.1)


def test_a_likelihood_is_that_of_the_noise(white):
    """Of white noise alone it is the sum of the logarithms of normal densities."""
    expected = 0.0
    for axis in "xyz":
        sigma = white.after.rms[f"accel_{axis}_m_s2"]
        n = quick_length(len(recorded(bench(), 2)))
        expected += n * (norm.logpdf(0, scale=sigma) - 0.5)
    # flicker and walk may take a few nats more
    assert white.after.log_likelihood == pytest.approx(expected, abs=15)


@pytest.mark.parametrize(
    ("truth", "name"),
    [
        (WhiteFlickerWalk(1.0, 0.0, 0.03), "walk"),
        (WhiteFlickerWalk(1.0, 0.0, 0.03), "white"),
        (WhiteFlickerWalk(1.0, 0.1), "flicker"),
        (AutoRegressive2(1.0, 0.0, 0.0), "white"),
    ],
    ids=str,
)
def test_an_interval_holds_the_truth_nearly_always(truth, name, rng):
    n, draws = 1500, 100
    inside = 0
    for _ in range(draws):
        e = rng.normal(size=n) * np.sqrt(truth.spectrum(n))
        low, high = interval_of(NoiseFit.of(e, np.ones(n), type(truth)), name)
        inside += low <= getattr(truth, name) <= high
    assert inside >= binom.ppf(FALSE_ALARM, draws, 0.95)


def test_an_interval_is_not_wider_than_it_needs_to_be(rng):
    """White noise of n samples is known to 1.96 / sqrt(2 n); none of it is slow."""
    n = 4000
    fit = estimate_noise(
        cosines(rng.normal(size=n)), cosines(np.ones(n))[:, None], WhiteFlickerWalk
    )
    low, high = interval_of(fit, "white")
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(2 * n), rel=0.3)
    assert interval_of(fit, "walk")[0] == interval_of(fit, "flicker")[0] == 0.0


def test_the_noise_is_in_the_units_of_a_data_sheet(walking):
    found = walking.to_json()["noise"]
    assert found["source"] == "the recording itself"
    assert set(found["channels"]) == {"accel_x", "accel_y", "accel_z"}
    for channel in found["channels"].values():
        assert [channel[k]["unit"] for k in ("white", "flicker", "walk")] == [
            "ug_rthz",
            "ug",
            "ug_rts",
        ]
        # three channels: an interval of 95 % may miss, one twice as wide does not
        for kind, size in (("white", WHITE), ("walk", 12.0)):
            middle, half = channel[kind]["value"], channel[kind]["high"] - channel[kind]["low"]
            assert abs(middle - size) < half
        assert 0 < channel["share_of_residual"] < 1


def test_an_inclinometer_and_a_static_record_are_told_in_the_same_units():
    truth = bench(sensor="incl", table="vertical")
    table = truth.model_dump(exclude_defaults=True, by_alias=True)
    rest = [{"action": "rest", "dwell_s": 200.0}]
    still = recorded(parse_scenario({"schema": 1, **table, "sequence": rest}), 2)
    found = diagnose(honest(truth), [recorded(truth, 1)], static=still).to_json()["noise"]
    assert found["source"] == "the static record"
    assert set(found["channels"]) == {"incl_x", "incl_y"}
    for channel in found["channels"].values():
        assert channel["white"]["unit"] == "ug_rthz"
        assert channel["white"]["value"] == pytest.approx(WHITE, rel=0.15)


def test_a_static_record_in_the_wrong_unit_is_repaired_as_the_recording_is():
    """Both come from one logger, whose columns are 1000 times what their unit says."""
    truth = bench()
    table = truth.model_dump(exclude_defaults=True, by_alias=True)
    rest = [{"action": "rest", "dwell_s": 200.0}]
    still = recorded(parse_scenario({"schema": 1, **table, "sequence": rest}), 2)
    wrong = [
        rewritten(r, **{n: 1000 * r.column(n) for n in r.column_names if n.startswith("accel")})
        for r in (recorded(truth, 1), still)
    ]
    found = diagnose(honest(truth), wrong[:1], static=wrong[1])
    assert [f.effect for f in found.findings] == ["data_unit"]
    assert found.after.chi2_per_dof == pytest.approx(1, abs=0.15)


def test_a_noise_model_from_outside_is_reported_by_its_own_amplitudes():
    truth = bench()
    found = diagnose(honest(truth), [recorded(truth, 4)], noise=AutoRegressive2)
    assert found.verdict == "match"
    for channel in found.to_json()["noise"]["channels"].values():
        assert set(channel) == {"white", "share_of_residual", "may_be", "depends_on"}
        assert channel["white"]["low"] < WHITE < channel["white"]["high"] * 1.05


def test_slow_variation_beyond_any_grade_is_a_finding(walking):
    """That of the worst grades is none."""
    assert (walking.verdict, walking.findings) == ("match", ())
    truth = shorter(bench(noisy(200.0), noise=False), 6)
    found = diagnose(honest(truth), [recorded(truth, 3)])
    slow = [f for f in found.findings if "Slow variation of accel" in f.statement]
    assert slow
    assert found.verdict == "unlisted"
    for finding in slow:
        assert "times the slow noise of a consumer-grade sensor" in finding.statement


def test_what_is_not_probable_enough_to_be_claimed_is_a_doubt():
    slow = (
        SlowVariation("fog", ("a",), None, 15.0, False, False, 0.97),
        SlowVariation("gyro", ("x",), None, 90.0, False, False, 0.9999),
    )
    said = SimpleNamespace(slow=slow, bands=(), tones=(), motions=(), in_noise=())
    (finding,) = nameless_findings(said)
    assert finding.axes == ("x",)
    ((words, chance),) = nameless_doubts(said)
    assert words.startswith("slow variation of fog a")
    assert chance == 0.97
    assert "(probability 0.97)" in doubted(nameless_doubts(said))


def test_slow_variation_below_the_effect_of_coarse_codes_is_not_told():
    truth = bench(noisy(200.0), noise=False)
    found = prepare(honest(truth), [recorded(truth, 3)])
    left = NoiseSource(None, len(found.whitened.hypotheses)).left_by(found.start, found.whitened)
    assert slow_variations(left, CLAIM)
    assert slow_variations(replace(left, floors={"accel": 1e-6}), CLAIM)
    assert not slow_variations(replace(left, floors={"accel": 1.0}), CLAIM)  # m/s2


TINY = 1e-6  # m/s2: beside it a reading is its prediction


@pytest.mark.parametrize("degrees", [1e6, 3.0], ids=["normal", "heavy tails"])
def test_noise_of_one_size_depends_on_nothing(degrees, rng):
    """Koenker's statistic is chi-square for any kurtosis."""
    truth = bench()
    prepared = prepare(honest(truth), [recorded(truth, 1)])
    channels, found = prepared.observations.channels, []
    for _ in range(40):
        noise = [TINY * rng.standard_t(degrees, len(c.values)) for c in channels]
        found.append(any(noise_dependences(prepared.observations, noise, [white_noise(TINY)] * 3)))
    assert sum(found) <= 3  # binomial, 40 of probability 0.01: 3 or fewer in 99.9 %


def test_noise_that_grows_with_motion_is_noted(rng):
    truth = bench()
    prepared = prepare(honest(truth), [recorded(truth, 1)])
    channels = prepared.observations.channels
    noise = [rng.normal(0, np.where(c.stop < 0, 2 * TINY, TINY)) for c in channels]
    for own in noise_dependences(prepared.observations, noise, [white_noise(TINY)] * 3):
        assert own[0].coordinate == "motion"
        assert own[0].ratio == pytest.approx(2.0, rel=0.15)


SWEEP = [
    {"action": "rest", "dwell_s": 5.0},
    {"action": "sweep", "outer_deg": 360.0, "step_deg": 15.0, "dwell_s": 5.0},
    {"action": "move", "inner_deg": 90.0, "rate_deg_s": 40.0, "dwell_s": 5.0},
    {"action": "sweep", "outer_deg": 0.0, "step_deg": 15.0, "dwell_s": 5.0},
]


@pytest.mark.parametrize("left_out", [None, {"id": "acc_K2", "k2_x_ug_g2": 3000.0}])
def test_an_inclinometer_is_diagnosed_through_the_poles_of_its_arcsine(left_out):
    """Biases of 20 mg are read as degrees there, and no linear model holds."""
    truth = parse_scenario(
        {
            "schema": 1,
            "name": "round twice",
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": "dual"},
            "sensor": [SENSORS["incl"]],
            "sequence": SWEEP,
            "effect": [
                NOISE["incl"],
                {"id": "acc_bias", "bias_x_ug": -17680.0, "bias_y_ug": -12020.0},
                {"id": "acc_scale", "scale_x_ppm": 5034.0, "scale_y_ppm": 3008.0},
                {"id": "acc_cross_axis", "cross_yx_ppm": -4547.0, "cross_xy_ppm": 3991.0},
                *([left_out | {"sensor": "incl"}] if left_out else []),
            ],
        }
    )
    found = diagnose(honest(truth), [recorded(truth, 1)])
    assert [f.effect for f in found.findings] == ([left_out["id"]] if left_out else [])
    assert (found.verdict == "match") is (left_out is None)
    assert found.after.chi2_per_dof == pytest.approx(1, abs=0.15)
    assert any("so near +-90 deg" in note for note in found.notes)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (2.125, 1.015, "falls from 2.125 to 1.015 of"),
        (0.97696, 0.97696, "stays at 0.977 of"),
        (0.9, 0.95, "goes from 0.9 to 0.95 of"),
    ],
)
def test_a_statement_says_whether_chi_square_falls(before, after, words):
    fits = (Fitness(before), Fitness(after))
    told = summary((), "explained", "", *fits, NoiseReport("the recording"))
    assert f"Chi-square per degree of freedom {words} the sensors' white noise" in told
