"""Events happen in one recording: what another recording of the same set-up still finds of them."""

import numpy as np
import pytest
from builders import ACCEL, read_poses, setup_of, still

from tiltcal.core.units import G0
from tiltcal.effects import make_effect
from tiltcal.effects.events import active_in, afterwards
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario

SETUP = setup_of("dual", ACCEL)


def event(id, seen_in="first", **words):
    where = {} if id == "floor_tilt_drift" else {"sensor": "accel"}
    return make_effect(id, words, SETUP, **where, seen_in=seen_in)


def test_what_was_seen_nowhere_in_particular_or_here_is_met_as_it_is():
    always, here = (
        event("acc_bias", None, bias_x_ug=5),
        event("acc_bias_step", bias_step_x_ug=5, time_s=20),
    )
    assert active_in([always, here], "first") == [always, here]


def test_a_step_has_been_made_before_another_recording_starts():
    step = event("acc_bias_step", bias_step_x_ug=100, time_s=20)
    drive = still(SETUP, outer=np.zeros(30))
    first, second = (
        read_poses(SETUP, drive, *active_in([step], name))["accel"][:, 0]
        for name in ("first", "second")
    )
    np.testing.assert_allclose(first, 1e-4 * G0 * (np.arange(30) >= 20), atol=1e-14)
    np.testing.assert_allclose(second, 1e-4 * G0, atol=1e-14)


def test_a_creep_stays_where_it_ended():
    creep = make_effect(
        "learned",
        {"coordinate": "time", "knots": [0.0, 10.0, 20.0], "coefficients": [0.0, 1.0, 2.0]},
        SETUP,
        sensor="accel",
        axis="x",
        seen_in="first",
    )
    drive = still(SETUP, outer=np.zeros(30))
    first, second = (
        read_poses(SETUP, drive, *active_in([creep], name))["accel"][:, 0]
        for name in ("first", "second")
    )
    np.testing.assert_allclose(first, np.minimum(np.arange(30) / 10, 2.0), atol=1e-12)
    np.testing.assert_allclose(second, 2.0, atol=1e-6)


@pytest.mark.parametrize(
    ("id", "words"),
    [
        ("data_drop", {"samples": 7, "time_s": 3}),
        ("data_stuck", {"start_s": 3, "length_s": 2}),
        ("mains_pickup", {"pickup_x_ug": 9, "frequency_hz": 3}),
    ],
)
def test_lost_samples_and_phases_leave_nothing(id, words):
    assert afterwards(event(id, **words)) is None
    assert active_in([event(id, **words)], "second") == []


def test_what_has_no_instant_is_there_in_every_recording():
    bias = event("acc_bias", bias_x_ug=5)
    assert afterwards(bias) == bias
    assert active_in([bias], "second") == [bias]


def test_a_prediction_meets_the_event_of_its_own_recording_and_the_after_state_in_another():
    text = {
        "schema": 1,
        "name": "a step",
        "site": {"gravity_m_s2": 9.8},
        "rig": {"table": "dual"},
        "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": 10}],
    }
    laboratory = SimulatedLaboratory()
    one, other = (
        laboratory.record(parse_scenario(text | {"sequence": [{"action": "rest", "dwell_s": s}]}))
        for s in (5, 6)
    )
    step = {
        "id": "acc_bias_step",
        "sensor": "accel",
        "bias_step_x_ug": 1000,
        "time_s": 2,
        "seen_in": one.fingerprint,
    }
    amended = parse_scenario(text | {"effect": [step]})
    here, there = (
        laboratory.predict(amended, r).sensor(amended.named("accel")).values[:, 0]
        for r in (one, other)
    )
    np.testing.assert_allclose(here, 1e-3 * G0 * (one.time >= 2), atol=1e-9)
    np.testing.assert_allclose(there, 1e-3 * G0, atol=1e-9)
