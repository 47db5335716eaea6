"""Parquet files of any program."""

from pathlib import Path

import numpy as np

from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import RawFile, RawTable
from tiltcal.recordings.formats.text import arrow_to_numpy

_CELL = 8  # bytes of a value


def read_parquet_tables(path: Path, budget: ReadBudget) -> RawFile:
    """The flat columns of a Parquet file; lists and structures are left out.

    Raises:
        TiltcalError: it would expand to more than the budget.
    """
    import pyarrow as pa
    from pyarrow import parquet

    with parquet.ParquetFile(path) as file:
        head, schema = file.metadata, file.schema_arrow
        flat = [f for f in schema if not pa.types.is_nested(f.type)]
        stated = sum(head.row_group(k).total_byte_size for k in range(head.num_row_groups))
        budget.require(max(float(stated), float(head.num_rows) * len(flat) * _CELL), path.name)
        table = file.read(columns=[f.name for f in flat])
    units = {
        f.name: (f.metadata or {}).get(key, b"").decode()
        for f in flat
        for key in (b"unit", b"units")
        if key in (f.metadata or {})
    }
    columns = tuple((f.name, arrow_to_numpy(table.column(k))) for k, f in enumerate(flat))
    kept = tuple((n, v) for n, v in columns if np.ndim(v) == 1)
    return RawFile(path.name, "Parquet", (RawTable("", kept, units),))
