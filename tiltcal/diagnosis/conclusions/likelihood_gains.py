"""What a finding adds to the likelihood of the readings: the model with it against the same one
without it, fitted again, each under the most probable noise that it leaves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.diagnosis.conclusions.fit_figures import log_likelihood
from tiltcal.diagnosis.model.cross_validation import heldout_log_likelihood
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.shape_refinement import shapes


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
    noise, observations = whitened.noise, whitened.observations
    return (
        log_likelihood(observations, fitted.effects, noise),
        heldout_log_likelihood(fitted, whitened),
    )


def _without(
    fitted: FittedModel, whitened: WhitenedModel, places: Sequence[int], noise_source: NoiseSource
) -> tuple[FittedModel, WhitenedModel]:
    """The model without the terms at these places, fitted again under the noise that it leaves."""
    terms = tuple(t for k, t in enumerate(fitted.terms) if k not in places)
    rest = refit(replace(fitted, terms=terms), whitened)
    left = noise_source.left_by(rest, whitened)
    return refit(rest, left), left
