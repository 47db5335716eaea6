"""Checks of what is written where nothing was read, and of angles that wrap."""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.data_quality.check import Check, Emptying, Finding, in_rows, in_words
from tiltcal.data_quality.log import FINE, LEAST, Channel, Log

HALF_TURN = 0.5  # turns: an angle does not jump by more between two rows


class Missing(Check):
    """Rows without a value."""

    name = "missing"
    test = "no value missing"
    answer = "note"
    looks_at = "all columns"
    finds = "one empty cell, where not every so many rows have one"

    def _find(self, log: Log) -> Iterator[Finding]:
        alike: dict[bytes, list[Channel]] = {}
        for c in log.channels.values():
            if len(c.rows) not in (0, len(c.values)) and not _at_slower_rate(c):
                alike.setdefault(c.rows.tobytes(), []).append(c)
        for channels in alike.values():
            rows = np.flatnonzero(~np.isfinite(channels[0].values))
            columns = tuple(c.name for c in channels)
            yield self.finding(columns, rows, f"{', '.join(columns)}: no value, {in_rows(rows)}")


def _at_slower_rate(channel: Channel) -> bool:
    """Whether values stand at every so many rows, without exception."""
    apart = np.diff(channel.rows)
    return bool(len(apart)) and bool(apart[0] > 1) and bool(np.all(apart == apart[0]))


class Constant(Emptying):
    """A channel without a value, or with a single one."""

    name = "dead"
    test = "alive"
    looks_at = "readings"
    finds = "one value throughout, beside channels with noise or without any other"
    explains = True

    def _find(self, log: Log) -> Iterator[Finding]:
        for channel in log.channels.values():
            if not len(channel.rows):
                words = f"{channel.name}: no value in any row"
                yield self.finding((channel.name,), channel.rows, words)
        for channels in log.sensors.values():
            others = [c for c in channels if not c.is_constant]
            if others and all(_is_computed(c) for c in others):
                continue
            for c in channels:
                if c.is_constant and len(c.read) > 1:
                    words = (
                        f"{c.name}: {c.read[0]:g} in all {len(c.read)} rows: dead, disconnected or"
                        " too coarsely quantised"
                    )
                    yield self.finding((c.name,), c.rows[1:], words, count=len(c.rows))


def _is_computed(channel: Channel) -> bool:
    """Whether a channel moves on no grid and without noise, as a computed one does."""
    return channel.lsb is None and float(np.mean(channel.repeats)) > FINE


class Equal(Check):
    """Columns that hold the same readings: one register read for several."""

    name = "equal_columns"
    test = "columns differ"
    looks_at = "readings"
    finds = "two columns that are equal in all rows, and not constant"

    def _find(self, log: Log) -> Iterator[Finding]:
        groups: list[list[Channel]] = []
        for channel in log.readings:
            if channel.is_constant or len(channel.read) < 2:
                continue
            group = next((g for g in groups if _are_equal(g[0], channel)), None)
            if group is None:
                groups.append([channel])
            else:
                group.append(channel)
        for group in groups:
            if len(group) > 1:
                names = tuple(c.name for c in group)
                words = f"{in_words(names)} are equal in all rows: one source"
                yield self.finding(names, group[0].rows, words)


def _are_equal(one: Channel, other: Channel) -> bool:
    """Whether two channels have the same values; most differ in the first rows."""
    beginning = slice(0, LEAST)
    return all(
        np.array_equal(one.values[part], other.values[part], equal_nan=True)
        for part in (beginning, slice(None))
    )


class Alternating(Check):
    """Readings that alternate from row to row: two sources in one table."""

    name = "alternating"
    test = "one source"
    looks_at = "readings of a sensor"
    finds = "a difference of alternate rows of twice the noise, in 300 rows"

    def _find(self, log: Log) -> Iterator[Finding]:
        for name, channels in log.sensors.items():
            hit = [c for c in channels if _alternates(c.sample)]
            if hit:
                words = (
                    f"{in_words([c.name for c in hit])}: readings alternate from row to row: two"
                    f" instruments or instances under the name {name}"
                )
                yield self.finding(tuple(c.name for c in hit), hit[0].rows, words)


# of the median step to the next row over that to the next but one: 1 in noise, less in motion
APART = 1.5
ALTERNATES = 300  # readings, of which the ratio is known to a tenth: five sigmas


def _alternates(values: Array) -> bool:
    """Whether a reading is much nearer to the next but one than to the next."""
    if len(values) < ALTERNATES:
        return False
    after, next_but_one = np.abs(np.diff(values)), np.abs(values[2:] - values[:-2])
    near = max(float(np.median(next_but_one)), float(np.min(after[after > 0], initial=np.inf)))
    return bool(float(np.median(after)) > APART * near)


class AngleWraps(Check):
    """An angle of the table that jumps by a turn."""

    name = "wrap"
    test = "angles are continuous"
    answer = "note"
    repair = "unwrap_angles"
    looks_at = "angles of the table"
    finds = "one step of more than half a turn"

    def _find(self, log: Log) -> Iterator[Finding]:
        for channel in log.channels.values():
            if channel.is_angle and (jumps := _angle_jumps(channel)).any():
                rows = np.flatnonzero(jumps) + 1
                words = f"{channel.name}: the angle wraps, {in_rows(rows)}"
                yield self.finding((channel.name,), rows, words)

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        changed = {}
        for name in [c for f in findings for c in f.columns]:
            channel = log.channels[name]
            values = channel.values.copy()
            values[channel.rows] = np.unwrap(channel.read, period=_turn(channel))
            changed[name] = values
        return log.changed(changed), ", ".join(changed) + " made continuous"


def _turn(channel: Channel) -> float:
    """A whole turn in the unit of the column."""
    return float(2 * np.pi / COLUMN_UNITS[str(split_unit(channel.name)[1])].factor)


def _angle_jumps(channel: Channel) -> Mask:
    """Steps of an angle by more than half a turn, (n - 1,)."""
    step = np.abs(np.nan_to_num(np.diff(channel.values)))
    return np.asarray(step > HALF_TURN * _turn(channel))
