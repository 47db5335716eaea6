"""What searches for oscillations without a name share: the residual in which they look, and the
prior.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.special import expit, logsumexp

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Channel
from tiltcal.diagnosis.hypotheses.priors import NAMELESS
from tiltcal.diagnosis.lines.limited_residual import limited, noise_about
from tiltcal.diagnosis.model.whitened_model import WhitenedModel

ROWS = 256  # that tell the noise about each
EXCESS = 10.0 ** np.arange(-2, 2.5, 0.5)
"""Power of an oscillation, in that of the noise: each as probable as another."""


def searched(whitened: WhitenedModel, floors: Mapping[str, float]) -> Iterator[tuple[int, Channel]]:
    """The channels in which oscillations are looked for, with their numbers; none by hand, where a
    hand trembles at no steady frequency.

    Args:
        whitened: whose channels.
        floors: sensors with coarse codes, which oscillate with the input: none of them.
    """
    observations = whitened.observations
    for k, channel in enumerate(observations.channels if observations.courses else ()):
        if not channel.derived and channel.sensor not in floors:
            yield k, channel


def probability(factor: float, whitened: WhitenedModel) -> float:
    """That an oscillation is there. factor: logarithm of its Bayes factor in one channel."""
    prior = NAMELESS - float(np.log(len(whitened.observations.channels)))
    return float(expit(factor + prior))


def equalised(residual: Array) -> Array:
    """A residual in time, behind the limiter, in units of the noise about each row, (n,). residual:
    cosine coefficients in units of the noise, (n,).
    """
    left = limited(residual)
    return np.asarray(left / np.sqrt(noise_about(left, ROWS)))


def log_excess_of_sums(total: Array, count: int) -> Array:
    """Logarithm of the Bayes factor of sums of powers with something in them, (n,): powers that are
    1 + EXCESS times as large.

    Args:
        total: sums of powers in units of the usual one, exponential in noise, (n,).
        count: of how many powers.
    """
    more = EXCESS[:, None]
    each = total * more / (1 + more) - count * np.log1p(more)
    return np.asarray(logsumexp(each, axis=0) - np.log(len(EXCESS)))
