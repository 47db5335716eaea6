"""Frozen, repeated and clipped values, and bits that are never set. They are found before any fit,
because they spoil every fit; each is reported, and its samples become missing.
"""

from collections.abc import Sequence
from functools import reduce

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.quantisation import lsb_width
from tiltcal.diagnosis.data.channels import (
    CHANCE,
    FLAT,
    at_least,
    changed,
    column_values,
    repeat_chance,
    runs_of,
    written,
)
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.data_quality.stuck_bit import stuck_bit
from tiltcal.effects.data.faults import DataDuplicate, DataStuck
from tiltcal.effects.electronics.converter import AdcStuckBit
from tiltcal.effects.sensor.dynamics import AccSaturation, GyrSaturation
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.dwell_noise import second_difference_noise


def stuck_values(
    recording: Recording, sensor: Sensor, fine: Sequence[str]
) -> tuple[Recording, list[Fault]]:
    """A channel that repeats one value for longer than chance and its codes allow."""
    found = []
    for axis in fine:
        rows, time, values = column_values(recording, sensor, axis)
        if len(values) < MIN_SAMPLES:
            continue
        first, last = runs_of(np.diff(values) == 0)
        runs = np.sort(last - first)
        # how often it repeats outside the longest run
        usual = runs[:-1].sum() / max(len(values) - runs[-1:].sum(), 1)
        p = max(repeat_chance(values), float(usual))
        least = max(5, int(np.ceil(np.log(CHANCE / len(values)) / np.log(np.clip(p, 1e-3, 0.95)))))
        long = [
            (a, b + 1)
            for a, b in zip(first, last, strict=True)
            if b - a >= least and not _at_end(values, values[a])
        ]
        if np.ptp(values) == 0 and any(
            _is_noisy(recording, sensor, other) for other in fine if other != axis
        ):
            long = [(0, len(values))]
        if not long:
            continue
        a, b = max(long, key=lambda run: run[1] - run[0])
        start, length = float(time[a] - recording.time[0]), float(time[b - 1] - time[a])
        effect = DataStuck(
            {"start": start, "length": length},
            sensor.name,
            axis,
            "found",
            seen_in=recording.fingerprint,
        )
        mask = np.zeros(len(values), bool)
        for run in long:
            mask[run[0] + 1 : run[1]] = True
        recording = changed(recording, sensor, axis, rows[mask], np.nan)
        words = (
            f"{sensor.name} {axis} is frozen at one value from {start:.2f} s for {length:.2f} s."
        )
        found.append(Fault(effect, (sensor.name,), (axis,), words, (start, start + length)))
    return recording, found


MIN_SAMPLES = 32  # samples that repeats are told from
FINE = 0.1
"""Chance of a repeat on one axis up to which codes are fine: a third of the noise."""


def _is_noisy(recording: Recording, sensor: Sensor, axis: str) -> bool:
    """Whether a channel varies by more than its codes: one that never does is dead beside it."""
    _, _, values = column_values(recording, sensor, axis)
    return len(values) > 2 and float(np.ptp(values)) > 0 and repeat_chance(values) < FINE


def _at_end(values: Array, value: float) -> bool:
    """Whether a value is the largest or smallest of all: clipping, not freezing."""
    return bool(value in (values.max(), values.min()))


def lacking_bits(recording: Recording, sensor: Sensor, fine: Sequence[str]) -> list[Fault]:
    """Channels of a sensor with a bit that is never set, whatever zero and unit the file has."""
    found = []
    for axis in fine:
        rows, _, values = column_values(recording, sensor, axis)
        if repeat_chance(values) > FLAT:
            continue
        codes = written(recording, sensor, axis)[rows]
        if (bit := stuck_bit(codes)) is None:
            continue
        span = float(np.ptp(values))
        bit *= span / float(np.ptp(codes))
        effect = AdcStuckBit({"bit_value": bit}, sensor.name, axis, "found")
        words = (
            f"In {sensor.name} {axis} the bit worth {bit:.4g} (SI) is never set: half of all values"
            " are missing."
        )
        found.append(
            Fault(effect, (sensor.name,), (axis,), words, sigma={"bit_value": bit**2 / span})
        )
    return found


def clipped_values(
    recording: Recording, sensor: Sensor, fine: Sequence[str]
) -> tuple[Recording, list[Fault]]:
    """A channel whose noise ends at its largest or smallest value."""
    found = []
    cls = AccSaturation if sensor.is_accelerometer else GyrSaturation
    for axis in fine:
        rows, _, values = column_values(recording, sensor, axis)
        # most of a recording may be clipped
        free = values[(values > values.min()) & (values < values.max())]
        if len(free) < 32 or repeat_chance(free) > FLAT:
            continue
        noise = noise_of(free)
        limits = _limits_of(values, noise)
        if not limits:
            continue
        full_scale = min(top for _, top, _ in limits)
        # half of the noise of what lies just below is cut off as well
        mask = np.any([sign * values > top - 4 * noise for sign, top, _ in limits], axis=0)
        effect = cls({"full_scale": full_scale}, sensor.name, axis, "found")
        recording = changed(recording, sensor, axis, rows[mask], np.nan)
        flat = sum(int(t.sum()) for *_, t in limits)
        words = (
            f"{sensor.name} {axis} is clipped at {full_scale:.6g} (SI): {flat} samples without"
            " noise."
        )
        sigma = {"full_scale": noise / np.sqrt(mask.sum())}
        found.append(Fault(effect, (sensor.name,), (axis,), words, sigma=sigma))
    return recording, found


def _limits_of(values: Array, noise: float) -> list[tuple[float, float, Mask]]:
    """(sign, limit, rows) of each end at which values lie without noise."""
    limits = []
    for sign in (1.0, -1.0):
        top = float((sign * values).max())
        there = sign * values >= top - 1e-9 * max(abs(top), 1e-9)
        near = sign * values > top - 4 * noise
        many = there.sum() >= 6 and there.sum() > 0.3 * near.sum()
        if top > 20 * noise and many and _in_runs(there):
            limits.append((sign, top, there))
    return limits


def _in_runs(mask: Mask) -> bool:
    first, last = runs_of(mask)
    return bool(len(first) and (last - first).max() >= 3)


def noise_of(values: Array) -> float:
    """White noise of a column from its second differences, one code at least. values: (n,)."""
    code = lsb_width(values) / np.sqrt(12)
    return float(max(second_difference_noise(values), code, 1e-15))


def _too_often(again: Mask, chance: float) -> bool:
    """Whether more samples repeat than by chance."""
    n, p = len(again), min(1.5 * chance, 1.0)
    return n > 64 and at_least(int(again.sum()), n, p) < CHANCE and again.mean() > p + 5e-4


def _repeated_on_all(
    columns: Sequence[tuple[str, Index, Array]], expected: Sequence[float]
) -> Index | None:
    """Rows that repeat the one before on all axes at once, (m,), where they are more than by
    chance; None where not, or where the codes are coarse.

    Noise may be correlated between the axes: the chance is how often a row is that two before. Of
    coarse codes it says too little where noise is correlated in time as well.
    """
    if len(columns) < 2 or max(expected) > FINE:
        return None
    rows = reduce(np.intersect1d, (own for _, own, _ in columns))
    values = np.column_stack([v[np.searchsorted(own, rows)] for _, own, v in columns])
    again, later = (np.all(values[k:] == values[:-k], axis=1) for k in (1, 2))
    chance = max(float(np.prod(expected)), float(later.mean()))
    return rows[1:][again] if _too_often(again, chance) else None


def repeated_samples(
    recording: Recording, sensor: Sensor, fine: Sequence[str]
) -> tuple[Recording, list[Fault]]:
    """Samples that repeat the one before more often than their codes explain: on one axis, or on
    all axes at once, which chance seldom does.
    """
    again, expected, columns = [], [], []
    for axis in fine:
        rows, _, values = column_values(recording, sensor, axis)
        if len(values) < MIN_SAMPLES:
            continue
        columns.append((axis, rows, values))
        again.append(np.concatenate([[False], np.diff(values) == 0]))
        expected.append(min(repeat_chance(values), 1.0))
    hit = [k for k, (a, p) in enumerate(zip(again, expected, strict=True)) if _too_often(a, p)]
    if not hit and (whole := _repeated_on_all(columns, expected)) is not None:
        hit, expected = list(range(len(columns))), [0.0] * len(columns)
        again = [np.isin(rows, whole) for _, rows, _ in columns]
    if not hit:
        return recording, []
    share = float(np.mean([again[k].mean() - expected[k] for k in hit]))
    for k in hit:
        axis, rows, _ = columns[k]
        recording = changed(recording, sensor, axis, rows[again[k]], np.nan)
    axes = tuple(columns[k][0] for k in hit)
    n = sum(len(again[k]) for k in hit) / len(hit)
    effect = DataDuplicate({"share": share}, sensor.name, None, "found")
    words = (
        f"{100 * share:.2g} % of the samples of {sensor.name} {', '.join(axes)} repeat the one"
        " before exactly."
    )
    return recording, [
        Fault(effect, (sensor.name,), axes, words, sigma={"share": float(np.sqrt(share / n))})
    ]
