"""Sources of live samples: each is iterated over, yields what has come at least a few times a
second, and keeps trying when its connection drops.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from tiltcal.core.addresses import address
from tiltcal.core.errors import TiltcalError
from tiltcal.guide.guide import Guide
from tiltcal.guide.lines import NOTHING, LineReader, Samples
from tiltcal.guide.state import GuideState
from tiltcal.guide.transports import (
    Serial,
    StandardInput,
    Tcp,
    Transport,
    Udp,
    require_open,
)
from tiltcal.laboratory.serve.client import TableClient
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording

TICK_S = 0.1  # between two answers: fast enough for a display
RETRY_S = 0.5  # between two trials of a connection that dropped
SILENT_S = 3.0  # without samples after which that is said
GIVEN_UP_S = 120.0  # of trials after which a dropped connection is the end of the samples


@dataclass(frozen=True)
class Arrival:
    """What came from a source.

    Args:
        samples: perhaps none.
        notice: of the connection, one sentence; empty: all is well; None: as before.
    """

    samples: Samples = NOTHING
    notice: str | None = None

    def give(self, guide: Guide) -> None:
        """Feed a guide."""
        if self.notice is not None:
            guide.note("connection", "")
            if self.notice:
                guide.note("connection", self.notice)
        if len(self.samples):
            guide.feed(self.samples.time, self.samples.columns)


class Source(Protocol):
    """Where samples come from."""

    name: str
    """For messages."""

    def __iter__(self) -> Iterator[Arrival]:
        """What comes, until it ends.

        Raises:
            TiltcalError: nobody is there at first, or what comes are no samples.
        """

    def close(self) -> None:
        """Let go of it."""


class RecordedFile:
    """A recording that is replayed.

    Args:
        path: of the recording.
        speed: seconds of the recording in one of the clock; 0: as fast as they are taken.
    """

    def __init__(self, path: Path, speed: float = 1.0) -> None:
        self.name, self._path, self._speed = path.name, path, speed

    def __iter__(self) -> Iterator[Arrival]:
        recording = read_recording(self._path).require_increasing()
        names = recording.column_names
        if not len(recording):
            return
        columns = {name: recording.column(name) for name in names}
        begun, start = time.monotonic(), float(recording.time[0])
        step = TICK_S * (self._speed or 1.0)
        for rows in _parts(recording, step):
            due = (float(recording.time[rows.stop - 1]) - start) / (self._speed or np.inf)
            while (wait := due - (time.monotonic() - begun)) > 0:
                time.sleep(min(wait, TICK_S))
                if wait > 2 * TICK_S:  # a pause of the recording
                    yield Arrival()
            part = {name: values[rows] for name, values in columns.items()}
            yield Arrival(Samples(recording.time[rows], part))

    def close(self) -> None:
        """Nothing is held."""


def _parts(recording: Recording, step: float) -> Iterator[slice]:
    """Successive rows of about a time, s."""
    edges = np.flatnonzero(np.diff(np.floor(recording.time / step))) + 1
    for first, last in zip([0, *edges], [*edges, len(recording)], strict=True):
        yield slice(int(first), int(last))


class Lines:
    """Lines of text on a transport; a connection that drops is tried again.

    Args:
        transport: on which they come.
        reader: of the lines.
    """

    def __init__(self, transport: Transport, reader: LineReader) -> None:
        self.name, self._transport, self._reader = transport.name, transport, reader

    def __iter__(self) -> Iterator[Arrival]:
        require_open(self._transport)
        heard, silent = time.monotonic(), False
        while True:
            try:
                data = self._transport.read(TICK_S)
            except (OSError, EOFError) as error:
                if self._transport.ends:
                    return
                yield from self._again(str(error))
                heard = time.monotonic()
                continue
            now = time.monotonic()
            heard = now if data else heard
            was, silent = silent, now - heard > SILENT_S
            words = "" if was and not silent else None
            if silent:
                words = f"{self.name}: nothing has come for {now - heard:.0f} s"
            damaged = self._reader.damaged
            samples = self._reader.feed(data)
            if self._reader.damaged > damaged:
                words = f"{self.name}: {self._reader.damaged} lines were no samples: left out"
            yield Arrival(samples, words)

    def _again(self, cause: str) -> Iterator[Arrival]:
        """Connect again.

        Raises:
            TiltcalError: it was tried for long enough.
        """
        self._transport.close()
        dropped = time.monotonic()
        while True:
            away = time.monotonic() - dropped
            words = f"{self.name}: the connection dropped {away:.0f} s ago ({cause}), trying again"
            yield Arrival(notice=words)
            try:
                self._transport.open()
                break
            except OSError as error:
                _give_up(self.name, away, error)
            time.sleep(RETRY_S)
        away = time.monotonic() - dropped
        self._reader.skip(away)
        yield Arrival(notice=f"{self.name}: back after {away:.1f} s; only that gap is missing")

    def close(self) -> None:
        """Let go of the connection."""
        self._transport.close()


def _give_up(name: str, away: float, error: Exception) -> None:
    """Refuse to wait for ever.

    Raises:
        TiltcalError: it was tried for long enough.
    """
    if away > GIVEN_UP_S:
        raise TiltcalError(
            name,
            found=f"no connection for {away:.0f} s",
            need="the source that was there before",
            do="start it again, and go on with another recording",
        ) from error


class ServedTable:
    """A table of ``tiltcal serve``: its frames, and its drives.

    Args:
        host, port: of its commands.
        rate_deg_s: of moves.
    """

    def __init__(self, host: str, port: int, rate_deg_s: float = 30.0) -> None:
        self.name = f"table {host}:{port}"
        self._where, self._rate = (host, port), rate_deg_s
        self._client: TableClient | None = None
        self._asked: Mapping[str, float] = {}

    def __iter__(self) -> Iterator[Arrival]:
        self._client = self._connected()
        while True:
            rows: list[tuple[float, list[float]]] = []
            assert self._client is not None
            names, due = self._client.format.columns, time.monotonic() + TICK_S
            try:
                for _, stamp, values in self._client.frames():
                    rows.append((stamp, values))
                    if time.monotonic() >= due or len(rows) >= 1000:
                        break
            except TiltcalError as error:
                yield _frames(rows, names)
                yield from self._again(str(error))
                continue
            yield _frames(rows, names)

    def drive(self, angles_deg: Mapping[str, float]) -> None:
        """Have the axes go to some angles.

        Args:
            angles_deg: axis -> angle, deg.

        Raises:
            TiltcalError: the table refuses.
        """
        if self._client is None:
            return
        self._asked = dict(angles_deg)
        numbers = {axis: k for k, (axis, _) in enumerate(self._client.axes, start=1)}
        for axis, angle in angles_deg.items():
            number = numbers[axis]
            self._client.send(f":MODe:POSition {number};:LIMit:RATE {number},{self._rate!r}")
            self._client.send(f":DEMand:POSition {number},{float(angle)!r}")
        self._client.require_no_error("turning to the next pose")

    def close(self) -> None:
        """Let go of the connection."""
        if self._client is not None:
            self._client.__exit__()
            self._client = None

    def _connected(self) -> TableClient:
        return TableClient(*self._where)

    def _again(self, cause: str) -> Iterator[Arrival]:
        """Connect again, and go on to the pose that was asked for.

        Raises:
            TiltcalError: it was tried for long enough.
        """
        self.close()
        dropped = time.monotonic()
        while self._client is None:
            away = time.monotonic() - dropped
            yield Arrival(notice=f"{self.name}: the connection dropped, trying again ({cause})")
            try:
                self._client = self._connected()
            except TiltcalError as error:
                _give_up(self.name, away, error)
                time.sleep(RETRY_S)
        self.drive(self._asked)
        away = time.monotonic() - dropped
        yield Arrival(notice=f"{self.name}: back after {away:.1f} s; only that gap is missing")


def _frames(rows: list[tuple[float, list[float]]], names: tuple[str, ...]) -> Arrival:
    if not rows:
        return Arrival()
    values = np.array([row for _, row in rows])
    stamps = np.array([stamp for stamp, _ in rows])
    return Arrival(Samples(stamps, {name: values[:, k] for k, name in enumerate(names)}))


class TableDriver:
    """Turns a served table to each pose that a guide proposes.

    Args:
        table: a source that is being iterated over.
    """

    def __init__(self, table: ServedTable) -> None:
        self._table = table
        self._dwells = -1

    def follow(self, state: GuideState) -> None:
        """Turn on where a dwell was taken since the last call.

        Args:
            state: of the guide.

        Raises:
            TiltcalError: the table refuses.
        """
        if state.next is None or state.manner != "table" or len(state.dwells) == self._dwells:
            return
        self._dwells = len(state.dwells)
        self._table.drive(state.next.angles_deg)


@dataclass(frozen=True)
class SourceOptions:
    """How a source is read.

    Args:
        columns: names of the cells of lines; empty: by their header.
        rate_hz: of lines without a time.
        baud: of a serial port.
        speed: of a recorded file; 0: as fast as it is taken.
    """

    columns: tuple[str, ...] = ()
    rate_hz: float | None = None
    baud: int = 115200
    speed: float = 1.0


SCHEMES = ("tcp", "udp", "serve", "serial")


def open_source(text: str, options: SourceOptions | None = None) -> Source:
    """The source of an address.

    Args:
        text: ``tcp://HOST:PORT``, ``udp://HOST:PORT`` (to listen on), ``serve://HOST:PORT`` (the
            commands of ``tiltcal serve``), ``serial:DEVICE`` or a device (/dev/ttyUSB0, COM3),
            ``-`` (standard input), or a recorded file.
        options: how it is read.

    Raises:
        TiltcalError: it is none of them.
    """
    options = options or SourceOptions()
    if text == "-":
        return _lines(StandardInput(), options)
    scheme, colon, rest = text.partition(":")
    if colon and scheme.lower() in SCHEMES:
        rest = rest.removeprefix("//")
        if scheme.lower() == "serial":
            return _lines(Serial(rest, options.baud), options)
        host, port = address(rest.rstrip("/"))
        if scheme.lower() == "serve":
            return ServedTable(host, port)
        return _lines(Tcp(host, port) if scheme.lower() == "tcp" else Udp(host, port), options)
    path = Path(text)
    if _is_device(path):
        return _lines(Serial(text, options.baud), options)
    if not path.exists():
        raise TiltcalError(
            f"source {text}",
            found="no such file or device",
            need="a file, a serial port, - or tcp://, udp://, serve://HOST:PORT",
            do="correct it",
        )
    return RecordedFile(path, options.speed)


def _lines(transport: Transport, options: SourceOptions) -> Lines:
    midway = isinstance(transport, Serial)
    return Lines(transport, LineReader(transport.name, options.columns, options.rate_hz, midway))


def _is_device(path: Path) -> bool:
    """Whether a path is a serial port."""
    windows = path.name.upper().startswith("COM") and path.name[3:].isdigit()
    return windows or path.is_char_device()
