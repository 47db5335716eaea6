"""Recordings as files: CSV, Parquet, NPZ. What is written reads back exactly."""

import csv
import json
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import replacing, require_file
from tiltcal.core.units import split_unit
from tiltcal.recordings.recording import Labels, Recording

SUFFIXES = (".csv", ".parquet", ".npz")
_METADATA = "tiltcal.metadata"
EMPTY = [" " * k for k in range(9)]  # cells that hold nothing


def read_recording(path: Path | str) -> Recording:
    """Read a recording.

    Raises:
        TiltcalError: the file is missing, empty, of another format, or a cell is not a number.
    """
    path = require_file(Path(path), "recording")
    if path.stat().st_size == 0:
        raise TiltcalError(
            f"recording {path.name}",
            found="an empty file",
            need="a header and rows",
            do="record it again",
        )
    if path.suffix == ".csv":
        columns, metadata = _read_csv(path)
    elif path.suffix == ".parquet":
        columns, metadata = _read_parquet(path)
    elif path.suffix == ".npz":
        columns, metadata = _read_npz(path)
    else:
        raise TiltcalError(
            f"recording {path.name}",
            found=f"the ending '{path.suffix}'",
            need="one of " + ", ".join(SUFFIXES),
            do="rename it, or bring a foreign format in with `tiltcal import`",
        )
    return assemble(columns, metadata, path.name)


def write_recording(recording: Recording, path: Path | str) -> None:
    """Write a recording, whole or not at all; the ending decides the format.

    Raises:
        TiltcalError: the ending is unknown or the place cannot be written.
    """
    path = Path(path)
    writers = {".csv": _write_csv, ".parquet": _write_parquet, ".npz": _write_npz}
    if path.suffix not in writers:
        raise TiltcalError(
            f"output {path}",
            found=f"the ending '{path.suffix}'",
            need="one of " + ", ".join(SUFFIXES),
            do="rename it",
        )
    with replacing(path) as temporary:
        writers[path.suffix](recording, temporary)


def assemble(
    columns: Mapping[str, Array | Labels], metadata: Mapping[str, str], source: str
) -> Recording:
    """A recording from columns as read, (n,) each: floats, or objects for text.

    Raises:
        TiltcalError: there is no time column, a stamp is missing, or there are no rows.
    """
    subject = f"recording {source}"
    if "time_s" not in columns:
        raise TiltcalError(
            subject,
            found="columns " + ", ".join(list(columns)[:8]),
            need="a column time_s",
            do="name the time column so, or bring a foreign format in with `tiltcal import`",
        )
    time = np.asarray(columns["time_s"], dtype=float)
    if len(time) == 0:
        raise TiltcalError(
            subject, found="a header and no rows", need="at least one row", do="record it again"
        )
    if np.isnan(time).any():
        row = int(np.argmax(np.isnan(time))) + 1
        raise TiltcalError(
            f"{subject}, data row {row}, column time_s",
            found="no time",
            need="a number",
            do="fill it in",
        )
    numbers = {
        n: np.asarray(v, dtype=float)
        for n, v in columns.items()
        if v.dtype != object and n != "time_s"
    }
    texts: dict[str, Labels] = {n: v for n, v in columns.items() if v.dtype == object}  # type: ignore[misc]
    labels = texts.pop("label", None)
    return Recording.from_columns(
        time, numbers, labels=labels, extra=texts, metadata=metadata, source=subject
    )


def is_number(name: str) -> bool:
    """Whether a column of that name holds numbers (its name ends in a unit)."""
    return name != "label" and split_unit(name)[1] is not None


# --------------------------------------------------------------------------------------------------
# -------------- CSV


def csv_head(path: Path) -> tuple[dict[str, str], list[str], int]:
    """Metadata, column names and the number of lines before the first data row.

    Raises:
        TiltcalError: there is no header, or a name stands twice.
    """
    metadata: dict[str, str] = {}
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if line.startswith("#"):
                key, colon, value = line[1:].partition(":")
                if colon:
                    metadata[key.strip()] = value.strip()
            elif line.strip():
                names = [name.strip() for name in next(csv.reader([line]))]
                twice = sorted({name for name in names if names.count(name) > 1})
                if twice:
                    raise TiltcalError(
                        f"recording {path.name}, line {number}",
                        found=f"column {twice[0]} twice",
                        need="each column once",
                        do="rename one of them",
                    )
                return metadata, names, number
    raise TiltcalError(
        f"recording {path.name}", found="no header line", need="column names", do="add the header"
    )


def _read_csv(path: Path) -> tuple[dict[str, Array | Labels], dict[str, str]]:
    import pyarrow as pa
    from pyarrow import csv as pacsv

    metadata, names, skip = csv_head(path)
    types = {name: pa.float64() if is_number(name) else pa.string() for name in names}
    try:
        table = pacsv.read_csv(
            path,
            read_options=pacsv.ReadOptions(skip_rows=skip, column_names=names, encoding="utf8"),
            parse_options=pacsv.ParseOptions(newlines_in_values=False),
            convert_options=pacsv.ConvertOptions(
                column_types=types,
                null_values=EMPTY,
                strings_can_be_null=True,
                quoted_strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid as error:
        if "Empty CSV" in str(error) or "skip initial" in str(error):
            return {name: np.zeros(0) for name in names}, metadata
        raise _bad_cell(path, names, skip, str(error)) from error
    return {
        name: _to_numpy(table.column(i), is_number(name)) for i, name in enumerate(names)
    }, metadata


def _to_numpy(column: "object", number: bool) -> Array | Labels:
    values = column.to_numpy()  # type: ignore[attr-defined]
    return np.array(values, dtype=float) if number else np.array(values, dtype=object)


def _bad_cell(path: Path, names: list[str], skip: int, reason: str) -> TiltcalError:
    """The first line that does not read, found slowly because it is only needed once."""
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as lines:
        for number, row in enumerate(csv.reader(islice(lines, skip, None)), start=skip + 1):
            if row and len(row) != len(names):
                return TiltcalError(
                    f"recording {path.name}, line {number}",
                    found=f"{len(row)} cells",
                    need=f"{len(names)} as in the header",
                    do="complete or remove that line",
                )
            for name, cell in zip(names, row, strict=False):
                if is_number(name) and cell.strip() and not _reads_as_number(cell):
                    return TiltcalError(
                        f"recording {path.name}, line {number}, column {name}",
                        found=f"the text '{cell}'",
                        need="a number or an empty cell",
                        do="correct or empty that cell",
                    )
    return TiltcalError(
        f"recording {path.name}", found=reason, need="a CSV table", do="check the file"
    )


def _reads_as_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _write_csv(recording: Recording, path: Path) -> None:
    with path.open("wb") as out:
        write_csv(recording, out)


def write_csv(recording: Recording, out: IO[bytes]) -> None:
    """Write a recording as CSV into an open binary file."""
    import pyarrow as pa
    from pyarrow import csv as pacsv

    names, arrays = _arrow_columns(recording)
    write_head(out, recording.metadata, names)
    pacsv.write_csv(pa.table(arrays, names=names), out, pacsv.WriteOptions(include_header=False))


def write_head(out: IO[bytes], metadata: Mapping[str, str], names: Sequence[str]) -> None:
    """Metadata, one line each, and the line of column names."""
    for key, value in metadata.items():
        out.write(f"# {key}: {' '.join(value.splitlines())}\n".encode())
    out.write((",".join(_quoted(name) for name in names) + "\n").encode())


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n') else name


def _arrow_columns(recording: Recording) -> tuple[list[str], list[Any]]:
    import pyarrow as pa

    numbers = {"time_s": recording.time} | {
        name: recording.column(name) for name in recording.column_names
    }
    texts = dict(recording.extra)
    if recording.labels is not None:
        texts["label"] = recording.labels
    arrays: list[Any] = [
        pa.array(values, pa.float64(), from_pandas=True) for values in numbers.values()
    ]
    arrays += [
        pa.array([t if t else None for t in texts_], pa.string()) for texts_ in texts.values()
    ]
    return list(numbers) + list(texts), arrays


# --------------------------------------------------------------------------------------------------
# ---- Parquet, NPZ


def _read_parquet(path: Path) -> tuple[dict[str, Array | Labels], dict[str, str]]:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        reason = str(error).splitlines()[0]
        raise TiltcalError(
            f"recording {path.name}", found=reason, need="a Parquet file", do="check the file"
        ) from error
    metadata = stored_metadata(table.schema.metadata, path)
    columns: dict[str, Array | Labels] = {}
    for i, name in enumerate(table.column_names):
        number = is_number(name)
        if number and not (
            pa.types.is_floating(table.schema.types[i])
            or pa.types.is_integer(table.schema.types[i])
        ):
            raise TiltcalError(
                f"recording {path.name}, column {name}",
                found=f"type {table.schema.types[i]}",
                need="numbers",
                do="convert that column",
            )
        try:
            columns[name] = _to_numpy(
                table.column(i).cast(pa.float64() if number else pa.string()), number
            )
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            raise TiltcalError(
                f"recording {path.name}, column {name}",
                found=str(error).splitlines()[0],
                need="text or numbers",
                do="convert or leave out that column",
            ) from error
    return columns, metadata


def stored_metadata(schema: Mapping[bytes, bytes] | None, path: Path) -> dict[str, str]:
    """The metadata that a Parquet schema carries.

    Raises:
        TiltcalError: it is not what we write.
    """
    try:
        return dict(json.loads((schema or {}).get(_METADATA.encode(), b"{}")))
    except ValueError as error:
        raise TiltcalError(
            f"recording {path.name}, metadata",
            found=str(error),
            need="the JSON that tiltcal writes",
            do="write the file again",
        ) from error


def _write_parquet(recording: Recording, path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    names, arrays = _arrow_columns(recording)
    table = pa.table(arrays, names=names).replace_schema_metadata(
        {_METADATA: json.dumps(dict(recording.metadata))}
    )
    parquet.write_table(table, path)


def _read_npz(path: Path) -> tuple[dict[str, Array | Labels], dict[str, str]]:
    import zipfile

    columns: dict[str, Array | Labels] = {}
    metadata: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            for name in archive.files:
                values = archive[name]
                if name == _METADATA:
                    metadata = json.loads(str(values))
                elif np.ndim(values) != 1:
                    raise ValueError(f"array {name} of shape {np.shape(values)}")
                elif is_number(name):
                    columns[name] = np.asarray(values, dtype=float)
                else:
                    columns[name] = np.array([str(v) or None for v in values], dtype=object)
    except (ValueError, OSError, AttributeError, zipfile.BadZipFile) as error:
        raise TiltcalError(
            f"recording {path.name}",
            found=str(error).splitlines()[0],
            need="an NPZ archive, one array a column",
            do="check the file",
        ) from error
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        odd = max(lengths, key=lambda name: abs(lengths[name] - lengths.get("time_s", 0)))
        raise TiltcalError(
            f"recording {path.name}, array {odd}",
            found=f"{lengths[odd]} values",
            need=f"as many as time_s, {lengths.get('time_s', 0)}",
            do="write all arrays at one length, NaN for gaps",
        )
    return columns, metadata


def _write_npz(recording: Recording, path: Path) -> None:
    arrays = {"time_s": recording.time} | {
        name: recording.column(name) for name in recording.column_names
    }
    texts = dict(recording.extra) | (
        {} if recording.labels is None else {"label": recording.labels}
    )
    words = {name: np.array([t or "" for t in values], dtype=str) for name, values in texts.items()}
    metadata = {_METADATA: np.array(json.dumps(dict(recording.metadata)))}
    with path.open("wb") as out:
        np.savez(out, allow_pickle=False, **arrays, **words, **metadata)
