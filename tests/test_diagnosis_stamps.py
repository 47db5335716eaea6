"""Stamps that are late by what no list has: a clock that wanders, a buffer that is emptied."""

import numpy as np
import pytest
from diagnosis_fixtures import bench, honest, recorded, rewritten

from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.lines.spectral_lines import late_of
from tiltcal.laboratory.scenario import parse_scenario

EVERY = 7.3  # s


def moving(*effects, seed=5, rate_hz=25.0):
    """A triad on a table that moves every four seconds, and its scenario."""
    truth = bench()
    table = truth.model_dump(exclude={"effect", "sequence"}, exclude_defaults=True, by_alias=True)
    table["sensor"][0]["rate_hz"] = rate_hz
    turns = np.random.default_rng(2).uniform(-170, 170, (28, 2))
    sequence = [
        {"action": "move", "outer_deg": a, "inner_deg": b, "rate_deg_s": 60.0, "dwell_s": 1.5}
        for a, b in turns.tolist()
    ]
    noise = {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 40.0}
    words = {"schema": 1, **table, "effect": [noise, *effects], "sequence": sequence}
    scenario = parse_scenario(words)
    return scenario, recorded(scenario, seed)


def late_by(course, rate_hz=25.0):
    """A recording whose readings were stamped later than they were taken, by a course of the time,
    s: each is that of the motion then.
    """
    scenario, read = moving(rate_hz=rate_hz)
    time = np.asarray(read.time)
    changed = {}
    for axis in "xyz":
        name = f"accel_{axis}_m_s2"
        changed[name] = np.interp(time - course(time), time, read.column(name))
    return scenario, rewritten(read, **changed)


def saw(time):
    """2.5 ms in each 7.3 s, then back to nothing."""
    return 2.5e-3 * (time % EVERY) / EVERY


def wandering(time):
    """1.5 ms to and fro, one and a half times in the recording."""
    return 1.5e-3 * np.sin(3 * np.pi * time / time[-1])


def test_a_delay_that_repeats_is_a_line_in_the_delay_of_the_stamps():
    scenario, read = late_by(saw)
    found = prepare(honest(scenario), [read])
    lines = late_of(found.observations, found.start)
    assert any(abs(f * EVERY - 1) < 0.02 for f in lines)


def test_stamps_that_are_right_have_no_such_line():
    scenario, read = moving()
    found = prepare(honest(scenario), [read])
    assert late_of(found.observations, found.start) == ()


@pytest.mark.parametrize(
    ("course", "rate_hz"), [pytest.param(saw, 12.0, marks=pytest.mark.long), (wandering, 25.0)]
)
def test_stamps_that_are_late_by_no_law_are_a_finding_at_the_stamps(course, rate_hz):
    scenario, read = late_by(course, rate_hz)
    found = diagnose(honest(scenario), [read])
    assert found.verdict == "unlisted"
    (nameless,) = (f for f in found.findings if f.effect is None)
    assert nameless.stage == "timing"
    assert "delay of the stamps of accel" in nameless.statement
    # its mean is a constant delay, which is listed
    others = {f.effect for f in found.findings if f.effect}
    assert others <= {"data_latency", "acc_bandwidth"}
    assert found.after.chi2_per_dof < 1 + (found.before.chi2_per_dof - 1) / 3
