"""The served table without its wire: motion within limits, commands, faults, frames."""

import numpy as np
import pytest

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.laboratory.serve.axis import AxisDrive
from tiltcal.laboratory.serve.commands import TableCommands, forms
from tiltcal.laboratory.serve.rate_table import RateTable
from tiltsim.motion import mujoco_motion


def scenario(*effects, rate=50, **more):
    table = {
        "schema": 1,
        "name": "bench",
        "site": {"gravity_m_s2": 9.8},
        "rig": {"table": "dual"},
        "sensor": [
            {"name": "accel", "kind": "accelerometer", "rate_hz": rate},
            {"name": "gyro", "kind": "gyro", "rate_hz": rate / 2},
        ],
        "effect": list(effects),
    }
    return parse_scenario(table | more)


@pytest.fixture
def table():
    return RateTable(scenario(), 1)


@pytest.fixture
def say(table):
    return TableCommands(table, {"stream": 4711}).line


def run(table, time):
    return list(table.advance(time))


@pytest.mark.parametrize("target", [0.3, -2.0, 40.0, 0.0])
@pytest.mark.parametrize("speed", [0.0, 1.0, -0.7])
def test_a_move_keeps_its_limits_and_ends_at_rest_at_the_target(target, speed):
    axis = AxisDrive(rate=1.0, acceleration=2.0)
    axis.turn(0.0, speed)
    axis.go(3.0, target)
    time = np.linspace(3.0, 80.0, 200_001)
    jet = axis.jet(time)
    assert np.abs(jet.v).max() <= 1.0 + 1e-12
    assert np.abs(jet.a).max() <= 2.0 + 1e-12
    assert (jet.x[-1], jet.v[-1]) == (target, 0.0)
    np.testing.assert_allclose(np.gradient(jet.x, time), jet.v, atol=1e-3)
    np.testing.assert_allclose(np.gradient(jet.v, time), jet.a, atol=1e-2)
    assert not axis.moving(80.0)


def test_commands_move_the_table(table, say):
    assert say(":mode:pos 1;:LIM:RATE 1,20;:Demand:Position 1,10") is None
    run(table, 0.2)
    assert say("*stb?") == str(1 | 16)  # moving; the inner axis is off
    run(table, 5.0)
    assert say(":read:pos? 1;:READ:RATE? 1;*STB?") == "10;0;16"
    assert say(":mode:rate 2;:dem:rate 2,-5") is None
    run(table, 6.0)
    assert say(":read:rate? 2") == "-5"
    assert say(":mode? 2;:mode? 1") == "RATE;POSITION"
    assert say(":syst:err?") == '0,"No error"'


def test_both_forms_of_each_word():
    assert set(forms(":MODe:POSition")) == {"mod:pos", "mod:position", "mode:pos", "mode:position"}
    assert forms("*IDN?") == ["*idn?"]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (":no:such 1", -113),
        (":mode:pos", -109),
        (":mode:pos 1,2", -108),
        (":mode:pos one", -120),
        (":mode:pos 3", -222),
        (":mode:pos 1.5", -224),
        (":dem:pos 1,10", -221),
        (":mode:pos 1;:lim:pos 1,-5,5;:dem:pos 1,10", -222),
        (":mode:pos 1;:int:open;:dem:pos 1,1", -200),
        (":mode:rate 1;:dem:rate 1,nan", -222),
        (":mount nonsense", -224),
    ],
)
def test_each_refusal_has_its_code(line, code, say):
    say(line)
    assert say("*stb?") != "16"
    assert say(":syst:err?").startswith(f"{code},")
    assert say(":syst:err?").startswith("0,")


def test_the_error_queue_overflows_without_growing(say):
    for _ in range(100):
        say("x")
    codes = [say(":syst:err?") for _ in range(33)]
    assert codes[30].startswith("-113")
    assert codes[31].startswith("-350")
    assert codes[32].startswith("0")


def test_a_limit_of_the_angle_stops_a_turn(table, say):
    say(":lim:pos 1,-20,20;:mode:rate 1;:dem:rate 1,40")
    frames = run(table, 5.0)
    assert say(":mode? 1;:read:rate? 1") == "OFF;0"
    assert 20 < max(f.values[0] for f in frames) < 20 + 40**2 / 100 + 1


def test_an_open_interlock_stops_all_axes(table, say):
    say(":mode:rate 1;:dem:rate 1,40")
    run(table, 2.0)
    say(":int:open")
    run(table, 4.0)
    assert say(":read:rate? 1;:mode? 1;:int?;*stb?") == "0;OFF;OPEN;24"
    say(":int:close;:mode:rate 1")
    assert say(":syst:err?;:mode? 1") == '0,"No error";RATE'


def test_frames_hold_what_the_sensors_read(table, say):
    say(":mode:pos 1;:dem:pos 1,30")
    frames = run(table, 4.0)
    assert [f.counter for f in frames] == list(range(201))
    assert table.format.columns[:3] == ("table_outer_deg", "table_inner_deg", "accel_x_m_s2")
    last = dict(zip(table.format.columns, frames[-1].values, strict=True))
    assert last["table_outer_deg"] == pytest.approx(30, abs=1e-12)
    assert last["accel_y_m_s2"] == pytest.approx(9.8 * np.sin(30 * DEG), abs=1e-12)
    assert np.isnan(frames[1].values[5:8]).all()  # the gyro has half the rate
    drive = table.drive(np.array([4.0]))
    np.testing.assert_allclose(
        frames[-1].values[2:5], closed_form(table.scenario, drive).force[0], atol=1e-12
    )


def test_frames_do_not_depend_on_how_time_is_advanced():
    effects = [
        {"id": "acc_noise", "white_ug_rthz": 50, "flicker_ug": 10},
        {"id": "acc_bandwidth", "tau_ms": 30},
        {"id": "table_encoder_eccentricity", "axis": "outer", "cos_arcsec": 50},
    ]
    one, other = (RateTable(scenario(*effects), 1) for _ in range(2))
    for each in (one, other):
        TableCommands(each).line(":mode:rate 1;:dem:rate 1,30")
    whole = run(one, 8.0)
    pieces = [f for time in np.arange(0.013, 8.02, 0.013) for f in run(other, min(time, 8.0))]
    for a, b in zip(whole, pieces, strict=True):
        np.testing.assert_allclose(a.values, b.values, rtol=0, atol=1e-12, equal_nan=True)


def test_faults_on_request(table, say):
    run(table, 1.0)
    say(":fault:lost 3")
    assert [f.lost for f in run(table, 1.2)] == [True] * 3 + [False] * 7
    say(":fault:slip 1,5")
    slipped = dict(zip(table.format.columns, run(table, 1.22)[-1].values, strict=True))
    assert slipped["table_outer_deg"] == 0
    assert slipped["accel_y_m_s2"] == pytest.approx(9.8 * np.sin(5 * DEG))
    say(":mode:pos 1;:fault:stick 1,1;:dem:pos 1,20")
    run(table, 5.0)
    assert say(":read:pos? 1") == "0"
    say(":fault:stick 1,0;:dem:pos 1,20")
    run(table, 6.0)
    say(":fault:trip")
    run(table, 9.0)
    assert say(":mode? 1;*stb?") == "OFF;16"


def test_mujoco_moves_as_the_closed_form():
    effects = [
        {"id": "table_encoder_eccentricity", "axis": "outer", "cos_arcsec": 50},
        {"id": "table_levelling", "tilt_east_arcsec": 30},
    ]
    found = []
    for mover in (closed_form, mujoco_motion):
        table = RateTable(scenario(*effects), None, mover)
        say = TableCommands(table).line
        say(":mode:pos 1;:dem:pos 1,50;:mode:rate 2;:dem:rate 2,30")
        run(table, 1.0)
        say(":fault:slip 1,2")
        run(table, 1.5)
        say(":dem:rate 2,0")
        run(table, 3.0)
        say(":mount 'Rx(90)'")
        found.append([frame.values for frame in run(table, 3.5)])
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)


def test_a_remount_turns_the_instrument(table, say):
    say(':mount "Rx(90)"')
    frame = run(table, 0.0)[-1]
    np.testing.assert_allclose(frame.values[2:5], [0, 9.8, 0], atol=1e-12)
    assert say(":mount?") == "Rx(90)"


def test_a_frame_reads_back_and_a_damaged_one_is_refused(table):
    frame = run(table, 0.02)[-1]
    packed = table.format.pack(frame.counter, frame.time, frame.values)
    assert len(packed) == table.format.size == 16 + 8 * 9 + 4
    counter, time, values = table.format.unpack(packed)
    assert (counter, time) == (1, 0.02)
    np.testing.assert_array_equal(values, frame.values)
    for damaged in (packed[:-1], b"X" + packed[1:], packed[:20] + b"\x55" + packed[21:]):
        with pytest.raises(TiltcalError, match="frame"):
            table.format.unpack(damaged)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rig": {"table": "handheld"}}, "table handheld"),
        ({"dynamics": {}}, "dynamics"),
        ({"sensor": []}, "no sensors"),
        ({"effect": [{"id": "table_backlash", "axis": "outer", "width_arcsec": 9}]}, "whole"),
    ],
)
def test_what_cannot_be_served_is_refused(change, words):
    with pytest.raises(TiltcalError, match=words):
        RateTable(scenario(**change), 1)
