"""What differs from stop to stop: the noise within them, angles of their own, wrong labels, curves
with a jump.
"""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten
from scipy.special import logsumexp
from scipy.stats import binom, norm
from statistics_helpers import FALSE_ALARM, mean_band

from tiltcal.data_quality.spikes import off_neighbours
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.data_faults.setting_errors import (
    Rotations,
    beside_stops,
    find_setting_error,
)
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.channel_noise import noise_under, noise_within_stops
from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.search.random_settings import WIDTHS, common_width, is_systematic
from tiltcal.effects import CATALOGUE
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.noise_spectrum import NoiseFit, WhiteFlickerWalk

ARCSEC = np.radians(1 / 3600)
INDEX = {"id": "table_index_error", "axis": "outer", "sigma_arcsec": 60.0}
HYSTERESIS = {
    "id": "acc_hysteresis",
    "sensor": "accel",
    "hysteresis_z_ug": 600.0,
    "width_unitless": 0.2,
}


def prepared(truth, seed=4):
    return prepare(honest(truth), [recorded(truth, seed)])


@pytest.mark.parametrize("walk", [0.0, 0.3])
def test_noise_within_parts_of_a_record_is_that_of_the_record(walk, rng):
    parts = [
        rng.standard_normal(n)
        + walk * np.cumsum(rng.standard_normal(n))
        + 100 * rng.standard_normal()
        for n in [80, 60] * 40
    ]
    model = NoiseFit.within([cosines(part) for part in parts], WhiteFlickerWalk).model
    # 5600 samples: 1 %; what a walk takes of the white noise is less sure
    assert model.white == pytest.approx(1.0, rel=0.06)
    assert model.walk == pytest.approx(walk, abs=0.06)


def test_levels_of_stops_are_a_walk_to_the_whole_record_and_nothing_within_them():
    found = prepared(bench(INDEX))
    whole = noise_under(found.start, found.whitened.columns)
    within = noise_within_stops(found.start, found.whitened)
    assert within is not None
    slow, rest = (max(fit.model.walk for fit in fits) for fits in (whole, within))
    assert slow > 5 * rest  # within 4 s a walk hides below white noise up to a few 1e-5 a sample


def test_a_setting_error_is_told_beside_what_else_is_there():
    found = prepared(bench(INDEX, HYSTERESIS))
    names = ("hysteresis_z",)
    hypothesis = Hypothesis(
        CATALOGUE["acc_hysteresis"]({"hysteresis_z": 1e-4, "width": 0.2}, "accel"), names
    )
    fitted = refit(replace(found.start, terms=(FittedTerm.start(hypothesis),)), found.whitened)
    setting = find_setting_error(fitted, found.start, found.whitened, 300, 0.01)
    assert setting is not None
    assert setting.fault.effect.axis == "outer"
    # 31 draws: 13 %, four times that
    assert setting.fault.effect.value("sigma") == pytest.approx(np.radians(60 / 3600), rel=0.5)
    kept = beside_stops(fitted, setting.stops, found.whitened, 300)
    assert [t.hypothesis.id for t in kept.terms] == ["acc_hysteresis"]


@pytest.mark.parametrize(("share", "found"), [(0.01, True), (0.5, False)])
def test_a_law_that_explains_more_than_the_stops_hides_them_only_if_its_form_may(share, found):
    """A listed law leaves a hundredth of what it explains at most, a nameless curve half of it."""
    small = {**INDEX, "sigma_arcsec": 12.0}
    truth = bench(small, {"id": "acc_K2", "sensor": "accel", "k2_z_ug_g2": 800.0})
    had = prepared(truth)
    law = Hypothesis(CATALOGUE["acc_K2"]({"k2_z": 1e-4}, "accel"), ("k2_z",))
    fitted = refit(replace(had.start, terms=(FittedTerm.start(law),)), had.whitened)
    setting = find_setting_error(fitted, had.start, had.whitened, 300, share)
    assert (setting is not None) == found


def test_a_finding_that_the_stops_explain_as_well_falls():
    found = prepared(bench(INDEX))
    hypothesis = Hypothesis(
        CATALOGUE["table_encoder_2rev"]({"cos2": 1e-4, "sin2": 1e-4}, None, "outer"),
        ("cos2", "sin2"),
    )
    fitted = refit(replace(found.start, terms=(FittedTerm.start(hypothesis),)), found.whitened)
    setting = find_setting_error(fitted, found.start, found.whitened, 300, 0.01)
    assert setting is not None
    assert beside_stops(fitted, setting.stops, found.whitened, 300).terms == ()


def test_stops_that_agree_have_no_setting_error():
    found = prepared(bench())
    assert find_setting_error(found.start, found.start, found.whitened, 300, 0.01) is None


def independent(values, variances):
    """Rotations that are each told by themselves, and nothing else is fitted."""
    return Rotations(values / np.sqrt(variances), np.diag(1 / np.sqrt(variances)))


def test_the_spread_of_rotations_is_that_of_their_prior_whatever_is_fitted_beside(rng):
    """Six of 24 directions go to the calibration; a fifth of the variance is noise."""
    sigma, noise, found, errors = 20 * ARCSEC, 10 * ARCSEC, [], []
    for _ in range(400):
        kept = np.linalg.qr(rng.normal(size=(24, 24)))[0][:18]
        rotations = rng.normal(0.0, sigma, 24)
        told = kept @ rotations / noise + rng.normal(size=18)
        value, error = Rotations(told, kept / noise).spread()
        found.append(value)
        errors.append(error)
    variances = np.square(found)
    assert abs(variances.mean() - sigma**2) < mean_band(variances)
    # one standard deviation of a standard deviation of 400 draws is 3.5 %
    assert np.median(errors) == pytest.approx(np.std(found), rel=0.15)


def test_the_evidence_for_random_settings_is_that_of_a_variance_component(rng):
    """Against the densities of the normal distributions themselves."""
    variances = rng.uniform(0.5, 2.0, 12) * ARCSEC**2
    values = rng.normal(0.0, 8.0 * ARCSEC, 12)
    widths = np.sqrt(WIDTHS) * 20.0 * ARCSEC

    def density(width):
        return norm.logpdf(values, 0.0, np.sqrt(variances + width**2)).sum()

    expected = logsumexp([density(w) - density(0.0) for w in widths]) - np.log(len(widths))
    assert common_width(independent(values, variances)) == pytest.approx(expected)
    assert common_width(independent(np.zeros(12), variances)) < 0


def test_random_settings_follow_nothing_and_a_law_of_an_angle_or_the_past_is_not_random(rng):
    angle = rng.uniform(-np.pi, np.pi, 30)
    other = np.repeat(np.linspace(-2.0, 2.0, 6), 5)  # each comes back five times
    variances = np.full(30, ARCSEC**2)
    angles = {"outer": angle, "inner": other}
    noise = rng.normal(0.0, ARCSEC, 30)
    assert not is_systematic(
        independent(rng.normal(0.0, 20 * ARCSEC, 30) + noise, variances), angles
    )
    steep = 20 * ARCSEC * np.tanh((angle - 0.3) / 0.2)
    assert is_systematic(independent(steep + noise, variances), angles)
    levels = rng.normal(0.0, 20 * ARCSEC, 6)
    assert is_systematic(independent(np.repeat(levels, 5) + noise, variances), angles)
    lost = 6 * ARCSEC * np.cumsum(rng.random(30) < 0.3)  # counts, and they stay lost
    assert is_systematic(independent(lost + noise, variances), angles)


def test_settings_between_two_widths_of_the_prior_are_no_law(rng):
    """A Bayes factor against the truth exceeds 3 in a third of all cases at most (Markov)."""
    k = np.arange(31)
    angles = {"outer": np.radians(137.5 * k % 360), "inner": np.radians(222.5 * k % 360)}
    variances = np.full(31, ARCSEC**2)
    draws = rng.normal(0.0, np.sqrt(11.0**2 + 1.0) * ARCSEC, (300, 31))
    found = [is_systematic(independent(rotations, variances), angles) for rotations in draws]
    assert sum(found) <= binom.ppf(1 - FALSE_ALARM, 300, 1 / 3)


@pytest.mark.parametrize(("power", "alone"), [(9, False), (400, True)])
def test_a_law_that_is_strongest_at_one_stop_is_no_wrong_label(power, alone):
    """One other angle would mend the stop that is furthest off, but its neighbours are off as
    well.
    """
    truth = bench()
    sound = recorded(truth, 4)
    angle = sound.column("table_outer_deg")
    bent = angle + 5.0 * (angle / np.abs(angle).max()) ** power
    faults = prepare(honest(truth), [rewritten(sound, table_outer_deg=bent)]).faults
    assert any(f.effect.id == "data_pose_label" for f in faults) is alone


def test_a_jerk_where_a_move_ends_is_no_gross_error():
    truth = bench()
    sound = recorded(truth, 4)
    found = prepare(honest(truth), [sound])
    stop = found.observations.stops[0]
    begins = np.flatnonzero((stop[1:] >= 0) & (stop[:-1] < 0)) + 1
    x = sound.column("accel_x_m_s2").copy()
    x[begins[::3]] += 0.05
    assert (
        np.sum(
            off_neighbours(x - sound.column("accel_x_m_s2") + 1e-3 * np.sin(np.arange(len(x)))) > 8
        )
        >= len(begins[::3]) - 1
    )
    assert prepare(honest(truth), [rewritten(sound, accel_x_m_s2=x)]).faults == ()


def test_a_jump_over_an_angle_is_one_curve_and_not_two_steps_in_time():
    """Passed on the way there and on the way back: two steps of opposite signs would say the same
    with more.
    """
    truth = bench(table="vertical", sensor="incl")
    sound = recorded(truth, 6)
    angle = sound.column("table_outer_deg")
    steps = sound.column("incl_x_deg") + np.where(angle > 187.0, 0.1, 0.0)
    found = diagnose(honest(truth), [rewritten(sound, incl_x_deg=steps)])
    (finding,) = found.findings
    assert finding.effect is None
    assert (finding.axes, finding.where.coordinate) == (("x",), "table_outer")
