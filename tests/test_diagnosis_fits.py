"""Fitting and pruning a fitted model: steps that run away, what belongs to a larger finding, what
codes hide, plainer words.
"""

from dataclasses import replace

import numpy as np
import pytest
from builders import FOG, GYRO
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.data_faults.quantisation_limit import above_codes
from tiltcal.diagnosis.data_faults.setting_errors import lawful_part
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, listed_hypotheses, step_hypotheses
from tiltcal.diagnosis.hypotheses.instants import Instant
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.best_shape import refined
from tiltcal.diagnosis.search.dictionary import build_dictionary
from tiltcal.effects import CATALOGUE
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.learned import LearnedReading
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


def test_a_step_that_ran_away_is_tried_again_with_damping(monkeypatch):
    """The second evaluation, that of the first step, is made absurd: the fit goes on from where it
    was, and finds the size all the same.
    """
    found = prepared(K2)
    usual, calls = WhitenedModel.residual, []

    def absurd(whitened, effects):
        calls.append(1)
        left = usual(whitened, effects)
        return [1e6 + r for r in left] if len(calls) == 2 else left

    monkeypatch.setattr(WhitenedModel, "residual", absurd)
    fitted = with_terms(found, hypothesis("acc_K2", ("k2_x",)))
    assert abs(fitted.terms[0].values[0] - 800e-6) < 4 * fitted.sigmas(0)[0]


def seen(found, fitted, floors):
    return above_codes(fitted.terms, fitted, replace(found.whitened, floors=floors))


@pytest.mark.parametrize(("code", "kept"), [(1e-3, True), (0.1, False)])
def test_what_is_nowhere_larger_than_a_code_is_not_named(code, kept):
    found = prepared(K2)
    fitted = with_terms(found, hypothesis("acc_K2", ("k2_x",)))  # 800 ug at 1 g: 8e-3 m/s2
    assert seen(found, fitted, {"accel": code}) is kept
    assert seen(found, fitted, {"gyro": code})  # another sensor's codes hide nothing here


@pytest.mark.parametrize(("bend", "kept"), [(0.0, False), (0.1, True)])
def test_of_a_curve_what_calibration_takes_is_not_larger_than_a_code(bend, kept):
    """0.1 m/s2 at 1 g along a straight line: a scale factor. Bent by as much it is a curve."""
    found = prepared(K2)
    names, values = ("c0", "c1", "c2"), (-0.1, bend, 0.1)
    curve = LearnedReading(
        dict.fromkeys(names, 0.1), "accel", "x", coordinate="input", knots=(-9.8, 0.0, 9.8)
    )
    fitted = replace(found.start, terms=(FittedTerm(Hypothesis(curve, names), names, values),))
    assert seen(found, fitted, {"accel": 0.01}) is kept


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
    assert seen(found, fitted, {"accel": 1e-6})
    cut = DataTruncation({"step": 1e-4}, None, None, "found")
    found.observations.known = (*found.observations.known, cut)
    assert not seen(found, fitted, {"accel": 1e-6})
    build_dictionary(found.whitened, found.start, SpectralLines())
    assert not {"settling_transient", "table_backlash", "lever_arm"} & {
        s.id for s in found.whitened.hypotheses
    }


def test_a_loss_is_weighed_by_one_sample():
    (drop,) = (s for s in step_hypotheses(honest(bench()), [Instant(50.0)]) if s.id == "data_drop")
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


def test_a_play_of_temperature_is_not_widened_until_it_is_in_proportion():
    """To a bias in proportion to temperature the widest play comes nearest, without a limit the one
    that is never gone through.
    """
    bias = {"id": "acc_temp_bias", "sensor": "accel", "temp_bias_x_ug_degC": 100.0}
    found = prepared(bias, swing_degC=3.0, period_s=60.0)
    span = np.ptp(found.observations.recordings[0].temperature())
    offered = [
        hypothesis("acc_thermal_hysteresis", ("thermal_hysteresis_x",), width=share * span)
        for share in (0.2, 0.5, 0.8)
    ]
    whitened = found.whitened.alone(offered, found.start.effects)
    (widest,) = refined((FittedTerm.start(offered[-1]),), found.start, whitened)
    assert widest.hypothesis.effect.values["width"] == pytest.approx(0.8 * span)


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
