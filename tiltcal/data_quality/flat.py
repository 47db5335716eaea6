"""Checks of readings that repeat: frozen, clipped, sent twice, or of coarse codes."""

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.data_quality.check import Check, Emptying, Finding
from tiltcal.data_quality.log import CHANCE, FINE, FLAT, LEAST, Channel, Log, repeat_chance, runs_of

SHORTEST = 5  # repeats that are ever called frozen
RARE = 1e-3  # chance of a repeat: a count says no less
OFTEN = 0.95  # chance of a repeat above which repeats say nothing
AT_END = 0.999  # of the stated range
PILED = 6  # readings at an extreme that make it an end of the range
SHARE = 0.3  # of the readings within four sigmas below it: of normal noise one in thousands
NEAR = 4.0  # sigmas
RUN = 3  # readings at the end in succession
AWAY = 20.0  # sigmas of the extreme from zero: noise at rest has its own extremes
RAREST = 5e-4  # a share of repeats that is looked into
COUNTED = 64  # readings that a share is taken from


class Coarse(Check):
    """An LSB that is not small beside the noise."""

    name = "coarse"
    test = "fine LSB"
    answer = "note"
    looks_at = "readings"
    finds = "an LSB of 1.5 times the noise at rest"

    def _find(self, log: Log) -> Iterator[Finding]:
        for channels in log.sensors.values():
            found = [c for c in channels if not c.is_constant and c.is_coarse]
            if not found:
                continue
            few = [c for c in channels if c not in found and len(np.unique(c.sample)) < 3]
            worst = max(found, key=lambda c: c.spread_at_rest)
            lsb = float(worst.lsb or 0.0)
            columns = tuple(c.name for c in [*found, *few])
            words = (
                f"{', '.join(columns)}: quantised in steps of {lsb:.4g}, not small compared with"
                " the noise"
            )
            size, sigma = {"lsb": lsb}, {"lsb": 1e-3 * lsb}
            yield self.finding(columns, worst.rows, words, size=size, sigma=sigma)


class Frozen(Emptying):
    """A channel that repeats one value for longer than chance and its codes allow."""

    name = "frozen"
    test = "not frozen"
    repair = "empty_frozen"
    looks_at = "readings, temperature"
    finds = "a run of equal readings of probability 1e-6, by how often the others repeat"

    def _find(self, log: Log) -> Iterator[Finding]:
        every = [[c] for c in log.channels.values() if c.channel == "temperature"]
        for c in _with_noise([*log.sensors.values(), *every]):
            if long := _frozen_runs(c):
                yield self.frozen(c, log.time, long)

    def frozen(self, c: Channel, time: Array, long: Sequence[tuple[int, int]]) -> Finding:
        """A finding of runs of readings, first and last exclusive. time: of the rows, s, (n,)."""
        a, b = max(long, key=lambda run: run[1] - run[0])
        rows = np.concatenate([c.rows[i + 1 : j] for i, j in long])
        start, end = time[c.rows[a]], time[c.rows[b - 1]]
        words = f"{c.name}: frozen at {c.read[a]:.6g} from {start:.6g} to {end:.6g} s"
        if len(long) > 1:
            words += f", the longest of {len(long)} stretches"
        size = {"start": float(start), "length": float(end - start)}
        return self.finding((c.name,), rows, words, size=size)


def standing_still(c: Channel, time: Array) -> Finding | None:
    """A channel with noise or without that repeats one value where its others hardly repeat; None
    where it does not. time: of the rows, s, (n,).
    """
    long = _frozen_runs(c)
    return Frozen().frozen(c, time, long) if long else None


def _with_noise(sensors: Sequence[Sequence[Channel]]) -> Iterator[Channel]:
    """Channels of sensors that have noise at standstill: where none of a sensor's channels has, the
    readings are computed, and repeats say nothing.
    """
    for channels in sensors:
        live = [c for c in channels if len(c.read) >= LEAST and not c.is_constant]
        if any(c.has_noise for c in live):
            yield from (c for c in live if not c.is_coarse)


def _frozen_runs(c: Channel) -> list[tuple[int, int]]:
    """First reading and that after the last of runs that are too long, not at an extreme; how often
    readings repeat by chance is taken from those outside the longest run.
    """
    again = c.repeats
    if len(again) < SHORTEST or not _in_succession(again, SHORTEST).any():
        return []
    first, last = runs_of(again)
    length = last - first
    k = int(np.argmax(length))
    others = np.concatenate([c.read[: first[k]], c.read[last[k] + 1 :]])
    if len(others) < LEAST:
        return []
    usual = float(length.sum() - length[k]) / len(others)
    p = max(repeat_chance(others[: len(c.sample)]), usual, RARE)
    if p > OFTEN:
        return []
    least = max(SHORTEST, int(np.ceil(np.log(CHANCE / len(c.read)) / np.log(p))))
    ends = (float(c.read.min()), float(c.read.max()))
    long = np.flatnonzero(length >= least)
    return [(int(first[k]), int(last[k]) + 1) for k in long if c.read[first[k]] not in ends]


def _in_succession(mask: Mask, number: int) -> Mask:
    """Where so many in succession are true, (m - number + 1,)."""
    parts = (mask[k : len(mask) - number + 1 + k] for k in range(number))
    return np.asarray(reduce(np.logical_and, parts))


class Clipped(Emptying):
    """A channel whose noise ends at its largest or smallest value."""

    name = "clipped"
    test = "not saturated"
    answer = "refused"
    repair = "empty_clipped"
    looks_at = "readings"
    finds = "six readings at an extreme, three in succession, 30 % of those within four sigmas"

    def _find(self, log: Log) -> Iterator[Finding]:
        for c in log.readings:
            flat = len(c.read) > LEAST and c.repeats.any() and not c.is_constant
            if not flat or not c.has_noise:
                continue
            limits, noise = _limits_of(c)
            if not limits:
                continue
            # half of the noise of what lies just below is cut off as well
            near = np.any([sign * c.read > top - NEAR * noise for sign, top, _ in limits], axis=0)
            number = sum(int(there.sum()) for *_, there in limits)
            sign, top, _ = min(limits, key=lambda limit: limit[1])
            words = (
                f"{c.name}: saturated at {sign * top:.6g}, or frozen at its extreme, in {number} of"
                f" {len(c.read)} rows ({number / len(c.read):.2g})"
            )
            size = {"full_scale": sign * top}
            sigma = {"full_scale": float(noise / np.sqrt(near.sum()))}
            yield self.finding((c.name,), c.rows[near], words, size=size, sigma=sigma)


def _limits_of(c: Channel) -> tuple[list[tuple[float, float, Mask]], float]:
    """(sign, limit, readings) of each end at which readings lie without noise, and the noise."""
    ends = (float(c.read.min()), float(c.read.max()))
    if max(np.count_nonzero(c.read == end) for end in ends) < PILED:
        return [], 0.0
    free = c.read[(c.read > ends[0]) & (c.read < ends[1])]
    if len(free) < LEAST or repeat_chance(free[: len(c.sample)]) > FLAT:
        return [], 0.0
    noise = max(Channel("", free).noise, (c.lsb or 0.0) / np.sqrt(12), 1e-15)
    limits = []
    for sign in (1.0, -1.0):
        top = float((sign * c.read).max())
        there = np.asarray(sign * c.read == top)
        near = sign * c.read > top - NEAR * noise
        stated = c.limit is not None and abs(top) >= AT_END * c.limit
        piled = there.sum() > SHARE * near.sum() and abs(top) > AWAY * noise
        if there.sum() >= PILED and (piled or stated) and _in_runs(there):
            limits.append((sign, top, there))
    return limits, noise


def _in_runs(mask: Mask) -> bool:
    first, last = runs_of(mask)
    return bool(len(first) and (last - first).max() >= RUN)


class SentTwice(Emptying):
    """Samples that repeat the one before more often than their codes explain: on one axis, or on
    all axes at once, which chance seldom does.
    """

    name = "repeated"
    test = "each sample is new"
    answer = "note"
    repair = "empty_repeated"
    looks_at = "readings of a sensor"
    finds = "one sample in a thousand where the codes are fine"

    def _find(self, log: Log) -> Iterator[Finding]:
        for name, every in log.sensors.items():
            channels = [c for c in every if len(c.read) >= LEAST and not c.is_coarse]
            channels = [c for c in channels if not c.is_constant]
            expected = {c.name: min(c.repeat_chance, 1.0) for c in channels}
            hit = [c for c in channels if _too_often(c.repeats, expected[c.name])]
            if not hit and (rows := _repeated_on_all(channels, expected)) is not None:
                hit, expected = channels, dict.fromkeys(expected, 0.0)
            elif hit:
                rows = reduce(np.union1d, (c.rows[1:][c.repeats] for c in hit))
            else:
                continue
            again = {c.name: np.isin(c.rows, rows) & _repeating(c) for c in hit}
            share = float(np.mean([again[c.name].mean() - expected[c.name] for c in hit]))
            number = sum(len(again[c.name]) for c in hit) / len(hit)
            columns = tuple(c.name for c in hit)
            words = (
                f"{', '.join(columns)}: {100 * share:.3g} % of the samples of {name} repeat the one"
                " before exactly"
            )
            yield self.finding(
                columns,
                rows,
                words,
                size={"share": share},
                sigma={"share": float(np.sqrt(share / number))},
            )

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        """Empty on each axis the samples that repeat on that axis."""
        rows = {
            name: np.intersect1d(f.rows, c.rows[1:][c.repeats])
            for f in findings
            for name in f.columns
            for c in [log.channels[name]]
        }
        done = [f"{len(r)} values of {name} emptied" for name, r in rows.items()]
        return log.emptied(rows), ", ".join(done)


def _repeating(c: Channel) -> Mask:
    """Whether a reading repeats the one before, (m,)."""
    return np.concatenate([[False], c.repeats])


def _too_often(again: Mask, chance: float) -> bool:
    """Whether more samples repeat than by chance."""
    n, p = len(again), min(1.5 * chance, 1.0)
    often = n > COUNTED and again.mean() > p + RAREST
    return bool(often) and at_least(int(again.sum()), n, p) < CHANCE


def _repeated_on_all(channels: Sequence[Channel], expected: dict[str, float]) -> Index | None:
    """Rows that repeat the one before on all axes at once, (m,), where they are more than by
    chance; None where not, or where the codes are coarse.

    Noise may be correlated between the axes: the chance is how often a row is that two before. Of
    coarse codes it says too little where noise is correlated in time as well.
    """
    if len(channels) < 2 or max(expected.values()) > FINE:
        return None
    if not all(c.repeats.any() for c in channels):
        return None
    complete = all(len(c.read) == len(c.values) for c in channels)
    together = (c.repeats for c in channels)
    if complete and np.mean(reduce(np.logical_and, together)) <= RAREST:
        return None
    rows = np.flatnonzero(reduce(np.logical_and, (np.isfinite(c.values) for c in channels)))
    values = np.column_stack([c.values[rows] for c in channels])
    again, later = (np.all(values[k:] == values[:-k], axis=1) for k in (1, 2))
    chance = max(float(np.prod(list(expected.values()))), float(later.mean()))
    return rows[1:][again] if _too_often(again, chance) else None


def at_least(k: int, n: int, p: float) -> float:
    """Chance of k or more of n when each has the chance p."""
    from scipy.special import betainc

    return float(betainc(k, n - k + 1, p)) if k > 0 else 1.0
