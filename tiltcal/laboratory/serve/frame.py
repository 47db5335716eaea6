"""A frame of readings on the wire: fixed length, little-endian, with a counter and a checksum."""

import struct
import zlib
from dataclasses import dataclass

from tiltcal.core.errors import TiltcalError

MAGIC = b"TCF1"
HEAD = "<4sId"  # magic, counter, time
TAIL = 4  # bytes of the checksum


@dataclass(frozen=True)
class FrameFormat:
    """Contents of a frame after its head: a float64 for each column, then the CRC-32 of all before.

    Args:
        columns: names with units, as in a recording; a NaN was not sampled.
    """

    columns: tuple[str, ...]

    @property
    def _layout(self) -> str:
        return f"{HEAD}{len(self.columns)}d"

    @property
    def size(self) -> int:
        """Bytes of a frame."""
        return struct.calcsize(self._layout) + TAIL

    def pack(self, counter: int, time: float, values: list[float]) -> bytes:
        """A frame. counter: modulo 2^32; time: s; values: of the columns."""
        body = struct.pack(self._layout, MAGIC, counter & 0xFFFFFFFF, time, *values)
        return body + struct.pack("<I", zlib.crc32(body))

    def unpack(self, frame: bytes) -> tuple[int, float, list[float]]:
        """Counter, time and values of a frame.

        Raises:
            TiltcalError: it has another length, another beginning or a wrong checksum.
        """
        sound = len(frame) == self.size and frame[:4] == MAGIC
        if not sound or zlib.crc32(frame[:-TAIL]) != struct.unpack("<I", frame[-TAIL:])[0]:
            raise TiltcalError(
                "frame",
                found=f"{len(frame)} bytes that are none",
                need=f"{self.size} bytes from TCF1 to a CRC-32 that agrees",
                do="ask for the columns again, and read whole frames",
            )
        _, counter, time, *values = struct.unpack(self._layout, frame[:-TAIL])
        return counter, time, values
