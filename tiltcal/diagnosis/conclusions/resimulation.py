"""The amended scenario is simulated again and compared with the fit and with the recording."""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.conclusions.fit_figures import MIN_SAMPLES
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.finding_tests import ALPHA
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import robust_white

LIMIT = 2 * float(np.log(1 / ALPHA))  # of chi-square


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
    def failed(self) -> bool:
        """Whether the recording is less probable by the simulator's run than by the fit, 1 / ALPHA
        times and more.
        """
        return not self.rise <= LIMIT

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
            f" {self.rise:.3g} to chi-square; from {LIMIT:.3g} the recording is {1 / ALPHA:.0f}"
            " times less probable"
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
        if there.sum() < MIN_SAMPLES:
            continue
        read, fit, again = (channel.weighed(v)[there] for v in (channel.values, algebra, run))
        noise = robust_white(read - fit)
        error, of_fit, beside = (read - again) / noise, (read - fit) / noise, (fit - again) / noise
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
