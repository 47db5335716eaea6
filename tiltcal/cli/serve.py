"""``tiltcal serve``."""

import asyncio
import os
import signal
import sys
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from tiltcal.api.simulating import seed_used, simulator
from tiltcal.cli.options import SEED, WHOLE, Json, ScenarioFile, between
from tiltcal.cli.output import print_json, print_line
from tiltcal.core.addresses import address, host_of
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.laboratory.serve.rate_table import MechanicalLaboratory, RateTable
from tiltcal.laboratory.serve.server import Server, Wires

PORT = Parameter(converter=WHOLE.converter, validator=between(0, 65535))


def serve(
    scenario_file: ScenarioFile,
    /,
    *,
    port: Annotated[int, PORT, Parameter(help="TCP port of the commands; 0: a free one.")] = 0,
    stream_port: Annotated[int, PORT, Parameter(help="TCP port of the frames; 0: a free one.")] = 0,
    host: Annotated[str, Parameter(help="Address to listen on.")] = "127.0.0.1",
    udp: Annotated[str | None, Parameter(help="HOST:PORT that gets a datagram a frame.")] = None,
    pty: Annotated[bool, Parameter(help="Send the frames to a pseudo-terminal as well.")] = False,
    speed: Annotated[
        float,
        Parameter(
            help="Table seconds in a second; 0: as fast as it computes.", validator=between(0, 1e6)
        ),
    ] = 1.0,
    noise: Annotated[
        Literal["on", "off"], Parameter(help="off: no random effects, no quantisation.")
    ] = "on",
    seed: Annotated[int | None, SEED, Parameter(help="Seed instead of the scenario's own.")] = None,
    as_json: Json = False,
) -> int:
    """Serve a simulated rate table and its instrument over TCP.

    Commands are those of ACUTROL-type controllers; frames of readings are
    streamed. Motion is prescribed, within limits of rate and acceleration; with
    [dynamics] in the scenario it is run by time steps. It runs until it is
    interrupted.

      tiltcal serve bench.toml --port 5025 --stream-port 5026
      tiltcal record 127.0.0.1:5025 SEQUENCE.csv RECORDING.csv
    """
    scenario = load_scenario(scenario_file)
    laboratory = simulator()
    mover = laboratory.mover if isinstance(laboratory, SimulatedLaboratory) else closed_form
    used = seed_used(scenario, noise == "on", seed)
    mechanics = None
    if scenario.dynamics is not None and isinstance(laboratory, MechanicalLaboratory):
        mechanics = laboratory.mechanics(scenario)
    table = RateTable(scenario, used, mover, mechanics)
    listener = None if udp is None else address(udp)
    wires = Wires(host_of(host), port, stream_port, listener, pty, speed)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        came = asyncio.run(_serve(Server(table, wires), as_json))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    # every connection is closed: now end as other commands do
    if came == signal.SIGINT:
        raise KeyboardInterrupt  # a process started in the background may ignore the signal itself
    os.kill(os.getpid(), came)
    return 0


async def _serve(server: Server, as_json: bool) -> int:
    """Serve until a signal comes, and return it; none interrupts a callback of the loop."""
    loop = asyncio.get_running_loop()
    ended: asyncio.Future[int] = loop.create_future()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, _settle, ended, int(number))
    async with server.open():
        if as_json:
            print_json({**server.ports, "terminal": server.terminal})
        else:
            where = server.wires.host
            print_line(f"commands: {where}:{server.ports['command']}")
            print_line(f"frames: {where}:{server.ports['stream']}")
            if server.terminal:
                print_line(f"terminal: {server.terminal}")
        sys.stdout.flush()
        # the table runs on until a signal comes, or an error that the end of the context raises
        either: list[asyncio.Future[Any]] = [ended, server.running]
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
    return ended.result()


def _settle(ended: "asyncio.Future[int]", number: int) -> None:
    if not ended.done():
        ended.set_result(number)
