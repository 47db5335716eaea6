"""Lines in the residual over a table angle, a reading's own input, or temperature."""

from collections.abc import Mapping

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.curve_coordinates import TURN_RATE, coordinate_of
from tiltcal.effects.spans import Wave
from tiltcal.effects.table.drive import EncoderSde
from tiltcal.setup.tables import angle_channel
from tiltcal.statistics.dwell_noise import robust_white

Phasors = np.ndarray[tuple[int], np.dtype[np.complex128]]
LINES = 1100  # a turn, of the finest scale that is looked for
CIRCLE = 2**15  # angles of a turn: a fifth of a radian of the finest line
FIRST = 6  # fewer are curves of the angle
CYCLES = 3  # over the range of temperature: fewer are a curve
BEYOND = 11  # harmonics of an angle that no curve over it has
MIN_LINES = 16  # lines of which a median says what is usual
PROBE = 36.0  # lines, from whose changes those of any other number follow
SMALL = 1e-6  # rad
CHANCE = 1e-4  # of a line in any recording without one
MOST = 5  # lines of an axis: with each all hypotheses over its angle are tried
WHITE = 2.0  # mean of what a line explains of white noise: a cosine and a sine
FINER = 4  # frequencies a width of a line


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
            floor = max(float(np.median(after[FIRST:])) / np.log(2), WHITE)
            if not gain[n] > floor * np.log(LINES / CHANCE):
                break
            found.append((float(gain[n]), n))
            gain = after
    return tuple(dict.fromkeys(n for _, n in sorted(found, reverse=True)[:MOST]))


def waves_of(observations: Observations, fitted: FittedModel) -> tuple[Wave, ...]:
    """Lines in the residual of a reading over its own input, over temperature or over a table
    angle, strongest first: one over each for each channel at most, and none by hand.

    Over temperature they are fringes, or a table of a compensation that is not interpolated, of the
    bias or of the scale factor. Over an angle they are of a constant amplitude or in proportion to
    the speed of turn or the rate of that angle: what a motor, a resolver or a ring of contacts puts
    into a reading. From sample to sample a turn passes half a line of the finest: finer ones look
    like coarser ones.
    """
    found: list[tuple[float, Wave]] = []
    left, watches = observations.residuals(fitted.effects), observations.watches(fitted.effects)
    turning = observations.scenario.rig.kind.turning
    for i, (channel, residual) in enumerate(zip(observations.channels, left, strict=True)):
        if channel.derived or channel.recording >= len(watches):
            continue
        sense = watches[channel.recording].sense[channel.sensor]
        true = sense.true_input()[:, channel.column]
        own, temperature, speed = (
            observations.at_samples(i, u)
            for u in (true, sense.temperature, coordinate_of("speed", sense, true))
        )
        place = channel.sensor, channel.axis
        for name, u, first, factors in (
            ("input", own, FIRST, ("",)),
            ("temperature", temperature, CYCLES, ("", "input")),
        ):
            if span := float(np.ptp(u)):
                phase = 2 * np.pi * (u - u.min()) / (FINER * span)
                signals = {"": residual, "input": residual * own}
                (n, strength), times = max(
                    ((_strongest(phase, signals[t], FINER * first, LINES), t) for t in factors),
                    key=lambda each: each[0][1],
                )
                found.append((strength, Wave(*place, name, FINER * span / n, times)))
        for axis in turning:
            name, turn_rate = angle_channel(axis), f"{TURN_RATE}{axis}"
            angle, rate = (
                observations.at_samples(i, coordinate_of(u, sense, true)) for u in (name, turn_rate)
            )
            finest = _finest(channel.time, angle)
            (n, strength), times = max(
                (_strongest(angle, residual, BEYOND, finest), ""),
                (_strongest(angle, residual * speed, BEYOND, finest), "speed"),
                (_strongest(angle, residual * rate, 1, finest), turn_rate),
                key=lambda each: each[0][1],
            )
            found.append((strength, Wave(*place, name, 2 * np.pi / n, times)))
    clear = [(s, w) for s, w in found if s > np.log(LINES / CHANCE)]
    return tuple(w for _, w in sorted(clear, key=lambda each: -each[0]))[:MOST]


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
    if len(power) < MIN_LINES:
        return first, 0.0
    k = int(np.argmax(power))
    floor = max(float(np.median(power)), np.finfo(float).tiny)
    return first + k, float(power[k]) / floor * np.log(2)


def _gains(
    angles: Mapping[int, Array], waves: Mapping[int, Phasors], rest: Mapping[int, Array]
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
    n: int,
    angles: Mapping[int, Array],
    waves: Mapping[int, Phasors],
    rest: Mapping[int, Array],
) -> dict[int, Array]:
    """A whitened rest without what n lines explain of it; all by channel, (n,)."""
    columns = {}
    for i, wave in waves.items():
        turned = (wave.real + 1j * n * wave.imag / PROBE) * np.exp(1j * n * angles[i])
        columns[i] = np.column_stack([turned.real, turned.imag])
    whole = np.concatenate(list(columns.values()))
    size = np.linalg.lstsq(whole, np.concatenate([rest[i] for i in columns]), rcond=None)[0]
    return {i: rest[i] - column @ size for i, column in columns.items()}


def _of_one_line(observations: Observations, axis: str, fitted: FittedModel) -> dict[int, Phasors]:
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
    found: dict[int, Phasors] = {}
    for i in cos.keys() | sin.keys():
        channel = observations.channels[i]
        angle = observations.courses[channel.recording].angles[axis][channel.rows]
        found[i] = (cos.get(i, 0.0) + 1j * sin.get(i, 0.0)) * np.exp(-1j * PROBE * angle)
    return found


def _harmonics(angle: Array, signal: Array) -> Phasors:
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
