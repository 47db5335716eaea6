"""Noise whose size depends on the state: studentised test for heteroscedasticity (Koenker, J.
Econometrics 17, 1981).

The squares of the whitened residual are regressed on a coordinate. n R^2 is chi-square with one
degree of freedom where the variance does not depend on it, whatever the kurtosis of the noise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.finding_tests import ALPHA, log_tail
from tiltcal.statistics.noise_spectrum import NoiseModel

ROUNDING = 1e-9  # of a coordinate: what varies by less is constant


@dataclass(frozen=True)
class NoiseDependence:
    """A channel's noise follows a coordinate.

    Args:
        coordinate: ``motion`` (0 at rest, 1 moving), ``time``, ``temperature`` or ``input``.
        ratio: standard deviation in the upper half of the coordinate's range over the lower half.
        p_value: corrected for all channels and coordinates.
    """

    coordinate: str
    ratio: float
    p_value: float

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {"coordinate": self.coordinate, "ratio": self.ratio, "p_value": self.p_value}

    def words(self, channel: Channel) -> str:
        """For the notes."""
        halves = {
            "motion": ("while moving", "at rest"),
            "time": ("in the second half of the record", "in the first"),
        }
        others = f"in the upper half of the range of {self.coordinate}", "in the lower half"
        high, low = halves.get(self.coordinate, others)
        return (
            f"the noise of {channel.sensor} {channel.axis} is {self.ratio:.3g} times as large"
            f" {high} as {low}"
        )


def noise_dependences(
    observations: Observations, residuals: Sequence[Array], noise: Sequence[NoiseModel]
) -> list[tuple[NoiseDependence, ...]]:
    """What the noise of each channel depends on, the most significant first.

    Args:
        observations: whose channels.
        residuals: of each channel, SI, (n,).
        noise: of each.
    """
    tests = [
        dict(_tests(_coordinates(observations, channel, r), _own_noise(channel, r, model)))
        if not channel.derived
        else {}
        for channel, r, model in zip(observations.channels, residuals, noise, strict=True)
    ]
    tried = sum(len(each) for each in tests)
    return [_significant(each, tried) for each in tests]


def _own_noise(channel: Channel, residual: Array, noise: NoiseModel) -> Array:
    """A whitened residual that grows with the motion as the channel's own noise does, (n,)."""
    white = noise.whiten(channel.weighed(residual))
    return white if channel.growth is None else white * channel.growth


def _significant(
    tests: Mapping[str, tuple[float, float]], tried: int
) -> tuple[NoiseDependence, ...]:
    found = [
        NoiseDependence(name, ratio, min(float(np.exp(log_p)) * tried, 1.0))
        for name, (log_p, ratio) in tests.items()
        if log_p + np.log(tried) < np.log(ALPHA)
    ]
    return tuple(sorted(found, key=lambda d: d.p_value))


def _tests(
    coordinates: Mapping[str, Array], white: Array
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Of each coordinate that varies: log p-value, and the ratio of standard deviations."""
    power = white**2
    for name, u in coordinates.items():
        varies = len(u) > 2 and np.ptp(u) > ROUNDING * np.abs(u).max()
        if varies and np.isfinite(u).all() and np.var(power) > 0:
            statistic = len(u) * float(np.corrcoef(u, power)[0, 1]) ** 2
            high = u > (u.min() + u.max()) / 2
            ratio = power[high].mean() / max(power[~high].mean(), np.finfo(float).tiny)
            yield name, (log_tail(statistic, 1), float(np.sqrt(ratio)))


def _coordinates(observations: Observations, channel: Channel, residual: Array) -> dict[str, Array]:
    """By name, (n,) each. The input is the predicted one, which holds no noise of the channel."""
    found = {
        "motion": (channel.stop < 0).astype(float),
        "time": channel.time,
        "input": np.nan_to_num(np.abs(channel.values - residual)),
    }
    temperature = observations.recordings[channel.recording].temperature()
    return found if temperature is None else found | {"temperature": temperature[channel.rows]}
