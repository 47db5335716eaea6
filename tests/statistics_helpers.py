"""Seeds and bands of the statistical tests: fixed by the test's name, computed from the
distribution, never tuned.
"""

import os
import zlib

import numpy as np
from scipy.stats import chi2, norm

# of one comparison: the chance that a correct product fails it (the seed fixes the outcome)
FALSE_ALARM = 1e-4


def seed_of(test_name: str) -> int:
    """The seed of a test."""
    return zlib.crc32(test_name.encode())


def rng_of(test_name: str) -> np.random.Generator:
    """The random stream of a test."""
    return np.random.default_rng(seed_of(test_name))


def draws_of(full: int) -> int:
    """Number of draws of a test whose claim is measured with ``full`` of them: a tenth
    in the suite, with the bands of a tenth; all with ``TILTCAL_DRAWS=full``, as in `make bench`.
    """
    return full if os.environ.get("TILTCAL_DRAWS") == "full" else full // 10


def variance_band(dof: int, comparisons: int = 1) -> tuple[float, float]:
    """Limits of (sample variance / true variance) for ``dof`` degrees of freedom, Bonferroni over
    the comparisons.
    """
    p = FALSE_ALARM / comparisons
    return float(chi2.ppf(p / 2, dof) / dof), float(chi2.isf(p / 2, dof) / dof)


def mean_band(samples: np.ndarray, comparisons: int = 1) -> float:
    """Half-width of the band of a mean of independent samples, from their own spread. samples: (n,)
    or (n, k).
    """
    z = float(norm.isf(FALSE_ALARM / comparisons / 2))
    return np.asarray(z * samples.std(axis=0, ddof=1) / np.sqrt(len(samples)))
