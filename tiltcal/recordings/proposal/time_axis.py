"""Which column has the time, in which unit, and the sample rate that the lines before the data
state.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import COLUMN_UNITS
from tiltcal.recordings.formats.cells import STAMP, iso_stamps
from tiltcal.recordings.proposal.channels import Channel

_KEYS = re.compile(r"rate|freq|sampling|采样", re.IGNORECASE)
_NUMBER = re.compile(r"(\d+(?:[.,]\d+)?)\s*(k?hz|sps)?\b", re.IGNORECASE)


def stated_rate(metadata: Mapping[str, str]) -> float | None:
    """Samples a second; None where no line states them.

    Args:
        metadata: ``key: value`` lines of the file.
    """
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


def find_time(channels: Sequence[Channel], stated_rate: float | None) -> TimeGuess:
    """The time of the channels of one table.

    Args:
        channels: of the file.
        stated_rate: of samples, by the file, Hz; None where it states none.
    """
    dates = [c for c in channels if c.raw.dtype.kind == "M" or _is_stamp(c)]
    if dates:
        return TimeGuess(
            dates[0], "iso", "dates with a time of day", "ISO 8601", rate=_rate_of(dates[0])
        )
    numbers = [c for c in channels if c.numeric]
    ordered = [c for c in numbers if _runs_forward(c.values, _ORDERED)]
    named = [c for c in numbers if c.meaning.role == "time" and _runs_forward(c.values, 0.5)]
    unnamed = [
        c for c in ordered if c.meaning.role in ("", "angle") and not _steps_by_one(c.values)
    ]
    for found in sorted(named, key=_preference) or unnamed[:1]:
        prefix = "its name, and it " if found in named else "it "
        return _with_unit(found, prefix + "runs forward at nearly equal steps")
    counter = next((c for c in ordered if _steps_by_one(c.values)), None)
    also = f"; {counter.name} only counts samples" if counter else ""
    if stated_rate:
        return TimeGuess(
            None, "", f"no column of times{also}; the file states the rate", "", rate=stated_rate
        )
    doubt = f"the sample rate: no column has times{also}"
    return TimeGuess(None, "", "no column of times", "", (doubt,))


def _rate_of(dates: Channel) -> float | None:
    """Samples a second of dates."""
    step = np.diff(iso_stamps(dates.raw, dates.name).astype(np.int64))
    onward = step[step > 0]
    return 1e9 / float(np.median(onward)) if len(onward) else None


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


def _steps_by_one(values: Array) -> bool:
    step = np.diff(values)
    return bool(np.median(step) == 1 and values[0] == np.round(values[0]) and len(values) > 2)


def _with_unit(channel: Channel, reason: str) -> TimeGuess:
    values = channel.values
    step = np.diff(values)
    usual = float(np.median(step[step > 0]))
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
