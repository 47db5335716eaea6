"""What comes to a reading at an instant and goes away again: a draught, a knock, a discharge.

The instants come from a matched filter on the whitened residual (Turin, IRE Trans. Inf. Theory 6,
1960), in units of the noise about each of them, so that a burst of noise is none.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis, with_values
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.learned import LearnedReading

RISES = (0.5, 1.5, 4.5, 13.5)  # s
FALL = 3.0  # rises, the time constant with which it goes away
END = 8.0  # rises, after which it is gone
KNOTS = (-1.0, 0.0, 1.0, 2.0, 4.0, END)  # rises, of its course: nothing at both ends
SHORTEST = 2.0  # samples of a rise
LONGEST = 0.2  # of a recording that a transient may last
AROUND = 64  # samples at least that tell the noise about an instant
CHANCE = 1e-4  # of a transient in any recording without one
MOST = 8


@dataclass(frozen=True)
class Transient:
    """A transient of one reading.

    Args:
        sensor, axis: of the reading.
        begin: s from the first stamp; rise: s.
        power: what it explains, in units of the noise about it.
    """

    sensor: str
    axis: str
    begin: float
    rise: float
    power: float = 0.0

    def meets(self, other: "Transient") -> bool:
        """Whether it begins in another one of the same reading, or that in it."""
        same = (self.sensor, self.axis) == (other.sensor, other.axis)
        return same and -END * self.rise < self.begin - other.begin < END * other.rise

    def hypothesis(self, odds: float) -> Hypothesis:
        """A course over time, nothing at both ends; odds: of its instant and rise."""
        knots = tuple(self.begin + self.rise * k for k in KNOTS)
        curve = curve_over(LearnedReading, "time", knots, sensor=self.sensor, axis=self.axis)
        inner = {name: curve.effect.values[name] for name in curve.names[1:-1]}
        return Hypothesis(with_values(curve.effect, inner), tuple(inner), odds=odds)


def transients(fitted: FittedModel, whitened: WhitenedModel) -> list[Hypothesis]:
    """Transients of single readings in what a model leaves, strongest first, apart from those that
    have hypotheses; none of several recordings, and none by hand, where every turn is one.

    Each pays for the instants and the rises among which it was found.

    Args:
        fitted: the model.
        whitened: all hypotheses under the noise that it leaves.
    """
    observations = whitened.observations
    if not observations.courses or len(observations.recordings) > 1:
        return []
    found: list[Transient] = []
    places = 0.0
    for channel, residual, root in zip(
        observations.channels, fitted.residual, whitened.roots, strict=True
    ):
        for rise in [] if channel.derived else _rises(channel.time):
            places += float(np.ptp(channel.time)) / rise
            power, since = _powers(residual, root, channel.time, rise), channel.time
            found += [
                Transient(channel.sensor, channel.axis, float(since[k] - since[0]), rise, power[k])
                for k in _peaks(power)
            ]
    known = [t for h in whitened.hypotheses if (t := _transient_of(h)) is not None]
    new: list[Transient] = []
    for one in sorted(found, key=lambda t: -t.power):
        clear = one.power > 2 * np.log(places / CHANCE)
        if clear and len(new) < MOST and not any(one.meets(t) for t in (*known, *new)):
            new.append(one)
    odds = float(np.log(max(len(new), 1) / places))  # they share the prior of all places
    return [t.hypothesis(odds) for t in new]


def _transient_of(hypothesis: Hypothesis) -> Transient | None:
    """The transient that a hypothesis is; None for any other."""
    effect = hypothesis.effect
    if not isinstance(effect, LearnedReading) or len(hypothesis.names) == len(effect.knots):
        return None
    if effect.coordinate != "time" or len(effect.knots) != len(KNOTS):
        return None
    begin = effect.knots[1]
    return Transient(str(effect.sensor), str(effect.axis), begin, begin - effect.knots[0])


def _rises(time: Array) -> list[float]:
    step, duration = float(np.median(np.diff(time))), float(np.ptp(time))
    return [r for r in RISES if r > SHORTEST * step and (1 + END) * r < LONGEST * duration]


def _powers(residual: Array, root: Array, time: Array, rise: float) -> Array:
    """What a transient from each row on explains of a whitened residual, in units of the noise
    about it, (n,).

    Args:
        residual: cosine coefficients in units of the noise, (n,).
        root: the noise, (n,).
        time: s, (n,); rise: s.
    """
    from scipy.fft import dct, idct
    from scipy.ndimage import uniform_filter1d
    from scipy.signal import fftconvolve

    step = float(np.median(np.diff(time)))
    u = np.arange(-int(rise / step), int(END * rise / step) + 1) * step / rise
    course = np.where(u < 0, 1 + u, np.exp(-u / FALL))
    middle = np.zeros(len(time))
    start = (len(time) - len(course)) // 2
    middle[start : start + len(course)] = course
    energy = float(np.sum((dct(middle, norm="ortho") / root) ** 2))
    along = fftconvolve(idct(residual / root, norm="ortho"), course[::-1], mode="full")
    along = along[len(course) - 1 - int(rise / step) :][: len(time)]
    white = np.diff(idct(residual, norm="ortho"), 2) ** 2 / 6
    near = uniform_filter1d(np.pad(white, 1, mode="edge"), max(len(course), AROUND))
    return np.asarray(along**2 / energy / np.maximum(near, 1.0))


def _peaks(power: Array) -> list[int]:
    """Rows of the largest powers, each the largest near it."""
    from scipy.signal import find_peaks

    rows = find_peaks(power)[0]
    return [int(k) for k in rows[np.argsort(-power[rows])][:MOST]]
