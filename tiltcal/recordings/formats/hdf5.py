"""HDF5 files, and MATLAB files of version 7.3, which are HDF5."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.optional_library import library
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.matlab_objects import objects_only
from tiltcal.recordings.formats.raw_table import DAMAGED, Raw, RawFile, by_length, vectors

_UNIT_KEYS = ("units", "unit", "UNITS", "Unit", "Units")
_CLASS = "MATLAB_class"
_TEXT = 64  # bytes of a text of Python, at least (sys.getsizeof("") is 49), with its pointer
_SHOWN = 3  # links that a finding lists
_NUMERIC_CLASSES = {"double", "single", "logical"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


def read_hdf5(path: Path, budget: ReadBudget) -> RawFile:
    """All data sets, and the fields of compound ones, by their paths.

    Raises:
        TiltcalError: there is no array, only MATLAB objects, or more than the budget.
    """
    h5py = library("h5py", "hdf5", "HDF5 and MATLAB v7.3 files")
    columns: list[tuple[str, Raw]] = []
    units: dict[str, str] = {}
    with h5py.File(path, "r") as file:
        lost: list[str] = []
        sets = list(_sets(file, h5py, lost))
        budget.require(sum(_size(item) for _, item in sets), path.name)
        for name, item in sets:
            columns += _channels(name, item, units)
        items = [(k, _followed(file, k)) for k in file]
        classes = [(k, _matlab_class(v)) for k, v in items if v is not None]
    objects = [(name, kind) for name, kind in classes if kind in ("table", "timetable")]
    if not columns and objects:
        raise objects_only(path.name, objects)
    tables = by_length(columns, units, path.name)
    if lost:
        text = f"links that lead nowhere: {', '.join(lost[:_SHOWN])}"
        first = replace(tables[0], metadata={**tables[0].metadata, DAMAGED: text})
        tables = (first, *tables[1:])
    return RawFile(path.name, "HDF5", tables)


def _sets(file: Any, h5py: Any, lost: list[str]) -> Iterator[tuple[str, Any]]:
    """(path, data set) of each array; what MATLAB keeps for itself is left out. A group is entered
    once, whatever links lead to it; links into other files are not followed, and are added to
    ``lost`` with those that lead nowhere.
    """
    waiting, seen = [("", file)], {h5py.h5o.get_info(file["/"].id).addr}
    while waiting:
        path, group = waiting.pop(0)
        for key in group:
            name = f"{path}/{key}".lstrip("/")
            outside = isinstance(group.get(key, getlink=True), h5py.ExternalLink)
            item = None if outside else _followed(group, key)
            if item is None:
                lost.append(name)
            elif isinstance(item, h5py.Dataset) and _is_array(item):
                yield name, item
            elif isinstance(item, h5py.Group) and not key.startswith("#"):
                address = h5py.h5o.get_info(item.id).addr
                if address not in seen:
                    seen.add(address)
                    waiting.append((name, item))


def _followed(group: Any, key: str) -> Any | None:
    """What a link leads to; None where it leads nowhere."""
    try:
        return group[key]
    except (KeyError, OSError, RuntimeError):
        return None


def _is_array(item: Any) -> bool:
    stated = _matlab_class(item)
    return item.shape is not None and item.ndim <= 2 and stated in ("", *_NUMERIC_CLASSES)


def _matlab_class(item: Any) -> str:
    stated = item.attrs.get(_CLASS, b"")
    return stated.decode() if isinstance(stated, bytes) else str(stated)


def _size(item: Any) -> float:
    least = 8 if item.dtype.kind in "iufb" else _TEXT
    return float(np.prod(item.shape, dtype=float)) * max(item.dtype.itemsize, least)


def _channels(name: str, item: Any, units: dict[str, str]) -> list[tuple[str, Raw]]:
    """The columns of a data set; its unit is added to ``units``."""
    values = item[()]
    if item.dtype.names:
        return [c for n in item.dtype.names for c in vectors(f"{name}/{n}", values[n])]
    columns = vectors(name, values)
    stated = next((item.attrs[k] for k in _UNIT_KEYS if k in item.attrs), None)
    if stated is not None:
        text = stated.decode() if isinstance(stated, bytes) else str(stated)
        units.update({n: text for n, _ in columns})
    return columns
