"""Acceptance over runs: a correct method whose error is at the bound it states is accepted; one
that breaks a limit in the mean, in one seed or in one parameter is not.
"""

import numpy as np
import pytest
from fake_runs import NAMES, SIGMA, at_the_bound, drawn, geometry, rows_of, scenario
from scipy.stats import binom, chi2, kstest
from statistics_helpers import FALSE_ALARM, rng_of

from tiltcal.validation.accuracy import effective_dof
from tiltcal.validation.limits import limits_of, rms_interval

VERIFICATIONS = 2000


def judged(rows, **accept):
    """The limits by name."""
    case = scenario(**accept)
    return {limit.name: limit for limit in limits_of(case, case.method[0], rows)}


def broken(rows, **accept):
    """Names of the limits that are not kept."""
    return [name for name, limit in judged(rows, **accept).items() if not limit.passed]


@pytest.mark.parametrize("runs", [1, 3, pytest.param(20, marks=pytest.mark.long)])
def test_a_correct_method_at_its_bound_is_accepted(runs):
    rng, limits = rng_of(f"correct {runs}"), at_the_bound()
    case = scenario(**limits)
    rejected = 0
    for _ in range(VERIFICATIONS):
        found = limits_of(case, case.method[0], rows_of(drawn(rng, runs)))
        rejected += not all(limit.passed for limit in found)
    assert rejected <= binom.isf(FALSE_ALARM, VERIFICATIONS, case.method[0].accept.false_alarm)


def test_the_tests_of_a_method_may_fail_as_often_as_they_say():
    good, suspect = (
        rows_of(drawn(rng_of("tests")), tests=4, verdict=v) for v in ("good", "suspect")
    )
    assert broken([suspect[0], *good[1:]]) == []
    assert broken(suspect[:6] + good[6:]) == ["verdict (suspect x6, good x14)"]
    lost = rows_of(drawn(rng_of("tests")), tests=4, verdict="cannot_tell")
    assert broken([lost[0], *good[1:]]) == ["verdict (cannot_tell x1, good x19)"]


# --------------------------------------------------------------------------------------------------
# ------ what breaks a limit


@pytest.mark.parametrize("name", ["tilt_arcsec", "better_by"])
def test_an_expected_error_slightly_beyond_a_limit_is_rejected(name):
    limit = at_the_bound()[name]
    slightly = limit * 1.02 if name == "better_by" else limit / 1.02
    rng = rng_of(f"slightly beyond {name}")
    for _ in range(50):
        names = broken(rows_of(drawn(rng)), **{name: slightly})
        assert any(n.endswith("expected by the covariance") for n in names)


@pytest.mark.parametrize(("name", "limit"), at_the_bound().items())
def test_a_mean_error_beyond_a_limit_is_rejected_whatever_the_method_states(name, limit):
    rng = rng_of(f"beyond {name}")
    for _ in range(50):
        rows = rows_of(1.6 * drawn(rng))
        names = broken(rows, parameters=False, **{name: limit})
        assert any(n.startswith("tilt error") for n in names)


def test_a_systematic_error_gets_no_chance_beyond_that_of_the_stated_bound():
    # the same error in every run, 2 % beyond the limit, of a method that states a third of it
    error = drawn(rng_of("systematic"), 1).repeat(20, axis=0)
    size = float(np.linalg.norm(geometry().tilt @ error[0]))
    rows = rows_of(error, stated=0.2 * size / geometry().bound)
    arcsec = size / 1.02 * 648000 / np.pi
    assert "tilt error, arcsec rms" in broken(rows, parameters=False, tilt_arcsec=arcsec)
    assert broken(rows, parameters=False, tilt_arcsec=arcsec * 1.03) == []


@pytest.mark.parametrize(("parameters", "factor"), [(True, 4.0), (False, 6.0)])
def test_one_seed_of_twenty_is_enough(parameters, factor):
    rng = rng_of(f"one seed {parameters}")
    for _ in range(50):
        errors = drawn(rng)
        errors[13] *= (
            factor * 12**0.5 / np.linalg.norm(np.linalg.solve(geometry().factor, errors[13]))
        )
        found = judged(
            rows_of(errors), parameters=parameters, **({} if parameters else at_the_bound())
        )
        names = [name for name, limit in found.items() if not limit.passed]
        assert any("seed 13" in found[name].where for name in names)


@pytest.mark.parametrize("k", range(12))
def test_a_mean_error_of_two_sigma_in_one_parameter_is_rejected(k):
    rng = rng_of(f"one parameter {k}")
    for _ in range(10):
        errors = drawn(rng)
        errors[:, k] += 2 * SIGMA[k]
        found = judged(rows_of(errors))["parameters, mean error over its sigma, worst parameter"]
        assert not found.passed
        assert found.where == NAMES[k]


def test_one_parameter_of_one_seed_is_enough():
    rng = rng_of("one parameter of one seed")
    for _ in range(50):
        errors = drawn(rng)
        errors[7, 4] = 9 * SIGMA[4]
        found = judged(rows_of(errors))["parameters, largest error, sigma"]
        assert not found.passed
        assert found.where == "accel.scale_y, seed 7"


def test_a_sigma_that_is_too_large_is_rejected_and_so_is_none():
    rng = rng_of("sigmas")
    assert "parameters, NEES per degree of freedom" in broken(rows_of(drawn(rng), stated=1.5))
    rows = rows_of(drawn(rng))
    sure = [
        p if p.name != "accel.bias_y" else type(p)(p.name, "1", 0.0, 0.0, 0.0)
        for p in rows[3].parameters
    ]
    rows[3] = type(rows[3])(**{**vars(rows[3]), "parameters": tuple(sure)})
    found = judged(rows)["parameters against the truth"]
    assert (found.passed, found.where) == (False, "accel.bias_y")


# --------------------------------------------------------------------------------------------------
# ------ what has to be there


def without(rows, *names):
    """Rows that lack these parameters."""
    return [
        type(r)(**{**vars(r), "parameters": tuple(p for p in r.parameters if p.name not in names)})
        for r in rows
    ]


def test_a_missing_parameter_is_named():
    rows = rows_of(drawn(rng_of("missing")))
    found = judged(without(rows, "accel.cross_zy"))["required parameters that are missing"]
    assert (found.passed, found.reached, found.where) == (False, 1.0, "accel.cross_zy")
    some = without(rows[:2], "accel.cross_zy") + rows[2:]
    where = judged(some)["required parameters that are missing"].where
    assert where == "accel.cross_zy in 2 of 20 runs"
    only = without(rows, *(n for n in NAMES if n != "accel.bias_x"))
    assert judged(only)["required parameters that are missing"].reached == 11


def test_the_scenario_may_say_which_are_required():
    rows = without(rows_of(drawn(rng_of("required"))), *(n for n in NAMES if "cross" in n))
    assert broken(rows, required=["accel.bias", "accel.scale_x"]) == []
    names = broken(rows, required=["accel.bias", "accel.K2_x"])
    assert names == ["required parameters that are missing"]
    assert broken(rows, parameters=False, required=["accel.cross"])


def test_a_limit_of_the_tilt_needs_a_tilt_error():
    rows = rows_of(drawn(rng_of("no tilt")))
    rows[4] = type(rows[4])(**{**vars(rows[4]), "tilt_before": None, "tilt_after": None})
    found = judged(rows, tilt_arcsec=100.0)["runs with a tilt error"]
    assert (found.passed, found.reached, found.where) == (False, 19.0, "seed 4")


# --------------------------------------------------------------------------------------------------
# ------ the statistics


def test_equal_weights_are_counted_and_a_constant_part_is_not():
    assert effective_dof(np.ones(5)) == 5.0
    assert effective_dof(np.array([4.0, 1.0, 1.0, -1e-20])) == 1.5
    # noncentral: variance 2 w (total + constant) at most
    assert effective_dof(np.ones(4), constant=4.0) == pytest.approx(8 / 1.5)
    assert effective_dof(np.zeros(3)) == effective_dof(np.array([])) == 1.0


def test_the_chance_of_an_rms_is_at_least_that_of_its_quadratic_form():
    g = geometry()
    errors = drawn(rng_of("chance"), 20000)
    ratio = np.sum((errors @ g.tilt.T) ** 2, axis=1) / g.bound**2
    assert np.mean(ratio) == pytest.approx(1.0, abs=5 * np.std(ratio) / 20000**0.5)
    for share in (1e-2, 1e-3):
        beyond = np.mean(ratio > chi2.isf(share, g.dof) / g.dof)
        assert beyond <= binom.isf(FALSE_ALARM, 20000, share) / 20000


def test_the_interval_of_an_rms_holds_it_in_95_of_100():
    values = np.sqrt(chi2.rvs(7, size=4000, random_state=rng_of("interval")) / 7)
    inside = sum(low <= 1 <= high for low, high in (rms_interval(v, 7) for v in values))
    assert binom.ppf(FALSE_ALARM, 4000, 0.95) <= inside <= binom.isf(FALSE_ALARM, 4000, 0.95)


def test_the_nees_of_the_fake_method_is_a_chi_square():
    nees = [r.nees for r in rows_of(drawn(rng_of("nees"), 500))]
    assert kstest(nees, "chi2", args=(12,)).pvalue > FALSE_ALARM
