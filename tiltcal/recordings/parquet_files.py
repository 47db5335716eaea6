"""Recordings as Parquet files, with metadata in the schema."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tiltcal.core.arrays import Array
from tiltcal.core.budget import require_within
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.arrow_columns import arrow_table, to_numpy
from tiltcal.recordings.csv_files import is_number, require_few
from tiltcal.recordings.samples import Columns, Labels

METADATA = "tiltcal.metadata"
PIECE = 1 << 16  # rows of a piece of a long recording


def read_parquet(path: Path) -> tuple[dict[str, Array | Labels], dict[str, str]]:
    """All columns, (n,) each, and the metadata.

    Raises:
        TiltcalError: it is no Parquet file, or a column has another type than its name states.
    """
    import pyarrow as pa
    from pyarrow import parquet

    metadata, _ = parquet_head(path)
    try:
        _require_within_budget(path, whole=True)
        with parquet.ParquetFile(path) as file:  # read_table would import pandas
            return _columns(file.read(), path), metadata
    except (pa.ArrowException, OSError) as error:
        raise _unreadable(path, error) from error


def parquet_head(path: Path) -> tuple[dict[str, str], list[str]]:
    """The metadata, and the names of the columns.

    Raises:
        TiltcalError: it is no Parquet file.
    """
    import pyarrow as pa
    from pyarrow import parquet

    try:
        schema = parquet.read_schema(path)
    except (pa.ArrowException, OSError) as error:
        raise _unreadable(path, error) from error
    require_few(len(schema.names), path)
    return stored_metadata(schema.metadata, path), list(schema.names)


def stated_rows(path: Path) -> int:
    """How many rows the file states; 0 where it is no Parquet file."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        return int(parquet.read_metadata(path).num_rows)
    except (pa.ArrowException, OSError):
        return 0  # reading it gives the reason


def parquet_pieces(path: Path) -> Iterator[dict[str, Array | Labels]]:
    """The columns piece by piece, (n,) each.

    Raises:
        TiltcalError: as ``read_parquet`` does.
    """
    import pyarrow as pa
    from pyarrow import parquet

    try:
        _require_within_budget(path, whole=False)
        # neither whole row groups in memory nor, of a column's bytes, more than a buffer
        with parquet.ParquetFile(path, pre_buffer=False, buffer_size=PIECE) as file:
            for batch in file.iter_batches(batch_size=PIECE):
                yield _columns(batch, path)
    except (pa.ArrowException, OSError) as error:
        raise _unreadable(path, error) from error


def _require_within_budget(path: Path, whole: bool) -> None:
    """Refuse a file that unpacks to more than may be in memory, or to more rows than are allowed.

    Args:
        whole: all of it at the same time, or its row groups one after another.
    """
    from pyarrow import parquet

    stated = parquet.read_metadata(path)
    groups = [stated.row_group(k).total_byte_size for k in range(stated.num_row_groups)]
    cells = stated.num_rows * stated.num_columns if whole else 0
    require_within(
        f"recording {path.name}",
        rows=stated.num_rows,
        size=max(sum(groups) if whole else max(groups, default=0), 8 * cells),
        less="cut it into shorter recordings",
    )


def _unreadable(path: Path, error: Exception) -> TiltcalError:
    return TiltcalError(
        f"recording {path.name}",
        found=str(error).splitlines()[0],
        need="a Parquet file",
        do="check the file",
    )


def _columns(table: Any, path: Path) -> dict[str, Array | Labels]:
    """The columns of an Arrow table or batch."""
    import pyarrow as pa

    columns: dict[str, Array | Labels] = {}
    for i, name in enumerate(table.schema.names):
        number = is_number(name)
        stored = table.schema.types[i]
        if number and not (pa.types.is_floating(stored) or pa.types.is_integer(stored)):
            raise TiltcalError(
                f"recording {path.name}, column {name}",
                found=f"type {stored}",
                need="numbers",
                do="convert that column",
            )
        try:
            columns[name] = to_numpy(
                table.column(i).cast(pa.float64() if number else pa.string()), number
            )
        except pa.ArrowException as error:
            raise TiltcalError(
                f"recording {path.name}, column {name}",
                found=str(error).splitlines()[0],
                need="text or numbers",
                do="convert or leave out that column",
            ) from error
    return columns


def stored_metadata(schema: Mapping[bytes, bytes] | None, path: Path) -> dict[str, str]:
    """The metadata that a Parquet schema carries.

    Raises:
        TiltcalError: it is not what we write.
    """
    return metadata_of((schema or {}).get(METADATA.encode(), b"{}"), path)


def metadata_of(text: str | bytes, path: Path) -> dict[str, str]:
    """Metadata as a file of ours stores it: JSON of texts by key.

    Raises:
        TiltcalError: it is not what we write.
    """
    try:
        found = json.loads(text)
        if not isinstance(found, dict) or not all(isinstance(v, str) for v in found.values()):
            raise ValueError("something else than texts by key")
        return found
    except (ValueError, RecursionError) as error:
        raise TiltcalError(
            f"recording {path.name}, metadata",
            found=str(error),
            need="the JSON that tiltcal writes",
            do="write the file again",
        ) from error


def write_parquet(recording: Columns, path: Path) -> None:
    """Write a recording as Parquet."""
    with parquet_writer(path) as write:
        write(recording)


@contextmanager
def parquet_writer(path: Path) -> Iterator[Callable[[Columns], None]]:
    """What appends pieces of a recording to a Parquet file, each with the columns of the first."""
    from pyarrow import parquet

    writers: list[Any] = []
    names: list[str] = []

    def write(piece: Columns) -> None:
        names.extend(() if names else piece.written_names)
        table = arrow_table(piece, names)
        if not writers:
            schema = table.schema.with_metadata({METADATA: json.dumps(dict(piece.metadata))})
            # numbers hardly ever repeat: a dictionary of them only costs time
            options: dict[str, Any] = {"use_dictionary": list(piece.texts) or False}
            writers.append(parquet.ParquetWriter(path, schema, **options))
        writers[0].write_table(table.replace_schema_metadata(writers[0].schema.metadata))

    try:
        yield write
    finally:
        for writer in writers:
            writer.close()
