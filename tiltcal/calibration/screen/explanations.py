"""Which cause explains what a model leaves: causes are compared by what they leave themselves, and
those that fit alike are given as a class.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.validity import SIGNIFICANCE
from tiltcal.statistics.least_squares import Fit

# of BIC: twice the logarithm of the odds, 20 to 1 (Kass and Raftery 1995: strong)
ALIKE = 2 * float(np.log(20))


@dataclass(frozen=True)
class Explanation:
    """A cause that was tried.

    Args:
        words: the cause.
        chi2, dof: that it leaves.
        bic: chi2 plus its parameters times the logarithm of the number of readings.
        freedom: degrees of freedom of the noise that chi2 is in units of.
    """

    words: str
    chi2: float
    dof: int
    bic: float
    freedom: float = 1e9  # known

    @classmethod
    def of(cls, words: str, chi2: float, dof: int, readings: int, tried: int) -> "Explanation":
        """From what the cause leaves of some readings; tried: places at which it was looked for."""
        bic = chi2 + (readings - dof) * float(np.log(readings)) + 2 * float(np.log(tried))
        return cls(words, chi2, dof, bic)

    @property
    def fits(self) -> bool:
        """Whether what it leaves is noise."""
        from scipy.special import fdtrc

        if self.dof <= 0:
            return False
        return float(fdtrc(self.dof, self.freedom, self.chi2 / self.dof)) > SIGNIFICANCE


def explanation(
    words: str, fit: Fit, tried: int = 1, *, further: int = 0, readings: int | None = None
) -> Explanation:
    """An explanation by a fit.

    Args:
        words: the cause.
        fit: with it.
        tried: places at which the cause was looked for (dwells, instants): each choice costs.
        further: parameters of the cause that the fit does not count.
        readings: that all causes share, where this fit leaves some out; those are its parameters.
    """
    n = len(fit.residuals) if readings is None else readings
    return Explanation.of(words, fit.chi2, fit.dof - further, n, tried)


def alike(found: Iterable[Explanation]) -> list[Explanation]:
    """The best of the causes that leave noise only, and those that the readings cannot tell from
    it, best first. Empty where none does.
    """
    fitting = sorted((e for e in found if e.fits), key=lambda e: (round(e.bic, 6), e.words))
    return [e for e in fitting if e.bic <= fitting[0].bic + ALIKE]


def in_words(found: Iterable[Explanation], nothing: str) -> str:
    """The class of causes in words; ``nothing`` where no single cause explains the residuals."""
    words = [e.words for e in alike(found)]
    if not words:
        return nothing
    if len(words) == 1:
        return f"explained by one cause: {words[0]}"
    return "these causes fit alike: " + "; or ".join(words)
