"""``tiltcal record``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json
from tiltcal.core.addresses import address
from tiltcal.core.files import require_document
from tiltcal.laboratory.serve.client import SequenceRecorder, TableClient
from tiltcal.recordings.saving import write_recording
from tiltcal.setup.sequence_files import read_sequence
from tiltcal.setup.tables import add_axes


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
    require_document(sequence, "sequence")
    with TableClient(*address(table)) as client:
        add_axes(client.axes)  # a sequence may move axes of a model that is known there only
        recording = SequenceRecorder(client, read_sequence(sequence)).record()
    write_recording(recording, recording_file)
    if as_json:
        print_json({"recording": str(recording_file), "rows": len(recording)})
    return 0
