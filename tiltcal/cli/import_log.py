"""``tiltcal import``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from tiltcal.cli.options import SEVERAL, WHOLE, Json
from tiltcal.cli.output import print_json, print_line, print_note, progress_line, require_output
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.files import write_text
from tiltcal.core.progress import Stages
from tiltcal.data_quality.check import Finding
from tiltcal.recordings.foreign_files import SHARES, WRITING, Imported, import_file
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.mcap_writer import write_mcap
from tiltcal.recordings.mapping import REPAIRS, Mapping, load_mapping
from tiltcal.recordings.saving import write_recording


def import_log(
    file: Annotated[Path, Parameter(help="Log, or parameters of mujoco.sysid (YAML).")],
    /,
    *more: Annotated[Path, Parameter("FILE", help="Further files of the same recording.")],
    mapping: Annotated[
        Path | None, Parameter("--map", help="Mapping file, TOML. Needed unless --propose.")
    ] = None,
    scenario: Annotated[
        Path | None,
        Parameter(help="YAML: scenario that the parameters were exported from; -o: the new one."),
    ] = None,
    propose: Annotated[
        bool, Parameter(help="Print a mapping for this file with reasons, and import nothing.")
    ] = False,
    join: Annotated[
        Literal["time"],
        Parameter(help="How several files become one recording: on the union of their stamps."),
    ] = "time",
    instance: Annotated[
        int | None,
        WHOLE,
        Parameter(help="Rows of this instrument, where several share a table (column I)."),
    ] = None,
    repair: Annotated[
        tuple[str, ...],
        SEVERAL,
        Parameter(help=f"Repair faults of the data: {', '.join(REPAIRS)}."),
    ] = (),
    memory_gb: Annotated[
        float, Parameter(help="Refuse a file whose values take more than this.")
    ] = 4.0,
    output: Annotated[
        Path | None,
        Parameter(alias="-o", help="File of the recording, or of the proposed mapping."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Import a log from another system.

    Reads text (CSV and its relatives), NPZ, MATLAB, HDF5, Parquet, ROS 1 and
    ROS 2 bags, MCAP, PX4 ULog and LabVIEW TDMS. --propose writes a mapping file
    with a reason on each line; check it, then import with it. It describes the
    columns of the log:

      [file]
      separator = "space"        # or comma, tab, semicolon, pipe
      decimal = "point"          # or comma
      encoding = "utf-8"         # or utf-16, gb18030, cp1252
      header = false
      [time]
      column = 1                 # number or name; without times: rate_hz = 100
      unit = "s"                 # s, ms, us, ns; dates: iso, dmy, mdy
      [[column]]
      from = 2                   # number or name
      to = "accel_x_LSB"         # <sensor>_<axis>_<unit>
      [[column]]
      file = "gyro.txt"          # a second file, with the same rows or with times of its own
      from = 2
      to = "gyro_x_LSB"

    In a file with several tables (topics, groups) a column also has
    table = "sensor_accel". Files of one recording, each with its own times:

      tiltcal import accel.csv gyro.csv --propose -o map.toml
      tiltcal import accel.csv gyro.csv --map map.toml -o run.csv

    What mujoco.sysid found, as effects of the scenario that it began from:

      tiltcal import found.yaml --scenario out/amended.toml -o found.toml
    """
    del join  # the only way there is
    if scenario is not None:
        return _parameters(file, scenario, output, as_json)
    budget = ReadBudget(memory_gb)
    if propose:
        return _propose([file, *more], instance, budget, output, as_json)
    if mapping is None or output is None:
        missing = "--map" if mapping is None else "-o"
        raise TiltcalError(
            "command line of `tiltcal import`",
            found=f"no {missing}",
            need="a mapping file and a file to write",
            do="add it; `tiltcal import FILE --propose` writes a mapping",
        )
    read_by = _completed(load_mapping(mapping, instance), repair)
    with progress_line() as progress:
        stages = Stages(progress, SHARES)
        imported = import_file(file, read_by, budget, more, stages.begin)
        stages.begin(WRITING)
        if output.suffix == ".mcap":
            write_mcap(imported.recording, output)
        else:
            write_recording(imported.recording, output)
    if as_json:
        print_json(_summary(imported, output))
    else:
        _print_notes(imported, output)
    return 0


def _parameters(file: Path, scenario: Path, output: Path | None, as_json: bool) -> int:
    import tomli_w

    from tiltcal.api.model_parameters import from_sysid
    from tiltcal.laboratory.scenario import load_scenario

    require_output("import", output, as_json, "the scenario")
    text = tomli_w.dumps(from_sysid(load_scenario(scenario), file))
    if output is None:
        print_line(text.rstrip("\n"))
        return 0
    write_text(output, text)
    if as_json:
        print_json({"scenario": str(output)})
    else:
        print_note(f"{output}: the scenario with the values of {file.name}")
    return 0


def _completed(mapping: Mapping, wanted: Sequence[str]) -> Mapping:
    names = [one_of(name, REPAIRS, "--repair") for name in wanted]
    return mapping.model_copy(update={"repair": (*mapping.repair, *names)})


def _propose(
    files: Sequence[Path],
    instance: int | None,
    budget: ReadBudget,
    output: Path | None,
    as_json: bool,
) -> int:
    from tiltcal.recordings.proposal.propose import propose_mapping

    proposal = propose_mapping(files[0], budget, files[1:], instance)
    text = proposal.toml()
    if output is not None:
        write_text(output, text)
    if as_json:
        print_json(
            {
                "mapping": text,
                "cannot_know": proposal.doubts,
                "findings": [f.as_json() for f in proposal.findings],
            }
        )
    elif output is None:
        print_line(text.rstrip("\n"))
    else:
        doubts = len(proposal.doubts)
        what = "thing" if doubts == 1 else "things"
        print_note(f"{output}: proposed; {doubts} {what} it cannot know, see there")
    return 0


def _summary(imported: Imported, output: Path) -> dict[str, Any]:
    recording = imported.recording
    return {
        "recording": str(output),
        "rows": len(recording),
        "columns": recording.column_names,
        "steps_back_in_time": int(np.sum(np.diff(recording.time) <= 0)),
        "findings": [f.as_json() for f in imported.findings],
        "repairs": list(imported.repairs),
    }


def _print_notes(imported: Imported, output: Path) -> None:
    recording = imported.recording
    channels = len(recording.column_names)
    print_note(f"{output}: {len(recording)} rows, {channels} channels")
    for text in imported.repairs:
        print_note(f"repaired: {text}")
    for finding in imported.findings:
        print_note(f"found: {_statement_with_repair(finding, imported.repairs)}")


def _statement_with_repair(finding: Finding, repairs: Sequence[str]) -> str:
    done = any(text.startswith(f"{finding.repair}:") for text in repairs)
    return finding.statement if done else finding.with_repair()
