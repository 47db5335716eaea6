"""A client of the served table: has it run a sequence, and records the frames."""

import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.serve.frame import FrameFormat
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sequence import Step
from tiltcal.setup.tables import CHANNEL

PATIENCE_S = 30.0  # of the wall clock, for an answer or a frame
BUFFER = 8192  # bytes of frames that wait to be read: the table is hardly ahead of its reader
LEAD_S = 1.0  # of standstill before the first step
ASK = 10  # frames between two questions whether it still moves
ARRIVED = 0.01  # deg or mm: an axis further from its target has not obeyed
MOVING = 1  # bit of the status byte


class TableClient:
    """A connection to a served table, commands and frames.

    Args:
        host, port: of the commands.

    Raises:
        TiltcalError: nobody answers there.
    """

    def __init__(self, host: str, port: int) -> None:
        self.where = f"{host}:{port}"
        self._wire = self._connect(host, port)
        self._lines = self._wire.makefile("rb")
        self.format = FrameFormat(tuple(self.ask(":STReam:COLumns?").split(",")))
        self._stream = self._connect(host, int(self.ask(":STReam:PORT?")))
        self._frames = self._stream.makefile("rb", buffering=BUFFER)

    def __enter__(self) -> "TableClient":
        return self

    def __exit__(self, *_: object) -> None:
        for closing in (self._lines, self._frames, self._wire, self._stream):
            closing.close()

    def _connect(self, host: str, port: int) -> socket.socket:
        wire = socket.socket()
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        wire.settimeout(PATIENCE_S)
        try:
            wire.connect((host, port))
        except OSError as error:
            wire.close()
            raise self._silent(error.strerror or str(error)) from error
        return wire

    @property
    def axes(self) -> list[tuple[str, str]]:
        """Each axis with the unit of its readout, deg or mm, outermost first."""
        channels = [c for c in self.format.columns if c.startswith(CHANNEL)]
        return [tuple(c.removeprefix(CHANNEL).rsplit("_", 1)) for c in channels]  # type: ignore[misc]

    def send(self, line: str) -> None:
        """A command without an answer."""
        self._wire.sendall(line.encode() + b"\n")

    def ask(self, line: str) -> str:
        """The answer to a query.

        Raises:
            TiltcalError: there is none.
        """
        self.send(line)
        try:
            answer = self._lines.readline()
        except OSError as error:
            raise self._silent(str(error)) from error
        if not answer:
            raise self._silent("a closed connection")
        return answer.decode().strip()

    def frames(self) -> Iterator[tuple[int, float, list[float]]]:
        """Counter, time and values of one frame after the other.

        Raises:
            TiltcalError: the stream ends, or a frame is damaged.
        """
        while True:
            try:
                frame = self._frames.read(self.format.size)
            except OSError as error:
                raise self._silent(str(error)) from error
            if not frame:
                raise self._silent("a stream that ended")
            yield self.format.unpack(frame)

    def require_no_error(self, doing: str) -> None:
        """Refuse to go on after an error.

        Raises:
            TiltcalError: the table keeps one.
        """
        error = self.ask(":SYSTem:ERRor?")
        if not error.startswith("0,"):
            raise TiltcalError(
                f"table {self.where}, {doing}",
                found=f"error {error}",
                need="a command that is obeyed",
                do="correct the sequence, or the limits and the interlock of the table",
            )

    def _silent(self, found: str) -> TiltcalError:
        return TiltcalError(
            f"table {self.where}",
            found=found.lower(),
            need="a served table",
            do="start `tiltcal serve`, and give the port of its commands",
        )


@dataclass
class SequenceRecorder:
    """Runs a sequence and keeps the frames.

    Args:
        client: connected.
        steps: of a sequence file.
    """

    client: TableClient
    steps: Sequence[Step]
    rows: list[tuple[int, float, list[float]]] = field(default_factory=list)
    labels: list[str | None] = field(default_factory=list)
    mounts: list[str] = field(default_factory=list)
    label: str | None = None

    def record(self) -> Recording:
        """The recording of all steps.

        Raises:
            TiltcalError: the table refuses a command, or an axis does not arrive.
        """
        columns = self.client.format.columns
        self.axes = self.client.axes
        self._frames = self.client.frames()
        self.mounts.append(self.client.ask(":MOUNt?"))
        for number in range(1, len(self.axes) + 1):
            self.client.send(f":MODe:POSition {number}")
        self.client.require_no_error("switching the drives on")
        self._keep(LEAD_S)
        for number, step in enumerate(self.steps, start=1):
            self._run(step, f"step {number}")
        values = np.array([row for _, _, row in self.rows])
        return Recording.from_columns(
            np.array([time for _, time, _ in self.rows]),
            {name: values[:, k] for k, name in enumerate(columns)},
            labels=np.array(self.labels, dtype=object) if any(self.labels) else None,
            metadata=self._metadata(),
            source=f"recording of {self.client.where}",
        )

    def _run(self, step: Step, doing: str) -> None:
        self._keep(
            0.0
        )  # the table is ahead of its reader: what is to come belongs to the step before
        self.label = step.label
        if step.mount is not None:
            self._remount(step.mount, doing)
        for axis, position, rate in self._asked(step):
            number = self._number(axis, doing)
            self.client.send(f":LIMit:RATE {number},{rate!r}")
            self.client.send(f":DEMand:POSition {number},{position!r}")
        self.client.require_no_error(doing)
        while int(self.client.ask("*STB?")) & MOVING:
            for _ in range(ASK):
                self._read()
        for axis, position, _ in self._asked(step):
            self._require_arrived(axis, position, doing)
        self._keep(step.dwell_s)

    def _asked(self, step: Step) -> Iterator[tuple[str, float, float]]:
        """Each axis that a step moves, where to, and how fast, in deg or mm."""
        for axis, position in step.angles_deg.items():
            yield axis, position, step.rate_deg_s
        for axis, position in step.lengths_mm.items():
            yield axis, position, step.rate_mm_s

    def _remount(self, mount: str, doing: str) -> None:
        """The frames after this instant have the new mounting."""
        time = float(self.client.ask(f':MOUNt "{mount}";:SYSTem:TIME?'))
        self.client.require_no_error(doing)
        (first, start, _), (last, end, _) = self.rows[0], self.rows[-1]
        between = time + (end - start) / (last - first) / 2
        self.mounts.append(f"{between:.9g} s: {mount}")

    def _number(self, axis: str, doing: str) -> int:
        names = [name for name, _ in self.axes]
        if axis not in names:
            raise TiltcalError(
                f"sequence, {doing}",
                found=f"axis {axis}",
                need=f"an axis of this table: {', '.join(names)}",
                do="correct the sequence, or serve another table",
            )
        return names.index(axis) + 1

    def _require_arrived(self, axis: str, position: float, doing: str) -> None:
        number = self._number(axis, doing)
        there, unit = float(self.client.ask(f":READ:POSition? {number}")), self.axes[number - 1][1]
        if abs(there - position) > ARRIVED:
            raise TiltcalError(
                f"table {self.client.where}, {doing}",
                found=f"axis {axis} at {there:g} {unit}",
                need=f"{position:g} {unit}",
                do="free the axis, or reset the table after a trip",
            )

    def _keep(self, seconds: float) -> None:
        """Record for a while of the table's time, from now on."""
        end = float(self.client.ask(":SYSTem:TIME?")) + seconds
        while not self.rows or self.rows[-1][1] < end:
            self._read()

    def _read(self) -> None:
        self.rows.append(next(self._frames))
        self.labels.append(self.label)

    def _metadata(self) -> dict[str, str]:
        lost = self.rows[-1][0] - self.rows[0][0] + 1 - len(self.rows)
        found = {"recorded from": self.client.ask("*IDN?")}
        if lost:
            found["frames lost"] = str(lost)
        return found | {"mount": "; ".join(self.mounts)}
