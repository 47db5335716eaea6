"""MATLAB files of version 5 (4, 6 and 7 as well); 7.3 is HDF5."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.budget import Budget
from tiltcal.recordings.formats.grouping import by_length
from tiltcal.recordings.formats.raw_table import Raw, RawFile, RawTable, vectors

_CELL = 8  # bytes of a value


def read_matlab(path: Path, budget: Budget) -> RawFile:
    """Matrices as columns, each structure as a table of its fields.

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
    loose: list[tuple[str, Raw]] = []
    tables: list[RawTable] = []
    for name, value in values.items():
        if isinstance(value, dict):
            for place, fields in _structures(name, value):
                tables += by_length(fields, {}, path.name, place)
        else:
            loose += vectors(name, value)
    if objects and not loose and not tables:
        raise _objects_only(path.name, objects)
    if loose:
        tables = [*by_length(loose, {}, path.name), *tables]
    if not tables:
        by_length((), {}, path.name)  # says what is missing
    return RawFile(path.name, "MATLAB", tuple(tables))


def _structures(
    name: str, structure: dict[str, Any]
) -> Iterator[tuple[str, list[tuple[str, Raw]]]]:
    """(name, columns) of a structure that holds arrays, and of those inside it."""
    columns = [c for k, v in structure.items() if not isinstance(v, dict) for c in vectors(k, v)]
    if any(len(values) > 1 for _, values in columns):
        yield name, columns
    for key, value in structure.items():
        if isinstance(value, dict):
            yield from _structures(f"{name}.{key}", value)


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
