"""NPZ archives of any program: one array a column, or arrays of several columns."""

import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import Raw, RawFile, by_length, vectors


def read_npz(path: Path, budget: ReadBudget) -> RawFile:
    """All arrays of an archive; objects that need pickle are refused.

    Raises:
        TiltcalError: an array states a size that the archive does not hold, or above the budget.
    """
    columns: list[tuple[str, Raw]] = []
    with zipfile.ZipFile(path) as archive:
        members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
        budget.require(sum(m.file_size for m in members), path.name)
        for member in members:
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as file:
                _require_whole(file, member.file_size, f"{path.name}, array {name}")
            with archive.open(member) as file:
                columns += vectors(name, np.lib.format.read_array(file, allow_pickle=False))
    return RawFile(path.name, "NPZ", by_length(columns, {}, path.name))


def _require_whole(file: IO[bytes], size: int, source: str) -> None:
    """Refuse an array whose header states more than its file contains, before it is allocated."""
    version = np.lib.format.read_magic(file)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    stated = int(np.prod(shape, dtype=np.float64)) * dtype.itemsize
    if stated > size:
        raise TiltcalError(
            f"foreign recording {source}",
            found=f"a shape of {shape} in {size} bytes",
            need=f"{stated} bytes",
            do="write the archive again",
        )
