"""Objects of MATLAB (table, timetable, datetime) in files of version 5: which variables are such,
and how to save them as plain arrays.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from tiltcal.core.errors import TiltcalError

_HEADER = 128  # bytes before the first element; the order of bytes stands in the last two
_COMPRESSED, _MATRIX, _OPAQUE = 15, 14, 17  # types of elements, class of an object (MAT 5 format)
_TAG = 8  # bytes of a tag
_SEEN = 512  # bytes of a variable that its name and class are in


def stated_objects(path: Path) -> tuple[list[tuple[str, str]], int]:
    """(name, class) of the variables that are objects, and the bytes of all variables as they are
    expanded; nothing is expanded for it.

    Args:
        path: of a file of version 5.
    """
    found, size = [], 0
    for head, order in _variables(path):
        try:
            kind, length = struct.unpack_from(order + "II", head)
            size += length
            if kind == _MATRIX and head[16 if order == "<" else 19] == _OPAQUE:
                name, offset = _text(head, 2 * _TAG + _TAG, order)
                _, offset = _text(head, offset, order)
                found.append((name, _text(head, offset, order)[0]))
        except (struct.error, IndexError):
            continue
    return found, size


def _variables(path: Path) -> Iterator[tuple[bytes, str]]:
    """The first bytes of each variable, and the order of bytes."""
    end = path.stat().st_size
    with path.open("rb") as file:
        order = ">" if file.read(_HEADER)[-2:] == b"MI" else "<"
        while file.tell() + _TAG <= end:
            kind, length = struct.unpack(order + "II", tag := file.read(_TAG))
            following = file.tell() + length
            content = file.read(min(length, _SEEN))
            if kind == _COMPRESSED:
                try:
                    yield zlib.decompressobj().decompress(content, _SEEN), order
                except zlib.error:
                    return  # the reader of the file says so
            else:
                yield tag + content, order
            file.seek(following)


def _text(head: bytes, offset: int, order: str) -> tuple[str, int]:
    """An element of text, and the byte after it."""
    kind, length = struct.unpack_from(order + "II", head, offset)
    if kind >> 16:  # a small element: its length and text are in the tag
        length, begin, after = kind >> 16, offset + 4, offset + _TAG
    else:
        begin = offset + _TAG
        after = begin + (length + 7) // 8 * 8
    return head[begin : begin + length].decode("latin-1"), after


def objects_only(source: str, objects: Sequence[tuple[str, str]]) -> TiltcalError:
    """The error of a file that has nothing but objects.

    Args:
        source: of the file.
        objects: (name, class) of each.
    """
    name, kind = objects[0]
    lines = [f"T = {name};"]
    if kind != "table":
        lines = [f"T = timetable2table({name});", "T.(1) = seconds(T.(1) - T.(1)(1));"]
    lines += ["S = table2struct(T, 'ToScalar', true);", "save('run.mat', '-struct', 'S')"]
    listed = ", ".join(f"{n} ({k})" for n, k in objects)
    return TiltcalError(
        f"foreign recording {source}",
        found=f"only MATLAB objects, {listed}, which no other program reads",
        need="plain arrays or structures",
        do="save each in MATLAB so:\n  " + "\n  ".join(lines),
    )
