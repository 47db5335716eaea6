"""Files that some tests read and that are not part of the project: published recordings, and the
schemas of the digital calibration certificate.

The environment variable TILTCAL_TEST_FILES names their folder; tests of files that it does not hold
are skipped:

    recordings/<data set>/<file>   as `tiltcal datasets list` names them
    dcc/*.xsd                      schemas of PTB, https://ptb.de/dcc and https://ptb.de/si
"""

import os
from pathlib import Path

import pytest

VARIABLE = "TILTCAL_TEST_FILES"
FOLDER = Path(os.environ.get(VARIABLE) or f"no {VARIABLE}")
RECORDINGS = FOLDER / "recordings"
SCHEMAS = FOLDER / "dcc"


def reason_without(path: Path) -> str | None:
    """Why a test that needs a file or folder is skipped; None where it is there."""
    if path.exists():
        return None
    if not os.environ.get(VARIABLE):
        return f"{VARIABLE} is not set: the folder with published recordings and schemas"
    return f"{VARIABLE} holds no {path.relative_to(FOLDER)}"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test where a file or folder is missing."""
    reason = reason_without(path)
    return pytest.mark.skipif(reason is not None, reason=reason or "")
