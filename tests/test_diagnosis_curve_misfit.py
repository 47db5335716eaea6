"""A listed law beside a nameless curve: a cause of its own, or what the curve leaves of its law."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, tumble

from tiltcal.diagnosis.conclusions.one_recording import mean_and_deviations
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.priors import EXPECTED_CAUSES, UNLISTED, log_priors
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.search.curve_misfit import (
    BEYOND_FAMILY,
    energy_beside,
    misfit_odds,
    taken_in,
)
from tiltcal.diagnosis.search.names import named, without_misfits
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import Cause, State, laws, repriced, without
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading

GATE = NoiseSource(None, 100)
WARM = {"id": "acc_temp_bias", "sensor": "accel", "temp_bias_x_ug_degC": 100.0}


def following_temperature(alias=None):
    """A curve on the x channel; without an alias it has no name."""
    effect = LearnedReading(
        {"c0": 1e-3}, "accel", "x", "found", coordinate="temperature", power=1.0, odd=True
    )
    return Hypothesis(effect, ("c0",), alias)


def square_on(axis):
    effect = CATALOGUE["acc_K2"]({f"k2_{axis}": 1e-3}, "accel", None, "found")
    return Hypothesis(effect, (f"k2_{axis}",))


def beside(axis, size_ug, alias=None):
    """A model of a recording that holds a bias over temperature on x, fitted as a curve, and a
    square of the input on some axis.
    """
    square = {"id": "acc_K2", "sensor": "accel", f"k2_{axis}_ug_g2": size_ug}
    return state_of([following_temperature(alias), square_on(axis)], square)


def state_of(hypotheses, *effects):
    """A model of a recording that holds a bias over temperature on x, and further effects."""
    truth = bench(WARM, *effects, swing_degC=3.0, period_s=60.0)
    table = truth.model_dump(exclude_defaults=True, by_alias=True)
    truth = type(truth).model_validate({"schema": 1, **table, "sequence": tumble(12)})
    found = prepare(honest(truth), [recorded(truth, 8)])
    whitened = found.whitened.alone(hypotheses, found.start.effects)
    terms = tuple(FittedTerm.start(h) for h in hypotheses)
    fitted = refit(replace(found.start, terms=terms), whitened)
    causes = tuple(Cause(float(p), 0) for p in np.log(EXPECTED_CAUSES) + log_priors(hypotheses))
    state = State(fitted, whitened, causes, (0.0,) * len(causes))
    return repriced(state, GATE.left_by(fitted, whitened))


def test_the_odds_of_a_misfit_are_those_of_its_size():
    """A listed law gains 20 beside a curve of energy 100. At a prior energy v the likelihood ratio
    is exp(10 v / (1 + v)) / sqrt(1 + v).

    Of the shares s only the last three say much: s = 0.02: v = 2, e^6.667 / 1.732 = 453.7;
    s = 0.16: v = 16, e^9.412 / 4.123 = 2965.0; s = 0.45: v = 45, e^9.783 / 6.782 = 2613.3;
    s = 0.0016: v = 0.16, e^1.379 / 1.077 = 3.69; the others 1.09 and 1.01. Their mean is 1006.3.

    Of any size: v = 1, 104.9; 10, 2675.7; 100, 1985.1; 1000, 689.3; then 220.0, 69.65, 22.03, 6.97
    and 2.20. Their mean is 641.8.
    """
    assert misfit_odds(20.0, 100.0) == pytest.approx(np.log(1006.3 / 641.8), abs=0.001)


def test_a_law_far_larger_than_what_a_curve_may_leave_is_no_misfit():
    """Gain 1000, energy 100: the best share leaves 500/46 = 10.87 of 500 nats, less
    the logarithms of 46^(1/2) and of six shares. Of any size: v = 100, e^-4.950 / 10.05 = 7.04e-4;
    1000, e^-0.4995 / 31.64 = 0.01918; then 0.00951, 0.00315, 0.001, 3.2e-4, 1e-4; of nine 0.00377.
    """
    expected = -500 / 46 - np.log(46) / 2 - np.log(6) - np.log(0.00377)
    assert misfit_odds(1000.0, 100.0) == pytest.approx(expected, abs=0.01)


def test_a_small_law_beside_a_nameless_curve_completes_the_curve():
    state = beside("x", 150.0)
    energy = energy_beside(state, 1, [0])
    left, kept = without_misfits(state, Scan(state.whitened))
    assert kept == (0,)
    (law,) = laws(left.fitted)
    assert not law.listed
    assert [t.hypothesis.id for t in left.fitted.terms] == ["learned", "acc_K2"]
    assert left.fitted.terms[1].host is law
    assert left.fitted.deviance == pytest.approx(state.fitted.deviance, rel=1e-3)
    assert energy > 0
    _, (names,) = named(left, Scan(left.whitened))
    assert not names.listed


@pytest.mark.parametrize(("axis", "kept"), [("x", (1,)), ("y", (0, 1))])
def test_a_nameless_curve_that_is_next_to_nothing_beside_a_listed_law_completes_it(axis, kept):
    """A square of 0.5 g on the channel of the curve has more than 10^5 times its energy; on another
    channel it leaves nothing there.
    """
    state = beside(axis, 500_000.0)
    curve = without(state, 0).fitted.deviance - state.fitted.deviance
    assert (energy_beside(state, 0, [1]) > 1e5 * curve) == (axis == "x")
    left, found = without_misfits(state, Scan(state.whitened))
    assert found == kept
    assert [law.listed for law in laws(left.fitted)] == ([True] if axis == "x" else [False, True])
    assert len(left.fitted.terms) == 2
    assert left.fitted.deviance == pytest.approx(state.fitted.deviance, rel=1e-3)


def test_what_a_textbook_form_leaves_is_a_small_share_of_its_law():
    """Gain 20, energy 10^6: the shares are v = 1, 10, 100, 1000: likelihood ratios 104.9, 2675.7,
    1985.1, 689.3, mean 1363.8, against 641.8 of any size (above).
    """
    odds = misfit_odds(20.0, 1e6, BEYOND_FAMILY)
    assert odds == pytest.approx(np.log(1363.8 / 641.8), abs=0.001)


@pytest.mark.parametrize(("axis", "kept"), [("x", (0,)), ("y", (0, 1))])
def test_two_curves_over_one_coordinate_in_one_channel_are_one_law(axis, kept):
    first = following_temperature()
    bent = replace(first.effect, axis=axis, power=2.0, odd=False)
    state = state_of([first, Hypothesis(bent, ("c0",))])
    left, found = without_misfits(state, Scan(state.whitened))
    assert found == kept
    assert len(left.fitted.terms) == 2
    assert (left.fitted.terms[1].host is None) == (axis == "y")


@pytest.mark.parametrize(
    ("axis", "size_ug", "kept"),
    [("x", 150.0, (0,)), ("x", 4000.0, (1,)), ("y", 150.0, (0, 1))],
    ids=["smaller", "larger", "in another channel"],
)
def test_the_smaller_of_two_curves_in_a_channel_completes_the_larger(axis, size_ug, kept):
    square = LearnedReading(
        {"c0": 1e-3}, "accel", axis, "found", coordinate="input", power=2.0, odd=False
    )
    hypotheses = [following_temperature(), Hypothesis(square, ("c0",))]
    truth = {"id": "acc_K2", "sensor": "accel", f"k2_{axis}_ug_g2": size_ug}
    state = state_of(hypotheses, truth)
    left, found = without_misfits(state, Scan(state.whitened))
    assert found == kept
    hosts = [t.host for t in left.fitted.terms]
    assert hosts == [None, laws(left.fitted)[0] if len(kept) == 1 else None]


def test_what_a_textbook_form_leaves_over_time_ends_with_its_recording():
    over_time = LearnedReading(
        {"c0": 1e-3}, "accel", "x", "found", coordinate="time", power=1.0, odd=True
    )
    law, left_over = square_on("x"), Hypothesis(over_time, ("c0",))
    state = state_of([law, left_over], {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 5e5})
    whole = taken_in(state, 1, 0).fitted
    effects = mean_and_deviations(
        whole, whole.findings()[0], [t.effect for t in whole.terms], state.whitened.observations
    )
    assert [(e.id, e.lasts) for e in effects] == [
        ("acc_K2", True),
        ("learned", True),  # its mean
        ("learned", False),
        ("learned", False),
    ]


@pytest.mark.parametrize(
    ("axis", "size_ug", "alias"),
    [("x", 4000.0, None), ("y", 150.0, None), ("x", 150.0, "acc_temp_bias")],
    ids=["far larger than the curve", "in another channel", "the curve has a name"],
)
def test_a_law_that_no_curve_leaves_is_a_cause(axis, size_ug, alias):
    state = beside(axis, size_ug, alias)
    scan = Scan(state.whitened)
    left, kept = without_misfits(state, scan)
    assert (left, kept) == (state, (0, 1))
    _, (_, names) = named(left, scan)
    assert names.probability.get(UNLISTED, 0.0) < 0.05
    assert names.alike[0] == "acc_K2"
