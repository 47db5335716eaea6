"""Reading recordings of every format."""

from pathlib import Path
from typing import overload

from tiltcal.recordings.foreign_files import import_recording
from tiltcal.recordings.mapping import load_mapping
from tiltcal.recordings.means_table import read_log_or_means
from tiltcal.recordings.recording import Recording

File = Path | str


@overload
def read(file: File, /, *, mapping: File | None = None) -> Recording: ...
@overload
def read(
    file: File, second: File, /, *more: File, mapping: File | None = None
) -> tuple[Recording, ...]: ...
def read(
    file: File, /, *more: File, mapping: File | None = None
) -> Recording | tuple[Recording, ...]:
    """A recording of one file, or those of several files.

    Args:
        file: CSV, Parquet or NPZ as the commands write them, or a CSV table of means; with a
            mapping any format that ``tiltcal import`` reads.
        more: further files; the result is then a tuple of recordings, in order.
        mapping: TOML file that states which columns of a foreign file become which channels.

    Raises:
        TiltcalError: a file is missing, or its content is no recording.
    """
    text = None if mapping is None else load_mapping(Path(mapping))
    found = tuple(
        read_log_or_means(path) if text is None else import_recording(path, text)
        for path in (file, *more)
    )
    return found if more else found[0]
