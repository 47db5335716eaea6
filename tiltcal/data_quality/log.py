"""A log as the checks see it: stamps and columns as they were written."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.quantisation import lsb_grid, lsb_width
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.setup.tables import axis_of
from tiltcal.statistics.dwell_noise import second_difference_noise

CHANCE = 1e-6  # of a finding in a sound channel, unless a check states its own
LEAST = 32  # samples that repeats are counted from
FLAT = 0.3  # chance of a repeat above which a coarse code is flat everywhere
FINE = 0.1  # up to which codes are fine: an LSB is a third of the noise
# LSB over noise: below it what rounding does is white to exp(-2 (pi / 1.5)^2), a part in 6000
COARSE = 1.5
HIDDEN = 0.4  # of an LSB: a smaller noise is hidden by it, and repeats say nothing
SAMPLED = 100_000  # readings from which noise and LSB of a longer channel are taken
PARTS = 10  # of the channel that these readings are taken from
ARITHMETIC = 1e-12  # of the largest reading: steps below it are rounding of the arithmetic
REST = 16  # samples whose spread is the noise where the table rests
AT_REST = 0.2  # of the time that a table rests, at least


@dataclass(frozen=True)
class Channel:
    """One column.

    Args:
        name: with its unit.
        values: as written, (n,); what is not finite was not sampled.
        limit: stated end of the range of the readings, in the unit of the column; None: unknown.
        rate_hz: that is stated; None: unknown.
    """

    name: str
    values: Array
    limit: float | None = None
    rate_hz: float | None = None

    @cached_property
    def rows(self) -> Index:
        """Rows on which it was sampled, (m,)."""
        return np.flatnonzero(np.isfinite(self.values))

    @cached_property
    def read(self) -> Array:
        """Its readings, (m,)."""
        return self.values if len(self.rows) == len(self.values) else self.values[self.rows]

    @property
    def quantity(self) -> str:
        """What its unit measures."""
        unit = split_unit(self.name)[1]
        return COLUMN_UNITS[unit].quantity if unit in COLUMN_UNITS else "raw"

    @property
    def channel(self) -> str:
        """Its name without the unit."""
        return split_unit(self.name)[0]

    @property
    def sensor(self) -> str:
        """The sensor that it belongs to: the name without axis and unit."""
        return self.channel.rpartition("_")[0] or self.channel

    @property
    def is_angle(self) -> bool:
        """Whether it is an angle of the table."""
        return axis_of(self.channel) is not None and self.quantity == "angle"

    @property
    def is_reading(self) -> bool:
        """Whether it is what a sensor read, not where the table stood or how warm it was."""
        return axis_of(self.channel) is None and self.channel != "temperature"

    @cached_property
    def repeats(self) -> Mask:
        """Whether a reading is that before it, (m - 1,)."""
        return np.asarray(self.read[1:] == self.read[:-1])

    @cached_property
    def is_constant(self) -> bool:
        """Whether it has one value throughout."""
        return bool(len(self.read)) and bool(self.repeats.all())

    @cached_property
    def sample(self) -> Array:
        """Readings that noise and LSB are taken from, (m,): all, or evenly spread parts of many."""
        if len(self.read) <= SAMPLED:
            return self.read
        size = SAMPLED // PARTS
        starts = np.linspace(0, len(self.read) - size, PARTS).astype(int)
        return np.concatenate([self.read[a : a + size] for a in starts])

    @cached_property
    def noise(self) -> float:
        """White noise by second differences, in the unit of the column."""
        return second_difference_noise(self.sample) if len(self.sample) > 2 else 0.0

    @cached_property
    def lsb(self) -> float | None:
        """LSB where all readings are whole multiples of it apart, else None."""
        return lsb_grid(self.sample) if len(self.sample) >= 2 * LEAST else None

    @cached_property
    def spread_at_rest(self) -> float:
        """Standard deviation over sixteen samples where they are quiet: the noise, if the table
        rests a fifth of the time.

        Values at the ends of the range may be clipped, the longest stretch of one value frozen:
        both are left out where anything else is left.
        """
        values = self.sample
        first, last = runs_of(np.diff(values) == 0)
        if len(first):
            k = int(np.argmax(last - first))
            rest = np.concatenate([values[: first[k]], values[last[k] + 1 :]])
            values = rest if len(rest) > len(values) // 4 else values
        inside = values[(values < values.max()) & (values > values.min())]
        values = inside if len(inside) > max(len(values) // 4, LEAST) else values
        blocks = values[: len(values) // REST * REST].reshape(-1, REST)
        if not len(blocks):
            return float(values.std())
        return float(np.quantile(blocks.std(axis=1), AT_REST))

    @cached_property
    def rounding(self) -> float:
        """What arithmetic rounds its readings to, at most, in the unit of the column."""
        return ARITHMETIC * float(np.abs(self.sample).max())

    @cached_property
    def has_noise(self) -> bool:
        """Whether it has noise where it is quiet and not flat; a computed course has none.

        Third differences of white noise are 1.8 times its second ones, those of a smooth course far
        smaller than these.
        """
        blocks = self.sample[: len(self.sample) // REST * REST].reshape(-1, REST)
        spread = blocks.std(axis=1)
        live = np.isfinite(spread) & (spread > self.rounding)
        blocks, spread = blocks[live], spread[live]
        if not len(blocks):
            return False
        quiet = blocks[spread <= np.quantile(spread, AT_REST)]
        second, third = (np.abs(np.diff(quiet, k, axis=1)).mean(axis=1) for k in (2, 3))
        return bool(np.mean(third > second) > 1 / 2)

    @cached_property
    def is_coarse(self) -> bool:
        """Whether its LSB is not small beside its noise."""
        if self.lsb is None or self.lsb < self.rounding:
            return False
        return self.lsb > COARSE * self.spread_at_rest

    @cached_property
    def repeat_chance(self) -> float:
        """Chance that two independent samples fall on the same code."""
        return repeat_chance(self.sample)


@dataclass(frozen=True)
class Log:
    """Stamps and columns of a log.

    Args:
        time: stamps, s, (n,).
        channels: by the names of their columns.
        labels: of the rows, (n,); None without any.
        period: s, after which the counter of the time starts again; None: from its falls.
        before: rows of the log before these.
    """

    time: Array
    channels: Mapping[str, Channel]
    labels: npt.NDArray[np.object_] | None = None
    period: float | None = None
    before: int = 0

    @classmethod
    def of(
        cls,
        time: Array,
        columns: Mapping[str, Array],
        *,
        labels: npt.NDArray[np.object_] | None = None,
        limits: Mapping[str, float] | None = None,
        rates: Mapping[str, float] | None = None,
        period: float | None = None,
    ) -> "Log":
        """A log of columns.

        Args:
            time: stamps, s, (n,).
            columns: name with unit -> values as written, (n,) each.
            labels: of the rows, (n,).
            limits: stated end of the range by column, in its unit.
            rates: stated sample rate by column, Hz.
            period: s, after which the counter of the time starts again.
        """
        limits, rates = limits or {}, rates or {}
        channels = {n: Channel(n, v, limits.get(n), rates.get(n)) for n, v in columns.items()}
        return cls(time, channels, labels, period)

    @property
    def columns(self) -> dict[str, Array]:
        """Values by column, (n,) each."""
        return {name: c.values for name, c in self.channels.items()}

    @cached_property
    def readings(self) -> list[Channel]:
        """Channels of sensors that have readings."""
        return [c for c in self.channels.values() if c.is_reading and len(c.rows)]

    @cached_property
    def sensors(self) -> dict[str, list[Channel]]:
        """Channels with readings, by the sensor that their names say."""
        found: dict[str, list[Channel]] = {}
        for channel in self.readings:
            found.setdefault(channel.sensor, []).append(channel)
        return found

    def changed(self, columns: Mapping[str, Array]) -> "Log":
        """The log with other values in some columns, (n,) each."""
        new = {n: replace(self.channels[n], values=v) for n, v in columns.items()}
        return replace(self, channels={**self.channels, **new})

    def emptied(self, rows: Mapping[str, Index]) -> "Log":
        """The log without the readings of these rows, by column. rows: (m,) each."""
        columns = {}
        for name, these in rows.items():
            columns[name] = self.channels[name].values.copy()
            columns[name][these] = np.nan
        return self.changed(columns)

    def taken(self, rows: Index) -> "Log":
        """These rows, (m,), in this order."""
        return replace(
            self,
            time=self.time[rows],
            channels={n: replace(c, values=c.values[rows]) for n, c in self.channels.items()},
            labels=None if self.labels is None else self.labels[rows],
        )

    def without(self, columns: frozenset[str]) -> "Log":
        """The log without some columns."""
        if not columns:
            return self
        left = {n: c for n, c in self.channels.items() if n not in columns}
        return replace(self, channels=left)


def runs_of(same: Mask) -> tuple[Index, Index]:
    """First and last index (exclusive) of runs of true in a mask, (m,) each."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(np.int8), [0]])))
    return edges[::2], edges[1::2]


def repeat_chance(values: Array) -> float:
    """Chance that two independent samples of a noisy column fall on the same code. values: (n,).

    From the noise, and from how often a sample is that two before, whichever is more: where the
    table moves much of the time the noise is overestimated, and codes need not be equally wide.
    """
    noise = second_difference_noise(values)
    width = lsb_width(values)
    if width <= 0:
        return 0.0
    if noise < HIDDEN * width:
        return 1.0
    later = float(np.mean(values[2:] == values[:-2]))
    return float(min(max(width / (2 * noise * np.sqrt(np.pi)), later), 1.0))
