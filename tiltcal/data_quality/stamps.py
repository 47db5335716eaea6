"""Checks of the time stamps."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.data_quality.check import Check, Finding, in_rows
from tiltcal.data_quality.log import LEAST, Log

STAMPS = ("time_s",)
GAP = 2.5  # usual steps: one missing sample makes two, and jitter of a quarter stays below it
EVEN = 0.05  # of a unit: stamps that are whole units of it, and their share, are off by less
CLOCK = 0.05  # of the rate: no clock of an instrument is off by as much, a wrong setting by more
HELD = 3.0  # rows a stamp, at least, of stamps that are too coarse for their rows
BURST = 4.0  # usual steps in a mean one, at least, where rows arrive in bursts


class Wraps(Check):
    """A counter of the time that starts again from its lowest value."""

    name = "time_wrap"
    test = "stamps go on"
    answer = "refused"
    repair = "unwrap_time"
    looks_at = "stamps"
    finds = "a fall from the highest to the lowest twentieth of the range of the stamps"

    def _find(self, log: Log) -> Iterator[Finding]:
        wraps = wrap_mask(log.time)
        if wraps.any():
            yield _at_steps(self, log, wraps, "a counter starts again from its lowest value")

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        del findings
        wraps = wrap_mask(log.time)
        period = _period(log.time, wraps) if log.period is None else log.period
        turns = np.concatenate([[0], np.cumsum(wraps)])
        done = f"{wraps.sum()} wraps of {period:.9g} s undone"
        return replace(log, time=log.time + period * turns), done


def wrap_mask(time: Array) -> Mask:
    """Steps at which a counter falls from near its highest to near its lowest value, (n - 1,).
    time: in the unit of the counter.
    """
    if len(time) < 2 or not (step := np.diff(time)).min() < 0:
        return np.zeros(max(len(time) - 1, 0), dtype=bool)
    low, high = float(np.min(time)), float(np.max(time))
    span = high - low
    falls = (step < -span / 2) & (time[:-1] > high - span / 20) & (time[1:] < low + span / 20)
    return np.asarray(falls, dtype=bool)


def _period(time: Array, wraps: Mask) -> float:
    """What the time falls by, s, with the usual step."""
    step = np.diff(time)
    usual = float(np.median(step[step > 0]))
    periods = usual - step[wraps]
    if np.ptp(periods) > usual:
        raise TiltcalError(
            "repair unwrap_time",
            found=f"falls by {periods.min():.9g} to {periods.max():.9g} s",
            need="one period of the counter",
            do="split the file where time goes back",
        )
    return float(np.median(periods))


class GoesBack(Check):
    """Stamps that decrease."""

    name = "time_back"
    test = "stamps in order"
    answer = "refused"
    repair = "sort_time"
    looks_at = "stamps"
    finds = "one step back"

    def _find(self, log: Log) -> Iterator[Finding]:
        back = (np.diff(log.time) < 0) & ~wrap_mask(log.time)
        if back.any():
            yield _at_steps(self, log, back, "time goes back")

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        del findings
        order = np.argsort(log.time, kind="stable")
        moved = int(np.sum(order != np.arange(len(order))))
        return log.taken(order), f"{moved} rows moved"


class TooCoarse(Check):
    """Stamps of whole units, with many rows each: a date in whole seconds."""

    name = "time_coarse"
    test = "stamps of each row"
    answer = "refused"
    repair = "spread_time"
    looks_at = "stamps"
    finds = "three rows a stamp"

    def _find(self, log: Log) -> Iterator[Finding]:
        step = np.diff(log.time)
        new = np.flatnonzero(step > 0)
        if len(new) < 3 or not _is_held(log.time):
            return
        unit = float(np.median(step[new]))
        held = float(np.median(np.diff(new)))
        whole = np.abs(step[new] / unit - np.rint(step[new] / unit)) < EVEN
        if held >= HELD and whole.mean() > 1 - EVEN:
            words = (
                f"time_s: stamps of {unit:.6g} s, {held:g} rows each; rows at even times between"
                f" them are {held / unit:.6g} Hz"
            )
            repeated = np.flatnonzero(step == 0) + 1
            yield self.finding(STAMPS, repeated, words, size={"unit": unit, "held": held})

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        new = np.flatnonzero(np.diff(log.time) > 0) + 1
        first = np.concatenate([[0], new])
        number = np.diff(np.append(first, len(log.time)))
        begin = log.time[first]
        length = np.append(np.diff(begin), findings[0].size["unit"])
        held = findings[0].size["held"]
        # the first and the last stamp hold a part of their rows
        part = np.repeat(length / np.maximum(number, held), number)
        within = np.arange(len(log.time)) - np.repeat(first, number)
        within[: number[0]] += max(int(held) - int(number[0]), 0)
        time = np.repeat(begin, number) + part * within
        return replace(log, time=time), f"rows spread evenly over {length[0]:.6g} s"


def _is_held(time: Array) -> bool:
    """Whether most stamps are those of the row before."""
    return len(time) > LEAST and float(np.mean(np.diff(time) == 0)) >= 1 - 1 / (HELD - 1)


class Repeats(Check):
    """Stamps that occur twice."""

    name = "time_repeated"
    test = "stamps increase"
    answer = "refused"
    repair = "drop_repeated_time"
    looks_at = "stamps"
    finds = "one repeated stamp"

    def _find(self, log: Log) -> Iterator[Finding]:
        again = np.diff(log.time) == 0
        if again.any() and not TooCoarse().find(log):  # to drop these would drop most rows
            yield _at_steps(self, log, again, "a stamp is repeated")

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        del findings
        kept = np.concatenate([[True], np.diff(log.time) != 0])
        done = f"{int(np.sum(~kept))} rows left out, the first of each stamp kept"
        return log.taken(np.flatnonzero(kept)), done


class Gaps(Check):
    """Steps that are longer than usual: samples are missing."""

    name = "gap"
    test = "stamps without gaps"
    answer = "note"
    looks_at = "stamps in order"
    finds = "two missing samples of a regular clock"

    def _find(self, log: Log) -> Iterator[Finding]:
        order, step = _in_order(log.time)
        if not (onward := step[step > 0]).size:
            return
        usual = float(np.median(onward))
        if usual * BURST < float(np.mean(onward)):  # another check says so
            return
        gaps = step > GAP * usual
        if gaps.any():
            lost = int(np.sum(np.round(step[gaps] / usual) - 1))
            words = f"a gap; about {lost} samples are missing at {usual:.6g} s a sample"
            rows = np.sort(order[1:][gaps])
            yield self.finding(STAMPS, rows, f"time_s: {words}, {in_rows(rows)}")


class Bursts(Check):
    """Rows that arrive in bursts: stamps of reception, not of sampling."""

    name = "time_bursts"
    test = "stamps of sampling"
    answer = "note"
    looks_at = "stamps in order"
    finds = "bursts in which the stamps run four times too fast"

    def _find(self, log: Log) -> Iterator[Finding]:
        order, step = _in_order(log.time)
        if len(step) < LEAST or not (onward := step[step > 0]).size:
            return
        usual, mean = float(np.median(onward)), float(np.mean(onward))
        ends = np.flatnonzero(step > mean)
        if usual * BURST >= mean or len(ends) < LEAST // 2:
            return
        rows = float(np.median(np.diff(ends)))
        # a gap or two make no bursts: these recur
        if rows < 2 or np.mean(np.abs(np.diff(ends) - rows) <= max(1.0, rows / 4)) < 0.5:
            return
        words = (
            f"time_s: rows arrive in bursts of about {rows:g}: the stamps are of reception; the"
            f" mean rate is {1 / mean:.6g} Hz"
        )
        yield self.finding(STAMPS, np.sort(order[1:][ends]), words)


class Rate(Check):
    """Stamps that run faster or slower than the stated sample rate."""

    name = "rate"
    test = "rate as stated"
    answer = "note"
    looks_at = "stamps of readings whose rate is stated"
    finds = "a rate 5 % off the stated one"

    def _find(self, log: Log) -> Iterator[Finding]:
        for name, channels in log.sensors.items():
            stated, rows = channels[0].rate_hz, channels[0].rows
            step = float(np.median(np.diff(log.time[rows]))) if len(rows) > LEAST else 0.0
            if stated is None or step <= 0 or abs(1 / step / stated - 1) < CLOCK:
                continue
            words = f"{name}: {1 / step:.6g} Hz by the stamps, {stated:g} Hz stated"
            columns = tuple(c.name for c in channels)
            yield self.finding(columns, rows[:1], words)


def _in_order(time: Array) -> tuple[Index, Array]:
    """Rows in the order of their stamps, (n,), and the steps between them, s, (n - 1,)."""
    if len(time) < 2 or np.diff(time).min() >= 0:
        return np.arange(len(time)), np.diff(time)
    order = np.argsort(time, kind="stable")
    return order, np.diff(time[order])


def faults_of_order(time: Array, before: int = 0, last: float = -np.inf) -> list[Finding]:
    """What makes stamps not increase.

    Args:
        time: s, (n,).
        before: rows of the log before these.
        last: the stamp of the last of them, s.
    """
    if before:
        time, before = np.append(last, time), before - 1
    if np.all(np.diff(time) > 0):
        return []
    log = Log(time, {}, before=before)
    return [f for check in (Wraps(), GoesBack(), TooCoarse(), Repeats()) for f in check.find(log)]


def _at_steps(check: Check, log: Log, steps: Mask, words: str) -> Finding:
    """A finding at the rows after these steps, (n - 1,)."""
    rows = np.flatnonzero(steps) + 1 + log.before
    return check.finding(STAMPS, rows, f"time_s: {words}, {in_rows(rows)}")
