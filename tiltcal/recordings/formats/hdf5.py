"""HDF5 files, and MATLAB files of version 7.3, which are HDF5."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.budget import Budget
from tiltcal.recordings.formats.extras import library
from tiltcal.recordings.formats.grouping import by_length
from tiltcal.recordings.formats.raw_table import Raw, RawFile, RawTable, vectors

_UNIT_KEYS = ("units", "unit", "UNITS", "Unit", "Units")
_CLASS = "MATLAB_class"
_NUMERIC_CLASSES = {"double", "single", "logical"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def read_hdf5(path: Path, budget: Budget) -> RawFile:
    """Each group as a table of its data sets, each compound data set as a table.

    Raises:
        TiltcalError: there is no array, only MATLAB objects, or more than the budget.
    """
    h5py = library("h5py", "hdf5", "HDF5 and MATLAB v7.3 files")
    tables: list[RawTable] = []
    with h5py.File(path, "r") as file:
        groups = list(_groups(file, h5py))
        sizes = [_size(d) for _, sets in groups for d in sets.values()]
        budget.require(sum(sizes), path.name)
        for name, sets in groups:
            tables += _tables(name, sets, path.name)
        objects = [k for k, v in file.items() if _matlab_class(v) in ("table", "timetable")]
    if not tables and objects:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found=f"only MATLAB objects ({', '.join(objects)}), such as a table or timetable",
            need="plain arrays or structures",
            do="in MATLAB: S = table2struct(timetable2table(T), 'ToScalar', true);"
            " save('run.mat', '-struct', 'S')",
        )
    if not tables:
        by_length((), {}, path.name)  # says what is missing
    return RawFile(path.name, "HDF5", tuple(tables))


def _groups(file: Any, h5py: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """(path, data sets) of each group; what MATLAB keeps for itself is left out."""
    waiting = [("", file)]
    while waiting:
        name, group = waiting.pop(0)
        sets = {k: v for k, v in group.items() if isinstance(v, h5py.Dataset) and _is_array(v)}
        if sets:
            yield name, sets
        waiting += [
            (f"{name}/{k}".lstrip("/"), v)
            for k, v in group.items()
            if isinstance(v, h5py.Group) and not k.startswith("#")
        ]


def _is_array(item: Any) -> bool:
    stated = _matlab_class(item)
    return item.shape is not None and item.ndim <= 2 and stated in ("", *_NUMERIC_CLASSES)


def _matlab_class(item: Any) -> str:
    stated = item.attrs.get(_CLASS, b"")
    return stated.decode() if isinstance(stated, bytes) else str(stated)


def _size(item: Any) -> float:
    return float(np.prod(item.shape, dtype=float)) * max(item.dtype.itemsize, 8)


def _tables(name: str, sets: dict[str, Any], source: str) -> list[RawTable]:
    loose: list[tuple[str, Raw]] = []
    units: dict[str, str] = {}
    found: list[RawTable] = []
    for key, item in sets.items():
        values = item[()]
        if item.dtype.names:
            columns = [c for n in item.dtype.names for c in vectors(n, values[n])]
            found += by_length(columns, {}, source, f"{name}/{key}".lstrip("/"))
            continue
        columns = vectors(key, values)
        loose += columns
        stated = next((item.attrs[k] for k in _UNIT_KEYS if k in item.attrs), None)
        if stated is not None:
            text = stated.decode() if isinstance(stated, bytes) else str(stated)
            units |= {n: text for n, _ in columns}
    if any(len(values) > 1 for _, values in loose):
        found = [*by_length(loose, units, source, name), *found]
    return found
