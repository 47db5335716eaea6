"""Ways on which bytes come in: TCP, UDP, a serial port, the standard input."""

import os
import select
import socket
import sys
from typing import Any, Protocol

from tiltcal.core.errors import TiltcalError
from tiltcal.core.optional_library import library

CHUNK = 65536  # bytes
PATIENCE_S = 5.0  # for a connection


class Transport(Protocol):
    """A way on which bytes come in."""

    name: str
    """For messages."""
    ends: bool
    """Whether its end is the end of the samples; else it is a connection that dropped."""

    def open(self) -> None:
        """Connect. OSError: nobody is there."""

    def read(self, timeout_s: float) -> bytes:
        """What has come; empty: nothing in that time. EOFError, OSError: it has ended."""

    def close(self) -> None:
        """Let go of it."""


class _Socket:
    """What TCP and UDP share."""

    ends = False

    def __init__(self, host: str, port: int, kind: str) -> None:
        self.host, self.port = host, port
        self.name = f"{kind} {host}:{port}"
        self._wire: socket.socket | None = None

    def read(self, timeout_s: float) -> bytes:
        """What has come."""
        assert self._wire is not None
        if not select.select([self._wire], [], [], timeout_s)[0]:
            return b""
        return self._received(self._wire)

    def _received(self, wire: socket.socket) -> bytes:
        data = wire.recv(CHUNK)
        if not data:
            raise EOFError(f"{self.name} has closed the connection")
        return data

    def close(self) -> None:
        """Let go of the socket."""
        if self._wire is not None:
            self._wire.close()
            self._wire = None


class Tcp(_Socket):
    """A client of a server that sends lines.

    Args:
        host, port: of the server.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, "TCP")

    def open(self) -> None:
        """Connect."""
        self._wire = socket.create_connection((self.host, self.port), timeout=PATIENCE_S)


class Udp(_Socket):
    """A port that lines are sent to; each datagram holds whole ones.

    Args:
        host, port: to listen on.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port, "UDP")

    def open(self) -> None:
        """Listen."""
        wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            wire.bind((self.host, self.port))
        except OSError:
            wire.close()
            raise
        self.port = wire.getsockname()[1]
        self._wire = wire

    def _received(self, wire: socket.socket) -> bytes:
        data = wire.recv(CHUNK)
        return data if data.endswith(b"\n") else data + b"\n"


class Serial:
    """A serial port, or a pseudo-terminal.

    Args:
        device: its name, such as /dev/ttyUSB0 or COM3.
        baud: bits a second.
    """

    ends = False

    def __init__(self, device: str, baud: int) -> None:
        self.name = f"serial port {device}"
        self._device, self._baud = device, baud
        self._port: Any = None

    def open(self) -> None:
        """Open the port.

        Raises:
            TiltcalError: pyserial is not installed.
        """
        serial = library("serial", "serial", self.name)
        self._port = serial.Serial(self._device, self._baud, timeout=0)

    def read(self, timeout_s: float) -> bytes:
        """What has come."""
        self._port.timeout = timeout_s
        first = self._port.read(1)  # waits for one byte, and takes what is there
        return bytes(first + (self._port.read(self._port.in_waiting) if first else b""))

    def close(self) -> None:
        """Let go of the port."""
        if self._port is not None:
            self._port.close()
            self._port = None


class StandardInput:
    """Lines that a program pipes in."""

    name = "standard input"
    ends = True

    def open(self) -> None:
        """It is open."""

    def read(self, timeout_s: float) -> bytes:
        """What has come."""
        if not select.select([sys.stdin], [], [], timeout_s)[0]:
            return b""
        data = os.read(sys.stdin.fileno(), CHUNK)
        if not data:
            raise EOFError("the standard input has ended")
        return data

    def close(self) -> None:
        """It stays open."""


def require_open(transport: Transport) -> None:
    """Open a way for the first time.

    Raises:
        TiltcalError: nobody is there.
    """
    try:
        transport.open()
    except OSError as error:
        raise TiltcalError(
            transport.name,
            found=(error.strerror or str(error)).lower(),
            need="a source that sends",
            do="start it, and check its address",
        ) from error
