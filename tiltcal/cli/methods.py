"""``tiltcal methods``."""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.api.inspecting import MethodTrial, about_method, options_of, try_methods
from tiltcal.calibration.methods.registry import GROUP, METHODS
from tiltcal.cli.options import Json, SegmentsFile
from tiltcal.cli.output import paragraph, print_json, print_table, progress_line
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.segment_files import read_segments
from tiltcal.recordings.span_means import read_averaged


def methods(
    recording_file: Annotated[
        Path | None, Parameter("REC", help="Recording to try each of them on.")
    ] = None,
    /,
    *,
    scenario: Annotated[
        Path | None, Parameter(help="With REC: scenario with its site, rig and sensors.")
    ] = None,
    segments: SegmentsFile = None,
    as_json: Json = False,
) -> int:
    """List the calibration methods.

    With a recording each of them is tried on it, with its default options: the
    verdict, or why the method refuses it.

      tiltcal methods
      tiltcal methods run.csv --scenario bench.toml
    """
    if recording_file is not None:
        trials = _trials(recording_file, scenario, segments)
        if as_json:
            print_json([t.to_json() for t in trials])
        else:
            shown = [(t.method, t.verdict, t.reason or t.about) for t in trials]
            print_table(["method", "verdict", "does, or why not"], shown)
        return 0
    rows = [(name, about_method(m), ", ".join(options_of(m))) for name, m in METHODS.items()]
    rows += [(e.name, f"installed: {e.value}", "") for e in entry_points(group=GROUP)]
    if as_json:
        print_json([{"method": n, "does": d, "options": o} for n, d, o in rows])
        return 0
    print_table(["method", "does", "options"], rows, spare=["options"])
    paragraph(
        "Your own method: --method package.module:function. It is called with (Recording, Setup)"
        " and returns a Calibration."
    )
    return 0


def _trials(path: Path, scenario: Path | None, segments: Path | None) -> list[MethodTrial]:
    if scenario is None:
        raise TiltcalError(
            "command line of `tiltcal methods`",
            found="REC without a scenario",
            need="the set-up of the recording",
            do="add --scenario TOML",
        )
    with progress_line() as progress:
        recording = read_averaged(path, progress)
        dwells = None if segments is None else read_segments(segments, recording)
        return try_methods(load_scenario(scenario), recording, dwells, progress)
