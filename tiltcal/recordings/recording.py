"""Recording: a continuous log as frozen blocks of channels, each on its own rows of one time
axis.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.tabular import Tabular
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.fingerprint import fingerprint_of
from tiltcal.recordings.samples import Block, Labels, Samples, si_values
from tiltcal.recordings.stamps import require_measurable, require_onward
from tiltcal.recordings.temperature import smooth_temperature
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.tables import angle_channel, axis_of

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Recording(Tabular):
    """A continuous log.

    Args:
        time: one stamp a row, s, (n,), any epoch.
        blocks: the numeric channels.
        labels: the operator's labels, (n,) of str or None; None when there is no such column.
        extra: columns that are no channel (no unit in their name), kept as text.
        metadata: ``# key: value`` lines.
        source: where it came from, for messages.
        origin: fingerprint of the recording that this one was made from; None: of none.
    """

    time: Array
    blocks: tuple[Block, ...] = ()
    labels: Labels | None = None
    extra: Mapping[str, Labels] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)
    source: str = "recording"
    origin: str | None = None

    @classmethod
    def from_columns(
        cls,
        time: Array,
        columns: Mapping[str, Array],
        *,
        labels: Labels | None = None,
        extra: Mapping[str, Labels] | None = None,
        metadata: Mapping[str, str] | None = None,
        source: str = "recording",
        origin: str | None = None,
    ) -> "Recording":
        """Group columns of full length, (n,) each with NaN for 'not sampled', into blocks.
        time: s.
        """
        groups: dict[bytes, dict[str, Array]] = {}
        for name, values in columns.items():
            missing = np.isnan(values)
            key = np.packbits(missing).tobytes() if missing.any() else b""
            groups.setdefault(key, {})[name] = values
        blocks = []
        for key, group in groups.items():
            if key == b"":
                blocks.append(Block(None, group))
                continue
            rows = np.flatnonzero(~np.isnan(next(iter(group.values()))))
            blocks.append(Block(rows, {name: values[rows] for name, values in group.items()}))
        return cls(
            time, tuple(blocks), labels, dict(extra or {}), dict(metadata or {}), source, origin
        )

    @cached_property
    def fingerprint(self) -> str:
        """Fingerprint of this recording, unchanged after samples of it were repaired or left
        out: a digest of its stamps and, where it has any, one of its readings.
        """
        if self.origin is not None:
            return self.origin
        readings = {n: self.column(n) for n in self.column_names if is_reading(n)}
        return fingerprint_of([self.time], readings)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def column_names(self) -> list[str]:
        """Names of the numeric columns, without ``time_s``."""
        return [name for block in self.blocks for name in block.columns]

    @property
    def texts(self) -> dict[str, Labels]:
        """The columns of text, (n,) each, ``label`` last."""
        return dict(self.extra) | ({} if self.labels is None else {"label": self.labels})

    @property
    def written_names(self) -> list[str]:
        """The columns of its file, in their order."""
        return ["time_s", *self.column_names, *self.texts]

    def column(self, name: str) -> Array:
        """A numeric column at full length, as written, (n,), NaN where not sampled.

        Raises:
            TiltcalError: there is no such column.
        """
        for block in self.blocks:
            if name in block.columns:
                if block.rows is None:
                    return block.columns[name]
                full = np.full(len(self.time), np.nan)
                full[block.rows] = block.columns[name]
                return full
        hint = nearest(name, self.column_names) if self.column_names else "it has none"
        raise TiltcalError(
            f"{self.source}, column {name}", found="no such column", need="that channel", do=hint
        )

    def channel(self, channel: str) -> str | None:
        """The full column name of a channel, whatever its unit; None when absent.

        Raises:
            TiltcalError: it stands there in two units.
        """
        names = self._by_channel.get(channel, [])
        if len(names) > 1:
            raise TiltcalError(
                f"{self.source}, channel {channel}",
                found=" and ".join(names),
                need="one column a channel",
                do="remove the other",
            )
        return names[0] if names else None

    @cached_property
    def _by_channel(self) -> dict[str, list[str]]:
        """Columns of each channel, whatever their units."""
        found: dict[str, list[str]] = {}
        for name in self.column_names:
            found.setdefault(split_unit(name)[0], []).append(name)
        return found

    def has_columns(self, sensor: Sensor) -> bool:
        """Whether every axis of ``sensor`` has a column."""
        return all(self.channel(f"{sensor.name}_{axis}") is not None for axis in sensor.axes)

    def has(self, sensor: Sensor) -> bool:
        """Whether every axis of ``sensor`` has a column, and a reading in it."""
        names = [self.channel(f"{sensor.name}_{axis}") for axis in sensor.axes]
        return all(n is not None and not np.isnan(self.column(n)).all() for n in names)

    def sensor(self, sensor: Sensor) -> Samples:
        """The readings of one sensor in SI, on the rows where any of its channels was sampled.

        Raises:
            TiltcalError: a column is missing or its unit does not fit the sensor.
        """
        names, columns = [], []
        for axis in sensor.axes:
            name = self.channel(f"{sensor.name}_{axis}")
            if name is None:
                raise TiltcalError(
                    f"{self.source}, sensor {sensor.name}",
                    found=f"no column {sensor.name}_{axis}_<unit>",
                    need=f"one column for each of its axes {', '.join(sensor.axes)}",
                    do=nearest(
                        f"{sensor.name}_{axis}_{sensor.column_unit}",
                        self.column_names or ["no column at all"],
                    ),
                )
            names.append(name)
            columns.append(self.column(name))
        missing = np.isnan(columns[0])
        for column in columns[1:]:
            missing &= np.isnan(column)
        rows = np.flatnonzero(~missing)
        raw = np.column_stack(columns if len(rows) == len(self) else [c[rows] for c in columns])
        units = tuple(str(split_unit(name)[1]) for name in names)
        for name, values in zip(names, raw.T, strict=True):
            require_measurable(values, self.time[rows], name, self.source)
        return Samples(
            self.time[rows], si_values(sensor, names, raw, self.source), sensor.axes, units, rows
        )

    def table(self, axis: str, suffix: str = "") -> Array | None:
        """Readout of a table axis, rad, (n,), NaN where it was not read; None without such a
        column.
        """
        return self._scaled(angle_channel(axis, suffix))

    def temperature(self) -> Array | None:
        """Temperature, degC, (n,), smooth over rounding, noise and the rows where it was not
        sampled; None without a column.
        """
        return self._temperature

    @cached_property
    def _temperature(self) -> Array | None:
        values = self._scaled("temperature")
        return (
            None
            if values is None or np.isnan(values).all()
            else smooth_temperature(self.time, values)
        )

    def _scaled(self, channel: str) -> Array | None:
        name = self.channel(channel)
        if name is None:
            return None
        require_measurable(self.column(name), self.time, name, self.source)
        return np.asarray(self.column(name) * COLUMN_UNITS[str(split_unit(name)[1])].factor)

    def require_increasing(self) -> "Recording":
        """Itself, when time runs forward.

        Raises:
            TiltcalError: naming the first row where it does not.
        """
        require_onward(self.time, self.source)
        return self

    def rewritten(self, columns: Mapping[str, Array]) -> "Recording":
        """A copy with these columns in place of its own, (n,) each."""
        return Recording.from_columns(
            self.time,
            columns,
            labels=self.labels,
            extra=self.extra,
            metadata=self.metadata,
            source=self.source,
            origin=self.fingerprint,
        )

    def with_columns(self, columns: Mapping[str, Array]) -> "Recording":
        """A copy with further full-length columns, (n,) each."""
        more = Recording.from_columns(self.time, columns)
        return replace(self, blocks=self.blocks + more.blocks)

    def unknown(self, sensors: Iterable[Sensor]) -> list[str]:
        """Columns that belong to no sensor, table axis or temperature: kept, and reported."""
        prefixes = {f"{s.name}_{axis}" for s in sensors for axis in s.axes}
        strange = [
            name
            for name in self.column_names
            if (c := split_unit(name)[0]) not in prefixes
            and axis_of(c) is None
            and c != "temperature"
        ]
        return strange + list(self.extra)

    def ignored_columns(self, sensors: Iterable[Sensor]) -> str:
        """A note of the unknown columns; empty without any."""
        unknown = ", ".join(self.unknown(sensors))
        message = f"columns that belong to no sensor of the scenario are ignored: {unknown}"
        return message if unknown else ""

    def as_columns(self) -> Mapping[str, Array | Labels]:
        """The columns of its file, (n,) each; numbers as written, NaN where not sampled."""
        numbers = {name: self.column(name) for name in self.column_names}
        return {"time_s": self.time} | numbers | self.texts

    def headline(self) -> str:
        """Source, rows and duration."""
        return f"{self.source}: {len(self)} rows, {np.ptp(self.time) if len(self) else 0:.6g} s"

    def to_arrow(self) -> "pa.Table":
        """The table for Arrow; null where a channel was not sampled."""
        from tiltcal.recordings.arrow_columns import arrow_table

        return arrow_table(self, self.written_names)

    def save(self, path: Path | str) -> None:
        """Write it as CSV, Parquet or NPZ, whole or not at all; the ending decides.

        Raises:
            TiltcalError: the ending is unknown or the path cannot be written.
        """
        from tiltcal.recordings.saving import write_recording

        write_recording(self, path)


def is_reading(name: str) -> bool:
    """Whether a column is what a sensor read, not where the table stood or how warm it was."""
    channel = split_unit(name)[0]
    return axis_of(channel) is None and channel != "temperature"


def stem(source: str) -> str:
    """The short name of a recording for messages."""
    return Path(source).name
