"""Reading and writing files so that nothing is lost: whole or not at all."""

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError


def require_file(path: Path, kind: str) -> Path:
    """``path`` when it is a readable file.

    Raises:
        TiltcalError: it is missing, a folder, or may not be read.
    """
    if path.is_dir():
        raise TiltcalError(
            f"{kind} {path}", found="a folder", need="a file", do="name the file itself"
        )
    if path.exists() and not path.is_file():
        raise TiltcalError(
            f"{kind} {path}",
            found="a device or pipe",
            need="a file, which can be read more than once",
            do="write it to a file first",
        )
    if not path.exists():
        raise TiltcalError(
            f"{kind} {path}", found="no such file", need="an existing file", do="check the path"
        )
    if not os.access(path, os.R_OK):
        raise TiltcalError(
            f"{kind} {path}",
            found="no permission to read",
            need="a readable file",
            do="change its mode",
        )
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that takes its name when the block ends well and vanishes
    otherwise.

    Raises:
        TiltcalError: the place cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise TiltcalError(
            f"output {path}", found="a folder", need="a file name", do="name the file to write"
        )
    if path.exists() and not path.is_file():
        raise TiltcalError(
            f"output {path}",
            found="a device or pipe",
            need="the name of a file",
            do="name a file, or leave the option out where a command can print",
        )
    try:
        handle, name = tempfile.mkstemp(prefix=".part-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        raise TiltcalError(
            f"output {path}",
            found=reason.lower(),
            need="a folder that can be written",
            do="choose another place",
        ) from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise TiltcalError(
            f"output {path}",
            found=reason.lower(),
            need="room and permission to write",
            do="choose another place",
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write JSON, whole or not at all; NaN is not JSON and an error of ours."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")


def make_folder(path: Path) -> Path:
    """``path`` as a folder that exists.

    Raises:
        TiltcalError: it is a file or cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TiltcalError(
            f"output {path}", found=reason, need="a folder", do="choose another place"
        ) from error
    return path
