"""Recordings written as files: CSV, Parquet, NPZ; the ending decides."""

from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing
from tiltcal.recordings.csv_files import write_csv_file
from tiltcal.recordings.npz_files import write_npz
from tiltcal.recordings.parquet_files import write_parquet
from tiltcal.recordings.samples import Columns

SUFFIXES = (".csv", ".parquet", ".npz")


def write_recording(recording: Columns, path: Path | str) -> None:
    """Write a recording, whole or not at all; the ending decides the format.

    Raises:
        TiltcalError: the ending is unknown or the path cannot be written.
    """
    path = require_suffix(Path(path))
    writers = {".csv": write_csv_file, ".parquet": write_parquet, ".npz": write_npz}
    with replacing(path) as temporary:
        writers[path.suffix](recording, temporary)


def require_suffix(path: Path) -> Path:
    """``path`` when its ending names a format that recordings are written in.

    Raises:
        TiltcalError: it does not.
    """
    if path.suffix not in SUFFIXES:
        raise TiltcalError(
            f"output {path}",
            found=f"the ending '{path.suffix}'",
            need="one of " + ", ".join(SUFFIXES),
            do="rename it",
        )
    return path
