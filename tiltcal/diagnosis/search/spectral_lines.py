"""Spectral lines in the residual, at unknown frequencies."""

from collections.abc import Callable, Mapping, Sequence
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.hypotheses.coordinate_ranges import fastest
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.curve_coordinates import coordinate_of
from tiltcal.effects.electronics.mains import WANDER
from tiltcal.effects.spans import SpectralLines, Wave
from tiltcal.effects.table.drive import EncoderSde
from tiltcal.setup.tables import angle_channel
from tiltcal.statistics.noise_spectrum import robust_white

Waves = np.ndarray[tuple[int], np.dtype[np.complex128]]
LINES = 1100  # a turn, of the finest scale that is looked for
CIRCLE = 2**15  # angles of a turn: a fifth of a radian of the finest line
FIRST = 6  # fewer are curves of the angle
BEYOND = 11  # harmonics of an angle that no curve over it has
FEWEST = 16  # lines of which a median says what is usual
PROBE = 36.0  # lines, from whose changes those of any other number follow
SMALL = 1e-6  # rad
CHANCE = 1e-4  # of a line in any recording without one
MOST = 5
FINER = 4  # frequencies a width of a line
SLOWEST = 4  # periods of a recording: below it a drift looks like a line
WIDE = (6, 12, 24, 48, 96)  # widths of a line, of a band that a wandering line may fill


def spectral_lines_of(observations: Observations, fitted: FittedModel) -> SpectralLines:
    """All lines in the residual of a fitted model."""
    return SpectralLines(
        tones_of(observations, fitted),
        shakes_of(observations, fitted),
        echoes_of(observations, fitted),
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
    return _apart(found, lambda _: 0.02)


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
    return _apart(found, lambda _: 1 / duration)


def shakes_of(observations: Observations, fitted: FittedModel) -> tuple[float, ...]:
    """Frequencies, Hz, of lines in the residual of accelerometers in the world frame: vibration of
    the base is one line there. In the body frame the pose modulates it.
    """
    left = observations.residuals(fitted.effects)
    found: list[tuple[float, float]] = []
    for number, watch in enumerate(observations.watches(fitted.effects)):
        for sensor in observations.scenario.sensors("accelerometer", "inclinometer"):
            own = [
                (c, r)
                for c, r in zip(observations.channels, left, strict=True)
                if (c.recording, c.sensor) == (number, sensor.name)
            ]
            if not own:
                continue
            up, north = watch.sense[sensor.name].up, watch.sense[sensor.name].north
            world = np.zeros((len(up), 3))
            for c, r in own:
                k = "xyz".index(c.axis)
                rows = np.minimum(c.rows // observations.block, len(up) - 1)
                world[rows] += r[:, None] * np.column_stack(
                    [np.cross(north, up)[rows, k], north[rows, k], up[rows, k]]
                )
            for column in world.T:
                found += _lines(watch.time, column)
    duration = float(np.ptp(observations.recordings[0].time))
    # slower than that the table's own turns look like lines
    slowest = max(20 / duration, 4 * fastest(observations) / (2 * np.pi))
    return _apart([(power, f) for power, f in found if f > slowest], lambda _: 2 / duration)


def ripples_of(observations: Observations, fitted: FittedModel) -> tuple[int, ...]:
    """Numbers of lines per turn of an axis whose readout error is significant in the residual,
    strongest first.

    One after the other is taken out: with few angles a strong one has skirts everywhere.
    """
    found: list[tuple[float, int]] = []
    left = observations.residuals(fitted.effects)
    noise = [robust_white(r) for r in left]
    for axis in observations.scenario.rig.kind.turning:
        waves = _of_one_line(observations, axis, fitted)
        angles = {
            i: observations.courses[c.recording].angles[axis][c.rows]
            for i, c in ((i, observations.channels[i]) for i in waves)
        }
        rest = {i: left[i] / noise[i] for i in waves}
        scaled = {i: wave / noise[i] for i, wave in waves.items()}
        gain = _gains(angles, scaled, rest)
        for _ in range(MOST if gain.any() else 0):
            n = FIRST + int(np.argmax(gain[FIRST:]))
            rest = _without_line(n, angles, scaled, rest)
            after = _gains(angles, scaled, rest)
            floor = max(float(np.median(after[FIRST:])) / np.log(2), 1.0)
            if not gain[n] > 2 * floor * np.log(LINES / CHANCE):
                break
            found.append((float(gain[n]), n))
            gain = after
    return tuple(dict.fromkeys(n for _, n in sorted(found, reverse=True)[:MOST]))


def waves_of(observations: Observations, fitted: FittedModel) -> tuple[Wave, ...]:
    """Lines in the residual of a reading over its own input or over a table angle, strongest first:
    one over each for each channel at most, and none by hand.

    Over an angle they are of a constant amplitude or in proportion to the speed of turn: what a
    motor, a resolver or a ring of contacts puts into a reading. From sample
    to sample a turn passes half a line of the finest: finer ones look like coarser ones.
    """
    found: list[tuple[float, Wave]] = []
    left, watches = observations.residuals(fitted.effects), observations.watches(fitted.effects)
    turning = observations.scenario.rig.kind.turning
    for channel, residual in zip(observations.channels, left, strict=True):
        if channel.derived or channel.recording >= len(watches):
            continue
        sense = watches[channel.recording].sense[channel.sensor]
        rows = np.minimum(channel.rows // observations.block, len(sense.time) - 1)
        own = sense.true_input()[:, channel.column]
        place = channel.sensor, channel.axis
        if span := float(np.ptp(own[rows])):
            phase = 2 * np.pi * (own - own[rows].min())[rows] / (FINER * span)
            n, strength = _strongest(phase, residual, FINER * FIRST, LINES)
            found.append((strength, Wave(*place, "input", FINER * span / n)))
        for name, times in product((angle_channel(axis) for axis in turning), ("", "speed")):
            size = coordinate_of(times, sense, own)[rows] if times else np.ones(len(rows))
            angle = coordinate_of(name, sense, own)[rows]
            n, strength = _strongest(angle, residual * size, BEYOND, _finest(channel.time, angle))
            found.append((strength, Wave(*place, name, 2 * np.pi / n, times)))
    clear = [(s, w) for s, w in found if s > np.log(LINES / CHANCE)]
    clear.sort(key=lambda each: -each[0])
    best = {(w.sensor, w.axis, w.coordinate): w for _, w in reversed(clear)}
    return tuple(w for _, w in clear if w in best.values())[:MOST]


def _finest(time: Array, angle: Array) -> int:
    """How many lines a turn pass at half a line a sample, at the mean speed over the angle that is
    turned.
    """
    gaps = np.diff(time)
    speed = np.abs(np.diff(angle)) / gaps
    turned = float(speed @ gaps)
    step = float(speed**2 @ gaps) / turned * float(np.median(gaps)) if turned else 0.0
    return min(int(np.pi / max(step, np.pi / LINES)), LINES)


def _strongest(phase: Array, signal: Array, first: int, finest: int) -> tuple[int, float]:
    """The strongest line over a phase, of those from a first number of lines to a last one, and its
    power over their median; phase: rad, (n,). Nothing has a power of 0.
    """
    power = np.abs(_harmonics(phase, signal)[first:finest]) ** 2
    if len(power) < FEWEST:
        return first, 0.0
    k = int(np.argmax(power))
    floor = max(float(np.median(power)), np.finfo(float).tiny)
    return first + k, float(power[k]) / floor * np.log(2)


def _gains(
    angles: Mapping[int, Array], waves: Mapping[int, Waves], rest: Mapping[int, Array]
) -> Array:
    """What each number of lines explains of a whitened rest, (LINES,); all by channel, (n,)."""
    each = np.arange(LINES)
    power, weight = np.zeros(LINES, complex), np.zeros(LINES)
    for i, wave in waves.items():
        # what n lines do to the readings: of_angle + 1j n of_rate
        of_angle, of_rate = wave.real, wave.imag / PROBE
        power += _harmonics(angles[i], of_angle * rest[i])
        power += 1j * each * _harmonics(angles[i], of_rate * rest[i])
        weight += of_angle @ of_angle + each**2 * (of_rate @ of_rate)
    return 2 * np.abs(power) ** 2 / np.maximum(weight, np.finfo(float).tiny)


def _without_line(
    n: int, angles: Mapping[int, Array], waves: Mapping[int, Waves], rest: Mapping[int, Array]
) -> dict[int, Array]:
    """A whitened rest without what n lines explain of it; all by channel, (n,)."""
    columns = {}
    for i, wave in waves.items():
        turned = (wave.real + 1j * n * wave.imag / PROBE) * np.exp(1j * n * angles[i])
        columns[i] = np.column_stack([turned.real, turned.imag])
    whole = np.concatenate(list(columns.values()))
    size = np.linalg.lstsq(whole, np.concatenate([rest[i] for i in columns]), rcond=None)[0]
    return {i: rest[i] - column @ size for i, column in columns.items()}


def _of_one_line(observations: Observations, axis: str, fitted: FittedModel) -> dict[int, Waves]:
    """What a readout error does to each channel: real part by the angle, imaginary part by its
    rate, times PROBE.

    Of PROBE lines a turn the cosine changes a channel by the real part of that times exp(1j PROBE
    angle), the sine by the imaginary part.
    """
    cos, sin = (
        observations.changes(
            EncoderSde({name: SMALL, "lines": PROBE}, None, axis, "found"),
            fitted.effects,
        )
        for name in ("cos", "sin")
    )
    found: dict[int, Waves] = {}
    for i in cos.keys() | sin.keys():
        channel = observations.channels[i]
        angle = observations.courses[channel.recording].angles[axis][channel.rows]
        found[i] = (cos.get(i, 0.0) + 1j * sin.get(i, 0.0)) * np.exp(-1j * PROBE * angle)
    return found


def _harmonics(angle: Array, signal: Array) -> Waves:
    """sum signal exp(i n angle) for n = 0 .. LINES - 1 by one FFT, each angle shared between its
    neighbours on a grid: the finest line is 0.4 % too small on average.
    """
    place = angle / (2 * np.pi) * CIRCLE
    below = np.floor(place)
    above, before = place - below, below.astype(np.int64) % CIRCLE
    shared = np.bincount(before, signal * (1 - above), CIRCLE) + np.bincount(
        (before + 1) % CIRCLE, signal * above, CIRCLE
    )
    return np.fft.rfft(shared)[:LINES].conj()


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
    return _apart(found, lambda f: 0.03 * f)


def _apart(
    found: Sequence[tuple[float, float]], width: Callable[[float], float]
) -> tuple[float, ...]:
    """The strongest of (power, frequency) that are further apart than the width of a line."""
    kept: list[float] = []
    for _, f in sorted(found, reverse=True):
        if len(kept) < MOST and all(abs(f - other) > width(f) for other in kept):
            kept.append(f)
    return tuple(kept)


def _lines(time: Array, residual: Array) -> list[tuple[float, float]]:
    """(power over its surroundings, frequency) of peaks of the periodogram."""
    from scipy.fft import next_fast_len

    if len(residual) < 256:
        return []
    values, rate = _evenly(time, residual - residual.mean())
    n = len(values)
    size = next_fast_len(FINER * n, real=True)
    spectrum = np.abs(np.fft.rfft(values * np.hanning(n), size)) ** 2
    frequency = np.fft.rfftfreq(size, 1 / rate)
    floor = _running_median(spectrum, FINER * max(n // 80, 16))
    ratio = spectrum / np.maximum(floor, 1e-300) * np.log(2)
    limit = np.log(n / CHANCE)
    peak = (ratio > limit) & (ratio >= np.roll(ratio, 1)) & (ratio >= np.roll(ratio, -1))
    slow = SLOWEST / max(float(time[-1] - time[0]), 1e-9)
    peak &= frequency > slow
    return [(float(ratio[k]), float(frequency[k])) for k in np.flatnonzero(peak)[:40]]


def _smeared(time: Array, residual: Array) -> list[tuple[float, float]]:
    """(power over its surroundings, frequency) of the peaks in bands with more power than noise.

    For white noise the powers at whole numbers of periods are independent, so their sum is gamma
    distributed.
    """
    from scipy.special import gammaincc

    if len(residual) < 256:
        return []
    values, rate = _evenly(time, residual - residual.mean())
    n = len(values)
    power = np.abs(np.fft.rfft(values)) ** 2
    ratio = power / np.maximum(_running_median(power, max(n // 80, 16)), 1e-300) * np.log(2)
    widths = [m for m in WIDE if m * rate / n < 2 * WANDER and m < n // 160]
    found: dict[int, float] = {}
    for m in widths:
        total = np.convolve(ratio[SLOWEST:-1], np.ones(m), "valid")
        chance = gammaincc(m, total) * n * len(widths)
        for first in SLOWEST + np.flatnonzero(chance < CHANCE):
            found |= {k: float(ratio[k]) for k in range(first, first + m) if ratio[k] > np.log(m)}
    return [(strength, k * rate / n) for k, strength in found.items()]


def _evenly(time: Array, values: Array) -> tuple[Array, float]:
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


def _running_median(values: Array, width: int) -> Array:
    """Median over blocks, interpolated, (n,)."""
    count = max(len(values) // width, 1)
    blocks = np.array_split(values, count)
    centres = np.cumsum([len(b) for b in blocks]) - np.array([len(b) for b in blocks]) / 2
    return np.interp(np.arange(len(values)), centres, [float(np.median(b)) for b in blocks])
