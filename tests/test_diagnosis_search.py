"""What belongs to one finding, and which hypotheses are looked at for a set-up."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.data_quality.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import (
    CREEPS,
    Hypothesis,
    listed_hypotheses,
    step_hypotheses,
    steps_at,
)
from tiltcal.diagnosis.model.channel_noise import noise_under
from tiltcal.diagnosis.model.finding_tests import ALPHA, finding_log_p_values
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, refit
from tiltcal.diagnosis.search.alternatives import fair
from tiltcal.diagnosis.search.forward_selection import _grown
from tiltcal.diagnosis.search.merging import merge_same_cause
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.spans import CoordinateRanges, SpectralLines

SPAN = CoordinateRanges(
    200.0, 10.0, SpectralLines(shakes=(3.4,), ripples=(12,)), {"temperature": (-2.0, 3.0)}
)


def term(id, values, names, sensor="accel", sizes=(1e-4,)):
    return FittedTerm(Hypothesis(CATALOGUE[id](values, sensor), names), names, sizes)


def shake(frequency):
    return term("base_vibration", {"ec": 1e-3, "frequency": frequency}, ("ec",), None)


def step(time):
    return term("acc_bias_step", {"bias_step_x": 1e-3, "time": time}, ("bias_step_x",))


def test_one_name_at_one_place_is_one_finding():
    k2 = term("acc_K2", {"k2_x": 1e-4}, ("k2_x",))
    fitted = merge_same_cause(FittedModel((), (), (shake(3.40), k2, shake(3.41))))
    assert [[fitted.terms[k].hypothesis.id for k in places] for places in fitted.findings()] == [
        ["base_vibration", "base_vibration"],
        ["acc_K2"],
    ]


def test_two_steps_at_two_instants_are_two_findings():
    assert len(merge_same_cause(FittedModel((), (), (step(20.0), step(90.0)))).findings()) == 2


@pytest.mark.parametrize(("value", "good"), [(5e-3, True), (-5e-3, False), (700.0, False)])
def test_a_time_constant_below_nothing_or_of_minutes_is_no_bandwidth(value, good):
    bandwidth = term("acc_bandwidth", {"tau": 0.01}, ("tau",))
    assert fair(replace(bandwidth, values=(value,))) is good


def test_every_step_may_set_in_at_once_or_creep():
    found = [s for s in steps_at(honest(bench()), 50.0, 60) if s.id == "acc_bias_step"]
    assert sorted(s.effect.values.get("creep", 0.0) for s in found) == [0.0, *CREEPS]
    assert all(s.effect.values["time"] == 50.0 for s in found)


def test_what_shakes_the_base_is_a_suspect_at_the_lines_of_the_world():
    found = [s for s in listed_hypotheses(honest(bench()), SPAN) if s.id == "base_vibration"]
    assert [s.effect.values["frequency"] for s in found] == [3.4]


def test_ripples_and_widths_come_from_the_recording():
    hypotheses = list(listed_hypotheses(honest(bench()), SPAN))
    assert any(s.id == "table_encoder_sde" and s.effect.values["lines"] == 12 for s in hypotheses)
    widths = [s.effect.values["width"] for s in hypotheses if s.id == "acc_thermal_hysteresis"]
    np.testing.assert_allclose(sorted(widths), [0.5, 1.0, 1.75, 2.5, 4.0])


def test_known_lines_are_not_looked_at_again():
    new = SpectralLines(tones=(1.0, 5.0), ripples=(12, 36)).beside(
        SpectralLines(tones=(5.001,), ripples=(36,)), 0.005
    )
    assert new == SpectralLines(tones=(1.0,), ripples=(12,))


@pytest.mark.parametrize(("samples", "good"), [(0.02, False), (0.9, True), (3.0, True)])
def test_a_small_part_of_a_sample_is_not_lost(samples, good):
    effect = CATALOGUE["data_drop"]({"samples": 1.0, "time": 5.0}, "accel", None, "found")
    assert (
        fair(replace(FittedTerm.start(Hypothesis(effect, ("samples",))), values=(samples,))) is good
    )


def test_a_slow_effect_that_stood_in_the_noise_of_a_larger_one_is_found_after_it():
    """Beside a drift of the floor a step of one bias is a random walk to the noise that is left."""
    truth = bench(
        {"id": "floor_tilt_drift", "tilt_east_arcsec": 60.0, "tilt_north_arcsec": 20.0},
        {"id": "acc_bias_step", "sensor": "accel", "bias_step_z_ug": 60.0, "time_s": 100.0},
    )
    found = diagnose(honest(truth), [recorded(truth, 1)]).findings
    assert {f.effect for f in found} == {"floor_tilt_drift", "acc_bias_step"}


def test_a_play_that_is_crossed_gradually_keeps_its_name_and_width():
    """With the sign of the last motion in place of the play other laws are needed beside it, or
    another name.
    """
    truth = bench(
        {"id": "table_backlash", "axis": "outer", "width_arcsec": 50.0, "crossing_deg": 40.0}
    )
    (finding,) = diagnose(honest(truth), [recorded(truth, 1)]).findings
    assert finding.effect == "table_backlash"
    width, sigma = finding.parameters["width_arcsec"]
    assert abs(width - 50.0) < 4 * sigma


@pytest.mark.parametrize(
    ("rows", "ends", "good"), [(1, (0,), False), (3, (0, 3), False), (None, (0,), True)]
)
def test_a_step_has_to_show_without_the_samples_next_to_it(rows, ends, good):
    """A few values that are off are two steps that cancel; beside a walk the first of them is half
    of it by itself.
    """
    truth = bench(
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 1.0, "walk_ug_rts": 10.0},
        noise=False,
    )
    sound = recorded(truth, 3)
    x = sound.column("accel_x_m_s2").copy()
    at = 1000
    x[at : at + rows if rows else None] += 10 * np.median(np.abs(np.diff(x)))
    found = prepare(honest(truth), [rewritten(sound, accel_x_m_s2=x)])
    times = [float(sound.time[at + end] - sound.time[0]) - 0.05 for end in ends]
    steps = [
        s for s in step_hypotheses(found.observations.scenario, times) if s.id == "acc_bias_step"
    ]
    fitted = refit(
        replace(found.start, terms=tuple(FittedTerm.start(s, ("bias_step_x",)) for s in steps)),
        found.whitened,
    )
    noise = [f.model for f in noise_under(fitted, found.whitened.columns)]
    whitened = found.whitened.under(noise)
    fitted = refit(fitted, whitened)
    assert len(fitted.terms) == len(ends)
    assert [
        bool(log_p < np.log(ALPHA)) for log_p in finding_log_p_values(fitted, whitened, 1000)
    ] == [good] * len(ends)


def test_one_value_far_off_is_no_finding():
    truth = bench(
        {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 1.0, "walk_ug_rts": 10.0},
        noise=False,
    )
    sound = recorded(truth, 3)
    x = sound.column("accel_x_m_s2").copy()
    x[1000] += 40 * np.std(np.diff(x)[900:930])
    assert diagnose(honest(truth), [rewritten(sound, accel_x_m_s2=x)]).findings == ()


@pytest.mark.parametrize(("size", "good"), [(0.5, True), (20.0, False)])
def test_a_law_that_follows_temperature_as_a_curve_is_no_steeper_than_its_straight_form_may_be(
    size, good
):
    """Ten times 300 ppm/K over 30 K to either side are 9 %."""
    curve = LearnedReading(
        {"c0": 1e-6},
        "accel",
        "y",
        coordinate="temperature",
        knots=(-30.0, 0.0, 30.0),
        per_input=True,
    )
    late = Hypothesis(curve, ("c0",), 1, "acc_temp_scale")
    assert fair(FittedTerm(late, ("c0",), (size * 0.09,))) is good


def test_a_further_shape_of_a_finding_that_brings_nothing_ends_the_search():
    """The same term again stands out as the first did, and takes nothing away: it was added again
    and again.
    """
    truth = bench({"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 800.0})
    found = prepare(honest(truth), [recorded(truth, 8)])
    k2 = Hypothesis(CATALOGUE["acc_K2"]({"k2_x": 1e-4}, "accel"), ("k2_x",))
    before = refit(replace(found.start, terms=(FittedTerm.start(k2),)), found.whitened)
    again = refit(replace(before, terms=(*before.terms, FittedTerm.start(k2))), found.whitened)
    assert _grown(again, before, found.whitened) is None
    assert _grown(before, found.start, found.whitened) is not None
