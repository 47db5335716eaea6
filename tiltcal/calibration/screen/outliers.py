"""One-sided outliers: spikes and gusts that pull the mean of a dwell away from its median."""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.validity import SIGNIFICANCE, Test
from tiltcal.core.arrays import Array
from tiltcal.core.quantisation import lsb_width
from tiltcal.recordings.means_table import MeansTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import Poses

BLOCK = 20  # samples whose mean and median are compared: hardly anything slow varies inside
LEAST = 5  # blocks of a dwell that is judged by itself
TINY = 1e-12  # of the readings: a noise below it is rounding of the arithmetic
COARSE = 0.5  # of the noise: a median of coarser steps sticks to them


def outlier_tests(
    recording: Recording, poses: Poses, axes: Sequence[str] | None = None
) -> list[Test]:
    """Whether the means of the dwells agree with their medians, block by block.

    Symmetric noise leaves the differences of mean and median zero on average, whatever its
    distribution (Student's t); outliers to one side move the mean and hardly the median.

    Args:
        recording: a log; nothing is tested of a table of means, nor where steps of the readings
            are coarse.
        poses: the dwells of a sensor.
        axes: of the channels that are used; all unless given.
    """
    from scipy.special import stdtr

    if isinstance(recording, MeansTable):
        return []
    samples = recording.sensor(poses.sensor)
    tried: list[tuple[float, float, str]] = []
    for i, axis in enumerate(poses.sensor.axes):
        if axes is not None and axis not in axes:
            continue
        known = ~np.isnan(samples.values[:, i])
        time, values = samples.time[known], samples.values[known, i]
        name = f"{poses.sensor.name}_{axis}"
        every = []
        for span in poses.spans:
            a, b = np.searchsorted(time, [span.start_s, np.nextafter(span.end_s, np.inf)])
            differences = _differences(values[a:b])
            every.append(differences)
            if len(differences) >= LEAST:
                where = f"{name} from {span.start_s:.6g} to {span.end_s:.6g} s"
                tried.append((*_student(differences), where))
        if len(together := np.concatenate(every)) >= LEAST:
            tried.append((*_student(together), f"{name} in all dwells"))
    if not tried:
        return []
    p, size, where = min((2 * float(stdtr(dof, -abs(t))), -abs(t), at) for t, dof, at in tried)
    p = min(1.0, p * len(tried))
    passed = p > SIGNIFICANCE
    text = "the mean of every dwell agrees with its median"
    if not passed:
        text = f"mean and median differ, |t| = {-size:.3g}, {where}: outliers to one side"
    return [Test(f"{poses.sensor.name} without outliers", -size, 0, p, passed, text)]


def _differences(values: Array) -> Array:
    """Mean less median of each block, (b,); none where the readings have no noise, or steps too
    coarse for a median. values: (n,).
    """
    blocks = values[: len(values) // BLOCK * BLOCK].reshape(-1, BLOCK)
    if not len(blocks):
        return np.zeros(0)
    noise = float(np.sqrt(blocks.var(axis=1).mean()))
    if noise <= TINY * float(np.abs(values).max()) or lsb_width(values) > COARSE * noise:
        return np.zeros(0)
    return np.asarray(blocks.mean(axis=1) - np.median(blocks, axis=1))


def _student(values: Array) -> tuple[float, float]:
    """Student's t of the mean of values, (n,), and its degrees of freedom."""
    error = float(values.std(ddof=1)) / np.sqrt(len(values))
    return float(values.mean()) / max(error, 1e-300), float(len(values) - 1)
