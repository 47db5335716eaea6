"""What comes to a reading at instants and goes away again: draughts, knocks, passing vehicles.

The instants come from a matched filter on the whitened residual (Turin, IRE Trans. Inf. Theory 6,
1960), behind a limiter, so that gross values are none, and in units of the noise about each of
them, so that a burst of noise is none. How many there are is chosen by what they explain less the
logarithm of the number of ways to choose them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.lines.spectral_lines import limited, noise_about
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.curve_bases import transients_at
from tiltcal.effects.learned import LearnedReading
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines

FALLS = (1.5, 4.5, 13.5, 40.0)  # s
RISES = (1 / 3, 2.0)  # falls: a knock, and what passes by
END = 3.0  # falls, after which a transient is gone
SHORTEST = 2.0  # samples of a rise
LONGEST = 0.2  # of a recording that a transient may last
MOST = 16  # transients of a reading
SIZE = 2.0  # nats that the size of each costs, about


@dataclass(frozen=True)
class ResidualCourse:
    """The course of a transient; rise, fall: s."""

    rise: float
    fall: float

    @property
    def duration(self) -> float:
        """From its beginning until it is gone, s."""
        return self.rise + END * self.fall

    def sampled(self, step: float) -> tuple[Array, int]:
        """Its values at every step, s, (n,), and which of them is its peak."""
        before = int(self.rise / step)
        since = np.asarray(np.arange(-before, int(END * self.fall / step) + 1) * step, float)
        return transients_at(since, 0, (0.0,), self.rise, self.fall)[:, 0], before


def transients(fitted: FittedModel, whitened: WhitenedModel) -> list[Hypothesis]:
    """The transients of each reading in what a model leaves, where they explain more than their
    number costs; none of several recordings, and none by hand, where every turn is one.

    Args:
        fitted: the model.
        whitened: the noise that it leaves.
    """
    observations = whitened.observations
    if not observations.courses or len(observations.recordings) > 1:
        return []
    found = []
    noise = whitened.noise_of(fitted.residual)
    for channel, residual, root in zip(observations.channels, noise, whitened.roots, strict=True):
        courses = [] if channel.derived else _courses(channel.time)
        for course, power in zip(
            courses, _powers(residual, root, channel.time, courses), strict=True
        ):
            rows, worth, price = _chosen(power, channel.time, course)
            if worth > 0:
                instants = np.sort(channel.time[rows] - channel.time[0])
                curve = curve_over(
                    LearnedReading,
                    "time",
                    len(rows),
                    sensor=channel.sensor,
                    axis=channel.axis,
                    instants=tuple(instants.tolist()),
                    rise=course.rise,
                    fall=course.fall,
                )
                found.append(replace(curve, log_odds=-price))
    return found


def _courses(time: Array) -> list[ResidualCourse]:
    """Those that end within the samples: a pause of the recording holds none."""
    step = float(np.median(np.diff(time)))
    duration = step * (len(time) - 1)
    every = [ResidualCourse(share * fall, fall) for fall, share in product(FALLS, RISES)]
    return [c for c in every if c.rise > SHORTEST * step and c.duration < LONGEST * duration]


def _powers(
    residual: Array, root: Array, time: Array, courses: Sequence[ResidualCourse]
) -> Iterator[Array]:
    """What a transient of each course with its peak at each row explains of a whitened residual, in
    units of the noise about it, (n,) each.

    Args:
        residual: cosine coefficients in units of the noise, (n,).
        root: the noise, (n,).
        time: s, (n,).
        courses: of the transients.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    n, step = len(time), float(np.median(np.diff(time)))
    left = limited(residual)
    again = inverse_cosines(cosines(left) / root)
    sampled = [course.sampled(step) for course in courses]
    length = next_fast_len(n + max((len(v) for v, _ in sampled), default=0), real=True)
    transformed = rfft(again, length)
    for values, peak in sampled:
        middle = np.zeros(n)
        start = (n - len(values)) // 2
        middle[start : start + len(values)] = values
        energy = float(np.sum((cosines(middle) / root) ** 2))
        # inner products with the course that begins at each row; its peak comes later
        along = irfft(transformed * rfft(values, length).conj(), length)
        along = np.roll(along, peak)[:n]
        yield along**2 / energy / noise_about(left, len(values))


def _chosen(power: Array, time: Array, course: ResidualCourse) -> tuple[Index, float, float]:
    """Rows of the transients that are worth most, by how much they explain more than the choice of
    their instants and their sizes cost, and the price of the choice, nats.
    """
    rows = _apart(power, time, course.duration)
    if not len(rows):
        return rows, 0.0, 0.0
    ways = max(float(np.ptp(time)) / min(course.rise, course.fall), len(rows) + 1.0)
    count = np.arange(1, len(rows) + 1)
    # of choosing so many of all places, one after the other
    price = np.cumsum(np.log((ways - count + 1) / count))
    worth = np.cumsum(power[rows]) / 2 - SIZE * count - price
    k = int(np.argmax(worth))
    return rows[: k + 1], float(worth[k]), float(price[k])


def _apart(power: Array, time: Array, width: float) -> Index:
    """Rows of the largest powers, strongest first, none within the width of a stronger one, s."""
    left, rows = power.copy(), []
    for _ in range(MOST):
        row = int(np.argmax(left))
        if left[row] <= 0:
            break
        rows.append(row)
        left[np.abs(time - time[row]) < width] = 0.0
    return np.array(rows, np.intp)
