"""The chain: motion -> ordered effects -> readings. The same for the laboratory that draws and the
fit that predicts.

The converter at the end of the chain is of the sigma-delta kind: low-pass, limiter, sinc3, channels
in turn, quantisation.

The modulator's single bits are not drawn: its quantisation noise, shaped away from the band, is
below one LSB. What its filter averages is: three boxes of one output period each, sinc3 with
notches at the output rate and its multiples.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, shown
from tiltcal.core.frames import tilt_of_force
from tiltcal.effects.base import AngleEffect, DelayEffect, Effect, SignalEffect, WritingEffect
from tiltcal.effects.hysteresis_and_lag import first_order_lag
from tiltcal.effects.sense import Sense
from tiltcal.effects.streams import Streams, no_streams
from tiltcal.forward.kinematics import closed_form
from tiltcal.setup.chain import LinkFrame
from tiltcal.setup.sensor import Converter, Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Course, Drive, Motion

OVERSAMPLING = (
    16  # points of the fine grid a period of the output rate, at most one a modulator period
)
SETTLING = 8  # time constants of the low-pass that run before the first sample


def fine_grid(converter: Converter, time: Array, delay: float) -> Array:
    """The instants at which the analogue signal is needed for samples at ``time``, s.

    Args:
        converter: delta-sigma converter, or None.
        time: (n,).
        delay: s; the instants, (m,).
    """
    step = 1 / _fine_rate(converter)
    tau = 1 / (2 * np.pi * converter.lowpass_hz)
    lead = SETTLING * tau + 3 / converter.output_hz + 4 * converter.turn_s + delay
    return np.asarray(np.arange(time[0] - lead, time[-1] + step, step))


def converted(converter: Converter, grid: Array, signal: Array, instants: list[Array]) -> Array:
    """Readings of all channels, (n, k): channel i is kept ``turn_s`` before channel i + 1, the last
    at the stamp.

    Args:
        converter: the chain.
        grid: s, (m,), from ``fine_grid``.
        signal: of each channel on it, m/s2, (m, k).
        instants: stamps of each channel less its delay, s, (n,) each.
    """
    width = round(_fine_rate(converter) / converter.output_hz)
    box = np.full(width, 1 / width)
    kernel = np.convolve(np.convolve(box, box), box)  # sinc3
    # three boxes of points are that much too prompt
    early = 1.5 * (1 / _fine_rate(converter) - 1 / converter.modulator_hz)
    columns = []
    for i, moments in enumerate(instants):
        analogue = first_order_lag(grid, signal[:, i], 1 / (2 * np.pi * converter.lowpass_hz))
        limited = np.clip(analogue, -converter.limit, converter.limit)
        filtered = np.convolve(limited, kernel)[: len(grid)]
        end = moments - (len(instants) - 1 - i) * converter.turn_s - early
        columns.append(np.interp(end, grid, filtered))
    return np.column_stack(columns)


def quantise(converter: Converter, reading: Array) -> Array:
    """Readings as whole LSB, clipped at the ends of the range, m/s2. reading: m/s2, (n,)."""
    top = 2 ** (converter.bits - 1)
    return np.asarray(np.clip(np.rint(reading / converter.lsb), -top, top - 1) * converter.lsb)


def _fine_rate(converter: Converter) -> float:
    return min(OVERSAMPLING * converter.output_hz, converter.modulator_hz)


Mover = Callable[[Setup, Drive, Sequence[Effect], Streams], Motion]
"""What turns a drive into motion: ``kinematics.closed_form``, or MuJoCo."""

# order of an inclinometer's arcsine: after what acts on the force, before noise and quantisation
CONVERSION = 70


def stream(seed: int, *names: str | None) -> np.random.Generator:
    """The random stream of one effect on one sensor: adding an effect does not change the others'
    numbers.

    Raises:
        TiltcalError: the seed is negative.
    """
    if seed < 0:
        raise TiltcalError(
            "seed", found=shown(seed), need="a whole number from 0 on", do="correct it"
        )
    return np.random.default_rng([seed, *(zlib.crc32((name or "").encode()) for name in names)])


def readings(
    setup: Setup,
    course: Course,
    times: dict[str, Array],
    effects: Sequence[Effect],
    *,
    seed: int | None = None,
    mover: Mover = closed_form,
) -> dict[str, Array]:
    """What every sensor reads.

    Args:
        setup: site, rig, sensors.
        course: what the table does.
        times: stamps of each sensor by name, s, (n,).
        effects: all effects; those of no size are skipped.
        seed: of the random effects; None switches every random effect and quantisation off.
        mover: what moves.

    Returns:
        SI readings by sensor name, (n, k).
    """
    live = [e for e in effects if not e.is_identity]
    geometry = [e for e in live if not isinstance(e, SignalEffect | DelayEffect | WritingEffect)]
    seen: list[tuple[LinkFrame | None, Array, Motion, Drive]] = []

    def move(sensor: Sensor, time: Array) -> tuple[Motion, Drive]:
        for position, known, motion, drive in seen:
            alike = known is time or (len(known) == len(time) and np.array_equal(known, time))
            if alike and position == sensor.place:
                return motion, drive
        drive = course.drive(time)
        motion = mover(setup.seen_by(sensor), drive, geometry, streams_of(seed))
        seen.append((sensor.place, time, motion, drive))
        return motion, drive

    return {
        s.name: _read(s, setup, times[s.name], live, seed, partial(move, s), course)
        for s in map(setup.named, times)
    }


def streams_of(seed: int | None) -> Streams:
    """The random numbers of a recording's geometry; none without a seed."""
    if seed is None:
        return no_streams
    return lambda effect: stream(seed, effect.id, effect.axis)


def _read(
    sensor: Sensor,
    setup: Setup,
    time: Array,
    effects: Sequence[Effect],
    seed: int | None,
    move: Callable[[Array], tuple[Motion, Drive]],
    course: Course,
) -> Array:
    mine = [
        e
        for e in effects
        if e.sensor == sensor.name or (e.sensor is None and isinstance(e, DelayEffect))
    ]
    signal = sorted((e for e in mine if isinstance(e, SignalEffect)), key=lambda e: e.order)
    before = [e for e in signal if not e.random and e.order < CONVERSION]
    after = [e for e in signal if e.random or e.order >= CONVERSION]
    delays = _delays(
        sensor, time, [e for e in mine if isinstance(e, DelayEffect)], seed, course.times[0]
    )
    if sensor.converter is not None:
        return _converted(sensor, setup, time, before, after, delays, seed, move)
    columns = np.empty((len(time), len(sensor.axes)))
    done: list[tuple[Array | float, Array]] = []
    for channel, delay in enumerate(delays):
        reading = next((r for d, r in done if np.array_equal(d, delay)), None)
        if reading is None:
            moment = time if np.ndim(delay) == 0 and delay == 0 else time - delay
            motion, drive = move(moment)
            sense = make_sense(sensor, setup, motion, drive)
            if sensor.of is not None:
                sense = replace(sense, encoded=_encoded(sensor.of, setup, drive, effects))
            reading = sense.true_input()
            for effect in before:
                reading = effect.apply(reading, sense, None)
            done.append((delay, reading))
        columns[:, channel] = reading[:, channel]
    if sensor.kind == "inclinometer":
        columns = tilt_of_force(columns, setup.site.gravity)
    for effect in after:
        rng = None if seed is None else stream(seed, effect.id, sensor.name)
        columns = effect.apply(columns, sense, rng)
    return columns


def _converted(
    sensor: Sensor,
    setup: Setup,
    time: Array,
    before: Sequence[SignalEffect],
    after: Sequence[SignalEffect],
    delays: list[Array | float],
    seed: int | None,
    move: Callable[[Array], tuple[Motion, Drive]],
) -> Array:
    """What a sensor behind a converter reads: the analogue signal on a fine grid, then the
    converter, then noise and quantisation.
    """
    assert sensor.converter is not None
    grid = fine_grid(sensor.converter, time, max(float(np.max(d)) for d in delays))
    sense = make_sense(sensor, setup, *move(grid))
    signal = sense.true_input()
    for effect in before:
        signal = effect.apply(signal, sense, None)
    columns = converted(sensor.converter, grid, signal, [time - delay for delay in delays])
    sense = make_sense(sensor, setup, *move(time))
    for effect in after:
        columns = effect.apply(
            columns, sense, None if seed is None else stream(seed, effect.id, sensor.name)
        )
    return columns if seed is None else quantise(sensor.converter, columns)


def _delays(
    sensor: Sensor, time: Array, effects: Sequence[DelayEffect], seed: int | None, start: float
) -> list[Array | float]:
    totals: list[Array | float] = []
    for channel in range(len(sensor.axes)):
        total: Array | float = 0.0
        for (
            effect
        ) in effects:  # each channel draws the same numbers: the stamp is wrong for all of them
            rng = None if seed is None else stream(seed, effect.id, sensor.name)
            total = total + effect.delay(time - start, channel, rng)
        totals.append(total)
    return totals


def _encoded(axis: str, setup: Setup, drive: Drive, effects: Sequence[Effect]) -> Array:
    """Where an encoder finds an axis, rad, (n,): at the command, and what the drive leaves."""
    found = drive.axes[axis]
    if axis in drive.following_error:
        found = found + drive.following_error[axis]
    of_drive = [e for e in effects if isinstance(e, AngleEffect) and e.of_drive]
    for effect in of_drive:
        if effect.address not in drive.realised and effect.acts_on(axis, setup.rig):
            found = found + effect.deviation(drive, axis, None)
    return np.array(np.broadcast_to(found.x, drive.time.shape))


def make_sense(sensor: Sensor, setup: Setup, motion: Motion, drive: Drive) -> Sense:
    """What a sensor senses of a motion."""
    return Sense(
        motion.time,
        drive.elapsed,
        motion.force,
        motion.rate,
        motion.up,
        motion.north,
        motion.angular_acceleration,
        drive.temperature - drive.reference_temperature,
        sensor.axis_indices,
        sensor.kind,
        sensor.input_vector if sensor.kind == "fog" else np.zeros(3),
        setup.site.gravity,
        sensor.rate_hz,
        sensor.full_scale,
        {name: np.asarray(jet.x) for name, jet in drive.axes.items()},
        drive.stop,
        drive.standstills,
        {name: np.broadcast_to(jet.v, motion.time.shape) for name, jet in drive.axes.items()},
        encoded=None if sensor.of is None else np.asarray(drive.axes[sensor.of].x),
    )
