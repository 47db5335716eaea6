"""What beats anew after each move: a line of its own period over the time since, not many lines of
the table's cadence.
"""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.replay import replay

PERIOD = 0.83  # s


def even(count=30):
    """A sweep of a table at an even cadence: what repeats with each move has lines at its
    multiples.
    """
    truth = bench(table="vertical")
    steps = [
        {"action": "move", "outer_deg": 10.0 * k, "rate_deg_s": 30.0, "dwell_s": 3.0}
        for k in range(1, count + 1)
    ]
    table = truth.model_dump(exclude={"effect", "sequence"}, exclude_defaults=True, by_alias=True)
    table["sensor"][0]["rate_hz"] = 25.0
    effects = [{"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 25.0}]
    sequence = [{"action": "rest", "dwell_s": 3.0}, *steps]
    return parse_scenario({"schema": 1, **table, "effect": effects, "sequence": sequence})


def since_arrival(scenario, time):
    """Time since the table came to rest, s, 0 while it moves: as it was asked to."""
    return scenario.schedule.standstills().since(time)


def test_the_time_since_a_move_is_told_to_a_part_of_a_sample():
    truth = even()
    whole = recorded(truth, 3)
    true, told = (
        since_arrival(truth, whole.time),
        replay(whole, honest(truth)).standstills.since(whole.time),
    )
    both = (true > 0) & (told > 0)
    assert np.sum((true > 0) != (told > 0)) <= 2 * 30  # a row at each end of a rest
    assert np.sqrt(np.mean((true - told)[both] ** 2)) < 0.1 / 25.0  # a tenth of a sample


def test_when_a_move_begins_is_told_to_a_part_of_a_sample():
    """What counts moves changes there."""
    truth = even()
    whole = recorded(truth, 3)
    true, told = truth.schedule.standstills(), replay(whole, honest(truth)).standstills
    assert np.abs(told.end[:-1] - true.end[:-1]).max() < 0.2 / 25.0  # a fifth of a sample
    np.testing.assert_array_equal(told.moves(true.begin + 0.5), np.arange(31))
    # amid the last of it
    np.testing.assert_array_equal(told.moves(true.begin[1:] - 0.2), np.arange(1, 31))


def test_what_beats_after_each_move_is_no_vibration():
    """At an even cadence it has as many lines as a vibration may have."""
    truth = even()
    whole = recorded(truth, 3)
    beat = 1e-3 * np.sin(2 * np.pi * since_arrival(truth, whole.time) / PERIOD)
    found = diagnose(
        honest(truth), [rewritten(whole, accel_x_m_s2=whole.column("accel_x_m_s2") + beat)]
    )
    assert found.verdict == "unlisted"
    assert [(f.where.coordinate, f.axes) for f in found.findings] == [("move", ("x",))]
    (effect,) = [e for e in found.amended["effect"] if e["id"] == "learned"]
    assert effect["period"] == pytest.approx(PERIOD, rel=3e-3)
