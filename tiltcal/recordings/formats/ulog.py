"""PX4 ULog files, by the library pyulog."""

import contextlib
import io
import mmap
import struct
from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.core.optional_library import library
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import DAMAGED, RawFile, RawTable, typed

TIME = "timestamp"
"""The column of time stamps, us, that every topic has."""
_UNITS = {
    "sensor_accel": dict.fromkeys(("x", "y", "z"), "m/s2"),
    "sensor_gyro": dict.fromkeys(("x", "y", "z"), "rad/s"),
    "sensor_combined": {f"accelerometer_m_s2[{k}]": "m/s2" for k in range(3)}
    | {f"gyro_rad[{k}]": "rad/s" for k in range(3)},
}
"""Units of the fields, as the messages of PX4 define them."""


def read_ulog(path: Path, budget: ReadBudget) -> RawFile:
    """One table a topic; further instances of a topic are called ``<topic>_1`` and so on.

    Raises:
        TiltcalError: the library is missing, its definitions do not end, or nothing was logged.
    """
    core = library("pyulog", "ulog", "ULog files")
    budget.require(path.stat().st_size, path.name)
    _require_definitions(path)
    output = io.StringIO()
    with contextlib.redirect_stdout(output), path.open("rb") as file:
        log = core.ULog(file)
    messages = output.getvalue().strip().splitlines()
    damage = (
        {DAMAGED: messages[0] if messages else "corrupt"} if log.file_corruption or messages else {}
    )
    tables: list[RawTable] = []
    for data in log.data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}_{data.multi_id}"
        columns = [(n, typed(values)) for n, values in data.data.items()]
        kept = sorted(
            ((n, v) for n, v in columns if v is not None), key=lambda pair: pair[0] != TIME
        )
        units = {TIME: "us"} | _UNITS.get(data.name, {})
        units |= dict.fromkeys((n for n, _ in kept if n == "temperature"), "degC")
        tables.append(RawTable(name, tuple(kept), units, {} if tables else damage))
    if not tables:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="no logged topic",
            need="topics such as sensor_accel",
            do="log the topics of the sensors",
        )
    return RawFile(path.name, "ULog", tuple(tables))


_HEADER, _MESSAGE = 16, struct.Struct("<HB")  # bytes of the file's header; size and type
_DEFINITIONS, _LOGGED = b"BFIMPQ", b"ALC"  # types of messages before the data, and that end these
_LONGEST = 10_000  # bytes: above it pyulog takes an unknown message for damage


def _require_definitions(path: Path) -> None:
    """Refuse a file whose definitions run into its end: pyulog never comes back from it, because it
    steps back by the stated size of the last message, of which it has read less.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = _HEADER
        while at + _MESSAGE.size <= len(data):
            size, kind = _MESSAGE.unpack_from(data, at)
            if kind in _LOGGED:
                return
            if at == _HEADER and kind not in _DEFINITIONS:
                break
            damaged = kind == 0 or not 0 < size <= _LONGEST
            at += 1 if kind not in _DEFINITIONS and damaged else _MESSAGE.size + size
    raise TiltcalError(
        f"foreign recording {path.name}",
        found="no message of data after the definitions",
        need="a whole ULog file",
        do="check the file, or fetch it again from the vehicle",
    )
