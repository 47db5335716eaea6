"""Inverse of inner products of columns, of which some may be dependent or hardly show."""

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.statistics.least_squares import DISTINCT


def column_lengths(gram: Array, sized: Mask) -> Array:
    """Lengths of columns, (p,). One that hardly shows at a plausible size is not scaled up: what is
    left of it may be rounding. Curves have no plausible size, and no rounding.

    Args:
        gram: inner products, (p, p).
        sized: whether each column is of a plausible size, (p,).
    """
    least = np.where(sized | (np.diag(gram) <= 0), 1.0, 0.0)
    return np.asarray(np.sqrt(np.maximum(np.diag(gram), least)))


def pseudo_inverse(gram: Array) -> tuple[Array, Array]:
    """Of the inner products of columns of unit length; what is left undetermined stays where it
    is. Returns the inverse, and the undetermined directions, (p, q).
    """
    values, vectors = np.linalg.eigh(gram)
    keep = values > DISTINCT * len(values)
    return np.asarray((vectors[:, keep] / values[keep]) @ vectors[:, keep].T), vectors[:, ~keep]


def prior_covariance(directions: Array, prior: Array) -> Array:
    """Covariance along directions that the readings leave undetermined, (p, p): that of the prior,
    whose inverse variances these are, (p,).
    """
    known = directions.T * prior @ directions
    return np.asarray(directions @ np.linalg.pinv(known, hermitian=True) @ directions.T)
