"""MATLAB files of version 5 (4, 6 and 7 as well); 7.3 is HDF5."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.matlab_objects import objects_only, stated_objects
from tiltcal.recordings.formats.raw_table import Raw, RawFile, by_length, vectors

_CELL = 8  # bytes of a value
_MARK = b"MATLAB 5.0"


def read_matlab(path: Path, budget: ReadBudget) -> RawFile:
    """Matrices as columns, and the fields of structures by ``name.field``.

    Raises:
        TiltcalError: nothing but MATLAB objects (table, timetable) is in it.
    """
    from scipy import io

    with path.open("rb") as file:
        version_5 = file.read(len(_MARK)) == _MARK
    objects, size = stated_objects(path) if version_5 else ([], 0)
    if objects:  # whosmat fails on them; a byte may become a double
        budget.require(_CELL * size, path.name)
    else:
        shapes = [shape for _, shape, _ in io.whosmat(path)]
        budget.require(sum(_CELL * np.prod(shape, dtype=float) for shape in shapes), path.name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = io.loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
    values = {k: v for k, v in content.items() if not k.startswith("__") and k != "None"}
    columns = [c for name, value in values.items() for c in _channels(name, value)]
    if objects and not columns:
        raise objects_only(path.name, objects)
    return RawFile(path.name, "MATLAB", by_length(columns, {}, path.name))


def _channels(name: str, value: Any) -> list[tuple[str, Raw]]:
    """The columns of a variable; fields of structures by ``name.field``."""
    if isinstance(value, dict):
        return [c for key, inner in value.items() for c in _channels(f"{name}.{key}", inner)]
    return vectors(name, value)
