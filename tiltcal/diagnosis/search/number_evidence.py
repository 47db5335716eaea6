"""The evidence for a number of a cause, also where the data count less.

A coarsened posterior raises the likelihood to a power below one (Miller and Dunson, J. Am. Stat.
Assoc. 114, 2019): what a number explains counts less, what its prior costs does not.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.model.bayes_factors import log_bayes_factor


@dataclass(frozen=True)
class NumberEvidence:
    """One number of a cause, beside those before it.

    Args:
        gain: fall of the deviance along it.
        ratio: prior variance over that of the estimate, for each width, (k,).
        price: of its choice, nats.
        needed: whether the cause has it in any case.
    """

    gain: float
    ratio: Array
    price: float = 0.0
    needed: bool = False

    @property
    def evidence(self) -> float:
        """Log Bayes factor less its price, nats."""
        return self._less(1.0)

    @property
    def plausible(self) -> bool:
        """Whether it is at most one standard deviation of its widest prior."""
        return self.gain <= float(self.ratio.max(initial=0.0))

    def at(self, coarse: float) -> float:
        """The same where the likelihood is raised to the power 1/coarse, nats. A number that is not
        worth its price there is not in use.
        """
        worth = self._less(coarse)
        return worth if self.needed else max(worth, 0.0)

    def _less(self, coarse: float) -> float:
        gain, ratio = np.array([self.gain]) / coarse, self.ratio[:, None] / coarse
        return float(log_bayes_factor(gain, ratio)[0]) - self.price
