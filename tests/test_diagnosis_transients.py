"""What comes to a reading at an instant and goes away again is looked for at its instant; a burst
of noise is none.
"""

import re

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten
from scipy.fft import dct

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.families import completes
from tiltcal.diagnosis.hypotheses.hypothesis import step_hypotheses
from tiltcal.diagnosis.hypotheses.instants import Instant
from tiltcal.diagnosis.lines.transients import (
    ResidualCourse,
    _chosen,
    _courses,
    _powers,
    transients,
)
from tiltcal.diagnosis.search.scan import Scan

WHITE = 25e-6 * 9.81 * np.sqrt(25.0)  # of a sample, m/s2
BEGIN = 100.3  # s
KNOCKS = (40.2, 100.3, 151.8)  # s


def knocked(instants, size: float, fall: float = 3.0, seed: int = 4):
    """A recording whose x rises by a number of sigma in a second and falls with a time constant."""
    whole = recorded(bench(), seed)
    since = (whole.time - whole.time[0])[:, None] - np.array(instants)
    course = np.where(since < 0, np.clip(1 + since, 0, 1), np.exp(-np.maximum(since, 0) / fall))
    x = whole.column("accel_x_m_s2") + size * WHITE * course.sum(axis=1)
    return rewritten(whole, accel_x_m_s2=x)


def found_in(recording):
    prepared = prepare(honest(bench()), [recording])
    return transients(prepared.start, prepared.whitened)


@pytest.mark.parametrize("seed", range(4))
def test_in_noise_none_is_worth_what_any_curve_has_to_be(seed):
    """Curves are two hundred: one of them alone has prior odds of a thousandth."""
    prepared = prepare(honest(bench()), [recorded(bench(), seed)])
    for hypothesis in transients(prepared.start, prepared.whitened):
        whitened = prepared.whitened.alone([hypothesis], prepared.start.effects)
        factor = Scan(whitened).log_bayes_factors(prepared.start)[0]
        assert factor + hypothesis.log_odds < np.log(1000)


def test_there_is_none_in_a_burst_of_noise(rng):
    """Six times the noise for 6 s: a matched filter by the mean noise would find several."""
    whole = recorded(bench(), 5)
    within = np.abs(whole.time - whole.time[0] - BEGIN) < 3
    burst = 6 * WHITE * rng.standard_normal(len(within)) * within
    assert found_in(rewritten(whole, accel_x_m_s2=whole.column("accel_x_m_s2") + burst)) == []


def test_gross_values_side_by_side_are_no_transient(rng):
    """Two rows that are 30 sigma off explain no more than two of 4 sigma; a transient of 2 sigma
    that falls with 15 rows explains its energy, 4 sigma2 (15 / 2 + 5 / 3).
    """
    time = np.arange(2000) * 0.1
    left = 0.2 * rng.standard_normal(2000)
    left[500:502] = 30.0
    course = ResidualCourse(0.5, 1.5)
    values, peak = course.sampled(0.1)
    left[1500 - peak : 1500 - peak + len(values)] += 2 * values
    (power,) = _powers(dct(left, norm="ortho"), np.ones(2000), time, [course])
    assert power[450:550].max() < 8.0
    assert power[1500] == pytest.approx(4 * (15 / 2 + 5 / 3), rel=0.2)


def test_a_pause_of_days_holds_none():
    """Transients as long as a share of it would be longer than all samples."""
    time = np.arange(512) / 8
    paused = time + 2.0**20 * (time > 30)
    assert _courses(paused) == _courses(time) != []


def told(hypotheses, instants):
    """Whether one of some hypotheses has a transient at each of these instants, s."""
    return any(
        all(np.abs(np.array(h.effect.instants) - t).min() < 1.5 for t in instants)
        for h in hypotheses
    )


def test_knocks_have_a_hypothesis_at_their_instants():
    found = found_in(knocked(KNOCKS, 3.0))
    assert {(h.effect.sensor, h.effect.axis) for h in found} == {("accel", "x")}
    assert told(found, KNOCKS)


def test_the_price_of_instants_is_that_of_choosing_them():
    """Of 200 places of 1 s one costs log 200, two log(200 199 / 2); each size 2 nats."""
    power = np.zeros(2001)
    power[[500, 1500]] = 60.0, 40.0
    course = ResidualCourse(1.0, 3.0)
    rows, worth, price = _chosen(power, np.arange(2001) / 10, course)
    assert rows.tolist() == [500, 1500]
    assert price == pytest.approx(np.log(200 * 199 / 2))
    assert worth == pytest.approx(50 - 4 - price)
    power[1500] = 2 * np.log(199 / 2) + 3.9
    assert _chosen(power, np.arange(2001) / 10, course)[0].tolist() == [500]


def test_transients_complete_no_step():
    """A step that comes back is no step with a transient as its deviation."""
    found = found_in(knocked(KNOCKS, 3.0))
    steps = [h for h in step_hypotheses(honest(bench()), [Instant(BEGIN)]) if h.is_step]
    assert steps
    assert not any(completes(t, step) for t in found for step in steps)


def test_knocks_are_an_addition_at_their_instants():
    """Of the instants that were looked at those that explain nothing beside the others are out."""
    found = diagnose(honest(bench()), [knocked(KNOCKS, 3.0)])
    told = (
        "accel x that follows time: transients at 40.[0-9], 100.[0-9] and 15[12].[0-9] s that fall"
    )
    assert re.search(told, found.statement)


def test_a_knock_is_an_addition_over_time_that_no_other_recording_repeats():
    found = diagnose(honest(bench()), [knocked([BEGIN], 4.0, 2.0)])
    assert found.verdict == "unlisted"
    assert "accel x that follows time: transients at 100." in found.statement
    assert "Another recording need not repeat it" in found.statement
