"""The search for the most probable model, what its causes may be, and which are select_claims."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten, tumble

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, listed_hypotheses, with_values
from tiltcal.diagnosis.hypotheses.priors import EXPECTED_CAUSES, UNLISTED, log_priors
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.refitting import refit, refit_linearly
from tiltcal.diagnosis.search import model_search
from tiltcal.diagnosis.search.best_shape import normalise_tone_phase
from tiltcal.diagnosis.search.dictionary import build_dictionary
from tiltcal.diagnosis.search.explained import (
    CLAIM,
    _without,
    probability_of,
    select_claims,
)
from tiltcal.diagnosis.search.explanation import explain
from tiltcal.diagnosis.search.model_search import _exchanged, most_probable
from tiltcal.diagnosis.search.names import named
from tiltcal.diagnosis.search.scan import ColumnProducts, Scan
from tiltcal.diagnosis.search.state import (
    Cause,
    Proposal,
    State,
    laws,
    proposals,
    repriced,
    with_new,
    without,
)
from tiltcal.effects import CATALOGUE
from tiltcal.effects.learned import LearnedReading
from tiltcal.effects.spans import SpectralLines
from tiltcal.statistics.noise_spectrum import NoiseFit, white_noise

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 800.0}
MODELS = (frozenset({0, 1}), frozenset({0}), frozenset({1}), frozenset[int]())
NOISE_SOURCE = NoiseSource(None, 100)


def truth_of(*left_out):
    """A short tumble in changing temperature."""
    truth = bench(*left_out, swing_degC=3.0, period_s=60.0)
    table = truth.model_dump(exclude_defaults=True, by_alias=True)
    return type(truth).model_validate({"schema": 1, **table, "sequence": tumble(12)})


def prepared(*left_out, seed=8, walk=0.0):
    """A recording from which these were left out; walk: of the x channel, m/s2 per sample."""
    truth = truth_of(*left_out)
    read = recorded(truth, seed)
    steps = np.random.default_rng(seed).normal(0, walk, len(read.time))
    read = rewritten(read, accel_x_m_s2=read.column("accel_x_m_s2") + np.cumsum(steps))
    return prepare(honest(truth), [read])


def searched(found):
    """Over every hypothesis."""
    build_dictionary(found.whitened, found.start, SpectralLines())
    return most_probable(found.start, found.whitened, NOISE_SOURCE)


def empty(found):
    """The model without causes, under its own noise."""
    nothing = NOISE_SOURCE.left_by(found.start, found.whitened)
    return State(refit(found.start, nothing), nothing)


@pytest.fixture(scope="module")
def square():
    """A square of the input, and the model that the search came to."""
    found = prepared(K2)
    return found, searched(found)


def ids(state):
    return [state.fitted.terms[p[0]].hypothesis.id for p in state.fitted.findings()]


RECORDINGS = {
    "nothing": prepared,
    "a walk": lambda: prepared(walk=3e-4),
    "a small square": lambda: prepared({**K2, "k2_x_ug_g2": 12.0}),
    "two laws": lambda: prepared(K2, {"id": "table_encoder_2rev", "cos_arcsec": 40.0}),
    "a step": lambda: prepared(
        {"id": "acc_bias_step", "sensor": "accel", "bias_step_y_ug": 300.0, "time_s": 40.0}
    ),
}


@pytest.mark.parametrize("recording", RECORDINGS.values(), ids=RECORDINGS)
def test_the_search_never_returns_what_costs_more_than_nothing(recording):
    found = recording()
    state = searched(found)
    assert state.cost <= empty(found).cost
    assert len(state.causes) == len(state.prices) == len(state.fitted.findings())


def test_the_search_finds_the_law_that_was_left_out(square):
    found, state = square
    assert ids(state) == ["acc_K2"]
    assert state.cost < empty(found).cost - 100


def test_without_its_only_cause_a_model_is_the_start(square):
    found, state = square
    rest = without(state, 0)
    assert (rest.fitted.terms, rest.causes, rest.prices) == ((), (), ())
    start = State(refit(found.start, state.whitened), state.whitened)
    assert rest.cost == pytest.approx(start.cost)
    signal = max(
        np.abs(mine - left).max()
        for mine, left in zip(rest.fitted.residual, state.fitted.residual, strict=True)
    )
    for mine, other in zip(rest.fitted.residual, start.fitted.residual, strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-6 * signal)  # columns of single precision


def test_fits_share_their_columns_and_reach_what_a_fit_about_itself_reaches(square):
    _, state = square
    shared = refit(state.fitted, state.whitened)
    own = refit(shared, state.whitened, about=shared.effects)
    known = [{(id(v.source), v.name) for v in fit.columns} for fit in (state.fitted, shared, own)]
    assert known[0] == known[1]
    assert not known[1] & known[2]
    for k, (mine, other) in enumerate(zip(shared.terms, own.terms, strict=True)):
        off = np.array(mine.values) - np.array(other.values)
        assert (np.abs(off) < 0.01 * own.sigmas(k)).all()


@pytest.mark.parametrize("number", [None, 0, 40], ids=["fewer", "another", "yet another"])
def test_inner_products_passed_on_from_a_model_are_those_of_a_pass(square, number):
    """To a model with one cause less, and to one with another cause in its place."""
    _, state = square
    terms = [] if number is None else [FittedTerm.start(state.whitened.hypotheses[number])]
    other = refit_linearly(without(state, 0).fitted, terms, state.whitened)
    passed_on, expected = ColumnProducts(state.whitened), ColumnProducts(state.whitened)
    passed_on.along(state.fitted)
    size = np.linalg.norm(expected.along(state.fitted), axis=0).max()
    found = passed_on.along(other)
    np.testing.assert_allclose(found, expected.along(other), rtol=0, atol=1e-5 * size)


def test_a_model_costs_the_same_when_it_is_weighed_again(square):
    _, state = square
    assert repriced(state, state.whitened).cost == pytest.approx(state.cost, abs=0.1)


def test_a_line_lowers_the_cost_by_no_more_than_it_stands_out_of_its_neighbours():
    """Six tones within an octave: of the noise each explains more than of the level there."""
    tone = {"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": 2500.0}
    tones = [{**tone, "frequency_hz": f} for f in (2.1, 2.3, 2.5, 2.7, 2.9, 3.1)]
    found = prepared(*tones)
    lines = spectral_lines_of(found.observations, found.start)
    build_dictionary(found.whitened, found.start, lines)
    nothing = empty(found)
    every = proposals(nothing, Scan(nothing.whitened))
    line = next(p for p in every if p.explanation.hypothesis.line_hz)
    state = with_new(nothing, line)
    assert nothing.fitted.deviance - state.fitted.deviance > 1.3 * line.explanation.gain
    assert nothing.cost - state.cost == pytest.approx(line.score, abs=0.5)


def test_a_tone_that_is_turned_round_keeps_the_covariance_of_its_fit():
    """Two tones side by side, one of them written with its phase half a turn off."""
    tones = [
        {"id": "mains_pickup", "sensor": "accel", "pickup_x_ug": 900.0, "frequency_hz": f}
        for f in (2.1, 2.11)
    ]
    found = prepared(*tones)
    offered = [
        with_values(h.effect, h.effect.values | {"phase": np.pi})
        for h in _tones(found, (2.1, 2.11))
    ]
    terms = [FittedTerm.start(Hypothesis(e, ("pickup_x",))) for e in offered]
    fitted = refit(replace(found.start, terms=tuple(terms)), found.whitened)
    fitted = replace(fitted, terms=(fitted.terms[0], replace(fitted.terms[1], values=(1e-3,))))
    turned = normalise_tone_phase(fitted, found.observations)
    assert turned.terms[0].values[0] > 0
    expected = refit(turned, found.whitened).covariance
    np.testing.assert_allclose(
        turned.covariance, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )


def _tones(found, frequencies):
    """A mains tone at each of these frequencies."""
    span = ranges_of(found.observations, SpectralLines(tones=frequencies))
    listed = listed_hypotheses(found.observations.scenario, span)
    every = [h for h in listed if h.id == "mains_pickup"]
    return [next(h for h in every if h.effect.values["frequency"] == f) for f in frequencies]


def test_a_curve_is_exchanged_for_one_over_another_coordinate():
    """A curve over time gives way to that over temperature, at the same place."""
    drift = {"id": "acc_temp_bias", "sensor": "accel", "temp_bias_x_ug_degC": 100.0}
    found = prepared(drift)
    warm, late = (curve_over(LearnedReading, c, 1, **PROPORTIONAL) for c in ("temperature", "time"))
    whitened = found.whitened.alone([warm, late], found.start.effects)
    state = with_new(
        State(refit(found.start, whitened), whitened), proposal_of(late, found, whitened)
    )
    other = _exchanged(state, [0], Scan(whitened))
    assert other.cost < state.cost
    assert laws(other.fitted) == [warm]


def test_further_sizes_of_a_law_are_sizes_of_that_law(square):
    """Taken in one after the other they are one term, at the cost of both together."""
    found, state = square
    listed = {h.id: h for h in found.whitened.hypotheses}
    law = listed["acc_K3"]
    columns = found.whitened.alone([law], state.fitted.known).columns
    whitened = replace(state.whitened, columns=columns)
    start = State(refit(found.start, whitened), whitened)
    told = explain(0, start.fitted, whitened)
    halves = [FittedTerm(law, (name,), (1e-6,)) for name in law.names[:2]]
    one, other, both = (
        Proposal(replace(told, terms=(term,)), 0.0)
        for term in (*halves, FittedTerm(law, law.names[:2], (1e-6, 1e-6)))
    )
    apart = with_new(with_new(start, one), other)
    together = repriced(with_new(start, both), whitened)
    assert [t.names for t in apart.fitted.terms] == [law.names[:2]]
    assert [t.host for t in apart.fitted.terms] == [None]
    assert repriced(apart, whitened).cost == pytest.approx(together.cost)


def test_a_search_that_comes_back_to_its_causes_ends(monkeypatch, square):
    """Each step lowers the cost, and there would always be another."""
    _, state = square
    rest, steps = without(state, 0), []

    def merged(now, _):
        steps.append(now)
        assert len(steps) < 9
        other = replace(rest if len(steps) % 2 else state)
        other.__dict__["cost"] = now.cost - 1.0
        return other

    monkeypatch.setattr(model_search, "_each_exchanged", lambda now, *_: now)
    monkeypatch.setattr(model_search, "_with_one_more", lambda now, *_: now)
    monkeypatch.setattr(model_search, "_merged", merged)
    assert model_search.local_search(state).cost == pytest.approx(state.cost - 2.0)
    assert len(steps) == 2


def test_where_the_refit_of_the_best_proposal_costs_more_the_next_is_tried(monkeypatch, square):
    _, state = square
    rest = without(state, 0)
    scan = Scan(rest.whitened)
    best = model_search.laws(model_search._with_one_more(rest, rest, scan).fitted)[0]

    def failing(new):
        """A refit that leaves more than there was for the best law."""
        if best in model_search.laws(new.fitted):
            new = replace(new)
            new.__dict__["cost"] = np.inf
        return new

    monkeypatch.setattr(model_search, "refitted", failing)
    other = model_search._with_one_more(rest, rest, scan)
    assert other.cost < rest.cost
    assert best not in model_search.laws(other.fitted)


def test_what_cannot_be_without_a_cause_goes_with_it():
    """Of readings that are early a low-pass alone would have a negative time constant."""
    early = {"id": "data_latency", "sensor": "accel", "latency_ms": -8.0}
    found = prepared(early)
    build_dictionary(found.whitened, found.start, SpectralLines())
    listed = {h.id: h for h in found.whitened.hypotheses}
    state = stated(found, listed["data_latency"], listed["acc_bandwidth"])
    kept, rest = _without(state, {0, 1}, {0}, NOISE_SOURCE)
    assert kept == frozenset()
    assert np.isfinite(rest.cost)
    kept, rest = _without(state, {0, 1}, {1}, NOISE_SOURCE)
    assert kept == {0}


def test_probabilities_of_names_sum_to_one(square):
    _, state = square
    state, (names,) = named(state, Scan(state.whitened))
    assert sum(names.probability.values()) == pytest.approx(1.0, abs=0.01)
    assert next(iter(names.probability)) == "acc_K2"
    assert names.probability["acc_K2"] > 0.5
    assert names.alike[0] == "acc_K2"


def following(coordinate, id, lag=0.0):
    """A curve with one number, under a name."""
    names = ("c0",)
    effect = LearnedReading(
        {"c0": 1e-3}, "accel", "x", "found", coordinate=coordinate, lag=lag, power=1.0, odd=True
    )
    return Hypothesis(effect, names, id)


PROPORTIONAL = {"sensor": "accel", "axis": "x", "power": 1.0, "odd": True}


def proposal_of(hypothesis, found, whitened):
    """A hypothesis as an explanation of what the scenario leaves."""
    told = explain(whitened.hypotheses.index(hypothesis), found.start, whitened)
    return Proposal(told, float(log_priors([hypothesis])[0]))


@pytest.mark.parametrize(("further", "share"), [(0, 1 / 2), (1, 1 / 3), (3, 1 / 5)])
def test_identical_columns_under_two_names_share_the_probability_by_their_priors(further, share):
    """The more shapes a name has, the less probable is each: the data say nothing of the two."""
    drift = {"id": "acc_temp_bias", "sensor": "accel", "temp_bias_x_ug_degC": 100.0}
    found = prepared(drift)
    first = following("temperature", "acc_temp_bias")
    second = following("temperature", "acc_thermal_hysteresis")
    others = [following("time", second.id, lag=20.0 + k) for k in range(further)]
    whitened = found.whitened.alone([first, second, *others], found.start.effects)
    state = most_probable(found.start, whitened, NOISE_SOURCE)
    _, (names,) = named(state, Scan(state.whitened))
    # a cause outside the catalogue, of which they explain a share, is a little of each
    listed = 1 - names.probability[UNLISTED]
    assert 0.9 < listed < 1
    assert names.probability[second.id] == pytest.approx(share * listed, abs=0.02)
    assert names.probability[first.id] == pytest.approx((1 - share) * listed, abs=0.02)
    assert set(names.alike) == {first.id, second.id}


def stated(found, *hypotheses):
    """A model with these causes, under the noise that it leaves."""
    terms = tuple(FittedTerm.start(h) for h in hypotheses)
    whitened = found.whitened.alone(hypotheses, found.start.effects)
    fitted = refit(replace(found.start, terms=terms), whitened)
    prior = float(np.log(EXPECTED_CAUSES) + log_priors(hypotheses)[0])
    causes, prices = (Cause(prior, 0),) * len(terms), (0.0,) * len(terms)
    return repriced(State(fitted, whitened, causes, prices), NOISE_SOURCE.left_by(fitted, whitened))


def test_a_cause_that_the_noise_explains_as_well_is_not_believed():
    """A random walk drifts; beside it is a square of the input."""
    found = prepared(K2, walk=1e-3)
    square = Hypothesis(CATALOGUE["acc_K2"]({"k2_x": 1e-4}, "accel", None, "found"), ("k2_x",))
    effect = CATALOGUE["acc_drift"]({"drift_x": 1e-3}, "accel", None, "found")
    drift = Hypothesis(effect, ("drift_x",))
    both = stated(found, drift, square)
    left, (chance,), _ = select_claims(both, NOISE_SOURCE)
    assert ids(left) == ["acc_K2"]
    assert chance > CLAIM
    sound = NoiseFit.known(white_noise(25e-6 * 9.81 * np.sqrt(5.0)))
    white = NoiseSource((sound,) * len(found.observations.channels), 100)
    kept, *_ = select_claims(repriced(both, white.left_by(both.fitted, both.whitened)), white)
    assert ids(kept) == ["acc_drift", "acc_K2"]


def test_what_is_believed_is_probable_enough(square):
    _, state = square
    left, chances, _ = select_claims(state, NOISE_SOURCE)
    assert ids(left) == ids(state)
    assert all(CLAIM <= chance <= 1.0 for chance in chances)
    nothing, none, _ = select_claims(without(state, 0), NOISE_SOURCE)
    assert (nothing.fitted.terms, none) == ((), ())


def test_a_cause_is_as_probable_as_the_models_that_hold_it():
    """By hand: weights of 8, 4, 4 and 1 with both, one, the other and none."""
    costs = {held: -np.log(w) for held, w in zip(MODELS, (8, 4, 4, 1), strict=True)}
    assert probability_of(0, costs) == pytest.approx(12 / 17)
    costs = {held: -np.log(w) for held, w in zip(MODELS, (90, 15, 0.5, 1), strict=True)}
    assert probability_of(0, costs) == pytest.approx(105 / 106.5)
    assert probability_of(1, costs) == pytest.approx(90.5 / 106.5)
    assert probability_of(0, {**costs, frozenset(): np.inf, frozenset({1}): np.inf}) == 1


@pytest.mark.parametrize("seed", range(2))
def test_white_noise_is_a_match(seed):
    truth = truth_of()
    found = diagnose(honest(truth), [recorded(truth, seed)])
    assert (found.verdict, found.findings) == ("match", ())


def test_a_fit_from_values_without_a_reading_starts_from_nothing(square):
    found, _ = square
    start, whitened = found.start, found.whitened
    wild = tuple(replace(t, values=(1e200,) * len(t.names)) for t in start.nuisance)
    with np.errstate(over="ignore", invalid="ignore"):
        again = refit(replace(start, nuisance=wild), whitened)
    assert again.deviance == pytest.approx(refit(start, whitened).deviance, rel=1e-6)
