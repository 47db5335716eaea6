"""Events of several recordings: between two of them, in one of them, and what the others meet."""

from dataclasses import replace

import numpy as np
import pytest

from tiltcal.core.units import G0
from tiltcal.diagnosis.conclusions.one_recording import beside_drawn_anew
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.instants import instants
from tiltcal.diagnosis.search.candidates import Names
from tiltcal.effects import CATALOGUE
from tiltcal.effects.events import active_in, same_recording
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario

KNOWN = {
    "schema": 1,
    "name": "two recordings of one set-up",
    "site": {"gravity_m_s2": 9.80123},
    "rig": {"table": "dual"},
    "sensor": [
        {
            "name": "accel",
            "kind": "accelerometer",
            "rate_hz": 10,
            "adjustable": ["bias", "scale", "cross_axis"],
        }
    ],
}
SEQUENCE = [{"action": "scheme", "scheme": "tumble", "dwell_s": 2}]
NOISE = {"id": "acc_noise", "white_ug_rthz": 25}
LABORATORY = SimulatedLaboratory()


def recorded(seed, *effects):
    """One recording; all have the same stamps."""
    text = KNOWN | {"seed": seed, "sequence": SEQUENCE, "effect": [NOISE, *effects]}
    return LABORATORY.record(parse_scenario(text), seed)


@pytest.fixture(scope="module")
def before():
    return recorded(1)


def test_recordings_of_equal_stamps_are_told_apart_by_their_readings(before):
    other = recorded(2)
    assert np.array_equal(before.time, other.time)
    assert not same_recording(before.fingerprint, other.fingerprint)
    motion = replace(
        before, blocks=tuple(b for b in before.blocks if "accel_x_m_s2" not in b.columns)
    )
    assert same_recording(motion.fingerprint, before.fingerprint)


def test_an_event_is_looked_for_within_long_rests_too():
    """Six poses leave little to a step that is tried 7 s away from its instant."""
    sequence = [{"action": "scheme", "scheme": "6", "dwell_s": 14}]
    text = KNOWN | {"seed": 5, "sequence": sequence, "effect": [NOISE]}
    recording = LABORATORY.record(parse_scenario(text), 5)
    observations = observe(parse_scenario(KNOWN), [recording])
    times = np.array([one.time for one in instants(observations)])
    span, stop = np.ptp(recording.time), observations.channels[0].stop
    assert np.diff([0, *times, span]).max() < span / 60
    moves = observations.channels[0].time[np.flatnonzero(np.diff((stop >= 0).astype(int)))]
    assert np.isin(moves[1:-1] - recording.time[0], times).all()


def test_step_between_two_recordings_is_a_class_with_the_run_to_run_bias(before):
    after = recorded(2, {"id": "acc_bias", "bias_x_ug": 900})
    answer = diagnose(parse_scenario(KNOWN), [before, after], laboratory=LABORATORY)
    (finding,) = answer.findings
    assert finding.names == ("acc_bias_step", "acc_turn_on")
    assert answer.verdict == "ambiguous"
    assert "between" in (finding.where.recording or "")
    value, sigma = finding.parameters["bias_step_x_ug"]
    assert abs(value - 900) < 4 * sigma
    assert sigma < 20
    assert sum(finding.name_probability.values()) == pytest.approx(1, abs=1e-3)


def test_each_name_of_an_event_between_two_recordings_is_shared_with_what_is_drawn_anew():
    step = CATALOGUE["acc_bias_step"]({"time": 0.0}, "accel")
    between = replace(step, seen_in="b", earlier=("a",))
    names = Names({"mount_slip": 0.6, "acc_bias_step": 0.4}, ("mount_slip", "acc_bias_step"), ())
    shared = beside_drawn_anew(names, between)
    expected = {
        "mount_slip": 0.3,
        "remount_repeatability": 0.3,
        "acc_bias_step": 0.2,
        "acc_turn_on": 0.2,
    }
    assert shared.probability == pytest.approx(expected)
    assert set(shared.alike) == set(expected)
    assert beside_drawn_anew(names, replace(between, values={"time": 5.0})) is names


def test_remount_between_two_recordings_is_a_class_with_a_slip(before):
    after = recorded(
        3, {"id": "mount_slip", "slip_x_arcsec": 80, "slip_y_arcsec": -50, "time_s": 0}
    )
    answer = diagnose(parse_scenario(KNOWN), [before, after])
    assert answer.findings[0].names == ("mount_slip", "remount_repeatability")


def test_step_in_the_second_recording_is_not_met_by_the_first(before):
    after = recorded(4, {"id": "acc_bias_step", "bias_step_y_ug": 600, "time_s": 60})
    answer = diagnose(parse_scenario(KNOWN), [before, after], laboratory=LABORATORY)
    (finding,) = answer.findings
    assert (answer.verdict, finding.effect) == ("explained", "acc_bias_step")
    assert finding.where.interval[0] == pytest.approx(60, abs=2)
    amended = parse_scenario(answer.amended)
    (step,) = (e for e in amended.effects if e.id == "acc_bias_step")
    assert active_in([step], before.fingerprint) == []
    assert active_in([step], after.fingerprint) == [step]
    later = recorded(5)
    assert active_in([step], later.fingerprint)[0].value("time") < 0
    sensor = amended.named("accel")
    change = [
        LABORATORY.predict(amended, r).sensor(sensor).values[-1, 1]
        - LABORATORY.predict(amended, r).sensor(sensor).values[0, 1]
        for r in (before, after, later)
    ]
    assert change[1] - change[0] == pytest.approx(600e-6 * G0, rel=0.1)
    assert change[2] == pytest.approx(change[0], abs=1e-6 * G0)


def test_an_instant_beyond_the_length_of_the_first_recording_is_found():
    """A shape is refined within its own recording."""
    step = {"id": "mount_slip", "slip_x_arcsec": 200, "time_s": 160}
    text = KNOWN | {"seed": 9, "effect": [NOISE]}
    short = parse_scenario(text | {"sequence": [{**SEQUENCE[0], "dwell_s": 0.7}]})
    brief, after = LABORATORY.record(short, 9), recorded(10, step)
    assert np.ptp(brief.time) < 160 < np.ptp(after.time)
    answer = diagnose(parse_scenario(KNOWN), [brief, after])
    (finding,) = answer.findings
    assert finding.effect == "mount_slip"
    assert finding.where.interval[0] == pytest.approx(160, abs=2)


def test_two_recordings_without_an_event_match(before):
    answer = diagnose(parse_scenario(KNOWN), [before, recorded(6)])
    assert (answer.verdict, answer.findings) == ("match", ())


def test_history_without_a_cause_is_left_out_of_another_recording_but_for_its_mean():
    course = {"id": "learned", "sensor": "accel", "axis": "x", "on": "reading"}
    bumps = [0, 0.02, -0.015, 0.03, -0.01, 0.025, 0.0]
    curve = course | {"coordinate": "time", "knots": [15.0 * k for k in range(7)]}
    first = recorded(1, curve | {"coefficients": bumps})
    answer = diagnose(parse_scenario(KNOWN), [first], laboratory=LABORATORY)
    (finding,) = answer.findings
    assert (answer.verdict, finding.where.coordinate) == ("unlisted", "time")
    assert "only its mean is predicted" in answer.statement
    amended = parse_scenario(dict(answer.amended))
    left_out = [e for e in amended.effects if not e.lasts]
    assert {e.seen_in for e in left_out} == {first.fingerprint}

    def residual(recording):
        there = LABORATORY.predict(amended, recording).column("accel_x_m_s2")
        return recording.column("accel_x_m_s2") - there

    noise = 25e-6 * G0 * np.sqrt(10)
    assert np.std(residual(first)) < 1.5 * noise
    other = residual(recorded(2))
    assert np.std(other) < 1.5 * noise  # none of the bumps
    mean = np.mean(np.interp(first.time - first.time[0], curve["knots"], bumps))
    assert np.mean(other) == pytest.approx(-mean, abs=0.3 * max(bumps))


def hum(phase):
    return {"id": "mains_pickup", "pickup_y_ug": 300, "frequency_hz": 50.3, "phase_deg": phase}


def test_mains_in_one_recording_are_named_and_their_recording_is_told(before):
    after = recorded(5, hum(40))
    answer = diagnose(parse_scenario(KNOWN), [before, after], laboratory=LABORATORY)
    (finding,) = answer.findings
    assert finding.effect == "mains_pickup"
    assert finding.where.recording.startswith("in ")
    value, sigma = finding.parameters["pickup_y_ug"]
    assert abs(value - 300) < 4 * sigma
    (amended,) = (e for e in answer.amended["effect"] if e["id"] == "mains_pickup")
    assert same_recording(amended["seen_in"], after.fingerprint)


def test_mains_in_both_recordings_are_one_finding_with_a_phase_for_each():
    both = [recorded(6, hum(20)), recorded(7, hum(110))]
    answer = diagnose(parse_scenario(KNOWN), both, laboratory=LABORATORY)
    (finding,) = answer.findings
    assert finding.effect == "mains_pickup"
    assert finding.where.recording is None
    tones = [e for e in answer.amended["effect"] if e["id"] == "mains_pickup"]
    seen = {tone["seen_in"].partition("-")[2]: tone["phase_deg"] for tone in tones}
    assert len(seen) == 2
    value, sigma = finding.parameters["pickup_y_ug"]
    assert abs(value - 300) < 4 * sigma
