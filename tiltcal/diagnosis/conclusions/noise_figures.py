"""The noise that a model leaves: its amplitudes, and how much of the residual is slow.

Noise whose size depends on the state: studentised test for heteroscedasticity (Koenker, J.
Econometrics 17, 1981).

The squares of the whitened residual are regressed on a coordinate. n R^2 is chi-square with one
degree of freedom where the variance does not depend on it, whatever the kurtosis of the noise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import G0
from tiltcal.diagnosis.conclusions.residual_plots import unit_of
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.model.finding_tests import ALPHA, log_tail
from tiltcal.diagnosis.search.slow_laws import SlowLaw, probabilities
from tiltcal.effects import CATALOGUE, Parameter
from tiltcal.effects.sensor.noise import Noise
from tiltcal.effects.spans import ROUNDING
from tiltcal.statistics.noise_spectrum import Amplitude, NoiseFit, NoiseModel


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
        dict(_tests(_coordinates(observations, channel, r), *_own_noise(channel, r, model)))
        if not channel.derived
        else {}
        for channel, r, model in zip(observations.channels, residuals, noise, strict=True)
    ]
    tried = sum(len(each) for each in tests)
    return [_significant(each, tried) for each in tests]


def _own_noise(channel: Channel, residual: Array, noise: NoiseModel) -> tuple[Array, Array]:
    """A whitened residual that grows with the motion as the channel's own noise does, and all that
    the residual does, (n,) each: between them lies how large the noise is where the prediction is
    uncertain.
    """
    white = noise.whiten(channel.weighed(residual))
    least = white if channel.growth is None else white * channel.growth
    return least, least * channel.uncertainty


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
    coordinates: Mapping[str, Array], least: Array, most: Array
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Of each coordinate that varies: log p-value, and the ratio of standard deviations, where the
    least and the most that the noise can be agree on which half is noisier.
    """
    for name, u in coordinates.items():
        varies = len(u) > 2 and np.ptp(u) > ROUNDING * np.abs(u).max()
        if not varies or not np.isfinite(u).all() or np.var(least) == 0:
            continue
        found = [_test(u, white**2) for white in (least, most)]
        ratios = [ratio for _, ratio in found]
        if max(ratios) < 1 or min(ratios) > 1:
            yield name, max(found)


def _test(u: Array, power: Array) -> tuple[float, float]:
    """Log p-value of squares that depend on a coordinate, and the ratio of standard deviations."""
    statistic = len(u) * float(np.corrcoef(u, power)[0, 1]) ** 2
    high = u > (u.min() + u.max()) / 2
    ratio = power[high].mean() / max(power[~high].mean(), np.finfo(float).tiny)
    return log_tail(statistic, 1), float(np.sqrt(ratio))


def _coordinates(observations: Observations, channel: Channel, residual: Array) -> dict[str, Array]:
    """By name, (n,) each. The input is the predicted one, which holds no noise of the channel."""
    found = {
        "motion": (channel.stop < 0).astype(float),
        "time": channel.time,
        "input": np.nan_to_num(np.abs(channel.values - residual)),
    }
    temperature = observations.recordings[channel.recording].temperature()
    return found if temperature is None else found | {"temperature": temperature[channel.rows]}


INTERVAL = "95 %, profile of Whittle's likelihood"
STEPS = {"white": 0.5, "flicker": 0.0, "walk": -0.5}  # power of the sampling step, s, in a density


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel.

    Args:
        amplitudes: by name, in ``units``.
        share: of the energy of the residual that is not white.
        slow: energy of the residual that is not white, in units of the white variance; energy: of
            all of it; walk: the part of the former that is a random walk, from 0 to 1.
        may_be: ids of the laws that the slow noise may be, each with its probability.
    """

    amplitudes: Mapping[str, Amplitude]
    units: Mapping[str, str]
    share: float
    slow: float
    energy: float
    walk: float
    depends: tuple[NoiseDependence, ...] = ()
    may_be: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        found: dict[str, Any] = {
            name: {"value": a.value, "low": a.low, "high": a.high, "unit": self.units[name]}
            for name, a in self.amplitudes.items()
        }
        found["share_of_residual"] = self.share
        found["may_be"] = [{"effect": id, "probability": p} for id, p in self.may_be.items()]
        return found | {"depends_on": [d.to_json() for d in self.depends]}


@dataclass(frozen=True)
class NoiseReport:
    """The noise of all channels.

    Args:
        source: where it was taken from.
        channels: by name; those of further recordings with their number.
        notes: on noise that depends on the state.
    """

    source: str = "none"
    channels: Mapping[str, ChannelNoise] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "source": self.source,
            "interval": INTERVAL,
            "channels": {name: c.to_json() for name, c in self.channels.items()},
        }

    @property
    def words(self) -> str:
        """How much of what is left is slow, of all channels together."""
        slow = sum(c.slow for c in self.channels.values())
        share = slow / max(sum(c.energy for c in self.channels.values()), 1e-300)
        if share < 0.005:
            return "less than 1 % of what is left is slow noise"
        kinds = {name for c in self.channels.values() for name in c.amplitudes}
        walk = sum(c.slow * c.walk for c in self.channels.values()) > slow / 2
        kind = "walk" if walk else "flicker"
        named = f" (mostly {kind})" if kind in kinds else ""
        return f"{100 * share:.0f} % of what is left is slow noise{named}"

    @property
    def may_be(self) -> str:
        """What slow noise may be instead, and what would tell; empty without any."""
        laws: dict[tuple[tuple[str, float], ...], list[str]] = {}
        for name, channel in self.channels.items():
            if channel.may_be:
                laws.setdefault(tuple(channel.may_be.items()), []).append(name)
        told = [
            f"The slow noise of {', '.join(names)} may be "
            + " or ".join(
                f"{CATALOGUE[id].title} ({id}, probability {p:.2f})"
                for id, p in each
                if round(p, 2) > 0
            )
            for each, names in laws.items()
        ]
        if not told:
            return ""
        ask = "record once at rest for as long (--static), or the same course twice"
        return f"{'. '.join(told)}: {ask}."


def noise_report(
    observations: Observations,
    residuals: Sequence[Array],
    fits: Sequence[NoiseFit],
    source: str,
    in_noise: Sequence[SlowLaw] = (),
) -> NoiseReport:
    """The noise of each channel as it was fitted.

    Args:
        observations: whose channels.
        residuals: of each channel, SI, (n,).
        fits: of each channel.
        source: where they were taken from.
        in_noise: laws that slow noise may be.
    """
    found: dict[str, ChannelNoise] = {}
    notes: list[str] = []
    depends = noise_dependences(observations, residuals, [f.model for f in fits])
    together = zip(observations.channels, residuals, fits, depends, strict=True)
    for number, (channel, r, fit, own) in enumerate(together):
        name = f"{channel.sensor}_{channel.axis}"
        if channel.recording:
            name = f"{name}_recording_{channel.recording + 1}"
        noise = _channel_noise(channel, observations, channel.waves(r), fit)
        found[name] = replace(noise, depends=own, may_be=probabilities(in_noise, number))
        notes += [d.words(channel) for d in own[:1]]
    return NoiseReport(source, found, tuple(notes))


def _channel_noise(
    channel: Channel, observations: Observations, waves: Array, fit: NoiseFit
) -> ChannelNoise:
    amplitudes, units = {}, {}
    for name, amplitude in fit.amplitudes.items():
        factor, units[name] = _unit(channel, observations, name)
        amplitudes[name] = amplitude.scaled(1 / factor)
    spectrum, white = fit.model.spectrum(len(waves)), fit.model.white**2
    energy = float(waves @ waves)
    slow = float(np.clip(waves**2 @ (1 - white / spectrum), 0.0, energy))
    beyond = max(float((spectrum - white).sum()), 1e-300)
    return ChannelNoise(
        amplitudes,
        units,
        slow / max(energy, 1e-300),
        slow / white,
        energy / white,
        float(fit.model.drift_spectrum(len(waves)).sum()) / beyond,
    )


def _unit(channel: Channel, observations: Observations, name: str) -> tuple[float, str]:
    """What an amplitude, SI per sample, is divided by, and the unit that it then has: that of the
    catalogue's noise where it has such a kind of noise.
    """
    grade = None if channel.axis == "turn" else _largest(channel, observations).get(name)
    if grade is None or name not in STEPS:
        return 1.0, unit_of(channel, observations)
    parameter, size = grade
    return size * _step(channel) ** -STEPS[name] / parameter.plausible[-1], parameter.unit


def _largest(channel: Channel, observations: Observations) -> dict[str, tuple[Parameter, float]]:
    """The noise of the largest grade of a sensor's kind by name: its parameter, and its size in the
    unit of the channel.
    """
    kind = observations.scenario.named(channel.sensor).kind
    cls = next(c for c in CATALOGUE.values() if issubclass(c, Noise) and kind in c.kinds)
    per = G0 if kind == "inclinometer" else 1.0
    return {p.name: (p, p.plausible[-1] * p.factor / per) for p in cls.parameters}


def _step(channel: Channel) -> float:
    """Between samples, s."""
    return float(np.median(np.diff(channel.time))) if len(channel.time) > 1 else 1.0
