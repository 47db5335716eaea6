"""Channels that do not measure: dead, saturated or frozen."""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.quantisation import lsb_width
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor

AT_LIMIT = 0.05  # share of the log at the stated range that makes a channel saturated
BLOCK = 20  # samples
TINY = 1e-12  # SI: a noise below it is rounding of the arithmetic
# different values in a block of 20 samples: the noise is then 0.8 of a code or more, and a sample
# repeats the one before with a probability of at most REPEATS
VARIED = 4
REPEATS = 0.3
IMPOSSIBLE = 1e-6  # probability of so long a run of equal samples


def channel_tests(
    recording: Recording, sensor: Sensor, axes: Sequence[str] | None = None
) -> list[Test]:
    """Whether the channels of a sensor measure: none is constant, and none repeats a single value
    for a stretch; refuses one that is saturated.

    Args:
        recording: with the sensor.
        sensor: its channels are looked at.
        axes: of the channels that are used; all unless given.

    Raises:
        TiltcalError: a channel is saturated.
    """
    samples = recording.sensor(sensor)
    dead, frozen = [], []
    for axis, values in zip(sensor.axes, samples.values.T, strict=True):
        if axes is not None and axis not in axes:
            continue
        known = ~np.isnan(values)
        name = f"{sensor.name}_{axis}"
        if not known.any() or np.ptp(values[known]) == 0:
            dead.append(name)
            continue
        _require_unsaturated(recording, sensor, name, values[known])
        found = frozen_stretch(values[known])
        if found is not None:
            start, end = samples.time[known][[found[0], found[1] - 1]]
            frozen.append(f"{name} repeats one value from {start:.6g} to {end:.6g} s")
    alive = "every channel varies"
    if dead:
        alive = (
            f"{', '.join(dead)} constant throughout: dead, disconnected or too coarsely quantised"
        )
    still = "no channel froze"
    if frozen:
        still = "; ".join(frozen) + ": frozen, leave that stretch out"
    return [
        threshold_test(f"{sensor.name} alive", len(dead), not dead, alive),
        threshold_test(f"{sensor.name} not frozen", len(frozen), not frozen, still),
    ]


def _require_unsaturated(recording: Recording, sensor: Sensor, name: str, known: Array) -> None:
    """Refuse a channel that stays at the end of its range: the stated one, or the extreme at which
    it stops.
    """
    limit = sensor.converter.limit if sensor.converter is not None else sensor.full_scale
    at_end = np.zeros(len(known), bool)
    if limit is not None:
        at_end = np.abs(known) >= 0.999 * limit
    if at_end.mean() <= AT_LIMIT:
        at_end = _stopped_at_an_extreme(known)
    if at_end.any():
        raise TiltcalError(
            f"{recording.source}, channel {name}",
            found=f"saturated, or frozen at its extreme, for {at_end.mean():.0%} of the log",
            need="readings within its range",
            do="lower the gain, level the base or turn slower, and record again",
        )


def _stopped_at_an_extreme(values: Array) -> Mask:
    """Samples exactly at an extreme of the channel, where they pile up: more than stand at the next
    value inside, though the noise is a code or more. The tail of a normal distribution thins out.
    """
    none = np.zeros(len(values), bool)
    inside = values[(values > values.min()) & (values < values.max())]
    if len(inside) < BLOCK or _noise(inside) < max(lsb_width(inside), TINY):
        return none
    for end, beside in ((values.max(), inside.max()), (values.min(), inside.min())):
        at_end = np.asarray(values == end)
        if at_end.sum() >= max(BLOCK, 2 * np.sum(values == beside)):
            none |= at_end
    return none


def _noise(values: Array) -> float:
    """White noise by second differences: what nine blocks in ten exceed, so that motion is none."""
    second = values[2:] - 2 * values[1:-1] + values[:-2]
    blocks = second[: len(second) // BLOCK * BLOCK].reshape(-1, BLOCK)
    return float(np.sqrt(np.quantile(np.mean(blocks**2, axis=1), 0.1) / 6)) if len(blocks) else 0.0


def frozen_stretch(values: Array) -> tuple[int, int] | None:
    """First and last + 1 of a run of equal samples that noise does not make; None without one.

    Judged only where the rest of the channel varies from sample to sample: a quiet sensor with
    coarse codes repeats itself and is not frozen. (n,)
    """
    if len(values) < 2 * BLOCK:
        return None
    change = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1, [len(values)]])
    lengths = np.diff(change)
    longest = int(np.argmax(lengths))
    length = int(lengths[longest])
    if np.log(len(values)) + length * np.log(REPEATS) > np.log(IMPOSSIBLE):
        return None
    first, last = int(change[longest]), int(change[longest]) + length
    rest = np.concatenate([values[:first], values[last:]])
    blocks = rest[: len(rest) // BLOCK * BLOCK].reshape(-1, BLOCK)
    varied = [len(np.unique(block)) for block in blocks]
    return (first, last) if varied and np.median(varied) >= VARIED else None
