"""Reading and writing files so that nothing is lost: whole or not at all, and one run at a time
in a folder of results.
"""

import json
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError

TEMPORARY = ".part-"
"""Beginning of the names of temporary files."""
_unfinished: set[Path] = set()


def require_file(path: Path, kind: str) -> Path:
    """``path`` when it is a readable file.

    Raises:
        TiltcalError: it is missing, a folder, or may not be read.
    """
    mode = _mode(path, f"{kind} {path}")
    if mode is None:
        raise TiltcalError(
            f"{kind} {path}", found="no such file", need="an existing file", do="check the path"
        )
    if stat.S_ISDIR(mode):
        raise TiltcalError(
            f"{kind} {path}", found="a folder", need="a file", do="name the file itself"
        )
    if not stat.S_ISREG(mode):
        raise TiltcalError(
            f"{kind} {path}",
            found="a device or pipe",
            need="a file, which can be read more than once",
            do="write it to a file first",
        )
    if not os.access(path, os.R_OK):
        raise TiltcalError(
            f"{kind} {path}",
            found="no permission to read",
            need="a readable file",
            do="change its mode",
        )
    return path


MOST_TEXT = 64 << 20  # bytes of a scenario, a calibration or a model: far more than any has


def require_document(path: Path, kind: str) -> Path:
    """``path`` when it is a readable file that is read whole.

    Raises:
        TiltcalError: it is missing, a folder, may not be read, or is larger than any such file.
    """
    size = require_file(path, kind).stat().st_size
    if size > MOST_TEXT:
        raise TiltcalError(
            f"{kind} {path}",
            found=f"{size} bytes",
            need=f"at most {MOST_TEXT}",
            do="name the file itself, or check what wrote it",
        )
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file next to ``path`` that takes its name when the block ends well and vanishes
    otherwise.

    Raises:
        TiltcalError: the file cannot be written.
    """
    path = require_writable(Path(path))
    # of a name of its own length: one of the greatest length cannot be extended; and
    # absolute: libraries take `x:y` for an address
    temporary = path.absolute().with_name(f"{TEMPORARY}{secrets.token_hex(8)}{path.suffix[:20]}")
    _unfinished.add(temporary)
    try:
        with _explained(path, "a folder that can be written"):
            temporary.touch(exist_ok=False)
        with _explained(path, "free space and permission to write"):
            yield temporary
            os.replace(temporary, path)
    finally:
        _discard(temporary)
        _unfinished.discard(temporary)


def require_writable(path: Path) -> Path:
    """``path`` when a file of that name can be there.

    Raises:
        TiltcalError: it is a folder, a device or a pipe, or no name for a file.
    """
    mode = _mode(path, f"output {path}")
    if mode is None or stat.S_ISREG(mode):
        return path
    if stat.S_ISDIR(mode):
        raise TiltcalError(
            f"output {path}", found="a folder", need="a file name", do="name the file to write"
        )
    raise TiltcalError(
        f"output {path}",
        found="a device or pipe",
        need="the name of a file",
        do="name a file, or leave the option out where a command can print",
    )


def remove_temporary() -> None:
    """Remove every temporary file that is still there, after an interrupt."""
    while _unfinished:
        _discard(_unfinished.pop())


def _discard(temporary: Path) -> None:
    """Remove a temporary file, where it is."""
    with suppress(FileNotFoundError, NotADirectoryError):
        temporary.unlink()


@contextmanager
def _explained(path: Path, need: str) -> Iterator[None]:
    """One error for what the operating system refuses."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TiltcalError(
            f"output {path}", found=reason, need=need, do="choose another location"
        ) from error


def _require_text(path: Path, subject: str) -> None:
    """Refuse a name that is no text: libraries cannot be handed it."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise TiltcalError(
            subject, found="a name that is no text", need="a name in UTF-8", do="rename it"
        ) from error


def _mode(path: Path, subject: str) -> int | None:
    """Type and permissions of what has that name; None where nothing has.

    Raises:
        TiltcalError: nothing can have it.
    """
    _require_text(path, subject)
    try:
        return path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise TiltcalError(
            subject,
            found=(reason or str(error)).lower(),
            need="the name of a file",
            do="correct the name",
        ) from error


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
    _require_text(path, f"output {path}")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise TiltcalError(
            f"output {path}", found=reason, need="a folder", do="choose another location"
        ) from error
    return path


@contextmanager
def claimed(folder: Path | None) -> Iterator[None]:
    """Hold a folder, made if there is none, so that no second run writes into it; a folder that
    was made here and is still empty goes again. None: no lock.

    The lock is one of the operating system on the folder itself: it leaves no file, and ends with
    the process however that ends. Where the system has none, nothing is locked.

    Raises:
        TiltcalError: another run has claimed it, or it cannot be made.
    """
    if folder is None:
        yield
        return
    made = [p for p in (folder, *folder.parents) if not os.path.lexists(p)]
    handle = _held(make_folder(folder))
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)
        with suppress(OSError):  # the first that is not empty stays, and those above it
            for empty in made:
                empty.rmdir()


def _held(folder: Path) -> int | None:
    """The folder, opened and locked."""
    try:
        from fcntl import LOCK_EX, LOCK_NB, flock
    except ImportError:  # no file locks on this system
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        flock(handle, LOCK_EX | LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise TiltcalError(
            f"output {folder}",
            found="another run that writes into it",
            need="a folder for each run",
            do="wait for that run, or choose another folder",
        ) from error
    except OSError:  # a file system without locks
        os.close(handle)
        return None
    return handle
