"""Which column has the time, in which unit, and the sample rate that the lines before the data
state.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.recordings.formats.cells import STAMP, date_stamps, order_of_dates
from tiltcal.recordings.formats.raw_table import Raw
from tiltcal.recordings.mapping import TimeSource
from tiltcal.recordings.proposal.channels import Channel

_KEYS = re.compile(r"rate|freq|sampling|采样", re.IGNORECASE)
_NUMBER = re.compile(r"(\d+(?:[.,]\d+)?)\s*(k?hz|sps)?\b", re.IGNORECASE)
_AT = re.compile(r"(\S*)\s+(?:at|@)\s*(\d+(?:[.,]\d+)?\s*(?:k?hz|sps))\b", re.IGNORECASE)
_FILTER = re.compile(r"filter|cut|corner|band|pass|notch", re.IGNORECASE)
"""Words before "at 50 Hz" that make it a property of a filter."""


@dataclass(frozen=True)
class StatedRate:
    """Sample rate by the file, Hz, and where it states it."""

    rate: float
    reason: str


def stated_rate(metadata: Mapping[str, str], before: Sequence[str] = ()) -> StatedRate | None:
    """The sample rate by the file; None where no line states it, or two differ.

    Args:
        metadata: ``key: value`` lines of the file.
        before: lines before the data.
    """
    by_key = _rate_by_key(metadata)
    if by_key is not None:
        return StatedRate(by_key, "the file states the rate")
    found = [
        StatedRate(rate, f"line {number} states 'at {at[2]}'")
        for number, line in enumerate(before, start=1)
        for at in _AT.finditer(line)
        if not _FILTER.search(at[1]) and (rate := _rate_by_key({"rate": at[2]})) is not None
    ]
    return found[0] if len({s.rate for s in found}) == 1 else None


def _rate_by_key(metadata: Mapping[str, str]) -> float | None:
    for key, value in metadata.items():
        found = _NUMBER.match(value.strip())
        in_hertz = found is not None and (found[2] or "hz" in key.lower())
        if _KEYS.search(key) and found is not None and in_hertz:
            thousand = (found[2] or "").lower() == "khz"
            rate = float(found[1].replace(",", ".")) * (1000 if thousand else 1)
            if rate > 0:
                return rate
    return None


RATES = (0.4, 8_000.0)
"""Sample rates that instruments have, Hz."""
_EPOCH = (1.0e9, 2.5e9)  # s, 2001 to 2049
_ORDERED = 0.95  # share of steps forward in a column of times
_FINE_TICK, _FINE_WRAP = 1e-4, 2**32  # s, counts of the Xsens SampleTimeFine


@dataclass(frozen=True)
class TimeGuess:
    """The time of one table.

    Args:
        channel: None where no column has it.
        unit: empty where it is not known.
        tick_s: of a counter whose tick is none of the units.
        wraps_at: counts after which it starts again.
        reason: of the column.
        unit_reason: of the unit.
        doubts: what cannot be known.
        rate: of samples, Hz; None where it is not known.
    """

    channel: Channel | None
    unit: str
    reason: str
    unit_reason: str
    doubts: Sequence[str] = ()
    tick_s: float | None = None
    wraps_at: float | None = None
    rate: float | None = None

    @property
    def spec(self) -> TimeSource:
        """As a mapping states it; seconds where the unit is not known, 1 Hz where no rate is."""
        if self.channel is None:
            return TimeSource(rate_hz=self.rate or 1.0)
        unit = self.unit or ("s" if self.channel.numeric else "dmy")
        return TimeSource.model_validate(
            {
                "column": self.channel.source,
                "unit": unit,
                "tick_s": self.tick_s,
                "wraps_at": self.wraps_at,
            }
        )


TABLE_OF_MEANS = TimeGuess(None, "", "one row a pose: only their order matters", "", rate=1.0)
"""The time of a table of means."""


def find_time(channels: Sequence[Channel], stated: StatedRate | None) -> TimeGuess:
    """The time of the channels of one table.

    Args:
        channels: of the file.
        stated: sample rate by the file; None where it states none.
    """
    dates = [c for c in channels if c.raw.dtype.kind == "M" or _is_stamp(c)]
    if dates:
        return _dated(dates[0])
    numbers = [c for c in channels if c.numeric]
    named = [c for c in numbers if c.meaning.role == "time"]
    steady = "runs forward at nearly equal steps"
    for found in sorted((c for c in named if _runs_forward(c.values, 0.5)), key=_preference):
        return _with_unit(found, f"its name, and it {steady}")
    for found in (c for c in named if _never_decreases(c.values)):
        return _with_unit(found, "its name, and it never decreases")
    for found in numbers:
        if found.meaning.role in ("", "angle") and holds_times(found.raw):
            return _with_unit(found, f"it {steady}")
    ordered = (c for c in numbers if _runs_forward(c.values, _ORDERED))
    counter = next((c for c in ordered if _steps_by_one(c.values)), None)
    also = f"; {counter.name} only counts samples" if counter else ""
    if stated is not None:
        why = f"no column of times{also}; {stated.reason}"
        return TimeGuess(None, "", why, "", rate=stated.rate)
    doubt = f"the sample rate: no column has times{also}"
    return TimeGuess(None, "", "no column of times", "", (doubt,))


def _dated(dates: Channel) -> TimeGuess:
    """The time of a column of dates."""
    order = "iso" if dates.raw.dtype.kind == "M" else order_of_dates(dates.raw)
    stamps = date_stamps(dates.raw, dates.name, order or "dmy").astype(np.int64)
    step = usual_step(stamps.astype(float) - stamps[0])
    reason, rate = "dates with a time of day", 1e9 / step if step else None
    if not order:
        example = str(dates.raw[0]).split()[0]
        doubt = f"the order of day and month in {example}: dmy or mdy, no number is above 12"
        return TimeGuess(dates, "", reason, "", (doubt,), rate=rate)
    why = {"iso": "ISO 8601", "dmy": "the day is first", "mdy": "the month is first"}[order]
    return TimeGuess(dates, order, reason, why, rate=rate)


def usual_step(values: Array) -> float:
    """The usual step of stamps, in their unit, 0 where none is forward: the median of the steps
    forward, or the mean of all where most stamps are those of the row before.

    Args:
        values: stamps, (n,).
    """
    step = np.diff(values)
    if not (onward := step[step > 0]).size:
        return 0.0
    if np.mean(step == 0) > 0.5:
        return float(values[-1] - values[0]) / len(step)
    return float(np.median(onward))


def _preference(channel: Channel) -> int:
    """Stamps of the measurement before those of the log."""
    return 1 if channel.name == "received" else 0


def _is_stamp(channel: Channel) -> bool:
    first = next((t for t in channel.raw[:20] if t), None) if channel.raw.dtype == object else None
    return first is not None and STAMP.fullmatch(str(first).strip()) is not None


def _runs_forward(values: Array, share: float) -> bool:
    """Whether this share of the steps is forward, most of them of nearly the same length."""
    if len(values) < 3 or not np.isfinite(values).all():
        return False
    step = np.diff(values)
    forward = step[step > 0]
    if len(forward) < share * len(step):
        return False
    middle = float(np.median(forward))
    return float(np.mean(np.abs(forward - middle) < 0.75 * middle)) > 0.7


def _never_decreases(values: Array) -> bool:
    """Whether stamps never decrease, and do increase: some may be repeated."""
    if len(values) < 3 or not np.isfinite(values).all():
        return False
    step = np.diff(values)
    return bool(step.min() >= 0 and np.sum(step > 0) >= _STEPS)


_STEPS = 3  # forward: fewer show no clock, only a level that changes


def holds_times(raw: Raw) -> bool:
    """Whether a column runs forward at nearly equal steps, and does not only count.

    Args:
        raw: its values, (n,).
    """
    if raw.dtype.kind not in "if":
        return False
    values = np.asarray(raw, dtype=float)
    return _runs_forward(values, _ORDERED) and not _steps_by_one(values)


def _steps_by_one(values: Array) -> bool:
    step = np.diff(values)
    return bool(np.median(step) == 1 and values[0] == np.round(values[0]) and len(values) > 2)


def _with_unit(channel: Channel, reason: str) -> TimeGuess:
    values = channel.values
    usual = usual_step(values)
    if channel.unit in ("s", "ms", "us", "ns"):
        rate = 1 / (usual * COLUMN_UNITS[channel.unit].factor)
        if RATES[0] <= rate <= RATES[1]:
            why = f"the file states {channel.unit}; {rate:.6g} samples a second"
            return TimeGuess(channel, channel.unit, reason, why, rate=rate)
        doubt = f"the unit of {channel.name}: as {channel.unit}, {rate:.3g} samples a second"
        return TimeGuess(channel, "", reason, "", (doubt,))
    if "sampletimefine" in channel.name.lower():
        why = "SampleTimeFine counts 0.1 ms"
        rate = 1 / (usual * _FINE_TICK)
        return TimeGuess(
            channel, "s", reason, why, tick_s=_FINE_TICK, wraps_at=_FINE_WRAP, rate=rate
        )
    epochs = [
        u
        for u in ("s", "ms", "us", "ns")
        if _EPOCH[0] < values[0] * COLUMN_UNITS[u].factor < _EPOCH[1]
        and RATES[0] <= 1 / (usual * COLUMN_UNITS[u].factor) <= RATES[1]
    ]
    if len(epochs) == 1:
        rate = 1 / (usual * COLUMN_UNITS[epochs[0]].factor)
        why = f"{values[0]:.0f} is a date since 1970 in {epochs[0]}; {rate:.6g} samples a second"
        return TimeGuess(channel, epochs[0], reason, why, rate=rate)
    return _by_rate(channel, usual, reason)


def _by_rate(channel: Channel, usual: float, reason: str) -> TimeGuess:
    """The unit in which the rate is one that instruments have."""
    rates = {u: 1 / (usual * COLUMN_UNITS[u].factor) for u in ("s", "ms", "us", "ns")}
    likely = [u for u, rate in rates.items() if RATES[0] <= rate <= RATES[1]]
    rates_text = ", ".join(f"{rates[u]:.4g} Hz as {u}" for u in likely)
    if len(likely) == 1:
        unit = likely[0]
        why = f"steps of {usual:.6g}: {rates_text}, no rate of an instrument in other units"
        return TimeGuess(channel, unit, reason, why, rate=rates[unit])
    doubt = f"the unit of {channel.name}: steps of {usual:.6g} are {rates_text or 'no usual rate'}"
    return TimeGuess(channel, "", reason, "", (doubt,))
