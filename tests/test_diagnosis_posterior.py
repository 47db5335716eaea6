"""What a model is worth: Bayes factors, priors, and the evidence for every hypothesis at once, held
to quadrature and to dense linear algebra.
"""

from copy import copy
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, tumble
from scipy.integrate import quad
from scipy.special import logsumexp
from scipy.stats import norm

from tiltcal.core.units import G0
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, listed_hypotheses
from tiltcal.diagnosis.hypotheses.priors import UNLISTED_SHARE, log_priors
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.noise_prior import noise_price
from tiltcal.diagnosis.model.normal_equations import normal_equations
from tiltcal.diagnosis.model.refitting import PRIOR, log_det_information, refit
from tiltcal.diagnosis.model.score_test import ENERGIES, SIZES, SURVIVES, any_of, log_bayes_factor
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.candidates import (
    Candidate,
    _is_again,
    imitation_odds,
    name_probabilities,
    partial_matches,
)
from tiltcal.diagnosis.search.column_selection import ColumnSelection, NumberEvidence
from tiltcal.diagnosis.search.dictionary import build_dictionary
from tiltcal.diagnosis.search.explanation import explain, explanation_of, level_beside, local_level
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import State
from tiltcal.effects import CATALOGUE
from tiltcal.effects.spans import SpectralLines
from tiltcal.statistics.noise_spectrum import NoiseFit, WhiteFlickerWalk

K2 = {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 800.0}


def prepared(*left_out, seed=8):
    """A short tumble from which these were left out, with every hypothesis."""
    truth = bench(*left_out, swing_degC=3.0, period_s=60.0)
    table = truth.model_dump(exclude_defaults=True, by_alias=True)
    truth = type(truth).model_validate({"schema": 1, **table, "sequence": tumble(12)})
    found = prepare(honest(truth), [recorded(truth, seed)])
    build_dictionary(found.whitened, found.start, SpectralLines())
    return found


@pytest.fixture(scope="module")
def square():
    """A recording with a square of the input that nothing in the scenario accounts for."""
    return prepared(K2)


def test_a_model_without_causes_costs_its_marginal_likelihood_over_the_adjustable_terms(square):
    """Of whitened readings y = C b + noise, with b normal about nothing: y is normal with the
    covariance 1 + PRIOR^2 C C', and the cost holds minus the logarithm of its density.
    """
    fitted = refit(square.start, square.whitened)
    values = [
        value / term.hypothesis.size(name)
        for term in fitted.nuisance
        for name, value in zip(term.names, term.values, strict=True)
    ]
    C = np.zeros((sum(len(r) for r in fitted.residual), len(fitted.columns)))
    starts = np.cumsum([0, *(len(r) for r in fitted.residual)])
    for k, column in enumerate(fitted.columns):
        for i, part in column.parts.items():
            C[starts[i] : starts[i + 1], k] = part
    assert C.shape[1] == len(values) == 12
    y = np.concatenate(fitted.residual) + C @ values
    covariance = np.eye(len(y)) + PRIOR**2 * C @ C.T
    told = y @ np.linalg.solve(covariance, y) + np.linalg.slogdet(covariance)[1]
    fit = fitted.deviance + fitted.penalty + log_det_information(fitted)
    assert fit == pytest.approx(told, abs=0.1)
    assert log_det_information(fitted) > 50


def by_quadrature(gain, variance, info):
    """log of the mean likelihood ratio of a size over its prior, against no size."""
    z, sigma = np.sqrt(gain * info), np.sqrt(variance)
    middle, width = z * variance / (1 + variance * info), sigma / np.sqrt(1 + variance * info)
    top = z * middle - info * middle**2 / 2 - (middle / sigma) ** 2 / 2

    def ratio(x):
        return np.exp(z * x - info * x**2 / 2 - (x / sigma) ** 2 / 2 - top)

    area, _ = quad(ratio, middle - 12 * width, middle + 12 * width, epsabs=0, epsrel=1e-11)
    return top + np.log(area / (sigma * np.sqrt(2 * np.pi)))


@pytest.mark.parametrize("info", [0.02, 3.0, 1e4])
@pytest.mark.parametrize("gain", [0.0, 1.0, 25.0, 4e4])
def test_a_bayes_factor_is_the_mean_likelihood_over_the_prior(gain, info):
    widths = np.array([1e-4, 0.1, 5.0])
    one_by_one = [by_quadrature(gain, v, info) for v in widths]
    for v, expected in zip(widths, one_by_one, strict=True):
        found = log_bayes_factor(np.array([gain]), np.array([[v * info]]))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    mixed = log_bayes_factor(np.array([gain]), widths[:, None] * info)
    np.testing.assert_allclose(mixed, logsumexp(one_by_one) - np.log(3), rtol=1e-9, atol=1e-9)


def test_each_direction_has_its_own_bayes_factor():
    gain, info = np.array([4.0, 90.0, 0.0]), np.array([1.0, 70.0, 1e6])
    together = log_bayes_factor(gain, SIZES[:, None] * info)
    alone = [log_bayes_factor(gain[[k]], SIZES[:, None] * info[[k]])[0] for k in range(len(gain))]
    np.testing.assert_allclose(together, alone)


@pytest.mark.parametrize("factors", [[-3.0], [2.0], [0.0, 0.0], [-1.0, 0.0, 2.0], [-40.0, -50.0]])
def test_every_set_of_at_least_one_direction_is_as_probable_as_another(factors):
    every = (s for n in range(1, len(factors) + 1) for s in combinations(factors, n))
    sums = [sum(s) for s in every]
    expected = logsumexp(sums) - np.log(len(sums))
    np.testing.assert_allclose(any_of(np.array([factors])), [expected], rtol=1e-9, atol=1e-9)


def test_a_single_direction_says_what_its_bayes_factor_says():
    factors = np.array([[-30.0], [-1.0], [0.0], [2.0], [800.0]])
    np.testing.assert_allclose(any_of(factors), factors[:, 0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("gain", [1.0, 100.0, 3000.0, 1e6])
def test_a_name_may_be_a_share_of_a_law_that_no_list_has(gain):
    """The mean over all shares of the chance that the rest hides among 500 directions."""
    limit = np.sqrt(2 * np.log(500))

    def hidden(share):
        rest = np.sqrt(gain * share / (1 - share))
        return norm.cdf(limit - rest)

    edge, far = (e / (gain + e) for e in (limit**2, (limit + 9) ** 2))
    unseen = sum(quad(hidden, *ends, limit=200)[0] for ends in ((0, edge), (edge, far)))
    assert np.exp(imitation_odds(gain, 500)) == pytest.approx(unseen / 3, rel=1e-3)


def test_a_name_that_is_in_the_model_twice_is_doubted():
    """A quarter of laws is unlisted; names are taken for 15 % of these, 27 % of them twice; of
    listed laws 2.4 % are twice: 0.25 0.15 0.27 to 0.75 0.024, 9 to 16.
    """
    rows = [
        Candidate("acc_warmup", 40.0, 45.0, 45.0, 100.0),
        Candidate("acc_temp_bias", 30.0, 35.0, 35.0, 80.0),
    ]
    once = list(partial_matches(rows, 500, again=False))
    twice = list(partial_matches(rows, 500, again=True))
    assert [r.name for r in twice] == ["unlisted", "unlisted"]
    assert np.exp(twice[0].score - 40.0) == pytest.approx(9 / 16)
    assert once[0].score < twice[0].score
    assert once[1].score == twice[1].score


def test_a_name_is_twice_in_a_model_at_two_shapes_or_as_two_causes(square):
    shapes = [h for h in square.whitened.hypotheses if h.id == "acc_warmup"][:2]
    other = next(h for h in square.whitened.hypotheses if h.id == "acc_K2")
    curve = next(h for h in square.whitened.hypotheses if not h.listed)
    assert shapes[0].place == shapes[1].place

    def again(*hosted):
        terms = [replace(FittedTerm.start(h), host=host) for h, host in hosted]
        return _is_again(State(replace(square.start, terms=tuple(terms)), square.whitened), 0)

    first, second = shapes
    assert again((first, None), (second, first))
    assert again((first, None), (second, None))
    assert not again((first, None))
    assert not again((first, None), (other, None))
    assert not again((first, None), (curve, first))
    assert not again((curve, None), (curve, curve))


def test_a_tone_of_several_frequencies_is_one_name(square):
    observations = square.whitened.observations
    span = ranges_of(observations, SpectralLines((2.3, 4.1)))
    lines = [
        h for h in listed_hypotheses(observations.scenario, span, ()) if h.id == "mains_pickup"
    ]
    tones = [next(h for h in lines if abs(h.line_hz - f) < 0.1) for f in (2.3, 4.1)]
    assert tones[0].place == tones[1].place
    terms = (FittedTerm.start(tones[0]), replace(FittedTerm.start(tones[1]), host=tones[0]))
    assert not _is_again(State(replace(square.start, terms=terms), square.whitened), 0)


def test_priors_sum_to_one_and_a_quarter_is_of_no_list(square):
    hypotheses = square.whitened.hypotheses
    prior = np.exp(log_priors(hypotheses))
    listed = np.array([h.listed for h in hypotheses])
    # a transient has its share of the instants that were looked at
    passing = np.array([bool(getattr(h.effect, "instants", ())) for h in hypotheses])
    prior[passing] /= np.exp(
        [h.log_odds for h, there in zip(hypotheses, passing, strict=True) if there]
    )
    assert prior.sum() == pytest.approx(1.0)
    assert prior[~listed].sum() == pytest.approx(UNLISTED_SHARE)


def test_shapes_of_one_place_share_its_prior(square):
    """An effect that is tried at ten shapes is no more probable than one that has one."""
    hypotheses = square.whitened.hypotheses
    prior = np.exp(log_priors(hypotheses))
    free = {h.id for h in hypotheses if h.alias}
    places = {}
    for h, p in zip(hypotheses, prior, strict=True):
        if h.listed and h.id not in free:
            places.setdefault(h.place, []).append(p)
    counts = [len(each) for each in places.values()]
    assert (min(counts), max(counts) > 5) == (1, True)
    for each in places.values():
        assert sum(each) == pytest.approx(sum(places["acc_K2", "accel", None]))
        np.testing.assert_allclose(each, each[0])


def test_half_of_a_name_with_a_textbook_form_is_that_form(square):
    """A lag that hardly shows is no more probable than the law without it."""
    hypotheses = square.whitened.hypotheses
    prior = np.exp(log_priors(hypotheses))
    own = [h.id == "acc_temp_scale" and h.effect.sensor == "accel" for h in hypotheses]
    textbook = np.array([mine and h.alias is None for mine, h in zip(own, hypotheses, strict=True)])
    curves = np.array(own) & ~textbook
    assert curves.sum() > 10 * textbook.sum() > 0
    assert prior[textbook].sum() == pytest.approx(prior[curves].sum())


@pytest.mark.parametrize(
    ("time", "dear"),
    [(np.arange(100) / 10.0, True), (np.repeat(np.arange(20.0), 5), False), (np.zeros(1), False)],
    ids=["in time", "several at one instant", "a single one"],
)
def test_a_walk_is_improbable_of_a_channel_that_runs_in_time_only(square, time, dear):
    walk = WhiteFlickerWalk(1e-3, 0.0, 1.0)
    channel = replace(square.observations.channels[0], time=time)
    observations = copy(square.observations)
    observations.channels = (channel,)
    columns = HypothesisColumns(observations)
    roots, fits = (np.ones(len(time)),), (NoiseFit.known(walk),)
    price = noise_price(WhitenedModel(columns, (walk,), roots, fits=fits))
    assert (price > 10) == dear
    assert price == 0 or dear


def dense_factor(found, hypothesis):
    """Evidence for one hypothesis in the residual of the start, by the singular vectors of its
    columns.
    """
    start, whitened = found.start, found.whitened
    lengths = [len(r) for r in start.residual]
    columns = []
    for name in hypothesis.names:
        changes = found.observations.changes(hypothesis.alone(name), start.effects)
        waves = whitened.whiten(changes)
        columns.append(np.concatenate([waves.get(i, np.zeros(n)) for i, n in enumerate(lengths)]))
    raw = np.linalg.norm(columns, axis=1)
    unit = np.column_stack(columns) / np.maximum(raw, 1e-150)
    basis = np.concatenate(start.basis)
    left, root, turn = np.linalg.svd(unit - basis @ (basis.T @ unit), full_matrices=False)
    there = root**2 > SURVIVES
    gain = (left.T @ np.concatenate(start.residual))[there] ** 2
    info = (root**2 * (turn**2 @ raw**2))[there]
    ratio = SIZES[:, None] * info if hypothesis.has_plausible_size else ENERGIES[:, None] + 0 * info
    factors = np.zeros((1, len(hypothesis.names)))  # what the calibration takes up says nothing
    factors[0, : len(gain)] = log_bayes_factor(gain, ratio)
    return float(any_of(factors)[0])


def test_the_scan_is_what_dense_algebra_says(square):
    """Columns are held in single precision."""
    whitened = square.whitened
    found = Scan(whitened).log_bayes_factors(square.start)
    which = (
        np.linspace(0, len(found) - 1, 60).astype(int).tolist() + np.argsort(-found)[:20].tolist()
    )
    expected = [dense_factor(square, whitened.hypotheses[k]) for k in which]
    np.testing.assert_allclose(found[which], expected, rtol=2e-3, atol=0.1)


def test_the_scan_does_not_depend_on_the_order_of_the_hypotheses(square):
    """Beyond single precision: rounding of inner products over n rows, sqrt(n) units in the last
    place, counts the more, the less of a column the calibration leaves.
    """
    whitened, start = square.whitened, square.start
    some = whitened.hypotheses[::7]
    scans = [Scan(whitened.alone(each, start.effects)) for each in (some, some[::-1])]
    there, back = (scan.log_bayes_factors(start) for scan in scans)
    assert there.max() > 100
    rows = max(len(c.values) for c in square.observations.channels)
    rounding = np.sqrt(rows) * np.finfo(np.float32).eps
    off = np.abs(there - back[::-1])
    assert (off < 1e-3 + rounding / least_shares(scans[0], start) * np.abs(there)).all()


def least_shares(scan, start):
    """The least share of its columns that the calibration leaves of each hypothesis, of those that
    count, (hypotheses,).
    """
    along, found = scan.products.along(start), []
    columns = scan._whitened.columns
    for k, h in enumerate(columns.hypotheses):
        (inner,) = scan.products.own.of(np.array([k]))
        if not inner.any():
            found.append(1.0)
            continue
        inside = along[columns.starts[k] : columns.starts[k] + len(h.names), 1:]
        raw = np.sqrt(np.diag(inner))
        raw[raw == 0] = np.inf
        shares = np.linalg.eigvalsh((inner - inside @ inside.T) / np.outer(raw, raw))
        found.append(min(shares[shares > SURVIVES], default=1.0))
    return np.array(found)


def test_an_explanation_is_worth_the_same_when_it_is_weighed_again(square):
    """Whatever the order of its numbers, and without those that calibration takes: else one model
    has two costs.
    """
    start, whitened = square.start, square.whitened
    best = np.argsort(-Scan(whitened).log_bayes_factors(start))
    completed = 0
    for k in best[:60]:
        told = explain(int(k), start, whitened)
        again = explanation_of(told.terms, told.tried, start, whitened)
        assert again.evidence == pytest.approx(told.evidence, abs=0.01), told.hypothesis
        assert again.gain == pytest.approx(told.gain, abs=0.01)
        completed += len(told.terms) > 1
    assert completed > 3


def test_what_no_longer_explains_anything_of_a_cause_costs_its_price(square):
    """The chance of one in 1 + tried that it is in use, and half the logarithm of how much wider
    its prior is than it is known.
    """
    start, whitened = square.start, square.whitened
    columns, checked = whitened.columns, 0
    for k in np.argsort(-Scan(whitened).log_bayes_factors(start))[:20]:
        told = explain(int(k), start, whitened)
        idle = [whitened.hypotheses[m] for m in columns.family(int(k))][-1:]
        if told is None or not idle or idle[0] in [t.hypothesis for t in told.terms]:
            continue
        further = FittedTerm(idle[0], idle[0].names[-1:], (0.0,), told.hypothesis)
        again = explanation_of([*told.terms, further], told.tried, start, whitened)
        lost = told.evidence - again.evidence
        assert lost > np.log(1 + told.tried) - again.numbers[-1].gain / 2
        assert again.coarsely(1.0) == pytest.approx(told.coarsely(1.0), abs=0.01)
        checked += 1
    assert checked > 3


def test_a_size_that_the_recording_cannot_see_says_nothing():
    """The mean over the sets of at least one of three sizes, one of which calibration takes up."""
    info, target = np.array([400.0, 300.0, 0.0]), np.array([200.0, 1.0, 0.0])
    raw = np.array([400.0, 300.0, 200.0])
    selection = ColumnSelection(
        np.diag(info), target, raw, np.ones(3, bool), np.zeros((1, 3)), True
    )
    selection.add_sizes()
    factors = log_bayes_factor(target[:2] ** 2 / info[:2], SIZES[:, None] * info[:2])
    sets = (s for n in (1, 2, 3) for s in combinations((*factors, 0.0), n))
    sums = [sum(s) for s in sets]
    found = selection.choice + sum(n.evidence for n in selection.numbers)
    assert found == pytest.approx(logsumexp(sums) - np.log(7), abs=1e-6)


@pytest.mark.parametrize("coarse", [1.0, 3.0, 20.0])
def test_where_the_likelihood_is_coarsened_a_gain_counts_less_and_a_prior_does_not(coarse):
    """Against the integral over the size, of a normal prior: 50 of deviance, prior sigmas 3 and 40
    times that of the estimate.
    """

    def integral(width):
        def integrand(u):
            return np.exp((u * np.sqrt(50.0) - u * u / 2) / coarse - (u / width) ** 2 / 2)

        return quad(integrand, -200, 200, points=(0.0, 7.0), limit=500)[0] / (
            width * np.sqrt(2 * np.pi)
        )

    number = NumberEvidence(50.0, np.array([3.0, 40.0]) ** 2, needed=True)
    by_hand = np.log(np.mean([integral(width) for width in (3.0, 40.0)]))
    assert number.at(coarse) == pytest.approx(by_hand, abs=1e-6)
    optional = replace(number, price=2.0, needed=False)
    assert optional.at(coarse) == pytest.approx(max(by_hand - 2.0, 0.0), abs=1e-6)


def shaking(frequency):
    """A line of the base at both phases."""
    names = ("ec", "es")
    effect = CATALOGUE["base_vibration"](
        {**dict.fromkeys(names, 1e-3 * G0), "frequency": frequency}, None, None, "found"
    )
    return Hypothesis(effect, names)


def level_of(found, hypothesis):
    return local_level(hypothesis, (), found.start, found.whitened)


def lines(*frequencies):
    return [{"id": "base_vibration", "ec_ug": 300.0, "frequency_hz": f} for f in frequencies]


@pytest.mark.parametrize("frequency", [0.7, 2.0, 4.0])
def test_the_level_of_white_noise_is_one(frequency):
    assert 1.0 <= level_of(prepared(), shaking(frequency)) < 1.5


def test_a_line_does_not_raise_its_own_level_but_many_raise_that_of_each():
    alone, among = prepared(*lines(2.0)), prepared(*lines(*np.arange(1.5, 2.7, 0.05)))
    assert level_of(among, shaking(2.0)) > 10 * level_of(alone, shaking(2.0))
    assert level_of(alone, shaking(2.0)) < 3


def test_the_level_from_normal_equations_is_that_from_the_columns():
    """Of a law with what completes it."""
    truth = bench(*lines(2.0), *lines(2.1))
    found = prepare(honest(truth), [recorded(truth, 8)])
    build_dictionary(found.whitened, found.start, SpectralLines(tones=(2.0,), shakes=(2.0,)))
    columns, whitened = found.whitened.columns, found.whitened
    fitted = refit(found.start, whitened)
    several = [k for k, h in enumerate(whitened.hypotheses) if h.line_hz and columns.family(k)]
    assert several
    for k in several[:6]:
        members = [k, *columns.family(k)]
        equations = normal_equations(members, fitted.basis, fitted.residual, whitened)
        law, *family = (whitened.hypotheses[m] for m in members)
        level = local_level(law, family, fitted, whitened)
        assert level_beside(law, equations, fitted, whitened) == pytest.approx(level, rel=1e-4)


def test_what_is_no_line_has_no_level(square):
    k2 = next(h for h in square.whitened.hypotheses if h.id == "acc_K2")
    assert level_of(square, k2) == 1.0


@pytest.mark.parametrize(
    ("probabilities", "alike", "in_doubt"),
    [
        ({"a": 0.95, "b": 0.04, "unlisted": 0.01}, ("a",), False),
        ({"a": 0.8, "b": 0.15, "unlisted": 0.05}, ("a", "b"), False),
        ({"a": 0.85, "b": 0.02, "unlisted": 0.13}, ("a",), True),
        ({"a": 0.6, "unlisted": 0.25, "b": 0.15}, ("a", "b"), True),
        ({"a": 0.8, "unlisted": 0.1, "near": 0.1}, ("a", "near"), False),
    ],
)
def test_a_class_holds_the_cause_with_nine_tenths(probabilities, alike, in_doubt):
    """The fewest names that do, beside those that explain as much as the first: ``near``."""
    rows = [
        Candidate(name, float(np.log(p)), *2 * (0.0 if name == "near" else -100.0 * k,), 0.0)
        for k, (name, p) in enumerate(probabilities.items())
    ]
    names = name_probabilities(rows)
    assert names.alike == alike
    assert names.in_doubt == in_doubt
    assert names.perhaps == ()


@pytest.mark.parametrize(
    ("first", "other", "alike"),
    [(0.0, 0.0, ("a", "b")), (0.0, 20.0, ("a",)), (20.0, 20.0, ("a", "b"))],
)
def test_a_name_that_explains_as_much_only_where_it_deviates_is_no_equal(first, other, alike):
    """Of a law in its textbook form; of one that deviates itself it is. Evidence of 20 nats is that
    of the deviations.
    """
    likely = Candidate("a", 95.0, 100.0, 100.0, 200.0, deviation=first)
    less = Candidate("b", 91.0, 96.0, 96.0, 200.0, deviation=other)
    assert name_probabilities([likely, less]).alike == alike


def test_a_textbook_form_that_fits_as_well_is_in_the_class_however_many_sizes_it_takes():
    """Two more sizes cost 20 nats of evidence and no fit; a curve that fits better has no form."""
    likely = Candidate("a", 95.0, 100.0, 100.0, 200.0, textbook_gain=200.0)
    more = Candidate("b", 75.0, 80.0, 80.0, 200.2, textbook_gain=200.2)
    worse = Candidate("c", 75.0, 80.0, 80.0, 187.8, textbook_gain=187.8)
    curve = Candidate("d", 75.0, 80.0, 80.0, 220.0)
    names = name_probabilities([likely, more, worse, curve])
    assert set(names.alike) == {"a", "b"}
    assert {n: s for n, _, s in names.rivals} == pytest.approx({"b": 0.0, "c": 12.2, "d": 40.0})


def test_a_column_that_the_others_all_but_hold_has_no_evidence_for_what_it_explains():
    """Whatever deviance it takes off the fit is its price: two curves that nearly cancel are no
    cause.
    """
    info, raw = np.array([400.0, 0.1]), np.array([400.0, 400.0])
    selection = ColumnSelection(
        np.diag(info), np.array([200.0, 6.0]), raw, np.array([True, False]), np.ones((1, 2)), True
    )
    selection.take_sizes([0])
    selection.take_deviation([1], 1)
    assert selection.numbers[1].gain == pytest.approx(360.0)
    assert selection.numbers[1].evidence == pytest.approx(-np.log(2))


def test_a_size_is_plausible_up_to_its_widest_prior():
    """Ten plausible sizes: here 0.1 sigma each."""
    assert NumberEvidence(0.9, np.array([1e-4, 1.0])).plausible
    assert not NumberEvidence(4.0, np.array([1e-4, 1.0])).plausible


@pytest.mark.parametrize(
    ("probabilities", "perhaps"),
    [
        ({"unlisted": 0.92, "a": 0.08}, ()),
        ({"unlisted": 0.6, "a": 0.4}, ("a",)),
        ({"unlisted": 0.6, "a": 0.31, "b": 0.09}, ("a",)),
        ({"unlisted": 0.55, "a": 0.3, "b": 0.15}, ("a", "b")),
    ],
)
def test_beside_a_law_that_no_list_has_stand_the_names_of_nine_tenths(probabilities, perhaps):
    rows = [
        Candidate(name, float(np.log(p)), -100.0 * k, -100.0 * k, 0.0)
        for k, (name, p) in enumerate(probabilities.items())
    ]
    names = name_probabilities(rows)
    assert (names.perhaps, names.alike, names.in_doubt) == (perhaps, (), False)
