"""Lines over time in a coefficient: the delay of stamps, the tilts of the base, scale factors.

What such a line does to a reading is a cosine times what one of the coefficient does there, which
changes with pose and motion: in the reading itself it is many lines.
"""

from collections.abc import Iterable

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.curve_forms import curve_over
from tiltcal.diagnosis.hypotheses.periodic_curves import frames, gains, stamped
from tiltcal.diagnosis.lines.lines_over_angles import CHANCE, FINER
from tiltcal.diagnosis.lines.spectral_peaks import apart, evenly, peaks
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import LearnedDelay, LearnedReading, LearnedTilt
from tiltcal.statistics.dwell_noise import robust_white

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
