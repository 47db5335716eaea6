"""Lines that stand out of the noise, at frequencies nobody told us."""

import numpy as np

from tiltcal.diagnosis.account import Account
from tiltcal.diagnosis.evidence import Ledger
from tiltcal.frames import Array

CHANCE = 1e-4  # of a line in any recording without one
MOST = 3


def tones_of(ledger: Ledger, account: Account) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in what is left, the strongest first."""
    found: list[tuple[float, float]] = []
    for channel, residual in zip(ledger.observations.channels, ledger.observations.residuals(account.effects), strict=True):
        found += _lines(channel.time, residual)
    kept: list[float] = []
    for _, frequency in sorted(found, reverse=True):
        if len(kept) < MOST and all(abs(frequency - f) > 0.02 for f in kept):
            kept.append(frequency)
    return tuple(kept)


def echoes_of(ledger: Ledger, account: Account) -> tuple[float, ...]:
    """Frequencies, Hz, of what rings, or beats, anew after each move: lines in the mean over all rests, aligned at their start."""
    observations = ledger.observations
    found: list[tuple[float, float]] = []
    for channel, residual in zip(observations.channels, observations.residuals(account.effects), strict=True):
        rests = [np.flatnonzero(channel.stop == k) for k in range(int(channel.stop.max(initial=-1)) + 1)]
        rests = [rows for rows in rests if len(rows) >= 32]
        if len(rests) < 4:
            continue
        length = int(np.median([len(rows) for rows in rests]))
        whole = [residual[rows[:length]] - residual[rows[:length]].mean() for rows in rests if len(rows) >= length]
        step = float(np.median(np.diff(channel.time)))
        mean = np.mean(whole, axis=0) * np.hanning(length)
        power = np.abs(np.fft.rfft(mean, 4 * length)) ** 2
        frequency = np.fft.rfftfreq(4 * length, step)
        seen = frequency > 1.5 / (length * step)
        floor = float(np.median(power[seen])) / np.log(2)
        k = int(np.argmax(np.where(seen, power, 0.0)))
        if power[k] > floor * np.log(length / CHANCE):
            found.append((float(power[k] / floor), float(frequency[k])))
    kept: list[float] = []
    for _, f in sorted(found, reverse=True):
        if len(kept) < MOST and all(abs(f - other) > 0.03 * f for other in kept):
            kept.append(f)
    return tuple(kept)


def _lines(time: Array, residual: Array) -> list[tuple[float, float]]:
    """(power over its surroundings, frequency) of peaks of the periodogram."""
    n = len(residual)
    if n < 256:
        return []
    window = np.hanning(n)
    spectrum = np.abs(np.fft.rfft((residual - residual.mean()) * window, 2 * n)) ** 2
    rate = (n - 1) / float(time[-1] - time[0])
    frequency = np.fft.rfftfreq(2 * n, 1 / rate)
    width = max(n // 40, 32)
    floor = _running_median(spectrum, width)
    ratio = spectrum / np.maximum(floor, 1e-300) * np.log(2)
    limit = np.log(n / CHANCE)
    peak = (ratio > limit) & (ratio >= np.roll(ratio, 1)) & (ratio >= np.roll(ratio, -1))
    slow = 8 / max(float(time[-1] - time[0]), 1e-9)  # below it a drift looks like a line
    peak &= frequency > slow
    return [(float(ratio[k]), float(frequency[k])) for k in np.flatnonzero(peak)[:40]]


def _running_median(values: Array, width: int) -> Array:
    """Median over blocks, interpolated, (n,)."""
    count = max(len(values) // width, 1)
    blocks = np.array_split(values, count)
    centres = np.cumsum([len(b) for b in blocks]) - np.array([len(b) for b in blocks]) / 2
    return np.interp(np.arange(len(values)), centres, [float(np.median(b)) for b in blocks])
