"""Recordings as NPZ archives. What an archive claims is checked before any of it is loaded."""

import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from tiltcal.core.arrays import Array
from tiltcal.core.budget import require_within
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.csv_files import is_number, require_few
from tiltcal.recordings.parquet_files import METADATA, PIECE, metadata_of
from tiltcal.recordings.samples import Columns, Labels

NUMBERS = "fiu"  # kinds of arrays that a column of numbers may be
TEXTS = "UOSfiub"  # and those that another column may be; objects are refused on loading
LARGEST = 8  # bytes of a number


def read_npz(path: Path) -> tuple[dict[str, Array | Labels], dict[str, str]]:
    """All columns, (n,) each, and the metadata.

    Raises:
        TiltcalError: it is no archive, claims more than it contains, or an array is no column.
    """
    with _checked(path, whole=True) as (archive, members, _):
        columns: dict[str, Array | Labels] = {}
        for name in _columns_of(members):
            with archive.open(members[name]) as stream:
                columns[name] = _column(name, npy.read_array(stream, allow_pickle=False))
        return columns, _metadata(archive, members, path)


def npz_head(path: Path) -> tuple[dict[str, str], list[str]]:
    """Metadata and column names.

    Raises:
        TiltcalError: as ``read_npz`` does.
    """
    with _checked(path, whole=False) as (archive, members, _):
        return _metadata(archive, members, path), _columns_of(members)


def npz_rows(path: Path) -> int:
    """How many rows the arrays have; 0 where it is no archive of columns: reading it gives the
    reason.
    """
    try:
        with _checked(path, whole=False) as (_, __, rows):
            return rows
    except TiltcalError:
        return 0


def npz_pieces(path: Path) -> Iterator[dict[str, Array | Labels]]:
    """The columns piece by piece, (n,) each: every array is read, and unpacked, as it is needed.

    Raises:
        TiltcalError: as ``read_npz`` does.
    """
    with _checked(path, whole=False) as (archive, members, rows), ExitStack() as stack:
        streams = {
            name: stack.enter_context(archive.open(members[name])) for name in _columns_of(members)
        }
        kinds = {name: _head(stream)[1] for name, stream in streams.items()}
        for first in range(0, rows, PIECE):
            count = min(PIECE, rows - first)
            yield {
                name: _column(name, _next(stream, kinds[name], count))
                for name, stream in streams.items()
            }


def _next(stream: IO[bytes], kind: np.dtype[Any], count: int) -> Any:
    """The next values of an array, (count,)."""
    if not kind.itemsize:
        return np.zeros(count, kind)
    return np.frombuffer(stream.read(count * kind.itemsize), kind, count)


@contextmanager
def _checked(
    path: Path, whole: bool
) -> Iterator[tuple[zipfile.ZipFile, dict[str, zipfile.ZipInfo], int]]:
    """An archive whose arrays are columns, its members by name, and its rows.

    Args:
        whole: whether all of it will be in memory at the same time.

    Raises:
        TiltcalError: as ``read_npz`` does; also for what is found wrong within the block.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
            _require_within_budget(path, members, whole)
            require_few(len(members), path)
            shapes = {name: _shape(archive, member) for name, member in members.items()}
            _require_one_length(path, shapes)
            rows = [shape[0] for name, shape in shapes.items() if name != METADATA]
            yield archive, members, max(rows, default=0)
    except _UNREADABLE as error:
        raise TiltcalError(
            f"recording {path.name}",
            found=(str(error) or type(error).__name__).splitlines()[0],
            need="an NPZ archive, one array a column",
            do="check the file",
        ) from error


def _columns_of(members: Mapping[str, zipfile.ZipInfo]) -> list[str]:
    return [name for name in members if name != METADATA]


def _metadata(
    archive: zipfile.ZipFile, members: Mapping[str, zipfile.ZipInfo], path: Path
) -> dict[str, str]:
    if METADATA not in members:
        return {}
    with archive.open(members[METADATA]) as stream:
        return metadata_of(str(npy.read_array(stream, allow_pickle=False)), path)


_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zipfile.zlib.error,  # type: ignore[attr-defined]
)


def _require_within_budget(path: Path, members: Mapping[str, zipfile.ZipInfo], whole: bool) -> None:
    """Refuse an archive that unpacks to more than may be in memory, or to more rows than are
    allowed.
    """
    size = sum(m.file_size for m in members.values()) if whole else 0
    require_within(
        f"recording {path.name}",
        rows=max((m.file_size for m in members.values()), default=0) / LARGEST,
        size=2 * size,
        less="write it as Parquet, which is read piece by piece",
    )


def _head(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, as its header states; the stream is at its first value then."""
    version = npy.read_magic(stream)
    read_head = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, kind = read_head(stream)
    return shape, kind


def _shape(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, ...]:
    """The shape of an array whose header claims exactly what the archive contains."""
    with archive.open(member) as stream:
        shape, kind = _head(stream)
        held = member.file_size - stream.tell()
    if kind.kind not in TEXTS or kind.hasobject:
        raise ValueError(f"array {member.filename} of type {kind}")
    count = 1
    for length in shape:
        count *= length
    if min(shape, default=0) < 0 or count * kind.itemsize != held:
        raise ValueError(f"array {member.filename} that claims {count} values in {held} bytes")
    return shape


def _column(name: str, values: Any) -> Array | Labels:
    """A column as floats or as text.

    Raises:
        ValueError: numbers are of another type.
    """
    if not is_number(name):
        return np.array([str(v) or None for v in values], dtype=object)
    if values.dtype.kind not in NUMBERS:
        raise ValueError(f"array {name} of type {values.dtype}")
    return np.asarray(values, dtype=float)


def _require_one_length(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays that are no columns, or columns of different lengths."""
    columns = {name: shape for name, shape in shapes.items() if name != METADATA}
    for name, shape in columns.items():
        if len(shape) != 1:
            raise ValueError(f"array {name} of shape {shape}")
    lengths = {name: shape[0] for name, shape in columns.items()}
    if len(set(lengths.values())) > 1:
        odd = max(lengths, key=lambda name: abs(lengths[name] - lengths.get("time_s", 0)))
        raise TiltcalError(
            f"recording {path.name}, array {odd}",
            found=f"{lengths[odd]} values",
            need=f"as many as time_s, {lengths.get('time_s', 0)}",
            do="write all arrays at one length, NaN for gaps",
        )


def write_npz(recording: Columns, path: Path) -> None:
    """Write a recording as an NPZ archive."""
    arrays = {"time_s": recording.time} | {
        name: recording.column(name) for name in recording.column_names
    }
    texts = {
        name: np.array([t or "" for t in values], dtype=str)
        for name, values in recording.texts.items()
    }
    metadata = {METADATA: np.array(json.dumps(dict(recording.metadata)))}
    with path.open("wb") as out:
        np.savez(out, allow_pickle=False, **arrays, **texts, **metadata)
