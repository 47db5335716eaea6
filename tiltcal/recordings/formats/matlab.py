"""MATLAB files of version 5 (4, 6 and 7 as well); 7.3 is HDF5."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import Raw, RawFile, by_length, vectors

_CELL = 8  # bytes of a value


def read_matlab(path: Path, budget: ReadBudget) -> RawFile:
    """Matrices as columns, and the fields of structures by ``name.field``.

    Raises:
        TiltcalError: nothing but MATLAB objects (table, timetable) is in it.
    """
    from scipy import io

    listed = io.whosmat(path)
    budget.require(sum(_CELL * np.prod(shape, dtype=float) for _, shape, _ in listed), path.name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content = io.loadmat(path, simplify_cells=True, verify_compressed_data_integrity=True)
    objects = [n for n, _, kind in listed if kind in ("opaque", "object", "unknown")]
    objects = [n for n in objects if n != "__function_workspace__"]
    values = {k: v for k, v in content.items() if not k.startswith("__") and k not in objects}
    columns = [c for name, value in values.items() for c in _channels(name, value)]
    if objects and not columns:
        raise _objects_only(path.name, objects)
    return RawFile(path.name, "MATLAB", by_length(columns, {}, path.name))


def _channels(name: str, value: Any) -> list[tuple[str, Raw]]:
    """The columns of a variable; fields of structures by ``name.field``."""
    if isinstance(value, dict):
        return [c for key, inner in value.items() for c in _channels(f"{name}.{key}", inner)]
    return vectors(name, value)


def _objects_only(source: str, objects: list[str]) -> TiltcalError:
    name = objects[0] or "T"
    return TiltcalError(
        f"foreign recording {source}",
        found=f"only MATLAB objects ({', '.join(o or 'unnamed' for o in objects)}),"
        " such as a table or timetable",
        need="plain arrays or structures",
        do=f"in MATLAB: S = table2struct(timetable2table({name}), 'ToScalar', true);"
        " save('run.mat', '-struct', 'S')",
    )
