"""The samples of a live source as one growing table."""

from collections.abc import Mapping

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.samples import Labels

ROWS = 4096  # of which memory is first taken; then twice as many whenever it is full
RECENT = 1000  # samples by which the rate is estimated


class Stream:
    """Columns that grow. Stamps run forward: late rows are left out and counted, and a clock that
    begins again is continued.

    Args:
        source: name for messages.
    """

    def __init__(self, source: str = "live recording") -> None:
        self.source = source
        self.late = 0
        self.restarts = 0
        self.rows = 0
        self._offset = 0.0
        self._data: dict[str, Array] = {}
        self._time = np.empty(ROWS)

    @property
    def names(self) -> tuple[str, ...]:
        """Columns of the stream, without the time."""
        return tuple(self._data)

    @property
    def time(self) -> Array:
        """Stamps so far, s, (n,)."""
        return self._time[: self.rows]

    def column(self, name: str) -> Array:
        """Readings of a column so far, as they came, (n,)."""
        return self._data[name][: self.rows]

    def append(self, time: Array, columns: Mapping[str, Array]) -> None:
        """Take further rows.

        Args:
            time: stamps, s, (n,).
            columns: readings by column name with its unit, (n,) each.

        Raises:
            TiltcalError: the columns are others than before, or of another length.
        """
        time = np.asarray(time, dtype=float)
        values = {name: np.asarray(column, dtype=float) for name, column in columns.items()}
        self._require_same(time, values)
        order = np.argsort(time, kind="stable")
        order = order[np.isfinite(time[order])]
        stamps = self._continued(time[order])
        ahead = stamps > np.maximum.accumulate(np.concatenate([[self._end], stamps[:-1]]))
        self.late += len(time) - int(ahead.sum())
        order, stamps = order[ahead], stamps[ahead]
        if not self._data:
            self._data = {name: np.empty(len(self._time)) for name in values}
        last = self.rows + len(stamps)
        self._reserve(last)
        self._time[self.rows : last] = stamps
        for name, column in values.items():
            self._data[name][self.rows : last] = column[order]
        self.rows = last

    @property
    def _end(self) -> float:
        return float(self._time[self.rows - 1]) if self.rows else -np.inf

    def _require_same(self, time: Array, values: Mapping[str, Array]) -> None:
        wrong = [name for name, column in values.items() if column.shape != time.shape]
        if time.ndim != 1 or wrong:
            raise TiltcalError(
                self.source,
                found=f"{len(wrong)} columns of another length than the time",
                need="one value a stamp in each",
                do="fill what was not sampled with NaN",
            )
        if self._data and set(values) != set(self._data):
            raise TiltcalError(
                self.source,
                found=f"columns {', '.join(values)}",
                need=f"those of the first samples: {', '.join(self._data)}",
                do="keep to the same columns",
            )
        nameless = [name for name in values if split_unit(name)[1] is None]
        if nameless:
            raise TiltcalError(
                self.source,
                found=f"column {nameless[0]}",
                need="<sensor>_<axis>_<unit>, such as accel_x_m_s2",
                do="name the columns so",
            )

    def _continued(self, time: Array) -> Array:
        """Stamps of a clock that began again, continued from the last one, (n,)."""
        time = time + self._offset
        span = float(self._end - self._time[0]) if self.rows else 0.0
        # one that jumps back by more than a second and at least half way began again
        back = self._end - time[-1] if len(time) and self.rows else 0.0
        if back > max(1.0, span / 2):
            shift = back + float(time[-1] - time[0]) + 1.0 / (self.rate or 1.0)
            self._offset += shift
            self.restarts += 1
            time = time + shift
        return time

    def _reserve(self, rows: int) -> None:
        if rows <= len(self._time):
            return
        size = max(rows, 2 * len(self._time))
        for name, old in {"": self._time, **self._data}.items():
            new = np.empty(size)
            new[: self.rows] = old[: self.rows]
            if name:
                self._data[name] = new
            else:
                self._time = new

    @property
    def rate(self) -> float | None:
        """Rows a second by the last of them; None before the third."""
        steps = np.diff(self.time[-RECENT:])
        return float(1 / np.median(steps)) if len(steps) > 1 else None

    def since(self, start: float) -> int:
        """The first row at or after an instant, s."""
        return int(np.searchsorted(self.time, start))

    def recording(
        self,
        rows: Index | slice = slice(None),
        *,
        more: Mapping[str, Array] | None = None,
        labels: Labels | None = None,
    ) -> Recording:
        """Some rows as a recording.

        Args:
            rows: which, (m,); all unless given.
            more: columns in addition to or in place of its own, (m,) each.
            labels: of the rows, (m,).
        """
        columns = {name: self.column(name)[rows] for name in self.names} | dict(more or {})
        kept = {name: values for name, values in columns.items() if not np.isnan(values).all()}
        return Recording.from_columns(self.time[rows], kept, labels=labels, source=self.source)
