"""One run at a time in a folder of results."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder


@contextmanager
def claimed(folder: Path | None) -> Iterator[None]:
    """Hold a folder, made if there is none, so that no second run writes into it; a folder that
    was made here and is still empty goes again. None: nothing to hold.

    The hold is one of the operating system on the folder itself: it leaves no file, and ends with
    the process however that ends. Where the system has none, nothing is held.

    Raises:
        TiltcalError: another run holds it, or it cannot be made.
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
    """The folder opened and held."""
    try:
        from fcntl import LOCK_EX, LOCK_NB, flock
    except ImportError:  # no such holds here
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
    except OSError:  # a file system without holds
        os.close(handle)
        return None
    return handle
