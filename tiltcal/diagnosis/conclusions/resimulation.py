"""The amended scenario is simulated again and compared with the fit and with the recording."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.conclusions.fit_figures import FEWEST
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.finding_tests import ALPHA
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import robust_white


@dataclass(frozen=True)
class Resimulation:
    """How far the simulator's run of the amended scenario is from the recording.

    Args:
        rms: of measured minus simulated, in standard deviations of a sample's noise, all channels
            together.
        algebra: largest distance of the simulator from the closed form that was fitted, in the same
            unit.
        rise: sum of squares of measured minus simulated, less that of measured minus fitted, in
            squares of that unit.
        samples: how many there are; 0 where nothing was simulated.
        refused: why the simulator did not run.
    """

    rms: float = 0.0
    algebra: float = 0.0
    rise: float = 0.0
    samples: int = 0
    refused: str = ""

    @property
    def limit(self) -> float:
        """What chance adds to the chi-square of so many samples in a share ALPHA of recordings."""
        from scipy.special import chdtri

        return float(chdtri(self.samples, ALPHA)) - self.samples if self.samples else np.inf

    @property
    def failed(self) -> bool:
        """Whether the simulator is further from the recording than the fit, by more than chance
        moves a chi-square.

        By hand the two may differ, because each reads the motion from noisy sensors in its own way.
        """
        return not self.rise <= self.limit

    @property
    def words(self) -> str:
        """As a note."""
        if self.refused:
            return f"not re-simulated: {self.refused}"
        if not self.samples:
            return "not re-simulated: the simulator predicts none of the channels that were fitted"
        return (
            f"re-simulated with the amended scenario: residual {self.rms:.3f} of a sample's noise"
            f" rms; the simulator and the fitted algebra differ by {self.algebra:.2g} at most"
        )

    @property
    def failure(self) -> str:
        """How much worse it is than the fit."""
        return (
            f"it differs by up to {self.algebra:.3g} of a sample's noise, which adds"
            f" {self.rise:.3g} to chi-square where chance adds {self.limit:.3g} in {ALPHA:.0%} of"
            " recordings"
        )


def resimulate(
    laboratory: Laboratory, amended: Scenario, observations: Observations, fitted: list[Array]
) -> Resimulation:
    """Run the amended scenario along every recording.

    Args:
        laboratory: the simulator.
        amended: what it runs.
        observations: what was read; its columns mean what they say, so that faults of meaning are
            left out of the run.
        fitted: what the closed form says each channel should have read, (n,).
    """
    try:
        runs = [laboratory.predict(amended, r, by_others=True) for r in observations.recordings]
    except TiltcalError as refusal:
        return Resimulation(refused=str(refusal))
    left, rise, furthest, count = 0.0, 0.0, 0.0, 0
    for channel, algebra in zip(observations.channels, fitted, strict=True):
        if channel.derived:
            continue
        run = _as_simulated(channel, runs[channel.recording], amended)
        there = ~np.isnan(run) & ~np.isnan(algebra)
        if there.sum() < FEWEST:
            continue
        noise = robust_white((channel.values - algebra)[there])
        error = (channel.values - run)[there] / noise
        beside = (algebra - run)[there] / noise
        of_fit = (channel.values - algebra)[there] / noise
        left += float(error @ error)
        rise += float(error @ error - of_fit @ of_fit)
        count += int(there.sum())
        furthest = max(furthest, float(np.abs(beside).max()))
    rms = float(np.sqrt(left / count)) if count else 0.0
    return Resimulation(rms, furthest, rise, count)


def _as_simulated(channel: Channel, run: Recording, amended: Scenario) -> Array:
    """What the simulator reads in the rows of a channel, SI, (n,); NaN where it reads nothing."""
    samples = run.sensor(amended.named(channel.sensor))
    full = np.full(len(run), np.nan)
    full[samples.rows] = samples.values[:, channel.column]
    return np.asarray(full[channel.rows])
