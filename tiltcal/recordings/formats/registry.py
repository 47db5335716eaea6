"""All foreign formats, which of them a file has (by its first bytes, then by its name), and the
error of a file that its library cannot read.
"""

import importlib
import struct
from dataclasses import dataclass
from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import require_file
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.labelled_lines import are_labelled_lines
from tiltcal.recordings.formats.other_programs import refuse_other_program
from tiltcal.recordings.formats.raw_table import RawFile
from tiltcal.recordings.mapping import FileLayout


def unreadable(source: str, format: str, error: BaseException) -> TiltcalError:
    """What to raise where a library cannot read a file."""
    text = str(error).strip().splitlines()
    return TiltcalError(
        f"foreign recording {source}",
        found=text[0][:200] if text else type(error).__name__,
        need=f"a whole {format} file",
        do="check the file, or export it again",
    )


@dataclass(frozen=True)
class Format:
    """A format.

    Args:
        name: of the format.
        reader: module of this package and function, ``module:function``; imported on use.
        marks: what its files begin with.
        suffixes: of their names, where the content does not determine the format.
    """

    name: str
    reader: str
    marks: tuple[bytes, ...] = ()
    suffixes: tuple[str, ...] = ()

    def read(self, path: Path, layout: FileLayout, budget: ReadBudget) -> RawFile:
        """The raw tables of a file.

        Raises:
            TiltcalError: it cannot be read, is above the budget, or a library is missing.
        """
        module, _, function = self.reader.partition(":")
        reader = getattr(importlib.import_module(f"{__package__}.{module}"), function)
        try:
            return reader(path, layout, budget) if self is TEXT else reader(path, budget)
        except TiltcalError:
            raise
        except Exception as error:  # libraries raise anything on a broken file
            raise unreadable(path.name, self.name, error) from error


TEXT = Format("text", "text:read_text")
LABELLED = Format("lines of names and numbers", "labelled_lines:read_labelled_lines")
MATLAB_4 = Format("MATLAB", "matlab:read_matlab")
BAG_FOLDER = Format("ROS 2 bag", "ros_files:read_bag")
BINARY = (
    Format("Parquet", "parquet_tables:read_parquet_tables", (b"PAR1",), (".parquet", ".pq")),
    Format("NPZ", "numpy_archive:read_npz", (b"PK\x03\x04", b"PK\x05\x06"), (".npz",)),
    Format("MATLAB", "matlab:read_matlab", (b"MATLAB 5.0",)),
    Format("MATLAB v7.3", "hdf5:read_hdf5", (b"MATLAB 7.3",)),
    Format("HDF5", "hdf5:read_hdf5", (b"\x89HDF\r\n\x1a\n",), (".h5", ".hdf5", ".hdf")),
    Format("ROS 1 bag", "ros_files:read_bag", (b"#ROSBAG V2.0",), (".bag",)),
    Format("ROS 2 bag", "ros_files:read_bag", (b"SQLite format 3\x00",), (".db3",)),
    Format("MCAP", "ros_files:read_mcap", (b"\x89MCAP0\r\n",), (".mcap",)),
    Format("ULog", "ulog:read_ulog", (b"ULog\x01\x12\x35",), (".ulg", ".ulog")),
    Format("TDMS", "tdms:read_tdms", (b"TDSm",), (".tdms",)),
)
_PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"7z\xbc\xaf": "7-Zip"}
_LONGEST = 32  # bytes by which a format is recognised


def format_of(path: Path) -> Format:
    """The format of a file or of the folder of a ROS 2 bag.

    Raises:
        TiltcalError: it is missing, empty, compressed, or a binary of no known format.
    """
    if path.is_dir() and (path / "metadata.yaml").exists():
        return BAG_FOLDER
    require_file(path, "foreign recording")
    with path.open("rb") as file:
        head = file.read(_LONGEST)
    refuse_other_program(path, head)
    for format in BINARY:
        if head.startswith(format.marks):
            return format
    if _is_matlab_4(head):
        return MATLAB_4
    for format in BINARY:
        if path.suffix.lower() in format.suffixes:
            return format
    packed = next((name for mark, name in _PACKED.items() if head.startswith(mark)), None)
    if packed is not None:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found=f"a file compressed by {packed}",
            need="the file that is inside",
            do="decompress it first",
        )
    if head.count(0) > len(head) * 3 / 4:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found="a binary file of no format that is known",
            need="text, " + ", ".join(dict.fromkeys(f.name for f in BINARY)),
            do="export it in one of these",
        )
    return LABELLED if are_labelled_lines(path) else TEXT


def _is_matlab_4(head: bytes) -> bool:
    """Whether a file begins with the header of a matrix of MATLAB 4, which has no mark: its type
    MOPT (order of bytes, 0, precision, kind), rows, columns, whether it is complex, and the length
    of its name.
    """
    if len(head) < _LONGEST:
        return False
    for order, big in (("<", 0), (">", 1)):
        kind, rows, columns, imaginary, length = struct.unpack_from(order + "5i", head)
        name = head[20 : 20 + length - 1] if 1 < length <= _NAME else b""
        digits = (kind // 1000, kind // 100 % 10, kind // 10 % 10, kind % 10)
        valid = digits[0] == big and digits[1] == 0 and digits[2] <= 5 and digits[3] <= 2
        if valid and kind >= 0 and min(rows, columns) >= 0 and imaginary in (0, 1):
            word = name.replace(b"_", b"a").decode("latin-1")
            if word.isascii() and word.isalnum():
                return True
    return False


_NAME = 64  # bytes of a name of MATLAB with its end


def read_raw(path: Path, layout: FileLayout, budget: ReadBudget | None = None) -> RawFile:
    """The raw tables of a foreign file.

    Args:
        path: of the file.
        layout: of a text file.
        budget: how much memory the values may take.

    Raises:
        TiltcalError: as ``Format.read`` and ``format_of`` do.
    """
    return format_of(path).read(path, layout, budget or ReadBudget())
