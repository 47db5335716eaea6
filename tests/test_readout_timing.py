"""The reference's own timing: a readout that is an average, or that is repeated between updates."""

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.diagnosis.data_faults.readout_faults import update_interval
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.effects import make_effect
from tiltcal.effects.timing.readout_timing import ReadoutRate
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.setup.trajectory import Drive, Jet

KNOWN = {
    "schema": 1,
    "name": "a triad and a gyro on a table",
    "site": {"gravity_m_s2": 9.80123, "latitude_deg": 40},
    "rig": {"table": "dual"},
    "sensor": [
        {"name": n, "kind": k, "rate_hz": 50, "adjustable": ["bias", "scale", "cross_axis"]}
        for n, k in (("accel", "accelerometer"), ("gyro", "gyro"))
    ],
}
NOISE = [
    {"id": "acc_noise", "white_ug_rthz": 25},
    {"id": "gyr_noise", "white_deg_rth": 0.1},
]
SEQUENCE = [{"action": "scheme", "scheme": "tumble", "dwell_s": 2}]
TURNS = [
    {"action": "move", "outer_deg": o, "inner_deg": i, "dwell_s": 1, "rate_deg_s": 40}
    for o, i in ((0, 0), (90, 0), (90, 90), (0, 90), (-90, -90), (-90, 90), (90, 180), (0, 0))
]
LABORATORY = SimulatedLaboratory()
WINDOW, INTERVAL = 0.03, 0.1  # s


def recorded(seed, *effects):
    text = KNOWN | {"sequence": SEQUENCE, "effect": [*NOISE, *effects]}
    return LABORATORY.record(parse_scenario(text), seed)


def swing(time):
    """A motion with its derivatives, and its exact mean over a window that ends now, rad."""
    w = 2.0
    true = Jet(np.sin(w * time), w * np.cos(w * time), -w * w * np.sin(w * time))
    mean = (np.cos(w * (time - WINDOW)) - np.cos(w * time)) / (w * WINDOW)
    return true, mean


def test_average_is_the_mean_over_the_window_to_third_order():
    time = np.arange(0, 5, 0.002)
    true, mean = swing(time)
    w = 2.0
    rate = (true.x - swing(time - WINDOW)[0].x) / WINDOW
    readout = Jet(mean, rate, -w * w * mean)
    drive = Drive(time, {"outer": readout}, 0.0, np.zeros(len(time)), 0.0, np.full(len(time), -1))
    effect = make_effect("readout_average", {"window_ms": 1e3 * WINDOW}, parse_scenario(KNOWN))
    inside = slice(5, -5)
    off = (mean + effect.deviation(drive, "outer", None).x - true.x)[inside]
    late = (mean - true.x)[inside]
    assert np.abs(late).max() == pytest.approx(w * WINDOW / 2, rel=0.01)
    # the next term of the series is the fourth: w^4 / 720
    assert np.abs(off).max() < 2 * (w * WINDOW) ** 4 / 720 + 1e-9


def test_average_is_named_and_sized():
    gyro = KNOWN | {"sensor": [KNOWN["sensor"][1] | {"adjustable": ["bias", "scale"]}]}
    average = {"id": "readout_average", "window_ms": 1e3 * WINDOW}
    truth = gyro | {"sequence": TURNS, "effect": [NOISE[1], average]}
    recording = LABORATORY.record(parse_scenario(truth), 1)
    answer = diagnose(parse_scenario(gyro), [recording], laboratory=LABORATORY)
    (finding,) = answer.findings
    assert finding.effect == "readout_average"
    # a law of 10^6 nats is known to no more than what a delay leaves of it, 0.06 %
    assert set(finding.names) <= {"readout_average", "data_latency"}
    value, sigma = finding.parameters["window_ms"]
    assert sigma < 0.1
    assert value == pytest.approx(1e3 * WINDOW, abs=0.3)


def test_repeated_readout_is_found_and_its_amended_scenario_matches():
    held = {"id": "readout_rate", "interval_ms": 1e3 * INTERVAL}
    truth = parse_scenario(KNOWN | {"sequence": TURNS, "effect": [*NOISE, held]})
    recording = LABORATORY.record(truth, 2)
    answer = diagnose(parse_scenario(KNOWN), [recording], laboratory=LABORATORY)
    (finding,) = answer.findings
    assert finding.effect == "readout_rate"
    assert finding.parameters["interval_ms"][0] == pytest.approx(1e3 * INTERVAL, rel=0.01)
    again = diagnose(parse_scenario(answer.amended), [recording])
    assert again.verdict == "match"


def test_readout_of_each_row_has_no_update_interval():
    recording = recorded(3)
    assert update_interval(recording.time, recording.table("inner")) is None
    rng = rng_of("a noisy readout")
    noisy = recording.table("inner") + rng.normal(0, 1e-7, len(recording))
    assert update_interval(recording.time, noisy) is None


@pytest.mark.parametrize("rows", [2, 3.3, 7])
def test_update_interval_of_a_noisy_readout(rows):
    recording = recorded(4)
    angle, step = recording.table("inner"), float(np.median(np.diff(recording.time)))
    angle = angle + rng_of("a noisy readout").normal(0, 1e-7, len(angle))
    sent = np.floor(np.arange(len(angle)) / rows + 1e-9) * rows
    held = angle[np.ceil(sent - 1e-9).astype(int).clip(0, len(angle) - 1)]
    found = update_interval(recording.time, held)
    assert found == pytest.approx(rows * step, rel=0.02)


def test_coarse_readout_in_a_slow_turn_is_not_a_held_one():
    time = np.arange(0, 200, 0.02)
    slow = np.radians(0.1) * time
    code = np.radians(0.01)
    assert update_interval(time, code * np.floor(slow / code)) is None


def test_steady_turn_is_told_by_the_updates_and_a_change_of_rate_is_not():
    time = np.arange(0, 20, 0.02)
    angle = np.where(time < 10, 0.0, 0.2 * (time - 10))
    effect = ReadoutRate({"interval": INTERVAL})
    held = angle[(np.arange(len(time)) // 5) * 5]
    np.testing.assert_allclose(
        effect.restored("outer", time, held)[time > 11][:-5], angle[time > 11][:-5], atol=1e-6
    )
    lost = effect.undetermined("outer", time, held)
    assert lost[np.abs(time - 10) < INTERVAL].all()
    assert not lost[np.abs(time - 10) > 5 * INTERVAL].any()
