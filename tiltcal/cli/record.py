"""``tiltcal record``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json
from tiltcal.cli.serve import address
from tiltcal.laboratory.serve.client import SequenceRecorder, TableClient
from tiltcal.recordings.recording_files import write_recording
from tiltcal.setup.sequence_files import read_sequence


def record(
    table: Annotated[str, Parameter("HOST:PORT", help="Command port of a served table.")],
    sequence: Annotated[Path, Parameter("SEQUENCE", help="Sequence file, CSV.")],
    recording_file: Annotated[Path, Parameter("RECORDING", help="File of the recording.")],
    /,
    *,
    as_json: Json = False,
) -> int:
    """Record a sequence file on a served table.

    The table is one that `tiltcal serve` simulates, or one with the same
    commands and frames.

      tiltcal record 127.0.0.1:5025 SEQUENCE.csv RECORDING.csv
      tiltcal investigate --scenario bench.toml --lab 'tiltcal record 127.0.0.1:5025'
    """
    steps = read_sequence(sequence)
    with TableClient(*address(table)) as client:
        recording = SequenceRecorder(client, steps).record()
    write_recording(recording, recording_file)
    if as_json:
        print_json({"recording": str(recording_file), "rows": len(recording)})
    return 0
