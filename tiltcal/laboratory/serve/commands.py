"""The commands of the served table, in the style of ACUTROL controllers: axes are numbered from 1,
the outermost first; angles are in deg, lengths in mm.

The syntax is that of SCPI: case-insensitive, short and long forms, several commands on a line.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from tiltcal import __version__
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_mount
from tiltcal.laboratory.serve.axis import AxisDrive, Mode
from tiltcal.laboratory.serve.rate_table import RateTable

ERRORS = {
    0: "No error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -120: "Numeric data error",
    -200: "Execution error; interlock open",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
}
QUEUE = 32  # errors that are kept
LARGEST = 1e9  # of a parameter


class CommandError(Exception):
    """A command that is not executed. Args: number of ERRORS."""

    def __init__(self, number: int) -> None:
        super().__init__(ERRORS[number])
        self.number = number


@dataclass(frozen=True)
class Command:
    """A command and what it needs.

    Args:
        run: (parameters) -> answer, or None.
        least, most: parameters.
    """

    run: Callable[[list[str]], str | None]
    least: int = 0
    most: int = 0


class Interpreter:
    """Runs lines of commands, and keeps the errors.

    Args:
        commands: by header, capitals are the short form: ``:DEMand:POSition``, ``*IDN?``.
    """

    def __init__(self, commands: Mapping[str, Command]) -> None:
        self.commands = {form: c for header, c in commands.items() for form in forms(header)}
        self.errors: list[int] = []

    def line(self, text: str) -> str | None:
        """Run a line; the answers of its queries, joined by ``;``."""
        answers = []
        for part in _split(text, ";"):
            if part.strip():
                try:
                    answer = self._run(part.strip())
                except CommandError as error:
                    self.refuse(error.number)
                    continue
                if answer is not None:
                    answers.append(answer)
        return ";".join(answers) if answers else None

    def refuse(self, number: int) -> None:
        """Keep an error; the last entry states that there were more."""
        self.errors.append(number if len(self.errors) < QUEUE - 1 else -350)
        del self.errors[QUEUE:]

    def next_error(self) -> str:
        """The oldest error, which is then forgotten."""
        number = self.errors.pop(0) if self.errors else 0
        return f'{number},"{ERRORS[number]}"'

    def _run(self, text: str) -> str | None:
        header, _, remainder = text.partition(" ")
        command = self.commands.get(header.lower().removeprefix(":"))
        if command is None:
            raise CommandError(-113)
        parameters = [part.strip() for part in _split(remainder, ",")] if remainder.strip() else []
        if len(parameters) < command.least:
            raise CommandError(-109)
        if len(parameters) > command.most:
            raise CommandError(-108)
        return command.run(parameters)


def forms(header: str) -> list[str]:
    """Every spelling of a header, in lower case, without its first colon."""
    found = [""]
    for node in re.split(r"(?=:)", header.removeprefix(":")):
        query = "?" if node.endswith("?") else ""
        long = node.removesuffix("?")
        short = re.sub(r"[a-z]", "", long)
        ends = {(long + query).lower(), (short + query).lower()}
        found = [begin + end for begin in found for end in sorted(ends)]
    return found


def _split(text: str, mark: str) -> list[str]:
    """At a mark that is not inside quotes or brackets."""
    return re.findall(rf"(?:\"[^\"]*\"|'[^']*'|[^{mark}])+", text)


def number(text: str, low: float = -LARGEST, high: float = LARGEST) -> float:
    """A parameter as a number.

    Raises:
        CommandError: it is none, or out of range.
    """
    try:
        value = float(text)
    except ValueError as error:
        raise CommandError(-120) from error
    if not low <= value <= high:
        raise CommandError(-222)
    return value


def whole(text: str, low: int, high: int) -> int:
    """A parameter as a whole number.

    Raises:
        CommandError: it is none, or out of range.
    """
    value = number(text, low, high)
    if value != int(value):
        raise CommandError(-224)
    return int(value)


MOVING, ERROR, OPEN, OFF = 1, 4, 8, 16  # bits of the status byte
TINY = 1e-6  # least limit of a rate or acceleration, in the unit of the axis


class TableCommands:
    """The commands of a table.

    Args:
        table: that obeys.
        ports: of the streams by name, for ``:STReam:PORT?``.
    """

    def __init__(self, table: RateTable, ports: Mapping[str, int] | None = None) -> None:
        self.table, self.ports = table, {} if ports is None else ports
        self.interpreter = Interpreter({**self._common(), **self._motion(), **self._faults()})

    def line(self, text: str) -> str | None:
        """Run a line at the table's present time."""
        return self.interpreter.line(text)

    def _common(self) -> dict[str, Command]:
        table = self.table
        return {
            "*IDN?": Command(lambda _: f"tiltcal,{table.scenario.rig.table},0,{__version__}"),
            "*STB?": Command(lambda _: str(self._status())),
            "*CLS": Command(lambda _: self.interpreter.errors.clear()),
            "*RST": Command(lambda _: table.reset()),
            ":SYSTem:ERRor?": Command(lambda _: self.interpreter.next_error()),
            ":SYSTem:TIME?": Command(lambda _: f"{table.time:.6f}"),
            ":STReam:COLumns?": Command(lambda _: ",".join(table.format.columns)),
            ":STReam:COUNter?": Command(lambda _: str(table.counter)),
            ":STReam:PORT?": Command(lambda _: str(self.ports.get("stream", 0))),
            ":MOUNt": Command(self._mount, 1, 1),
            ":MOUNt?": Command(lambda _: table.mount),
        }

    def _motion(self) -> dict[str, Command]:
        units = {"POSition": 0, "RATE": 1, "ACCeleration": 2}
        modes: dict[str, Mode] = {"POSition": "position", "RATE": "rate", "OFF": "off"}
        return {
            **{f":MODe:{name}": self._for_axis(self._mode(m)) for name, m in modes.items()},
            ":MODe?": self._for_axis(lambda axis: axis.mode.upper()),
            ":DEMand:POSition": self._for_axis(self._position, 1),
            ":DEMand:RATE": self._for_axis(self._rate, 1),
            ":DEMand?": self._query(lambda axis: (axis.demand,)),
            **{f":READ:{w}?": self._for_axis(self._read(k)) for w, k in units.items()},
            ":LIMit:RATE": self._for_axis(self._limit("rate"), 1),
            ":LIMit:RATE?": self._query(lambda axis: (axis.rate,)),
            ":LIMit:ACCeleration": self._for_axis(self._limit("acceleration"), 1),
            ":LIMit:ACCeleration?": self._query(lambda axis: (axis.acceleration,)),
            ":LIMit:POSition": self._for_axis(self._range, 2),
            ":LIMit:POSition?": self._query(lambda axis: (axis.low, axis.high)),
        }

    def _faults(self) -> dict[str, Command]:
        table = self.table

        def lose(parameters: list[str]) -> None:
            table.to_lose = whole(parameters[0], 0, 10**9)

        return {
            ":INTerlock:OPEN": Command(lambda _: self._interlock(False)),
            ":INTerlock:CLOSe": Command(lambda _: self._interlock(True)),
            ":INTerlock?": Command(lambda _: "CLOSED" if table.interlock else "OPEN"),
            ":FAULt:LOST": Command(lose, 1, 1),
            ":FAULt:TRIP": Command(lambda _: table.trip()),
            ":FAULt:SLIP": self._for_axis(self._slip, 1),
            ":FAULt:STICk": self._for_axis(self._stick, 1),
        }

    def _for_axis(self, act: Callable[..., str | None], more: int = 0) -> Command:
        """A command whose first parameter is the number of an axis."""

        def run(parameters: list[str]) -> str | None:
            axes = list(self.table.axes.values())
            return act(axes[whole(parameters[0], 1, len(axes)) - 1], *parameters[1:])

        return Command(run, 1 + more, 1 + more)

    def _query(self, parts: Callable[[AxisDrive], Sequence[float]]) -> Command:
        """A query for numbers of an axis, in its unit."""
        return self._for_axis(
            lambda axis: ",".join(f"{part / axis.unit:.9g}" for part in parts(axis))
        )

    def _status(self) -> int:
        table = self.table
        bits = {
            MOVING: table.moving(),
            ERROR: bool(self.interpreter.errors),
            OPEN: not table.interlock,
            OFF: any(axis.mode == "off" for axis in table.axes.values()),
        }
        return sum(bit for bit, present in bits.items() if present)

    def _mode(self, mode: Mode) -> Callable[[AxisDrive], None]:
        def change(axis: AxisDrive) -> None:
            if mode != "off" and not self.table.interlock:
                raise CommandError(-200)
            if mode != axis.mode:
                axis.stop(self.table.time)
            axis.mode = mode

        return change

    def _ready(self, axis: AxisDrive, mode: Mode) -> None:
        if not self.table.interlock:
            raise CommandError(-200)
        if axis.mode != mode:
            raise CommandError(-221)

    def _position(self, axis: AxisDrive, parameter: str) -> None:
        self._ready(axis, "position")
        low, high = max(-LARGEST, axis.low / axis.unit), min(LARGEST, axis.high / axis.unit)
        axis.go(self.table.time, number(parameter, low, high) * axis.unit)

    def _rate(self, axis: AxisDrive, parameter: str) -> None:
        self._ready(axis, "rate")
        most = axis.rate / axis.unit
        axis.turn(self.table.time, number(parameter, -most, most) * axis.unit)

    def _read(self, part: int) -> Callable[[AxisDrive], str]:
        def read(axis: AxisDrive) -> str:
            name = next(n for n, known in self.table.axes.items() if known is axis)
            return f"{self.table.readout(name)[part] / axis.unit:.9g}"

        return read

    def _limit(self, name: str) -> Callable[[AxisDrive, str], None]:
        def change(axis: AxisDrive, parameter: str) -> None:
            if axis.moving(self.table.time):
                raise CommandError(-221)
            setattr(axis, name, number(parameter, TINY) * axis.unit)

        return change

    def _range(self, axis: AxisDrive, low: str, high: str) -> None:
        ends = number(low) * axis.unit, number(high) * axis.unit
        if ends[0] >= ends[1]:
            raise CommandError(-222)
        axis.low, axis.high = ends

    def _mount(self, parameters: list[str]) -> None:
        text = parameters[0].strip("\"'")
        try:
            parse_mount(text)
        except TiltcalError as error:
            raise CommandError(-224) from error
        if self.table.moving():
            raise CommandError(-221)
        self.table.remount(text)

    def _interlock(self, closed: bool) -> None:
        self.table.interlock = closed
        if not closed:
            self.table.trip()

    def _slip(self, axis: AxisDrive, parameter: str) -> None:
        axis.slip += number(parameter, -360, 360) * axis.unit

    def _stick(self, axis: AxisDrive, parameter: str) -> None:
        axis.seize(self.table.time, bool(whole(parameter, 0, 1)))
