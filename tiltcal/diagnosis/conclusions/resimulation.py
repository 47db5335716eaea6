"""The amended scenario is simulated again and compared with the recording."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.statistics.noise_spectrum import robust_white


@dataclass(frozen=True)
class Resimulation:
    """How far the simulator's run of the amended scenario is from the recording.

    Args:
        rms: of measured minus simulated, in standard deviations of a sample's noise, all channels
            together.
        algebra: largest distance of the simulator from the closed form that was fitted, in the same
            unit.
    """

    rms: float
    algebra: float

    @property
    def words(self) -> str:
        """As a note."""
        return (
            f"re-simulated with the amended scenario: residual {self.rms:.3f} of a sample's noise"
            f" rms; the simulator and the fitted algebra differ by {self.algebra:.2g} at most"
        )


def resimulate(
    laboratory: Laboratory, amended: Scenario, observations: Observations, fitted: list[Array]
) -> Resimulation | None:
    """Run the amended scenario along the first recording.

    Args:
        laboratory: the simulator.
        amended: what it runs.
        observations: what was read; its columns mean what they say, so that faults of meaning are
            left out of the run.
        fitted: what the closed form says each channel should have read, (n,).
    """
    recording = observations.recordings[0]
    try:
        predicted = laboratory.predict(amended, recording)
    except TiltcalError:
        return None
    left, apart, count = 0.0, 0.0, 0
    for channel, algebra in zip(observations.channels, fitted, strict=True):
        if channel.recording or channel.derived:
            continue
        sensor = amended.named(channel.sensor)
        samples = predicted.sensor(sensor)
        full = np.full(len(recording), np.nan)
        full[samples.rows] = samples.values[:, channel.column]
        there = ~np.isnan(full[channel.rows])
        noise = robust_white((channel.values - algebra)[there])
        error = (channel.values - full[channel.rows])[there] / noise
        left += float(error @ error)
        count += int(there.sum())
        apart = max(
            apart, float(np.abs((algebra - full[channel.rows])[there]).max(initial=0.0)) / noise
        )
    return Resimulation(float(np.sqrt(left / count)), apart) if count else None
