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
