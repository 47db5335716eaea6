"""Files of other programs that are recognised and not read: what they are, and what to do."""

import zipfile
from pathlib import Path

from tiltcal.core.errors import TiltcalError

_OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"  # compound file: Excel 97 to 2003
_ZIP = b"PK\x03\x04"
_DATAFLASH = b"\xa3\x95\x80"  # HEAD_BYTE1, HEAD_BYTE2, LOG_FORMAT_MSG of ArduPilot's AP_Logger


def refuse_other_program(path: Path, head: bytes) -> None:
    """Refuse a spreadsheet, or a binary log of ArduPilot.

    Args:
        path: of the file.
        head: its first bytes.

    Raises:
        TiltcalError: it is one.
    """
    if head.startswith(_OLE) or (head.startswith(_ZIP) and _is_workbook(path)):
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="an Excel workbook",
            need="text with one row a sample",
            do="save the sheet as CSV (in Excel: Save As, CSV UTF-8)",
        )
    if head.startswith(_DATAFLASH):
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="a dataflash log of ArduPilot",
            need="text with one row a sample",
            do=f"convert it with pymavlink: mavlogdump.py --types IMU --format csv {path.name}"
            " > imu.csv",
        )


def _is_workbook(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.startswith("xl/") for name in archive.namelist())
    except zipfile.BadZipFile:
        return False
