"""A served table for the tests, in a thread of its own; and its fuzz.

python -m tests.serving --count 10000 --seed 1
"""

import argparse
import asyncio
import random
import socket
import sys
import threading
from contextlib import contextmanager

from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.laboratory.serve.rate_table import RateTable
from tiltcal.laboratory.serve.server import Server, Wires
from tiltsim.laboratory import MujocoLaboratory

SEED = 5


def scenario(*effects, rate=50, **more):
    """A triad on a table with two axes."""
    table = {
        "schema": 1,
        "name": "served",
        "site": {"gravity_m_s2": 9.8},
        "rig": {"table": "dual"},
        "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": rate}],
        "effect": list(effects),
    }
    return parse_scenario(table | more)


@contextmanager
def served(bench, *, seed=SEED, mechanics=None, **wires):
    """A server in a thread; errors of the thread are raised at the end."""
    ready, found = threading.Event(), {}

    async def run():
        table = RateTable(bench, seed, mechanics=mechanics)
        server = Server(table, Wires(**({"speed": 0.0} | wires)))
        async with server.open():
            found.update(server=server, loop=asyncio.get_running_loop(), stop=asyncio.Event())
            ready.set()
            await found["stop"].wait()

    def thread():
        try:
            asyncio.run(run())
        except BaseException as error:  # noqa: BLE001
            found["error"] = error
        finally:
            ready.set()

    running = threading.Thread(target=thread)
    running.start()
    ready.wait()
    try:
        if "error" not in found:
            yield found["server"]
    finally:
        if "stop" in found:
            found["loop"].call_soon_threadsafe(found["stop"].set)
        running.join(20)
    if "error" in found:
        raise found["error"]
    assert not running.is_alive()


class Wire:
    """A bare connection."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=20)
        self.lines = self.socket.makefile("rb")

    def send(self, data):
        self.socket.sendall(data if isinstance(data, bytes) else data.encode() + b"\n")

    def ask(self, line):
        self.send(line)
        return self.lines.readline().decode().strip()

    def close(self):
        self.lines.close()
        self.socket.close()


HEADERS = """:mode:pos :mode:rate :mode:off :dem:pos :dem:rate :lim:rate :lim:acc :lim:pos
:int:open :int:clos :faul:lost :faul:trip :faul:slip :faul:stic :moun *rst *cls :read:pos?
:read:rate? *idn? *stb? :syst:err? :mode?"""
ODD = """1 2 3 -1 nan inf 1e308 1e-300 0 1,2 1,-5,5 "Rx(90)" ' (1 \x00 é"""


def odd_line(rng):
    """A line that may be sound, mutated or noise."""
    if rng.random() < 0.1:
        return rng.randbytes(rng.randrange(200)) + b"\n"
    odd = [*ODD.split(), "", "1" * 400]
    text = ";".join(
        f"{rng.choice(HEADERS.split())} {','.join(rng.choices(odd, k=rng.randrange(4)))}"
        for _ in range(rng.randrange(1, 4))
    )
    data = bytearray(text.encode("utf-8", "replace"))
    for _ in range(rng.choice([0, 0, 1, 5])):
        data.insert(rng.randrange(len(data) + 1), rng.randrange(256))
    return bytes(data) + rng.choice([b"\n", b"\r\n", b"\n\n", b""])


def fuzz(count, seed, dynamics=False):
    """Send odd lines from three clients; how many times the server did not answer afterwards.
    dynamics: whether the table is run by time steps.
    """
    rng, silent = random.Random(seed), 0
    more = {"dynamics": {}} if dynamics else {}
    bench = scenario({"id": "acc_noise", "white_ug_rthz": 50}, **more)
    mechanics = MujocoLaboratory().mechanics(bench) if dynamics else None
    with served(bench, mechanics=mechanics) as server:
        wires = [Wire(server.ports["command"]) for _ in range(3)]
        for number in range(count):
            k = rng.randrange(3)
            wires[k].send(odd_line(rng))
            if rng.random() < 0.05:  # it leaves, amid a line or an answer
                wires[k].close()
                wires[k] = Wire(server.ports["command"])
            if number % 20 == 19:
                silent += not answers(server)
        silent += not answers(server)
        for wire in wires:
            wire.close()
    return silent


def answers(server):
    """Whether a new client is answered, and the table's time goes on."""
    wire = Wire(server.ports["command"])
    try:
        sound = wire.ask("*IDN?").startswith("tiltcal,dual")
        before = float(wire.ask(":syst:time?"))
        after = before
        for _ in range(1000):
            if after > before:
                break
            after = float(wire.ask(":syst:time?"))
        return sound and after > before
    finally:
        wire.close()


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.serving", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dynamics", action="store_true", help="a table run by time steps")
    words = parser.parse_args()
    silent = fuzz(words.count, words.seed, words.dynamics)
    print(f"{words.count} lines, seed {words.seed}: {silent} times no answer afterwards")
    return 1 if silent else 0


if __name__ == "__main__":
    sys.exit(main())
