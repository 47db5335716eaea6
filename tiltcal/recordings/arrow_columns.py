"""Columns of recordings in Arrow memory layout. Arrow's own conversions import pandas where it is
installed, which takes longer than a short recording does: here its buffers are read and made.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.recordings.samples import Columns, Labels


def to_numpy(column: Any, number: bool) -> Array | Labels:
    """An Arrow column as floats, NaN for null, or as text, (n,); each distinct text is decoded only
    once.
    """
    if number:
        return _buffer(column, np.nan)
    encoded = column.dictionary_encode()
    encoded = encoded.combine_chunks() if hasattr(encoded, "num_chunks") else encoded
    values = np.array([*encoded.dictionary.to_pylist(), None], dtype=object)
    return values[_buffer(encoded.indices, len(values) - 1)]


def _buffer(column: Any, null: float) -> Any:
    """A copy of the numbers of an Arrow column, (n,).

    Args:
        column: of float64 or int32.
        null: value that stands for a null.
    """
    array = column.combine_chunks() if hasattr(column, "num_chunks") else column
    kind = np.dtype(array.type.to_pandas_dtype())
    there, data = array.buffers()
    end = array.offset + len(array)
    if data is None:
        return np.zeros(0, kind)
    values = np.frombuffer(data, kind, end)[array.offset :].copy()
    if array.null_count:
        bits = np.unpackbits(np.frombuffer(there, np.uint8), count=end, bitorder="little")
        values[bits[array.offset :] == 0] = null
    return values


def arrow_table(
    recording: Columns, names: Sequence[str], to_cell: Callable[[str], str] = str
) -> Any:
    """These columns of a recording as an Arrow table: numbers, null for NaN, and text.

    Args:
        recording: whose columns they are.
        names: of the columns, in their order.
        to_cell: a text as the file stores it.
    """
    import pyarrow as pa

    def array_of(name: str) -> Any:
        if name == "time_s":
            return _arrow_numbers(recording.time)
        return (
            _arrow_texts(texts[name], to_cell)
            if name in texts
            else _arrow_numbers(recording.column(name))
        )

    texts = recording.texts
    return pa.table([array_of(name) for name in names], names=list(names))


def _arrow_numbers(values: Array) -> Any:
    """Floats, (n,), as an Arrow array with null for NaN."""
    import pyarrow as pa

    there = _bits(~np.isnan(values))
    data = np.ascontiguousarray(values, dtype=float)
    return pa.Array.from_buffers(pa.float64(), len(data), [there, pa.py_buffer(data)])


def _arrow_texts(texts: Labels, to_cell: Callable[[str], str]) -> Any:
    """Texts, (n,), as an Arrow array with null where there is none."""
    import pyarrow as pa

    encoded = {t: to_cell(t).encode() if t else b"" for t in set(texts)}
    cells = [encoded[t] for t in texts]
    ends = np.cumsum([0, *map(len, cells)])
    kind = pa.large_string() if ends[-1] > np.iinfo(np.int32).max else pa.string()
    offsets = ends.astype(np.int64 if kind == pa.large_string() else np.int32)
    there = _bits(np.array([bool(t) for t in texts]))
    data = [there, pa.py_buffer(offsets), pa.py_buffer(b"".join(cells))]
    return pa.Array.from_buffers(kind, len(cells), data)


def _bits(there: Mask) -> Any:
    """Bit mask of the values that are present in an Arrow array."""
    import pyarrow as pa

    return pa.py_buffer(np.packbits(there, bitorder="little"))
