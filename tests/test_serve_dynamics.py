"""The served table by time steps: servo theory, mechanics with a memory, an own model and faults
over a socket.
"""

import socket

import numpy as np
import pytest
import test_model_dynamics as arm_by_steps
from serving import Wire, scenario, served
from test_dynamics import servo_of

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.serve.commands import TableCommands
from tiltcal.laboratory.serve.rate_table import RateTable
from tiltcal.laboratory.serve.server import Server
from tiltsim.laboratory import MujocoLaboratory

BACKLASH = {"id": "table_backlash", "axis": "outer", "width_arcsec": 40}


def table_of(*effects, dynamics=(), **more):
    bench = scenario(*effects, dynamics=dict(dynamics), **more)
    return RateTable(bench, None, mechanics=MujocoLaboratory().mechanics(bench))


def run(table, time):
    return list(table.advance(time))


def column(table, frames, name):
    place = table.format.columns.index(name)
    return np.array([frame.values[place] for frame in frames])


def test_a_cruising_axis_lags_by_the_damping_over_the_stiffness_times_the_rate():
    table = table_of()
    TableCommands(table).line(":mode:rate 1;:dem:rate 1,20")
    run(table, 2.0)
    frames = run(table, 3.0)
    kp, kv, damping = servo_of("dual", "outer")
    asked = np.array([table.axes["outer"].jet(np.array([f.time])).x[0] for f in frames])
    lag = asked - column(table, frames, "table_outer_deg") * DEG
    # the weight that the instrument brings over the axis tilts it by less than an arcsec
    np.testing.assert_allclose(lag, (kv + damping) / kp * 20 * DEG, rtol=0, atol=ARCSEC)
    assert table.readout("outer")[1] == pytest.approx(20 * DEG, rel=1e-4)


def test_dry_friction_and_settling():
    table = table_of(dynamics={"friction_N_m": 2.0})
    say = TableCommands(table).line
    say(":mode:pos 1;:dem:pos 1,20;:mode:pos 2")
    run(table, 1.0)
    assert say("*stb?") == "1"
    run(table, 4.0)
    assert say("*stb?") == "0"
    short = 20 * DEG - float(say(":read:pos? 1")) * DEG
    most = 2.0 / servo_of("dual", "outer")[0]
    assert 0.8 * most < short <= most


def test_play_is_mechanics_and_remembers_from_where_the_axis_came():
    """Refused where motion is prescribed."""
    table = table_of(BACKLASH)
    say, up = TableCommands(table).line, []
    say(":mode:pos 1")
    for target in (20, 40, 20):
        say(f":dem:pos 1,{target}")
        frames = run(table, table.time + 4.0)
        angle = column(table, frames, "table_outer_deg")[-1] * DEG
        # accelerometer y reads sin of the true angle
        up.append(np.arcsin(column(table, frames, "accel_y_m_s2")[-1] / 9.8) - angle)
    assert up[2] - up[0] == pytest.approx(40 * ARCSEC, abs=2 * ARCSEC)
    with pytest.raises(TiltcalError, match="whole"):
        RateTable(scenario(BACKLASH), None)


def test_frames_do_not_depend_on_how_time_is_advanced():
    one, other = (table_of(dynamics={"friction_N_m": 1.0}) for _ in range(2))
    for each in (one, other):
        TableCommands(each).line(":mode:rate 1;:dem:rate 1,30;:mode:pos 2;:dem:pos 2,20")
    whole = run(one, 3.0)
    pieces = [f for time in np.arange(0.013, 3.02, 0.013) for f in run(other, min(time, 3.0))]
    for a, b in zip(whole, pieces, strict=True):
        np.testing.assert_allclose(a.values, b.values, rtol=0, atol=1e-9, equal_nan=True)


def test_a_slip_a_stuck_axis_and_a_remount():
    table = table_of()
    say = TableCommands(table).line
    say(":mode:pos 1;:fault:slip 1,5")
    frames = run(table, 1.0)
    assert column(table, frames, "table_outer_deg")[-1] == pytest.approx(0, abs=1e-3)
    slipped = column(table, frames, "accel_y_m_s2")[-1]
    assert slipped == pytest.approx(9.8 * np.sin(5 * DEG), abs=1e-3)
    say(":fault:slip 1,-5;:fault:stick 1,1;:dem:pos 1,20")
    run(table, 3.0)
    assert float(say(":read:pos? 1")) == pytest.approx(0, abs=1e-3)
    say(':fault:stick 1,0;:mount "Rx(90)"')
    frames = run(table, 4.0)
    assert say(":syst:err?") == '0,"No error"'
    assert column(table, frames, "accel_y_m_s2")[-1] == pytest.approx(9.8, abs=1e-3)


def test_an_arm_is_served_over_a_socket(tmp_path):
    bench = arm_by_steps.arm(tmp_path, arm_by_steps.SERVOS)
    mechanics = MujocoLaboratory().mechanics(bench)
    with served(bench, seed=None, mechanics=mechanics) as server:
        wire, frames = Wire(server.ports["command"]), Stream(server)
        assert wire.ask(":str:col?").startswith("table_pan_deg,table_lift_deg")
        wire.send(":lim:rate 2,60;:mode:pos 1;:mode:pos 2;:dem:pos 1,40;:dem:pos 2,-50")
        seen = [frames.next()]
        while int(wire.ask("*STB?")) & 1:
            seen += [frames.next() for _ in range(20)]
        lift = float(wire.ask(":read:pos? 2"))
        assert -50.5 < lift < -49.5
        assert lift != -50  # it hangs in its servo
        settled = float(wire.ask(":syst:time?"))
        while seen[-1][1] < settled:
            seen.append(frames.next())
        counter = seen[-1][0]
        wire.send(":fault:lost 5;:fault:trip")
        while (last := frames.next())[0] == counter + 1:
            counter = last[0]
        assert last[0] == counter + 6
        assert wire.ask(":mode? 1;:mode? 2;:syst:err?") == 'OFF;OFF;0,"No error"'
        wire.close()
        frames.close()
    values = np.array([frame[2] for frame in seen])
    angles = dict(zip(("pan", "lift", "elbow", "wrist"), values[:, :4].T, strict=True))
    assert np.ptp(angles["lift"]) > 45
    assert_rest_readings(bench, angles, values[-1, 4:7])


def assert_rest_readings(bench, angles, force):
    """The last readings, at rest, are those of the readout."""
    from tiltcal.laboratory.instrument.carried import CarriedInstrument
    from tiltcal.setup.trajectory import Jet

    jets = {
        name: Jet(values[-1:] * DEG, np.zeros(1), np.zeros(1)) for name, values in angles.items()
    }
    carried = CarriedInstrument(bench, 0.01)
    drive = carried.drive(np.zeros(1), jets, "identity")
    found = closed_form(bench, drive, bench.effects).force[0]
    np.testing.assert_allclose(force, found, rtol=0, atol=1e-2)


class Stream:
    """The frames of a server, one after the other."""

    def __init__(self, server: Server) -> None:
        self.format = server.table.format
        self.socket = socket.create_connection(("127.0.0.1", server.ports["stream"]), timeout=20)
        self.bytes = self.socket.makefile("rb")

    def next(self):
        return self.format.unpack(self.bytes.read(self.format.size))

    def close(self):
        self.bytes.close()
        self.socket.close()


def test_drives_trip_where_a_demand_makes_the_mechanics_diverge(tmp_path):
    bench = arm_by_steps.arm(tmp_path, arm_by_steps.SERVOS)
    table = RateTable(bench, None, mechanics=MujocoLaboratory().mechanics(bench))
    say = TableCommands(table).line
    for k in range(1, 5):
        say(f":lim:rate {k},1e9;:lim:acc {k},1e9;:mode:rate {k};:dem:rate {k},1e9")
    run(table, 2.0)
    assert say(":mode? 1;:mode? 4;*stb?") == "OFF;OFF;16"
    frames = run(table, 2.5)
    assert np.isfinite(frames[-1].values[:-1]).all()
    assert np.linalg.norm(frames[-1].values[4:7]) == pytest.approx(9.8, abs=0.01)
    say(":lim:rate 1,60;:lim:acc 1,100;:mode:pos 1")
    here = float(say(":read:pos? 1"))
    say(f":dem:pos 1,{here + 10}")
    run(table, 6.0)
    assert float(say(":read:pos? 1")) == pytest.approx(here + 10, abs=0.01)


def test_what_rings_at_the_end_of_a_move_of_a_sequence_is_refused():
    ring = {"id": "mount_resonance", "ring_x_arcsec": 30, "frequency_hz": 20, "tau_s": 0.2}
    with pytest.raises(TiltcalError, match="rings"):
        table_of(ring)


def test_dynamics_without_mechanics_are_refused():
    with pytest.raises(TiltcalError, match=r"\[dynamics\] and no mechanics"):
        RateTable(scenario(dynamics={}), 1)
