"""Spectral lines in the residual, at unknown frequencies in time.

Lines over time in a coefficient: the delay of stamps, the tilts of the base, scale factors.

What such a line does to a reading is a cosine times what one of the coefficient does there, which
changes with pose and motion: in the reading itself it is many lines.

A peak is a line that stands out of its spectrum: of a whitened residual in time, behind a limiter,
and the noise about each of its rows. Gross values and bursts of noise pass for no signal.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.coordinate_ranges import fastest
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.diagnosis.hypotheses.curves import frames, gains, stamped
from tiltcal.diagnosis.lines.lines_over_angles import CHANCE, FINER, MOST, ripples_of, waves_of
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.electronics.mains import WANDER
from tiltcal.effects.learned import LearnedDelay, LearnedReading, LearnedTilt
from tiltcal.effects.spans import SpectralLines
from tiltcal.statistics.cosine_transform import inverse_cosines
from tiltcal.statistics.dwell_noise import robust_white

SLOWEST = 4  # periods of a recording: below it a drift looks like a line
PEAKS = 40  # of a channel, the strongest


def evenly(time: Array, values: Array) -> tuple[Array, float]:
    """The values on an even grid, nothing where a row was lost, (m,), and its rate, Hz: a lost row
    shifts the phase of the rest.
    """
    step = float(np.median(np.diff(time)))
    place = np.rint((time - time[0]) / step).astype(np.intp)
    if place[-1] > 2 * len(time):  # long gaps, or stamps of no rate
        return values, (len(values) - 1) / float(time[-1] - time[0])
    even = np.zeros(int(place[-1]) + 1)
    even[place] = values
    return even, float(place[-1]) / float(time[-1] - time[0])


def running_median(values: Array, width: int) -> Array:
    """Median over blocks, interpolated, (n,)."""
    count = max(len(values) // width, 1)
    blocks = np.array_split(values, count)
    centres = np.cumsum([len(b) for b in blocks]) - np.array([len(b) for b in blocks]) / 2
    return np.interp(np.arange(len(values)), centres, [float(np.median(b)) for b in blocks])


def peaks(
    time: Array, strength: Array, frequency: Array, limit: float
) -> list[tuple[float, float]]:
    """(strength, frequency) of the strongest peaks of a spectrum above a limit, but for those of
    too few periods in these stamps, s.
    """
    left, right = np.roll(strength, 1), np.roll(strength, -1)
    peak = (strength > limit) & (strength >= left) & (strength >= right)
    peak &= frequency > SLOWEST / max(float(time[-1] - time[0]), 1e-9)
    found = [(float(strength[k]), float(frequency[k])) for k in np.flatnonzero(peak)]
    return sorted(found, reverse=True)[:PEAKS]


def apart(
    found: Sequence[tuple[float, float]], width: Callable[[float], float]
) -> tuple[float, ...]:
    """The strongest of (power, frequency) that are further apart than the width of a line, Hz."""
    kept: list[float] = []
    for _, f in sorted(found, reverse=True):
        if len(kept) < MOST and all(abs(f - other) > width(f) for other in kept):
            kept.append(f)
    return tuple(kept)


FAR = 4.0  # sigma: a reading that is farther off counts as that
AROUND = 64  # rows at least that tell the noise about one


def limited(residual: Array) -> Array:
    """A residual in time. residual: cosine coefficients in units of the noise, (n,)."""
    return np.clip(inverse_cosines(residual), -FAR, FAR)


def noise_about(left: Array, width: int = AROUND) -> Array:
    """Variance of the noise about each row, at least that of all rows, (n,).

    Args:
        left: residual in time, in units of the noise, (n,).
        width: rows that tell it, where they are more than ``AROUND``.
    """
    from scipy.ndimage import uniform_filter1d

    white = np.diff(left, 2) ** 2 / 6
    near = uniform_filter1d(np.pad(white, 1, mode="edge"), max(width, AROUND))
    return np.asarray(np.maximum(near, 1.0))


ALWAYS = (0.0, 1.0)  # knots of what is constant


def late_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in the delay of stamps, strongest first: of a buffer that fills and
    is emptied, of packets with a wrong interval.
    """
    scenario = observations.scenario
    sensors = sorted({c.sensor for c in observations.channels})
    delays = (curve_over(LearnedDelay, "time", ALWAYS, **w) for w in stamped(scenario, sensors))
    return _lines_of((d.effect for d in delays), observations, fitted)


def base_tilts_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in the tilts of the base, strongest first: of a bearing whose air
    is refilled, of a building.
    """
    places = frames(observations.scenario, "base")
    tilts = (curve_over(LearnedTilt, "time", ALWAYS, **where) for where in places)
    return _lines_of((t.effect for t in tilts), observations, fitted)


def scales_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in the scale factors of channels, strongest first: of a reference
    that is switched, of a counter that reads every n-th sample short.
    """
    sensors = sorted({c.sensor for c in observations.channels})
    constants = (
        curve_over(LearnedReading, "time", ALWAYS, **w)
        for w in gains(observations.scenario, sensors)
    )
    return _lines_of((c.effect for c in constants), observations, fitted)


def _lines_of(
    constants: Iterable[Effect], observations: Observations, fitted: FittedModel
) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in coefficients, each given by a constant in its place."""
    left = dict(enumerate(observations.residuals(fitted.effects)))
    found: list[tuple[float, float]] = []
    for constant in constants:
        changes = observations.changes(constant, fitted.effects)
        for number in range(len(observations.recordings)):
            found += _lines_in(changes, left, number, observations)
    duration = float(np.ptp(observations.recordings[0].time))
    return apart(found, lambda _: 1 / duration)


def _lines_in(
    changes: Columns, left: Columns, number: int, observations: Observations
) -> list[tuple[float, float]]:
    """(power over noise, frequency) of lines in a coefficient in one recording: a cosine times what
    it changes is compared with what is left, a constant taken out.

    Args:
        changes: of each channel, by some of the coefficient; left: of its readings.
        number: of the recording.
    """
    time = observations.block_times(number)
    along, energy = np.zeros((2, len(time)))
    for i, channel in enumerate(observations.channels):
        if i in changes and channel.recording == number and not channel.derived:
            noise = robust_white(left[i])
            rows = observations.blocks(i)
            along[rows] += left[i] * changes[i] / noise**2
            energy[rows] += (changes[i] / noise) ** 2
    whole = float(energy.sum())
    return _over_energy(time, along - along.sum() / whole * energy, whole) if whole > 0 else []


def _over_energy(time: Array, along: Array, energy: float) -> list[tuple[float, float]]:
    """(power over noise, frequency) of peaks in the spectrum of products of a residual with what it
    is compared with, whose squares sum to an energy.
    """
    from scipy.fft import next_fast_len

    values, rate = evenly(time, along)
    size = next_fast_len(FINER * len(values), real=True)
    power = np.abs(np.fft.rfft(values, size)) ** 2 / energy
    frequency = np.asarray(np.fft.rfftfreq(size, 1 / rate), float)
    floor = max(float(np.median(power)) / np.log(2), 1.0)
    return peaks(time, power, frequency, floor * np.log(len(values) / CHANCE))


WIDE = (6, 12, 24, 48, 96)  # widths of a line, of a band that a wandering line may fill


def spectral_lines_of(observations: Observations, fitted: FittedModel) -> SpectralLines:
    """All lines in the residual of a fitted model. A readout that is cut to steps beats with the
    motion: then only those in the readings.
    """
    tones = tones_of(observations, fitted)
    if observations.cut:
        return SpectralLines(tones)
    return SpectralLines(
        tones,
        shakes_of(observations, fitted),
        echoes_of(observations, fitted),
        late_of(observations, fitted),
        base_tilts_of(observations, fitted),
        scales_of(observations, fitted),
        ripples_of(observations, fitted),
        waves_of(observations, fitted),
    )


def tones_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in the residual, strongest first."""
    found: list[tuple[float, float]] = []
    for channel, residual in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        found += _lines(channel.time, residual)
    return apart(found, lambda _: 0.02)


def wandering_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of a line that wanders: no frequency is significant by itself, but all
    together are; strongest first.

    None is looked for by hand: a hand trembles at no steady frequency either.
    """
    if not observations.courses:
        return ()
    duration = float(np.ptp(observations.recordings[0].time))
    found: list[tuple[float, float]] = []
    for channel, residual in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        if not _lines(channel.time, residual):  # a strong one has skirts
            found += _smeared(channel.time, residual)
    return apart(found, lambda _: 1 / duration)


def shakes_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in the residual of accelerometers in the world frame: vibration of
    the base is one line there. In the body frame the pose modulates it.
    """
    left = observations.residuals(fitted.effects)
    found: list[tuple[float, float]] = []
    for number, watch in enumerate(observations.watches(fitted.effects)):
        for sensor in observations.scenario.sensors("accelerometer", "inclinometer"):
            own = [
                i
                for i, c in enumerate(observations.channels)
                if (c.recording, c.sensor) == (number, sensor.name)
            ]
            if not own:
                continue
            up, north = watch.sense[sensor.name].up, watch.sense[sensor.name].north
            time = observations.block_times(number)
            world = np.zeros((len(time), 3))
            for i in own:
                k = "xyz".index(observations.channels[i].axis)
                axes = np.column_stack([np.cross(north, up)[:, k], north[:, k], up[:, k]])
                world[observations.blocks(i)] += left[i][:, None] * observations.at_samples(i, axes)
            for column in world.T:
                found += _lines(time, column)
    duration = float(np.ptp(observations.recordings[0].time))
    # slower than that the table's own turns look like lines
    slowest = max(20 / duration, 4 * fastest(observations) / (2 * np.pi))
    return apart([(power, f) for power, f in found if f > slowest], lambda _: 2 / duration)


def echoes_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of oscillations that begin with each rest: lines over the time since the
    move, over all rests.
    """
    found: list[tuple[float, float]] = []
    for channel, residual in zip(
        observations.channels, observations.residuals(fitted.effects), strict=True
    ):
        stops = range(int(channel.stop.max(initial=-1)) + 1)
        rests = [rows for k in stops if len(rows := np.flatnonzero(channel.stop == k)) >= 32]
        if len(rests) < 4:
            continue
        level = np.concatenate([residual[rows] - residual[rows].mean() for rows in rests])
        since = np.concatenate([channel.time[rows] - channel.time[rows[0]] for rows in rests])
        cell, length = (
            float(np.median(np.diff(channel.time))) / FINER,
            float(np.median([np.ptp(channel.time[r]) for r in rests])),
        )
        summed = np.bincount(np.rint(since / cell).astype(np.intp), level)
        size = 2 * FINER * len(summed)
        power, frequency = np.abs(np.fft.rfft(summed, size)) ** 2, np.fft.rfftfreq(size, cell)
        seen = (frequency > 1.5 / length) & (frequency < 0.5 / (FINER * cell))
        floor = float(np.median(power[seen])) / np.log(2)
        k = int(np.argmax(np.where(seen, power, 0.0)))
        if power[k] > floor * np.log(len(summed) / CHANCE):
            found.append((float(power[k] / floor), float(frequency[k])))
    return apart(found, lambda f: 0.03 * f)


def _lines(time: Array, residual: Array) -> list[tuple[float, float]]:
    """(power over its surroundings, frequency) of peaks of the periodogram."""
    from scipy.fft import next_fast_len

    if len(residual) < 256:
        return []
    values, rate = evenly(time, residual - residual.mean())
    n = len(values)
    size = next_fast_len(FINER * n, real=True)
    spectrum = np.abs(np.fft.rfft(values * np.hanning(n), size)) ** 2
    frequency = np.asarray(np.fft.rfftfreq(size, 1 / rate), float)
    floor = running_median(spectrum, FINER * max(n // 80, 16))
    ratio = spectrum / np.maximum(floor, 1e-300) * np.log(2)
    return peaks(time, ratio, frequency, np.log(n / CHANCE))


def _smeared(time: Array, residual: Array) -> list[tuple[float, float]]:
    """(power over its surroundings, frequency) of the peaks in bands with more power than noise.

    For white noise the powers at whole numbers of periods are independent, so their sum is gamma
    distributed.
    """
    from scipy.special import gammaincc

    if len(residual) < 256:
        return []
    values, rate = evenly(time, residual - residual.mean())
    n = len(values)
    power = np.abs(np.fft.rfft(values)) ** 2
    ratio = power / np.maximum(running_median(power, max(n // 80, 16)), 1e-300) * np.log(2)
    widths = [m for m in WIDE if m * rate / n < 2 * WANDER and m < n // 160]
    found: dict[int, float] = {}
    for m in widths:
        total = np.convolve(ratio[SLOWEST:-1], np.ones(m), "valid")
        chance = gammaincc(m, total) * n * len(widths)
        for first in SLOWEST + np.flatnonzero(chance < CHANCE):
            found |= {k: float(ratio[k]) for k in range(first, first + m) if ratio[k] > np.log(m)}
    return [(strength, k * rate / n) for k, strength in found.items()]
