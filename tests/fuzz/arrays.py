"""Mutations of binary recordings: odd arrays in NPZ archives, odd columns in Parquet files."""

import io
import json
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

Arrays = dict[str, Any]


def mutated_npz(content: bytes, rng: np.random.Generator) -> bytes:
    """An archive with odd arrays."""
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = dict(archive.items())
    if rng.random() < 0.15:
        return claimed(arrays, rng)
    for _ in range(int(rng.integers(1, 3))):
        names = list(arrays)
        name = names[rng.integers(len(names))]
        if rng.random() < 0.15:
            arrays.pop(name)
        elif rng.random() < 0.1:
            arrays[str(rng.choice(["odd_g", "label", "a/b_g", "x" * 200, "time_s "]))] = odd_array(
                arrays[name], rng
            )
        else:
            arrays[name] = odd_array(arrays[name], rng)
        if not arrays:
            break
    out = io.BytesIO()
    (np.savez if rng.random() < 0.7 else np.savez_compressed)(out, **arrays)
    return out.getvalue()


def odd_array(values: Any, rng: np.random.Generator) -> Any:
    """An array of another type, shape, length or content."""
    return ARRAYS[rng.integers(len(ARRAYS))](np.asarray(values), rng)


def with_value(values: Any, rng: np.random.Generator) -> Any:
    """Numbers with nan, infinities or huge ones among them."""
    if values.dtype != np.float64 or values.ndim != 1 or not len(values):
        return np.array("x")
    changed = values.copy()
    k = rng.integers(len(changed), size=int(rng.choice([1, 10, len(changed)])))
    changed[k] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, 1e-310])
    return changed


ARRAYS: tuple[Callable[[Any, np.random.Generator], Any], ...] = (
    with_value,
    with_value,
    lambda v, r: v[:: int(r.choice([2, 3, 10]))] if v.ndim else v,
    lambda v, r: v[: int(r.integers(3))] if v.ndim else v,
    lambda _v, _r: np.array(1.0),
    lambda _v, _r: np.zeros((3, 3)),
    lambda _v, _r: np.zeros((0, 4)),
    lambda _v, _r: np.zeros(0),
    lambda _v, _r: np.array([{"a": 1}], dtype=object),
    lambda v, _r: np.array(["1"] * v.size),
    lambda v, _r: np.array([b"1"] * v.size),
    lambda v, _r: np.full(v.shape, True),
    lambda v, _r: np.full(v.shape, 1 + 2j),
    lambda v, _r: np.zeros(v.size, dtype="datetime64[s]"),
    lambda v, _r: np.zeros(v.size, dtype=[("a", "f8"), ("b", "i4")]),
    lambda v, _r: np.zeros(v.size, dtype="V3"),
    lambda v, _r: np.zeros(v.size, dtype=np.uint64) - np.uint64(1),
    lambda v, _r: np.full(v.size, 3, dtype=np.float16),
    lambda v, _r: np.full(v.size, 3, dtype=">f4"),
    lambda v, _r: np.full(v.size, 3, dtype=np.longdouble),
    lambda _v, _r: np.array("{not json"),
    lambda _v, _r: np.array(json.dumps(["a", 1])),
    lambda _v, _r: np.array(json.dumps({"mount": 3, "x": None})),
    lambda _v, _r: np.array(json.dumps({"mount": "Rx(nan)"})),
)


def claimed(arrays: Arrays, rng: np.random.Generator) -> bytes:
    """An archive with an array whose header claims more values than there are, or other bytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            part = io.BytesIO()
            np.save(part, values, allow_pickle=False)
            archive.writestr(f"{name}.npy", part.getvalue())
        archive.writestr("odd_g.npy", ODD_MEMBERS[rng.integers(len(ODD_MEMBERS))])
    return out.getvalue()


def npy_head(shape: str, dtype: str = "<f8") -> bytes:
    """The header of an NPY file."""
    words = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    words += b" " * (63 - (len(words) + 10) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(words).to_bytes(2, "little") + words


ODD_MEMBERS = (
    npy_head("(1000000000000,)"),
    npy_head("(100000000000,)") + bytes(64),
    npy_head("(-1,)"),
    npy_head("(2,)", "<U1000000000"),
    npy_head("(2,)", "|O") + bytes(16),
    npy_head("(2,)")[:20],
    b"not an array",
    b"",
    npy_head("(40000000,)") + bytes(8 * 40_000_000),
)


def mutated_parquet(content: bytes, rng: np.random.Generator) -> bytes:
    """A Parquet file with odd columns or metadata."""
    table = parquet.read_table(io.BytesIO(content))
    for _ in range(int(rng.integers(1, 3))):
        if not table.num_columns:
            break
        k, n = int(rng.integers(table.num_columns)), table.num_rows
        kind = rng.random()
        if kind < 0.15:
            table = table.remove_column(k)
        elif kind < 0.25:
            table = table.append_column(table.column_names[k], table.column(k))
        elif kind < 0.35:
            table = table.slice(0, int(rng.integers(4)))
        elif kind < 0.45:
            table = table.replace_schema_metadata(METADATA[rng.integers(len(METADATA))])
        else:
            column = COLUMNS[rng.integers(len(COLUMNS))](n)
            table = table.set_column(k, table.column_names[k], column)
    out = io.BytesIO()
    parquet.write_table(table, out)
    return out.getvalue()


METADATA: tuple[dict[bytes, bytes], ...] = (
    {b"tiltcal.metadata": b"{"},
    {b"tiltcal.metadata": b"[1, 2]"},
    {b"tiltcal.metadata": b'{"mount": 3}'},
    {b"tiltcal.metadata": b'{"mount": "Rx(nan)"}'},
    {b"tiltcal.metadata": b"\xff\xfe"},
    {b"\xff": b"\xff"},
)
COLUMNS: tuple[Callable[[int], pa.Array], ...] = (
    lambda n: pa.nulls(n),
    lambda n: pa.nulls(n, pa.float64()),
    lambda n: pa.array([True] * n),
    lambda n: pa.array(["x"] * n),
    lambda n: pa.array([b"\xff"] * n),
    lambda n: pa.array([[1.0]] * n),
    lambda n: pa.array([{"a": 1}] * n),
    lambda n: pa.array([0] * n, pa.timestamp("s")),
    lambda n: pa.array(np.full(n, np.nan)),
    lambda n: pa.array(np.full(n, np.inf)),
    lambda n: pa.array(np.arange(n), pa.int8()) if n < 128 else pa.array(np.zeros(n, np.int8)),
    lambda n: pa.array([2**63] * n, pa.uint64()),
    lambda n: pa.array(np.zeros(n), pa.float16()),
    lambda n: pa.array([1] * n, pa.decimal128(10, 2)),
    lambda n: pa.array(["a"] * n).dictionary_encode(),
    lambda n: pa.array([1.5] * n).dictionary_encode(),
)
