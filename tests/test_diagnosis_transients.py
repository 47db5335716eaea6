"""What comes to a reading at an instant and goes away again is looked for at its instant; a burst
of noise is none.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.data_quality.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.search.transients import transients

WHITE = 25e-6 * 9.81 * np.sqrt(25.0)  # of a sample, m/s2
BEGIN = 100.3  # s


def knocked(size: float, fall: float, seed: int = 4):
    """A recording whose x rises by a number of sigma in a second and falls with a time constant."""
    whole = recorded(bench(), seed)
    since = whole.time - whole.time[0] - BEGIN
    course = np.where(since < 0, np.clip(1 + since, 0, 1), np.exp(-np.maximum(since, 0) / fall))
    x = whole.column("accel_x_m_s2") + size * WHITE * course
    return rewritten(whole, accel_x_m_s2=x)


def found_in(recording):
    prepared = prepare(honest(bench()), [recording])
    return transients(prepared.start, prepared.whitened)


@pytest.mark.parametrize("seed", range(4))
def test_there_is_none_in_noise(seed):
    assert found_in(recorded(bench(), seed)) == []


def test_there_is_none_in_a_burst_of_noise(rng):
    """Six times the noise for 6 s: a matched filter by the mean noise would find several."""
    whole = recorded(bench(), 5)
    within = np.abs(whole.time - whole.time[0] - BEGIN) < 3
    burst = 6 * WHITE * rng.standard_normal(len(within)) * within
    assert found_in(rewritten(whole, accel_x_m_s2=whole.column("accel_x_m_s2") + burst)) == []


def test_a_knock_has_a_hypothesis_at_its_instant():
    (found, *_) = found_in(knocked(3.0, 3.0))
    effect = found.effect
    assert (effect.sensor, effect.axis, effect.coordinate) == ("accel", "x", "time")
    assert effect.knots[1] == pytest.approx(BEGIN, abs=1.5)
    # nothing before it and after it
    course = found.at(dict.fromkeys(found.names, 1.0))
    outside = np.array([0.0, effect.knots[0], effect.knots[-1], 200.0])
    assert course.curve(outside) == pytest.approx(np.zeros(4), abs=1e-12)
    assert course.curve(np.array(effect.knots[1:-1])) == pytest.approx(np.ones(4))


@pytest.mark.slow
def test_a_knock_is_an_addition_over_time_that_no_other_recording_repeats():
    found = diagnose(honest(bench()), [knocked(4.0, 2.0)])
    assert found.verdict == "unlisted"
    assert "accel x that follows time" in found.statement
    assert "Another recording need not repeat it" in found.statement
