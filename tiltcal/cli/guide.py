"""``tiltcal guide``."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from tiltcal.api.scenario import load_scenario
from tiltcal.cli.calibrate import parse_options, print_calibration
from tiltcal.cli.certificate import Statements
from tiltcal.cli.guide_display import Display, Events, Page
from tiltcal.cli.options import SEVERAL, WHOLE, DescribedBy, Json, between
from tiltcal.cli.output import (
    TypedLines,
    live_text,
    on_terminal,
    print_json,
    print_line,
    print_note,
)
from tiltcal.core.errors import TiltcalError
from tiltcal.design.goals import parse_goals
from tiltcal.guide.guide import Guide
from tiltcal.guide.sources import (
    ServedTable,
    Source,
    SourceOptions,
    TableDriver,
    open_source,
)
from tiltcal.guide.state import GuideState
from tiltcal.guide.typed_angles import parse_angles
from tiltcal.report.stated import NOTHING_STATED, Stated

RATE = 1e6  # Hz, and bits a second: more than any line has


def guide(
    source: Annotated[
        str,
        Parameter(
            "SOURCE",
            help="tcp:// udp:// or serve://HOST:PORT, a serial port, - (stdin), or a file.",
        ),
    ],
    /,
    *,
    scenario: DescribedBy,
    output: Annotated[Path, Parameter(alias="-o", help="Folder of the files.")],
    method: Annotated[Literal["norm", "six_position"], Parameter(help="Of calibration.")] = "norm",
    goal: Annotated[
        tuple[str, ...],
        Parameter(help="KIND=SIGMA that a kind is to reach, such as accel.bias=50ug."),
        SEVERAL,
    ] = (),
    option: Annotated[
        tuple[str, ...], Parameter(help="KEY=VALUE for the method; may be repeated.")
    ] = (),
    hold_s: Annotated[
        float, Parameter(help="Length of a dwell.", validator=between(1, 3600))
    ] = 5.0,
    manner: Annotated[
        Literal["hand", "head", "table"] | None,
        Parameter(help="How poses are set; by the scenario and the columns unless given."),
    ] = None,
    sensor: Annotated[str | None, Parameter(help="Its name, where several fit.")] = None,
    columns: Annotated[
        str, Parameter(help="Cells of lines without a header: time_s,accel_x_m_s2,...")
    ] = "",
    rate_hz: Annotated[
        float | None, Parameter(help="Of lines without a time.", validator=between(1e-3, RATE))
    ] = None,
    baud: Annotated[int, WHOLE, Parameter(help="Bits a second of a serial port.")] = 115200,
    speed: Annotated[
        float,
        Parameter(help="Seconds of a file in one second; 0: at once.", validator=between(0, 1e6)),
    ] = 1.0,
    certificate: Annotated[bool, Parameter(help="Write a certificate, too.")] = False,
    stated: Statements = NOTHING_STATED,
    as_json: Json = False,
) -> int:
    """Guide a calibration while it is recorded: next pose, sigmas, faults.

    It says what the sensor reads, whether it stands still, which pose is the most
    useful next, and what is to be mended. It stops when every sigma has reached
    its goal, and writes recording.csv, segments.csv and CAL.json.

      tiltcal guide /dev/ttyUSB0 --scenario hand.toml -o out
      tiltcal guide tcp://10.0.0.7:4000 --scenario hand.toml --goal bias=50ug -o out
      tiltcal guide serve://127.0.0.1:5025 --scenario bench.toml -o out
      tiltcal guide run.csv --speed 0 --scenario hand.toml -o out

    While it runs: q and Enter stops, r and Enter rejects the last dwell; on a
    dividing head the angles of a dwell are typed, Enter alone: as proposed.

    Exit status: 0 every goal reached, and the calibration is good; 1 not so; 2
    unusable input.
    """
    cells = tuple(cell.strip() for cell in columns.split(",") if cell.strip())
    samples = open_source(source, SourceOptions(cells, rate_hz, baud, speed))
    made = Guide(
        load_scenario(scenario),
        method,
        goal=parse_goals(goal),
        hold_s=hold_s,
        manner=manner,
        sensor=sensor,
        **parse_options(option),
    )
    wanted = stated if certificate else None
    with _saved(made, output, wanted) as written, _display(as_json) as display:
        _run(made, samples, display, None if source == "-" else TypedLines())
    return _conclude(made, written, as_json)


@contextmanager
def _saved(made: Guide, output: Path, stated: Stated | None) -> Iterator[dict[str, Path]]:
    """The files, written whatever ends the recording."""
    written: dict[str, Path] = {}
    try:
        yield written
    finally:
        written |= made.save(output, stated)


@contextmanager
def _display(as_json: bool) -> Iterator[Display]:
    """A page on a terminal, else lines."""
    if on_terminal():
        with live_text() as write:
            yield Page(write)
        return
    yield Events(print_note if as_json else print_line)


def _run(made: Guide, samples: Source, display: Display, typed: TypedLines | None) -> None:
    """Feed the guide until it is done, the source ends, or the operator stops."""
    driver = TableDriver(samples) if isinstance(samples, ServedTable) else None
    try:
        for arrival in samples:
            arrival.give(made)
            lines = typed.read() if typed is not None else []
            if not all(_obeyed(line, made, made.state) for line in lines):
                return
            state = made.state
            if driver is not None:
                driver.follow(state)
            display.show(state)
            if state.done:
                return
    finally:
        samples.close()


def _obeyed(line: str, made: Guide, state: GuideState) -> bool:
    """Do what was typed; False: stop. What cannot be done becomes a notice."""
    if line.lower() == "q":
        return False
    made.note("typed", "")
    try:
        if line.lower() == "r":
            made.reject()
        elif state.manner == "head":
            made.set_angles(parse_angles(line, made.axes))
    except TiltcalError as error:
        made.note("typed", str(error))
    return True


def _conclude(made: Guide, written: dict[str, Path], as_json: bool) -> int:
    """Print the result; the exit status."""
    state = made.state
    files = {what: str(path) for what, path in written.items()}
    if as_json:
        print_json(state.to_json() | {"files": files})
    else:
        if "calibration" in written:
            print_calibration(made.calibrate())
        for notice in () if "calibration" in written else state.notices:
            print_line(f"{notice.kind}: {notice.statement}")
        print_line(f"{sum(d.used for d in state.dwells)} dwells; {_end_of(state)}")
        for path in files.values():
            print_line(path)
    return 0 if state.done and state.verdict == "good" else 1


def _end_of(state: GuideState) -> str:
    """Whether the goals were reached, in words."""
    if state.reached:
        return "every goal is reached"
    missing = [name.rpartition("_")[0] for name, p in state.parameters.items() if not p.reached]
    kinds = ", ".join(dict.fromkeys(missing))
    return f"goals not reached: {kinds}" if missing else "too few dwells to judge by"
