"""Stretches whose written angle jumps away from the motion and back: the readout jumped, and no
sensor followed.

A wrong angle of one stop shows by gravity (``stop_errors.find_wrong_stop``). Of a vertical axis
gravity shows nothing, and beside another stop of the same angle that search finds none; but no
table moves far between two samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.stop_errors import mistyped
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.events import active_in
from tiltcal.forward.signal_chain import readings
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay
from tiltcal.statistics.dwell_noise import ARITHMETIC, MAD_TO_SIGMA, robust_white

SHORTEST = 8  # rows that a jump is told from
GROSS = 8.0  # sigma of the readout's own noise
# relative: how equal the jumps there and back are; the end of a move adds its own bend to one of
# them
AGREE = 0.2
# samples in which a table would have gone there: quick, and slow enough for a rate to be told from
# its readout
RISE = 9
SURE = 100.0  # fall of the deviance: ten sigma
SHARE = 0.25  # of the deviance, at most, that may be left where the jump would be seen


@dataclass(frozen=True)
class Jump:
    """A stretch of one axis between two jumps of its readout.

    Args:
        axis: of the table.
        rows: of the recording between the jumps, (n,) mask.
        error: rad.
        sigma: half of what the two jumps differ by, rad.
    """

    axis: str
    rows: Mask
    error: float
    sigma: float


def find_readout_jumps(
    observations: Observations, fitted: FittedModel
) -> tuple[list[Fault], tuple[Recording, ...]]:
    """Stretches of wrong angles that the readout itself shows, and the recordings without their
    readout.
    """
    faults: list[Fault] = []
    recordings = list(observations.recordings)
    left = observations.residuals(fitted.effects)
    for number, course in enumerate(observations.courses):
        for axis, angle in course.angles.items():
            jump = jump_of(axis, course.time, angle, course.known)
            if jump is None or not _misfits(observations, left, number, jump):
                continue
            if _unfollowed(observations, fitted.effects, number, jump):
                fault, recordings[number] = mistyped(
                    observations,
                    number,
                    recordings[number],
                    jump.rows,
                    axis,
                    jump.error,
                    jump.sigma,
                )
                faults.append(fault)
    return faults, tuple(recordings)


def jump_of(axis: str, time: Array, angle: Array, known: Mask) -> Jump | None:
    """The two sharpest bends of a readout (rad, (n,)) where it was read, if it jumped there, as far
    there as back. A bend is what a step is off the rates before and after it: stamps that are
    irregular bend nothing. time: s, (n,).
    """
    if len(angle) < SHORTEST:
        return None
    step, gap, read = np.diff(angle), np.diff(time), known[1:] & known[:-1]
    rate = step / gap
    bent = np.zeros(len(step))  # a table gathers speed, and loses it, over several samples
    bent[1:-1] = np.where(
        read[:-2] & read[1:-1] & read[2:],
        step[1:-1] - (rate[:-2] + rate[2:]) / 2 * gap[1:-1],
        0.0,
    )
    noise, sharp = MAD_TO_SIGMA * float(np.median(np.abs(bent))), _sharp(bent)
    first = int(np.argmax(np.abs(sharp)))
    others = np.where(np.abs(np.arange(len(bent)) - first) > 2, sharp, 0.0)
    first, last = sorted((first, int(np.argmax(np.abs(others)))))
    there, back = float(bent[first]), float(bent[last])
    error = (there - back) / 2
    if abs(error) <= max(GROSS * noise, ARITHMETIC) or abs(there + back) > AGREE * abs(error):
        return None
    row = np.arange(len(angle))
    return Jump(axis, (row > first) & (row <= last), error, max(abs(there + back) / 2, noise))


def _sharp(bent: Array) -> Array:
    """The bends where a course may have jumped, (n,), else 0: a jump bends it back by half on both
    sides; a steep one bends on.
    """
    around = np.zeros(len(bent))
    around[1:-1] = bent[:-2] + bent[2:]
    return np.where(-around * np.sign(bent) > np.abs(bent) / 2, bent, 0.0)


def _misfits(observations: Observations, left: Sequence[Array], number: int, jump: Jump) -> bool:
    """Whether the readout as it is leaves so much between the jumps, or beside them, that all but
    SHARE of it may go; left: by channel, SI.
    """
    beside = np.convolve(np.diff(jump.rows, prepend=False), np.ones(2 * RISE), "same") > 0
    for channel, residual in zip(observations.channels, left, strict=True):
        if channel.recording == number:
            noise = robust_white(residual)
            for rows in (jump.rows, beside):
                part = residual[rows[channel.rows]]
                if len(part) and np.mean(part**2) > noise**2 / SHARE / 2:
                    return True
    return False


def _unfollowed(
    observations: Observations, effects: Sequence[Effect], number: int, jump: Jump
) -> bool:
    """Whether the sensors show that the table did not jump."""
    course = observations.courses[number]
    angle = course.angles[jump.axis] - jump.error * jump.rows
    level = replace(course, angles={**course.angles, jump.axis: angle})
    own = [c for c in observations.channels if c.recording == number]
    met = active_in(effects, observations.recordings[number].fingerprint)
    times = dict.fromkeys(sorted({c.sensor for c in own}), course.time)
    gone, stayed = (
        readings(observations.scenario, c, times, met) for c in (_with_moves(level, jump), level)
    )
    before = after = 0.0
    for c in own:
        off, without = (
            np.nan_to_num(c.values - p[c.sensor][c.rows, c.column]) for p in (gone, stayed)
        )
        noise = robust_white(without)
        seen = np.abs(off - without) > noise
        before += float(np.sum(off[seen] ** 2)) / noise**2
        after += float(np.sum(without[seen] ** 2)) / noise**2
    return before - after > SURE and after < SHARE * before


def _with_moves(level: Replay, jump: Jump) -> Replay:
    """A course with quick moves in place of jumps: how a table would have moved there and back."""
    rise = np.hanning(RISE + 2)
    share = np.convolve(jump.rows, rise / rise.sum(), "same")
    moving = np.convolve(np.abs(np.diff(share, prepend=share[0])), np.ones(RISE), "same") > 0
    angles = {**level.angles, jump.axis: level.angles[jump.axis] + jump.error * share}
    return replace(level, angles=angles, stop=np.where(moving, -1, level.stop))
