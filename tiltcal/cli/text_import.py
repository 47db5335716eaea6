"""``tiltcal import``."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json
from tiltcal.recordings.recording_files import write_recording
from tiltcal.recordings.text_import import import_recording, load_mapping


def import_log(
    file: Annotated[Path, Parameter(help="Text log.")],
    /,
    *,
    mapping: Annotated[Path, Parameter("--map", help="Mapping file, TOML.")],
    output: Annotated[Path, Parameter(alias="-o", help="File of the recording.")],
    as_json: Json = False,
) -> int:
    """Import a text log from another system.

    The mapping file describes the columns of the log:

      [file]
      separator = "space"        # space (any white space), comma, tab or semicolon
      header = false
      [time]
      column = 1                 # number or name; without times: rate_hz = 100
      unit = "s"
      [[column]]
      from = 2                   # number or name
      to = "accel_x_LSB"         # <sensor>_<axis>_<unit>
      [[column]]
      file = "gyro.txt"          # a second file with the same rows
      from = 2
      to = "gyro_x_LSB"
    """
    recording = import_recording(file, load_mapping(mapping))
    write_recording(recording, output)
    back = int(np.sum(np.diff(recording.time) <= 0))
    summary = {
        "recording": str(output),
        "rows": len(recording),
        "columns": recording.column_names,
        "steps_back_in_time": back,
    }
    if as_json:
        print_json(summary)
    else:
        note = f"; time does not increase at {back} rows" if back else ""
        channels = len(recording.column_names)
        print(f"{output}: {len(recording)} rows, {channels} channels{note}", file=sys.stderr)
    return 0
