"""How well a model fits, before and after: under one white noise that is fixed before anything is
explained, and by its likelihood under the noise that it leaves.

What a finding adds to the likelihood of the readings: the model with it against the same one
without it, fitted again, each under the most probable noise that it leaves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.conclusions.finding import Fitness
from tiltcal.diagnosis.conclusions.residual_plots import unit_of
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.cross_validation import heldout_log_likelihood, heldout_misfit
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.best_shape import shapes
from tiltcal.effects.base import Effect
from tiltcal.statistics.dwell_noise import robust_white
from tiltcal.statistics.noise_spectrum import NoiseModel, white_noise

MIN_SAMPLES = 8  # samples that a channel's white noise can be told from
CLIP = 3.0  # standard deviations
CLIPPED = 0.97334  # variance of a normal within them


def under_fixed_white(start: FittedModel, whitened: WhitenedModel) -> WhitenedModel:
    """The same columns under the white noise of each channel, fixed before anything is explained.

    It is taken from second differences of neighbouring samples of what the calibrated scenario
    leaves: neither slow physics nor slow noise is in them. The samples are those that are fitted,
    averaged in blocks where these are.
    """
    noise = []
    for channel, r, own in zip(
        whitened.observations.channels,
        whitened.observations.residuals(start.effects),
        whitened.noise,
        strict=True,
    ):
        level = white_level(channel.weighed(r)) if len(r) >= MIN_SAMPLES else own.white
        noise.append(white_noise(max(level, channel.white)))
    return whitened.under(noise)


def white_level(residual: Array) -> float:
    """Standard deviation of a sample's white noise, (n,) -> 1: the rms second difference over
    sqrt(6), those beyond three robust standard deviations left out and made up for.

    Its own standard uncertainty is a share of about 1/sqrt(n).
    """
    rough = robust_white(residual)
    second = np.abs(residual[2:] - 2 * residual[1:-1] + residual[:-2]) / np.sqrt(6)
    inside = second[second < CLIP * rough]
    fine = float(np.sqrt(np.mean(inside**2) / CLIPPED)) if inside.any() else 0.0
    return max(fine, rough / 2)  # of coarse codes most second differences are nothing


def fitness_of(fitted: FittedModel, white: WhitenedModel, own: Sequence[NoiseModel]) -> Fitness:
    """The figures of a fitted model.

    Args:
        fitted: the model.
        white: its columns under the fixed white noise.
        own: the noise that it leaves, of each channel.
    """
    observations = white.observations
    left = sum(float(r @ r) for r in white.residual(fitted.effects))
    dof = observations.samples - fitted.rank
    chi2 = left / dof if dof > 0 else float("nan")
    if not np.isfinite(chi2):
        return Fitness(None, rms_of(observations, fitted.effects))
    return Fitness(
        chi2,
        rms_of(observations, fitted.effects),
        heldout_misfit(fitted, white),
        log_likelihood(fitted.effects, white.under(own)),
    )


def rms_of(observations: Observations, effects: Sequence[Effect]) -> dict[str, float]:
    """Rms of what these effects leave of each channel of the first recording, SI, by name with
    unit.
    """
    found: dict[str, float] = {}
    for channel, r in zip(observations.channels, observations.residuals(effects), strict=True):
        name = f"{channel.sensor}_{channel.axis}_{unit_of(channel, observations)}"
        found.setdefault(name, float(np.sqrt(np.mean(r * r))))
    return found


def log_likelihood(effects: Sequence[Effect], whitened: WhitenedModel) -> float:
    """Whittle's log-likelihood of the readings under a noise of each channel, nats."""
    observations, total = whitened.observations, 0.0
    every = observations.residual_waves(effects)
    for channel, waves, model in zip(observations.channels, every, whitened.noise, strict=True):
        spectrum = model.spectrum(len(waves))
        total -= 0.5 * float((np.log(2 * np.pi * spectrum) + waves**2 / spectrum).sum())
        if channel.spread is not None:
            total -= float(np.log(channel.spread).sum())
    left = {i: w / root for i, (w, root) in enumerate(zip(every, whitened.roots, strict=True))}
    return total + sum(one.log_ratio(left) for one in whitened.settings)


@dataclass(frozen=True)
class LikelihoodGain:
    """What one finding adds.

    Args:
        delta_bic: Bayesian information criterion of the model with it less that without it
            (Schwarz, Ann. Stat. 6, 1978): its sizes and the continuous shapes of its law count as
            parameters.
        heldout: rise of the log-likelihood of left-out blocks, nats.
    """

    delta_bic: float
    heldout: float


def likelihood_gains(
    fitted: FittedModel, whitened: WhitenedModel, noise_source: NoiseSource
) -> list[LikelihoodGain]:
    """Of each finding.

    Args:
        fitted: the whole model.
        whitened: columns under the most probable noise that it leaves.
        noise_source: where the noise is taken from.
    """
    whole = _likelihoods(fitted, whitened)
    samples = np.log(max(whitened.observations.samples, 2))
    found = []
    for places in fitted.findings():
        rest = _likelihoods(*_without(fitted, whitened, places, noise_source))
        rise, heldout = (a - b for a, b in zip(whole, rest, strict=True))
        count = sum(len(fitted.terms[k].names) for k in places)
        count += len(shapes(fitted.terms[places[0]].hypothesis))
        found.append(LikelihoodGain(float(samples * count - 2 * rise), heldout))
    return found


def _likelihoods(fitted: FittedModel, whitened: WhitenedModel) -> tuple[float, float]:
    """Log-likelihood of all readings, and that of left-out blocks, nats."""
    return log_likelihood(fitted.effects, whitened), heldout_log_likelihood(fitted, whitened)


def _without(
    fitted: FittedModel, whitened: WhitenedModel, places: Sequence[int], noise_source: NoiseSource
) -> tuple[FittedModel, WhitenedModel]:
    """The model without the terms at these places, fitted again under the noise that it leaves."""
    terms = tuple(t for k, t in enumerate(fitted.terms) if k not in places)
    rest = refit(replace(fitted, terms=terms), whitened)
    left = noise_source.left_by(rest, whitened)
    return refit(rest, left), left
