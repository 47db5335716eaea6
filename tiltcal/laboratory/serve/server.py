"""The served table on its sockets: commands by TCP, frames by TCP, UDP and a pseudo-terminal. One
task advances the table; everything runs in one thread.
"""

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.serve.commands import TableCommands
from tiltcal.laboratory.serve.rate_table import RateTable

LINE = 4096  # bytes of a line of commands, at most
TICK_S = 0.005  # of the wall clock, between two advances
SLICE = 64  # frames that are sent before others get their turn
SENT_AHEAD = 4096  # bytes on their way to a reader that the table waits for
BACKLOG = 1 << 20  # bytes that wait for a slow client, before its frames are dropped


@dataclass(frozen=True)
class Wires:
    """Where the table is served.

    Args:
        host: address to listen on.
        port, stream_port: of commands and frames, 0: any free one.
        udp: (host, port) that gets a datagram a frame; None: none.
        pty: whether a pseudo-terminal gets the frames.
        speed: seconds of the table in a second of the wall clock; 0: as fast as it computes and
            the clients of the stream read.
    """

    host: str = "127.0.0.1"
    port: int = 0
    stream_port: int = 0
    udp: tuple[str, int] | None = None
    pty: bool = False
    speed: float = 1.0


@dataclass
class Server:
    """A table that is being served.

    Args:
        table: that obeys.
        wires: where.
        clock: seconds of the wall clock.
    """

    table: RateTable
    wires: Wires
    clock: Callable[[], float] = monotonic
    readers: set[asyncio.StreamWriter] = field(default_factory=set)
    ports: dict[str, int] = field(default_factory=dict)
    terminal: str | None = None

    def __post_init__(self) -> None:
        self.commands = TableCommands(self.table, self.ports)
        self._sinks: list[Callable[[bytes], Any]] = []
        self._clients: set[asyncio.Task[None]] = set()

    @contextlib.asynccontextmanager
    async def open(self) -> AsyncIterator["Server"]:
        """Listen, and run the table until the end of the context.

        Raises:
            TiltcalError: a port is taken, or the address is none of this machine.
        """
        async with contextlib.AsyncExitStack() as stack:
            for name, port, serve in (
                ("command", self.wires.port, self._obey),
                ("stream", self.wires.stream_port, self._stream),
            ):
                listening = await self._listen(serve, port)
                stack.callback(listening.close)
                self.ports[name] = listening.sockets[0].getsockname()[1]
            await self._open_sinks(stack)
            self.running = asyncio.create_task(self._run(self.clock()))
            stack.push_async_callback(self._end, self.running)
            yield self

    async def _listen(self, serve: Any, port: int) -> asyncio.Server:
        try:
            return await asyncio.start_server(serve, self.wires.host, port, limit=LINE)
        except OSError as error:
            raise TiltcalError(
                f"{self.wires.host}:{port}",
                found=(error.strerror or str(error)).lower(),
                need="a free port of this machine",
                do="choose another --port, or 0 for any free one",
            ) from error

    async def _open_sinks(self, stack: contextlib.AsyncExitStack) -> None:
        if self.wires.udp is not None:
            loop = asyncio.get_running_loop()
            try:
                transport, _ = await loop.create_datagram_endpoint(
                    asyncio.DatagramProtocol, remote_addr=self.wires.udp
                )
            except OSError as error:
                raise TiltcalError(
                    f"{self.wires.udp[0]}:{self.wires.udp[1]}",
                    found=(error.strerror or str(error)).lower(),
                    need="a machine that can be reached",
                    do="correct --udp",
                ) from error
            stack.callback(transport.close)
            self._sinks.append(transport.sendto)
        if self.wires.pty:
            import pty
            import tty

            ours, theirs = pty.openpty()
            tty.setraw(theirs)
            os.set_blocking(ours, False)
            stack.callback(os.close, ours)
            stack.callback(os.close, theirs)
            self.terminal = os.ttyname(theirs)
            self._sinks.append(lambda frame: _write_whole(ours, frame))

    async def _end(self, running: "asyncio.Task[None]") -> None:
        """Close every connection; what the table ran into is raised."""
        tasks = [running, *self._clients]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if not running.cancelled() and (error := running.exception()) is not None:
            raise error

    async def _run(self, start: float) -> None:
        """Advance the table with the clock, which stood at ``start`` when it was switched on."""
        begun = self.table.time
        while True:
            if self.wires.speed > 0:
                await asyncio.sleep(TICK_S)
                await self.advance(begun + (self.clock() - start) * self.wires.speed)
            else:
                await asyncio.sleep(0)
                await self.advance(self.table.time + SLICE / self.table.rate_hz)

    async def advance(self, time: float) -> None:
        """Send the frames up to an instant of the table, s."""
        while self.table.time < time:
            upto = min(time, self.table.time + SLICE / self.table.rate_hz)
            for frame in self.table.advance(upto):
                if not frame.lost:
                    self._send(self.table.format.pack(frame.counter, frame.time, frame.values))
            await self._let_read()

    async def _let_read(self) -> None:
        """Give others their turn; without a clock, wait for the readers of the stream."""
        await asyncio.sleep(0)
        if self.wires.speed == 0:
            for writer in list(self.readers):
                with contextlib.suppress(ConnectionError):
                    await writer.drain()

    def _send(self, frame: bytes) -> None:
        for writer in self.readers:
            if self.wires.speed == 0 or writer.transport.get_write_buffer_size() < BACKLOG:
                writer.write(frame)
        for sink in self._sinks:
            sink(frame)

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Frames to one client, until it leaves."""
        with self._client(writer):
            if self.wires.speed == 0:  # the table waits for its readers, not for their buffers
                writer.transport.set_write_buffer_limits(high=0)
                wire = writer.get_extra_info("socket")
                wire.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_AHEAD)
            self.readers.add(writer)
            try:
                while await reader.read(LINE):
                    pass  # this connection sends nothing
            finally:
                self.readers.discard(writer)

    async def _obey(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Commands of one client, until it leaves."""
        with self._client(writer):
            waiting = b""
            while data := await reader.read(LINE):
                *lines, waiting = (waiting + data).split(b"\n")
                if len(waiting) > LINE:
                    waiting = b""
                    self.commands.interpreter.refuse(-363)
                for line in lines:
                    answer = self.commands.line(line.decode("ascii", "replace").strip())
                    if answer is not None:
                        writer.write(answer.encode() + b"\n")
                await writer.drain()

    @contextlib.contextmanager
    def _client(self, writer: asyncio.StreamWriter) -> Any:
        """A connection that ends with its client, or with the server."""
        task = asyncio.current_task()
        assert task is not None
        self._clients.add(task)
        try:
            # it left; or the server ends: in Python 3.11 a stream reports a cancelled client as an
            # error of the program (fixed in 3.12)
            with contextlib.suppress(ConnectionError, asyncio.CancelledError):
                yield
        finally:
            self._clients.discard(task)
            writer.close()


def _write_whole(file: int, frame: bytes) -> None:
    """A frame to a terminal, dropped where nobody reads."""
    with contextlib.suppress(BlockingIOError):
        done = os.write(file, frame)
        if done < len(frame):
            os.write(file, frame[done:])
