"""The served table on its wires: several clients, pyvisa, frames, faults, recording a sequence, odd
input, and the end.
"""

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import host
import numpy as np
import pytest
from serving import SEED, Wire, fuzz, scenario, served

import tiltcal as tc
from tiltcal.calibration.firmware.header import header
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.investigation.command import CommandLaboratory
from tiltcal.laboratory.serve.client import SequenceRecorder, TableClient
from tiltcal.laboratory.serve.rate_table import RateTable
from tiltcal.setup.sequence import Step

READER = Path(__file__).with_name("frame_reader.c")
NOISY = {"id": "acc_noise", "white_ug_rthz": 50}


@pytest.fixture
def server():
    with served(scenario(NOISY)) as running:
        yield running


def client(server):
    return TableClient("127.0.0.1", server.ports["command"])


def settled(wire):
    while int(wire.ask("*STB?")) & 1:
        pass


def test_three_clients_share_one_table_and_a_reconnect_loses_nothing(server):
    wires = [Wire(server.ports["command"]) for _ in range(3)]
    wires[0].send(":mode:pos 1;:dem:pos 1,12")
    settled(wires[1])
    assert [w.ask(":read:pos? 1") for w in wires] == ["12"] * 3
    for wire in wires:
        wire.close()
    again = Wire(server.ports["command"])
    assert again.ask(":read:pos? 1;:mode? 1") == "12;POSITION"
    again.close()


def test_a_line_may_come_in_pieces_and_lines_together(server):
    wire = Wire(server.ports["command"])
    wire.send(b":mode:po")
    wire.send(b"s 1\r\n:mode? 1\n*idn?\n")
    assert wire.lines.readline() == b"POSITION\n"
    assert wire.lines.readline().startswith(b"tiltcal,dual,0,")
    wire.send(b"x" * 50_000 + b"\n")
    assert wire.ask("*idn?").startswith("tiltcal")
    assert wire.ask(":syst:err?").startswith(("-363", "-113"))
    wire.close()


def test_pyvisa_drives_the_table(server):
    pyvisa = pytest.importorskip("pyvisa")
    manager = pyvisa.ResourceManager("@py")
    table = manager.open_resource(
        f"TCPIP::127.0.0.1::{server.ports['command']}::SOCKET",
        read_termination="\n",
        write_termination="\n",
        timeout=20_000,
    )
    try:
        assert table.query("*IDN?").startswith("tiltcal,dual")
        table.write(":MODE:POS 1")
        table.write(":DEM:POS 1,10")
        while int(table.query("*STB?")) & 1:
            pass
        assert float(table.query(":READ:POS? 1")) == pytest.approx(10)
        table.write(":nonsense")
        assert table.query(":SYST:ERR?") == '-113,"Undefined header"'
    finally:
        table.close()
        manager.close()


def test_the_stream_has_what_the_table_reads_without_a_gap(server):
    with client(server) as wire:
        frames = [next(wire.frames()) for _ in range(300)]
    counters = [counter for counter, _, _ in frames]
    assert counters == list(range(counters[0], counters[0] + 300))
    alone = list(RateTable(scenario(NOISY), SEED).advance(frames[-1][1]))[counters[0] :]
    for (_, time, values), frame in zip(frames, alone, strict=True):
        assert (time, values) == (frame.time, frame.values)


def test_lost_frames_leave_a_gap_of_the_counter(server):
    with client(server) as wire:
        next(wire.frames())  # it is being read
        wire.send(":fault:lost 7")
        counters = [next(wire.frames())[0] for _ in range(1500)]
    steps = np.diff(counters)
    assert sorted(set(steps)) == [1, 8]


STEPS = (
    Step(action="move", outer_deg=20, rate_deg_s=40, dwell_s=2, label="+z"),
    Step(action="remount", mount="Rz(180)"),
    Step(action="move", outer_deg=-20, inner_deg=90, rate_deg_s=60, dwell_s=1),
)


def test_a_sequence_is_recorded(server):
    with client(server) as wire:
        found = SequenceRecorder(wire, STEPS).record()
    assert found.metadata["mount"].startswith("identity; ")
    assert found.metadata["mount"].endswith("s: Rz(180)")
    outer, y = found.column("table_outer_deg"), found.column("accel_y_m_s2")
    changed = float(found.metadata["mount"].split("; ")[1].split(" s:")[0])
    tilted = np.abs(outer - 20) < 1e-9
    assert (y[tilted & (found.time < changed)] > 1).all()
    assert (y[tilted & (found.time > changed)] < -1).all()
    assert (tilted & (found.time > changed)).any()
    assert outer.max() == pytest.approx(20, abs=1e-9)
    assert (outer[-1], found.column("table_inner_deg")[-1]) == pytest.approx((-20, 90))
    resting = np.abs(outer - 20) < 1e-9
    assert resting.sum() / 50 > 2.0
    assert found.texts["label"][np.argmax(resting)] == "+z"
    np.testing.assert_allclose(np.diff(found.time), 1 / 50, atol=1e-9)


@pytest.mark.parametrize(
    ("fault", "words"),
    [(":fault:stick 1,1", "axis outer at 0 deg"), (":int:open", "interlock open")],
)
def test_a_table_that_does_not_obey_ends_the_recording(server, fault, words):
    with client(server) as wire:
        wire.send(fault)
        with pytest.raises(TiltcalError, match=words):
            SequenceRecorder(wire, STEPS).record()


def test_an_investigation_records_over_the_wire(server, tmp_path):
    """As ``--lab`` calls it."""
    (tmp_path / "sequence.csv").write_text("step,action,outer_deg,dwell_s\n1,move,15,1\n")
    port = server.ports["command"]
    lab = CommandLaboratory.parse(f"{sys.executable} -m tiltcal record 127.0.0.1:{port}")
    found = lab.record(tmp_path / "sequence.csv", tmp_path / "recording.csv")
    assert found.column("table_outer_deg")[-1] == pytest.approx(15)


@pytest.mark.skipif(host.compiler() is None, reason="no C compiler on this machine")
def test_a_c_program_reads_the_stream_and_corrects_it(server, tmp_path):
    """Frames from the wire, one missing and one damaged, through the header of `tiltcal export`."""
    terms = {"bias_x": (0.25, "m_s2"), "scale_z": (0.01, "1")}
    found = {
        f"accel.{name}": tc.Estimate(value, 0.0, unit) for name, (value, unit) in terms.items()
    }
    calibration = tc.Calibration("six_position", "good", found, np.zeros((2, 2)))
    (tmp_path / "imu.h").write_text(header(calibration, scenario(), "imu"))
    with client(server) as wire:
        form = wire.format
        frames = [form.pack(*next(wire.frames())) for _ in range(50)]
    frames[20:21] = []
    frames[30] = frames[30][:35] + bytes([frames[30][35] ^ 1]) + frames[30][36:]
    program = tmp_path / "reader"
    command = [host.compiler(), *host.STRICT, "-DIMU_DOUBLE", '-DHEADER="imu.h"', f"-I{tmp_path}"]
    subprocess.run([*command, str(READER), "-o", str(program), "-lm"], check=True)
    first = form.columns.index("accel_x_m_s2")
    words = [str(program), str(len(form.columns)), str(first)]
    lines = (
        subprocess.run(words, input=b"".join(frames), capture_output=True, check=True)
        .stdout.decode()
        .splitlines()
    )
    assert [line for line in lines if line[0] in "ld"] == ["lost 1", "damaged", "lost 1"]
    counter, time, x, _, z = map(float, lines[0].split())
    sent = form.unpack(frames[0])
    assert (counter, time) == sent[:2]
    assert x == pytest.approx(sent[2][first] - 0.25, abs=1e-12)
    assert z == pytest.approx(sent[2][first + 2] / 1.01, abs=1e-12)


def test_nobody_there(tmp_path, capsys):
    (tmp_path / "sequence.csv").write_text("step,action,outer_deg,dwell_s\n1,move,15,1\n")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        where = f"127.0.0.1:{free.getsockname()[1]}"
        words = ["record", where, str(tmp_path / "sequence.csv"), str(tmp_path / "out.csv")]
        assert main(words) == 2
    assert "start `tiltcal serve`" in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()


def test_datagrams_and_a_pseudo_terminal_carry_the_same_frames():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(20)
        with served(scenario(NOISY), speed=50.0, udp=ear.getsockname(), pty=True) as server:
            form = server.table.format
            datagrams = [form.unpack(ear.recv(4096)) for _ in range(20)]
            with Path(server.terminal).open("rb", buffering=0) as terminal:
                bytes_ = b""
                while len(bytes_) < 3 * form.size:
                    bytes_ += terminal.read(form.size)
    start = bytes_.index(b"TCF1")
    counter, time, _ = form.unpack(bytes_[start : start + form.size])
    assert time == counter / 50
    assert [d[0] for d in datagrams] == sorted({d[0] for d in datagrams})
    alone = list(RateTable(scenario(NOISY), SEED).advance(datagrams[-1][1]))
    assert datagrams[-1][2] == alone[-1].values


def test_what_the_table_runs_into_ends_the_command(tmp_path, monkeypatch, capsys):
    def fails(*_):
        raise TiltcalError("table", found="smoke", need="none", do="open a window")

    monkeypatch.setattr(RateTable, "advance", fails)
    (tmp_path / "bench.toml").write_text(BENCH)
    assert main(["serve", str(tmp_path / "bench.toml")]) == 2
    assert "found smoke" in capsys.readouterr().err


def test_a_taken_port_is_one_message(server):
    with (
        pytest.raises(TiltcalError, match="free port"),
        served(scenario(), port=server.ports["command"]),
    ):
        pass


def test_odd_input_never_silences_the_server():
    assert fuzz(500, 1) == 0


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_it_ends_on_a_signal(number, status, tmp_path):
    (tmp_path / "bench.toml").write_text(BENCH)
    words = [sys.executable, "-m", "tiltcal", "serve", str(tmp_path / "bench.toml"), "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        text = b""
        while not text.endswith(b"}\n"):
            text += process.stdout.readline()
        wire = Wire(json.loads(text)["command"])
        assert wire.ask("*idn?").startswith("tiltcal,dual")
        os.kill(process.pid, number)
        said = process.communicate(timeout=20)[1].decode()
    wire.close()
    assert process.returncode == status
    assert len(said.strip().splitlines()) == 1


BENCH = """
schema = 1
[site]
gravity_m_s2 = 9.8
[rig]
table = "dual"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 50
"""


def test_the_clock_decides_how_far_the_table_is():
    """Ten seconds of the wall clock at thirty times: three hundred seconds of the table."""
    import asyncio

    from tiltcal.laboratory.serve.server import Server, Wires

    now = [100.0]

    async def run():
        server = Server(RateTable(scenario(rate=2), 1), Wires(speed=30.0), clock=lambda: now[0])
        async with server.open():
            now[0] += 10.0
            while server.table.time < 300.0:
                await asyncio.sleep(0)
            return server.table.time

    assert asyncio.run(run()) == 300.0
