"""Optional libraries: imported when a file needs them, named when they are missing."""

import importlib
from types import ModuleType

from tiltcal.core.errors import TiltcalError


def library(module: str, extra: str, format: str) -> ModuleType:
    """An optional library.

    Raises:
        TiltcalError: it is not installed; the message names the extra that brings it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise TiltcalError(
            format,
            found=f"the library {module.partition('.')[0]} is not installed",
            need=f"the extra '{extra}'",
            do=f'install it with pip install "tiltcal[{extra}]"',
        ) from error


def unreadable(source: str, format: str, error: BaseException) -> TiltcalError:
    """What to raise where a library cannot read a file."""
    text = str(error).strip().splitlines()
    return TiltcalError(
        f"foreign recording {source}",
        found=text[0][:200] if text else type(error).__name__,
        need=f"a whole {format} file",
        do="check the file, or export it again",
    )
