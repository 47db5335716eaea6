"""Fitting and pruning a fitted model: steps that run away, what belongs to a larger finding, what
codes hide, plainer words.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import FOG, GYRO
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.core.units import G0
from tiltcal.diagnosis.conclusions.concluding import findings_of
from tiltcal.diagnosis.data_quality.prepare import prepare
from tiltcal.diagnosis.data_quality.quantisation_limit import drop_below_code
from tiltcal.diagnosis.data_quality.setting_errors import lawful_part
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, listed_hypotheses, step_hypotheses
from tiltcal.diagnosis.model.cross_validation import drop_unpredictive
from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedTerm, refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import Alternative, preferred
from tiltcal.diagnosis.search.backward_elimination import drop_below_bic, drop_implausible_sizes
from tiltcal.diagnosis.search.dictionary import build_dictionary
from tiltcal.diagnosis.search.forward_selection import forward_selection
from tiltcal.diagnosis.search.merging import merge_small_findings
from tiltcal.diagnosis.search.predictive_parameters import add_predictive_parameters
from tiltcal.diagnosis.search.swap_search import description_length, plainly, swap_search
from tiltcal.diagnosis.search.unlisted_curves import causes, prefer_unlisted_curve
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading, LearnedTilt
from tiltcal.effects.spans import CoordinateRanges, SpectralLines
from tiltcal.laboratory.handheld import earlier

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 800.0}


def prepared(*left_out, seed=8, **how):
    truth = bench(*left_out, **how)
    return prepare(honest(truth), [recorded(truth, seed)])


def hypothesis(id, names, sensor="accel", axis=None, **values):
    return Hypothesis(CATALOGUE[id](dict.fromkeys(names, 1e-4) | values, sensor, axis), names)


def with_terms(found, *hypotheses):
    return refit(
        replace(found.start, terms=tuple(FittedTerm.start(s) for s in hypotheses)), found.whitened
    )


def test_sizes_are_fitted_to_what_was_left_out():
    found = prepared(K2)
    fitted = with_terms(found, hypothesis("acc_K2", ("k2_x",)))
    (term,) = fitted.terms
    (sigma,) = fitted.sigmas(0)
    assert abs(term.values[0] - 800e-6) < 4 * sigma


@pytest.mark.parametrize("seed", range(4))
def test_sizes_that_a_prediction_is_better_with_are_used_too(seed):
    """Of three channels: the largest stands out; of the others those whose square is more than
    twice their variance.
    """
    found = prepared({**K2, "k2_y_ug_g2": 22.0}, seed=seed)
    names = ("k2_x", "k2_y", "k2_z")
    first = replace(
        with_terms(found, hypothesis("acc_K2", ("k2_x",))).terms[0],
        hypothesis=hypothesis("acc_K2", names),
    )
    fitted = refit(replace(found.start, terms=(first,)), found.whitened)
    whole = with_terms(found, hypothesis("acc_K2", names))
    told = [
        n
        for n, v, s in zip(names, whole.terms[0].values, whole.sigmas(0), strict=True)
        if (v / s) ** 2 > 2
    ]
    (term,) = add_predictive_parameters(fitted, found.whitened).terms
    assert sorted(term.names) == told
    assert "k2_x" in told


def test_a_step_to_where_the_model_has_no_reading_is_taken_back(monkeypatch):
    """The residual of the second evaluation is made absurd: the fit ends where it was sane, with
    the deviance it had.
    """
    found = prepared(K2)
    sane = found.start.deviance
    usual, calls = WhitenedModel.residual, []

    def absurd(whitened, effects):
        calls.append(1)
        left = usual(whitened, effects)
        return left if len(calls) == 1 else [np.full_like(r, np.nan) for r in left]

    monkeypatch.setattr(WhitenedModel, "residual", absurd)
    fitted = refit(
        replace(found.start, terms=(FittedTerm.start(hypothesis("acc_K2", ("k2_x",))),)),
        found.whitened,
    )
    assert fitted.terms[0].values == (0.0,)
    assert fitted.deviance <= sane * 1.001


def test_a_small_finding_of_the_same_kind_of_motion_is_a_part_of_a_large_one():
    found = prepared(
        {
            "id": "settling_transient",
            "axis": "outer",
            "amplitude_arcsec": 300.0,
            "frequency_hz": 1.5,
            "tau_s": 2.0,
        }
    )
    ring = {"frequency": 1.5, "tau": 2.0}
    large = hypothesis("settling_transient", ("amplitude",), None, "outer", **ring)
    small = hypothesis("settling_transient", ("amplitude",), None, "inner", **ring)
    both = with_terms(found, large, small)
    assert len(both.findings()) == 2
    assert [len(places) for places in merge_small_findings(both, found.whitened).findings()] == [2]
    other = with_terms(found, large, hypothesis("acc_K2", ("k2_y",)))
    # a pose does not excite what a move does
    assert len(merge_small_findings(other, found.whitened).findings()) == 2


@pytest.mark.parametrize("seed", range(4))
def test_a_random_walk_is_not_worth_five_warm_ups(seed):
    """Each fitted model under the noise that it leaves: under that of the warm-ups, which take the
    walk, the other pays for it.
    """
    truth, rng = bench(K2), np.random.default_rng(seed)
    whole = recorded(truth, 8)
    walk = np.cumsum(rng.normal(0, 3e-4, len(whole.time)))
    found = prepare(
        honest(truth), [rewritten(whole, accel_x_m_s2=whole.column("accel_x_m_s2") + walk)]
    )
    taus = (np.array([0.03, 0.1, 0.2, 0.5, 1.5]) * whole.time[-1]).tolist()
    first, *others = (hypothesis("acc_warmup", ("warmup_x",), tau=tau) for tau in taus)
    plain = with_terms(found, hypothesis("acc_K2", ("k2_x",)))
    beside = (FittedTerm.start(first), *(replace(FittedTerm.start(s), host=first) for s in others))
    gate = NoiseGate(None, 100)
    assert description_length(plain, found.whitened, gate) < description_length(
        replace(plain, terms=plain.terms + beside), found.whitened, gate
    )


def test_a_law_that_one_stop_alone_speaks_for_is_not_borne_out():
    """One stop is off; a cubic makes something of it, and all other stops are told worse. The
    square that is there stays.
    """
    truth = bench({**K2, "k2_x_ug_g2": 8000.0})
    whole = recorded(truth, 8)
    stop = prepare(honest(truth), [whole]).observations.stops[0]
    x = whole.column("accel_x_m_s2").copy()
    x[stop == stop[np.argmax(np.where(stop >= 0, x, 0.0))]] += 0.05
    found = prepare(honest(truth), [rewritten(whole, accel_x_m_s2=x)])
    both = with_terms(found, hypothesis("acc_K2", ("k2_x",)), hypothesis("acc_K3", ("k3_x",)))
    assert both.deviance < with_terms(found, hypothesis("acc_K2", ("k2_x",))).deviance - 100
    assert [t.hypothesis.id for t in drop_unpredictive(both, found.whitened).terms] == ["acc_K2"]


@pytest.mark.parametrize(("frequency", "parts"), [(2.03, [2]), (2.2, [1, 1])])
def test_lines_nearer_together_than_the_mains_wander_are_one(frequency, parts):
    """The second is half as strong: a line of the base, unless it is where the mains may go."""
    lines = ((60.0, 2.0), (30.0, frequency))
    found = prepared(
        *(
            {"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": s, "frequency_hz": f}
            for s, f in lines
        )
    )
    mains = hypothesis("mains_pickup", ("pickup_x",), frequency=2.0)
    both = with_terms(
        found, mains, hypothesis("base_vibration", ("ec", "es"), None, frequency=frequency)
    )
    assert [
        len(places) for places in merge_small_findings(both, found.whitened).findings()
    ] == parts


@pytest.mark.parametrize(("axis", "parts"), [("outer", [2]), ("inner", [1, 1])])
def test_a_small_ripple_of_an_encoder_is_a_part_of_its_curve(axis, parts):
    """Harmonics of one readout's error are one curve; those of another axis are of another
    encoder.
    """
    found = prepared(
        {"id": "table_encoder_2rev", "axis": "outer", "cos_arcsec": 40.0},
        {"id": "table_encoder_sde", "axis": axis, "cos_arcsec": 4.0, "lines": 36.0},
    )
    large = hypothesis("table_encoder_2rev", ("cos",), None, "outer")
    both = with_terms(
        found, large, hypothesis("table_encoder_sde", ("cos",), None, axis, lines=36.0)
    )
    assert [
        len(places) for places in merge_small_findings(both, found.whitened).findings()
    ] == parts


@pytest.mark.parametrize(("code", "kept"), [(1e-3, 1), (0.1, 0)])
def test_what_is_nowhere_larger_than_a_code_is_not_named(code, kept):
    found = prepared(K2)
    fitted = with_terms(found, hypothesis("acc_K2", ("k2_x",)))  # 800 ug at 1 g: 8e-3 m/s2
    assert len(drop_below_code(fitted, found.whitened, {"accel": code}).terms) == kept
    # another sensor's codes hide nothing here
    assert len(drop_below_code(fitted, found.whitened, {"gyro": code}).terms) == 1


@pytest.mark.parametrize(("bend", "kept"), [(0.0, 0), (0.1, 1)])
def test_of_a_curve_what_calibration_takes_is_not_larger_than_a_code(bend, kept):
    """0.1 m/s2 at 1 g along a straight line: a scale factor. Bent by as much it is a curve."""
    found = prepared(K2)
    names, values = ("c0", "c1", "c2"), (-0.1, bend, 0.1)
    curve = LearnedReading(
        dict.fromkeys(names, 0.1), "accel", "x", coordinate="input", knots=(-9.8, 0.0, 9.8)
    )
    fitted = replace(found.start, terms=(FittedTerm(Hypothesis(curve, names), names, values),))
    assert len(drop_below_code(fitted, found.whitened, {"accel": 0.01}).terms) == kept


@pytest.mark.parametrize(("count", "kept"), [(30, 2), (31, 1)])
def test_a_curve_with_as_many_numbers_as_there_are_stops_is_no_law(count, kept):
    found = prepared(K2)  # 31 stops
    names = tuple(f"c{k}" for k in range(count))
    curve = Hypothesis(
        LearnedReading(dict.fromkeys(names, 0.1), "accel", "x", coordinate="table_outer"), names
    )
    fitted = replace(
        found.start,
        terms=(
            FittedTerm.start(hypothesis("acc_K2", ("k2_x",))),
            FittedTerm(curve, names, (1e-4,) * count),
        ),
    )
    assert [t.hypothesis.id for t in lawful_part(fitted, found.whitened).terms] == [
        "acc_K2",
        "learned",
    ][:kept]


@pytest.mark.parametrize(("width", "kept"), [(2e-4, 2), (-2e-4, 1)])
def test_what_completes_a_form_has_a_size_that_a_file_may_give_it(width, kept, monkeypatch):
    """A width below nothing would round the corners of the other, and no scenario holds it."""
    found = prepared()
    plays = [
        hypothesis("table_backlash", ("width",), None, "outer", crossing=c) for c in (0.0, 0.3)
    ]
    terms = (
        FittedTerm(plays[0], ("width",), (5e-4,)),
        FittedTerm(plays[1], ("width",), (width,), plays[0]),
    )
    monkeypatch.setattr(
        "tiltcal.diagnosis.search.forward_selection.refit", lambda fitted, _: fitted
    )
    assert (
        len(drop_implausible_sizes(replace(found.start, terms=terms), found.whitened).terms) == kept
    )


def test_where_every_reading_is_at_fault_nothing_is_said_of_the_physics():
    truth = bench()
    whole = recorded(truth, 3)
    still = {f"accel_{a}_m_s2": np.full(len(whole), 0.5) for a in "xyz"}
    found = diagnose(honest(truth), [rewritten(whole, **still)])
    assert {f.stage for f in found.findings} <= {"data", "electronics"}


def test_what_moves_tell_is_not_named_where_the_angles_are_cut():
    found = prepared(
        {
            "id": "settling_transient",
            "axis": "outer",
            "amplitude_arcsec": 300.0,
            "frequency_hz": 1.5,
            "tau_s": 2.0,
        }
    )
    ring = hypothesis("settling_transient", ("amplitude",), None, "outer", frequency=1.5, tau=2.0)
    fitted = with_terms(found, ring)
    assert len(drop_below_code(fitted, found.whitened, {"accel": 1e-6}).terms) == 1
    assert drop_below_code(fitted, found.whitened, {"accel": 1e-6}, blurred=True).terms == ()
    build_dictionary(found.whitened.columns, found.start, SpectralLines(), blurred=True)
    assert not {"settling_transient", "table_backlash", "lever_arm"} & {
        s.id for s in found.whitened.hypotheses
    }


def test_an_account_with_many_numbers_gives_way_to_a_plain_one():
    """A K2 that two wrong laws with curves stand for is exchanged for itself."""
    found = prepared(K2)
    build_dictionary(found.whitened.columns, found.start, SpectralLines())
    gate = NoiseGate(None, len(found.whitened.hypotheses))
    wrong = with_terms(
        found, hypothesis("acc_scale_asym", ("asym_x",)), hypothesis("acc_K3", ("k3_x",))
    )
    found_again, _ = swap_search(wrong, found.start, found.whitened, gate, lambda s: s.textbook)
    assert [t.hypothesis.id for t in found_again.terms] == ["acc_K2"]


def test_where_no_form_by_itself_stands_out_several_are_tried_together():
    found = prepared(K2, {"id": "acc_K3", "sensor": "accel", "k3_y_ug_g3": 800.0})
    build_dictionary(found.whitened.columns, found.start, SpectralLines())
    gate = NoiseGate(None, len(found.whitened.hypotheses))
    several, _ = swap_search(found.start, found.start, found.whitened, gate, lambda s: s.textbook)
    assert {t.hypothesis.id for t in several.terms} == {"acc_K2", "acc_K3"}
    sound = prepared()
    build_dictionary(sound.whitened.columns, sound.start, SpectralLines())
    nothing, _ = swap_search(sound.start, sound.start, sound.whitened, gate, lambda s: s.textbook)
    assert nothing.terms == ()


@pytest.mark.parametrize(
    ("drift", "table", "sensor"), [("y", "dual", "accel"), ("x", "vertical", "incl")]
)
def test_a_drift_and_a_step_are_two_findings_though_a_step_that_bends_does_the_same(
    drift, table, sensor
):
    """A step with what creeps on after it and a curve follows any drift, with more numbers; each
    keeps its own axis only.
    """
    found = prepared(
        {"id": "acc_drift", "sensor": sensor, f"drift_{drift}_ug": 1000.0},
        {"id": "acc_bias_step", "sensor": sensor, "bias_step_x_ug": 1500.0, "time_s": 100.0},
        table=table,
        sensor=sensor,
    )
    build_dictionary(found.whitened.columns, found.start, SpectralLines())
    gate = NoiseGate(None, len(found.whitened.hypotheses))
    fitted, whitened = plainly(found.start, found.whitened, gate, lambda s: s.textbook)
    for told in (fitted, prefer_unlisted_curve(fitted, whitened, gate)[0]):
        assert {t.names for t in told.terms} == {(f"drift_{drift}",), ("bias_step_x",)}


@pytest.mark.parametrize(("latency_ms", "parts"), [(2.6, [2]), (-8.0, [1, 1])])
def test_a_delay_that_a_skew_explains_most_of_is_a_part_of_it(latency_ms, parts):
    """A clock that bends is a skew with a delay beside it, and a delay does much of what a skew
    does: that is the skew's.
    """
    found = prepared(
        {"id": "clock_skew", "sensor": "accel", "skew_ppm": 40.0},
        {"id": "data_latency", "sensor": "accel", "latency_ms": latency_ms},
    )
    fitted = with_terms(
        found, hypothesis("clock_skew", ("skew",)), hypothesis("data_latency", ("latency",))
    )
    assert [
        len(places) for places in merge_small_findings(fitted, found.whitened).findings()
    ] == parts


def test_a_finding_that_does_not_pay_for_its_numbers_is_not_stated():
    found = prepared(K2)
    gate = NoiseGate(None, 100)
    for others, kept in (
        ((), {"acc_K2"}),
        ((hypothesis("acc_K3", ("k3_x", "k3_y", "k3_z")),), {"acc_K2"}),
    ):
        fitted = with_terms(found, hypothesis("acc_K2", ("k2_x",)), *others)
        left, _ = drop_below_bic(fitted, found.whitened, gate)
        assert {t.hypothesis.id for t in left.terms} == kept
    assert drop_below_bic(found.start, found.whitened, gate)[0].terms == ()


def rival(of, value, worth):
    return Alternative((FittedTerm(of, of.names, (value,)),), 1000.0, worth, 1.0, 1.0, 0.0, True)


def test_among_equals_a_size_that_some_instrument_has_is_preferred():
    """A thermal tilt of 27 arcsec/degC and a bias of 130 ug/degC read the same: the bias is of this
    world.
    """
    tilt = rival(hypothesis("mount_thermal_tilt", ("tilt_x",), None), 130e-6, 991.0)
    bias = rival(hypothesis("acc_temp_bias", ("temp_bias_y",)), 130e-6 * G0, 990.0)
    assert preferred([tilt, bias]) is bias
    small = replace(tilt, terms=(replace(tilt.terms[0], values=(10e-6,)),))
    assert preferred([small, bias], [np.ones(3), np.ones(3)]) is small  # it moves both channels


def test_curves_of_two_readings_are_two_causes_those_of_one_are_one():
    """A law of x beside a law of y is not given up for a curve of each: that is no single cause."""
    x, y = (LearnedReading({"c0": 1e-6}, "accel", axis, coordinate="table_outer") for axis in "xy")
    tilt = LearnedTilt({"c0": 1e-6}, coordinate="table_outer", slot="mount", turn="x")
    for effects, count in (((x, y), 2), ((x, x), 1), ((tilt, tilt), 1), ((tilt, y), 2)):
        curve = SimpleNamespace(
            terms=[FittedTerm.start(Hypothesis(effect, ("c0",))) for effect in effects]
        )
        assert causes(curve) == count


def test_a_loss_is_weighed_by_one_sample():
    (drop,) = (s for s in step_hypotheses(honest(bench()), [50.0]) if s.id == "data_drop")
    assert drop.effect.values["samples"] == 1.0


@pytest.mark.parametrize(("range_degC", "widths"), [((-2.0, 3.0), 5), ((0.0, 0.0), 1)])
def test_a_thermal_hysteresis_is_tried_at_widths_of_the_range_that_was_gone_through(
    range_degC, widths
):
    span = CoordinateRanges(100.0, 10.0, ranges={"temperature": range_degC})
    found = [
        s for s in listed_hypotheses(honest(bench()), span) if s.id == "acc_thermal_hysteresis"
    ]
    assert len({s.effect.values.get("width", 0.0) for s in found}) == widths


def test_a_reference_that_is_felt_late_is_named_before_scale_factors():
    """One number and one lag do on all axes what scale factors need three numbers for."""
    truth = bench(
        {"id": "reference_drift", "sensor": "accel", "gain_ppm_degC": 60.0},
        swing_degC=6.0,
        period_s=150.0,
    )
    sound = recorded(truth, 8)
    felt = sound.column("temperature_degC")
    # what the reference feels is this, 16 s late
    ahead = felt + 16.0 * np.gradient(felt, sound.time)
    found = prepare(honest(truth), [rewritten(sound, temperature_degC=ahead)])
    build_dictionary(found.whitened.columns, found.start, SpectralLines())
    gate = NoiseGate(None, len(found.whitened.hypotheses))
    fitted, whitened = forward_selection(found.start, found.whitened, gate, lambda s: s.textbook)
    values, whitened = gate.log_p(fitted, whitened)
    first = findings_of(fitted, whitened, values)[0]
    assert (first.effect, first.parameters["gain_ppm_degC"][0]) == (
        "reference_drift",
        pytest.approx(60.0, rel=0.05),
    )
    assert fitted.terms[0].effect.value("lag") == pytest.approx(16.0, rel=0.15)


@pytest.mark.parametrize(("late", "ahead"), [(0.02, 0.0), (0.0, 0.03)])
def test_a_fog_and_a_gyro_that_are_late_see_the_rate_of_another_time(late, ahead):
    """A gyro that is late says now what was: a FOG that is in time has it from later; hand-worked
    for a rate t^2.
    """
    time = np.arange(0.0, 2.0, 0.01)
    rate = np.column_stack([time**2, time, np.ones_like(time)])
    effects = [
        CATALOGUE["data_latency"]({"latency": late}, "gyro"),
        CATALOGUE["data_latency"]({"latency": ahead}, "fog"),
    ]
    found = earlier(rate, time, effects, FOG, GYRO)
    at = time + late - ahead
    np.testing.assert_allclose(
        found[10:-10], np.column_stack([at**2, at, np.ones_like(at)])[10:-10], atol=1e-9
    )
    assert earlier(rate, time, [], FOG, GYRO) is rate
