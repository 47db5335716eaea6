"""``tiltcal view`` and ``film``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.api.table_scene import stage
from tiltcal.cli.options import Json, between
from tiltcal.cli.output import print_json, print_note, progress_line
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import Rate, report_each
from tiltcal.core.units import unit_sign
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.replay import replay
from tiltcal.report.moving_table import write_film, write_scene
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Course, Drive

PLAYED_HZ = 20  # instants of a page
FILMED_HZ = 25
FILM = (640, 480)  # px

Moving = Annotated[
    Path,
    Parameter("FILE", help="Scenario or design.toml with a sequence, or a recording on a table."),
]
Described = Annotated[
    Path | None, Parameter(help="Of a recording: the scenario with its site and rig.")
]
Length = Annotated[
    float,
    Parameter(
        validator=between(0.1, 600),
        help="Longest time of playing, s; what takes longer is played faster.",
    ),
]


@dataclass(frozen=True)
class Shown:
    """What is played.

    Args:
        setup: site, table and sensors.
        drive: of the table, at the instants that are shown.
        speed: how much faster than it was.
    """

    setup: Setup
    drive: Drive
    speed: float

    @property
    def labels(self) -> list[str]:
        """Time and angles at each instant."""
        table = self.setup.rig.kind
        formats = {
            f"{name} {{:.1f}}{unit_sign(table.unit(name))}": np.asarray(jet.x) / table.size(name)
            for name, jet in self.drive.axes.items()
        }
        return [
            ", ".join([f"{t:.1f} s", *(form.format(a[k]) for form, a in formats.items())])
            for k, t in enumerate(self.drive.elapsed)
        ]


def view(
    file: Moving,
    /,
    *,
    scenario: Described = None,
    seconds: Length = 30.0,
    output: Annotated[Path, Parameter(alias="-o", help="Page to write, HTML.")] = Path("view.html"),
    as_json: Json = False,
) -> int:
    """Write a page with the table in motion.

    The page opens offline in a browser: turn the scene with the mouse, play or
    scrub the time below it. The nominal table is shown, by the model in MJCF.

      tiltcal view bench.toml -o bench.html
      tiltcal view run.csv --scenario bench.toml -o run.html
    """
    shown = _shown(file, scenario, seconds, PLAYED_HZ)
    write_scene(output, stage().scene(shown.setup, shown.drive), shown.labels, PLAYED_HZ)
    _print_result(output, shown, len(shown.labels), as_json)
    return 0


def film(
    file: Moving,
    /,
    *,
    scenario: Described = None,
    seconds: Length = 20.0,
    output: Annotated[Path, Parameter(alias="-o", help="Film to write, MP4.")] = Path("film.mp4"),
    as_json: Json = False,
) -> int:
    """Write a film of the table in motion.

    MuJoCo draws the nominal table without a display, by EGL.

      tiltcal film bench.toml -o bench.mp4
      tiltcal film run.csv --scenario bench.toml --seconds 10 -o run.mp4
    """
    shown = _shown(file, scenario, seconds, FILMED_HZ)
    with progress_line() as progress:
        rate = Rate(len(shown.labels), "pictures")
        pictures = stage().pictures(shown.setup, shown.drive, *FILM)
        drawn = report_each(pictures, rate, progress)
        count = write_film(output, drawn, *FILM, FILMED_HZ)
    _print_result(output, shown, count, as_json)
    return 0


def _print_result(output: Path, shown: Shown, count: int, as_json: bool) -> None:
    if as_json:
        print_json({"written": str(output), "instants": count, "speed": shown.speed})
    else:
        print_note(f"{output}: {count} instants, {shown.speed:.3g} times as fast")


def _shown(file: Path, scenario: Path | None, seconds: float, rate_hz: int) -> Shown:
    """The table along a sequence or a recording.

    Raises:
        TiltcalError: nothing moves, or a recording comes without a scenario.
    """
    setup, course = _course(file, scenario)
    begin, end = course.times
    if not end > begin:
        raise TiltcalError(
            f"{file}", found="one instant", need="something that moves", do="record for longer"
        )
    speed = max(1.0, (end - begin) / seconds)
    time: Array = np.arange(begin, end, speed / rate_hz)
    return Shown(setup, course.drive(time), speed)


def _course(file: Path, scenario: Path | None) -> tuple[Setup, Course]:
    if file.suffix == ".toml":
        described = load_scenario(file)
        if not described.sequence:
            raise TiltcalError(
                f"scenario {file}",
                found="no [[sequence]]",
                need="something that moves",
                do="add a sequence, or give a recording with --scenario",
            )
        return described, described.schedule
    if scenario is None:
        raise TiltcalError(
            "command line",
            found=f"the recording {file} without --scenario",
            need="the table it was made on",
            do="add --scenario SCENARIO",
        )
    described = load_scenario(scenario)
    return described, replay(read_recording(file), described)
