"""Samples as lines of text: comma-separated numbers under a header or stated columns."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import COLUMN_UNITS, split_unit

LONGEST = 65536  # bytes of a line: what is longer is no line of numbers
TIMES = {"t": "time_s", "time": "time_s"}
"""Names of the time without a unit: seconds."""


@dataclass(frozen=True)
class Samples:
    """Some samples.

    Args:
        time: stamps, s, (n,).
        columns: readings by column name, (n,) each, NaN where not sampled.
    """

    time: Array
    columns: dict[str, Array]

    def __len__(self) -> int:
        return len(self.time)


NOTHING = Samples(np.zeros(0), {})


@dataclass
class LineReader:
    """Turns bytes into samples. The first line that is no comment is the header, unless columns
    are stated; a header that is repeated is skipped.

    Args:
        source: name for messages.
        columns: names of the cells; empty: by the header. ``time_s`` (or another unit of time) is
            among them, unless a rate is given.
        rate_hz: of the lines, where they have no time; None: they have.
        midway: whether the first line may have begun before it was heard: numbers in it are left
            out, and in the first after each gap.
    """

    source: str
    columns: tuple[str, ...] = ()
    rate_hz: float | None = None
    midway: bool = False
    damaged: int = 0
    _rest: bytes = b""
    _count: int = 0
    _gap: float = 0.0
    _time: tuple[int, float] | None = None
    _header: tuple[str, ...] = ()
    _kept: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._torn = self.midway
        if self.columns:
            self._name(self.columns)

    def feed(self, data: bytes) -> Samples:
        """The samples of all lines that are complete.

        Args:
            data: what came.

        Raises:
            TiltcalError: there is no header, or it lacks the time.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-LONGEST:]
        rows = [row for line in lines if (row := self._row(line)) is not None]
        if not rows:
            return NOTHING
        values = np.array(rows)
        names = self.columns
        if self._time is None:
            first = self._count + 1
            self._count += len(rows)
            assert self.rate_hz is not None
            time = np.arange(first, self._count + 1) / self.rate_hz + self._gap
            kept = range(len(names))
        else:
            index, factor = self._time
            time = values[:, index] * factor
            kept = [k for k in range(len(names)) if k != index]  # type: ignore[assignment]
        return Samples(time, {names[k]: values[:, k] for k in kept})

    def skip(self, seconds: float) -> None:
        """The connection was away: what is left of a line is gone, and lines without a time go on
        that much later. seconds: s.
        """
        self._rest, self._torn = b"", self.midway
        self._gap += seconds

    def _row(self, line: bytes) -> list[float] | None:
        """The numbers of a line; None where it is a header, a comment or damaged."""
        text = line.decode("utf-8", errors="replace").strip().lstrip("\ufeff")
        if not text or text.startswith("#"):
            return None
        torn, self._torn = self._torn, False
        every = next(csv.reader([text])) if '"' in text else text.split(",")
        cells = [cell.strip() for cell in every]
        if not self._header:
            if torn and _is_number(cells[0]):
                return None
            self._require_header(text, cells[0])
            self._name(cells)
            return None
        row = [_number(cells[k]) for k in self._kept] if len(cells) == len(self._header) else []
        found = [value for value in row if value is not None]
        lacking = len(found) < len(self._kept)
        if lacking or (self._time and not np.isfinite(found[self._time[0]])):
            self.damaged += not torn and tuple(cells) != self._header
            return None
        return None if torn else found

    def _require_header(self, text: str, first: str) -> None:
        """Refuse numbers where the names should stand."""
        if _is_number(first):
            raise TiltcalError(
                self.source,
                found=f"numbers without a header: {text[:60]}",
                need="names of the columns, such as time_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2",
                do="send them as the first line, or state them (--columns)",
            )

    def _name(self, cells: Sequence[str]) -> None:
        """Take the names of the columns; those without a unit are left out."""
        every = [TIMES.get(cell, cell) for cell in cells]
        kept = [k for k, name in enumerate(every) if split_unit(name)[1] is not None]
        names = tuple(every[k] for k in kept)
        units = [(k, split_unit(name)) for k, name in enumerate(names)]
        times = [(k, COLUMN_UNITS[str(u)].factor) for k, (stem, u) in units if stem == "time"]
        if len(names) == len(times) or len(set(names)) < len(names):
            raise TiltcalError(
                self.source,
                found=f"columns {', '.join(every)[:200]}",
                need="<sensor>_<axis>_<unit>, such as accel_x_m_s2, and none twice",
                do="state the columns (--columns)",
            )
        if not times and self.rate_hz is None:
            raise TiltcalError(
                self.source,
                found=f"columns {', '.join(names)[:200]}",
                need="a column time_s (or ms, us, ns)",
                do="send the time, or state the rate with --rate-hz",
            )
        self._header, self._kept = tuple(cells), kept
        self.columns, self._time = names, times[0] if times else None


def _number(cell: str) -> float | None:
    """A cell as a number, NaN where it is empty; None where it is no number."""
    try:
        return float(cell) if cell else float("nan")
    except ValueError:
        return None


def _is_number(cell: str) -> bool:
    return bool(cell) and _number(cell) is not None
