"""Which columns of a law, and of what completes its form, are in use: taken in one by one.

The evidence for a number of a cause, also where the data count less.

A coarsened posterior raises the likelihood to a power below one (Miller and Dunson, J. Am. Stat.
Assoc. 114, 2019): what a number explains counts less, what its prior costs does not.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.model.score_test import ENERGIES, SIZES, SURVIVES, log_bayes_factor


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


TOLD = 0.01
"""Nats that a further size of a law has to add. One that hardly shows at plausible sizes, such as
the sine of a tone at half the sampling rate, adds next to nothing at any value.
"""


class ColumnSelection:
    """Columns taken in one by one.

    A law has at least one of its sizes, each set of them as likely as another. A number of its
    deviation is in use with a chance of one in as many as are tried.

    Args:
        gram, target: inner products of the columns, (p, p), and with what is explained, (p,).
        raw: squared lengths of the columns beside nothing else, (p,).
        law: which columns are the law's, (p,).
        shares: prior energy of each number of a deviation, in energies of the law, (s, p).
        sized: whether the catalogue says how large the law may be.

    Attributes:
        used: numbers of the columns taken in.
        choice: evidence for the choice of the law's sizes, nats.
        numbers: the evidence for each column in use.
    """

    def __init__(
        self, gram: Array, target: Array, raw: Array, law: Mask, shares: Array, sized: bool
    ) -> None:
        self.used: list[int] = []
        self.choice, self.numbers = 0.0, list[NumberEvidence]()
        self._G, self._b, self._law, self._sized = gram, target, law, sized
        self._raw, self._shares = raw, shares
        self._info, self._there = self._beside()

    def add_sizes(self) -> None:
        """Those sizes of the law that have evidence, and the strongest."""
        while (each := np.where(self._law, self._factors(self._widths()), -np.inf)).max(
            initial=-np.inf
        ) > (TOLD if self.used else -np.inf):
            self._take(int(np.argmax(each)), self._widths())
        self._rest_of_sizes()

    def take_sizes(self, which: Iterable[int]) -> None:
        """These sizes of the law, the strongest first: evidence depends on the order."""
        left = set(which)
        while left:
            left.remove(self._take_strongest(left, self._widths()))
        self._rest_of_sizes()

    def add_deviation(self, tried: int) -> None:
        """Numbers of a deviation, as long as they have evidence."""
        widths, price = self._deviation(tried)
        while tried:
            each = np.where(self._law, -np.inf, self._factors(widths)) - price
            if not each.max(initial=-np.inf) > 0:
                break
            self._take(int(np.argmax(each)), widths, price)

    def take_deviation(self, which: Iterable[int], tried: int) -> None:
        """These numbers of a deviation, the strongest first."""
        (widths, price), left = self._deviation(tried), set(which)
        while left:
            left.remove(self._take_strongest(left, widths, price))

    def _deviation(self, tried: int) -> tuple[Array, float]:
        """Prior variances of the numbers of a deviation, (s, p), and the price of each, nats."""
        return sum(n.gain for n in self.numbers) * self._shares, float(np.log(1 + tried))

    def _rest_of_sizes(self) -> None:
        """The sizes that are not in use: perhaps they are, but what they would explain is not
        explained, and of what cannot be seen there is no evidence; and the price of the choice.
        """
        left = self._law.copy()
        left[self.used] = False
        seen = self._there[left]
        rest = np.where(seen, np.minimum(self._factors(self._widths())[left], 0.0), 0.0)
        self.choice = float(np.logaddexp(0.0, rest).sum())
        self.choice -= float(np.log(2.0 ** self._law.sum() - 1))

    def _beside(self) -> tuple[Array, Mask]:
        """Information of each column beside those taken, and which still have some: what is left of
        little is rounding.
        """
        rest = np.diag(self._G)
        there = rest > SURVIVES * self._raw
        there[self.used] = False
        return np.where(there, rest, 1.0), there

    def _widths(self) -> Array:
        """Prior variances of the sizes of the law over those of their estimates, (k, p)."""
        if self._sized:
            return np.asarray(SIZES[:, None] * self._info)
        return ENERGIES[:, None] + 0.0 * self._info

    def _factors(self, widths: Array) -> Array:
        """Log Bayes factor of each column, under each of these prior variances alike, (p,)."""
        factors = log_bayes_factor(self._b**2 / self._info, widths)
        return np.where(self._there, factors, -np.inf)

    def _take_strongest(self, left: Collection[int], widths: Array, price: float = 0.0) -> int:
        """Take in the column of these that has the largest evidence; its number."""
        factors = self._factors(widths)
        i = max(sorted(left), key=lambda i: factors[i])
        self._take(i, widths, price)
        return i

    def _take(self, i: int, widths: Array, price: float = 0.0) -> None:
        """Take in a column, with its evidence less its price. One of which the others leave next to
        nothing has no evidence, whatever it explains.
        """
        gain = float(self._b[i] ** 2 / self._G[i, i]) if self._G[i, i] > 0 else 0.0
        ratio = widths[:, i] if self._there[i] else np.zeros(len(widths))
        self.numbers.append(NumberEvidence(gain, ratio, price, needed=not self.used))
        self.used.append(i)
        if self._G[i, i] > 0:
            part = self._G[i] / self._G[i, i]
            self._b, self._G = self._b - part * self._b[i], self._G - np.outer(part, self._G[i])
        self._info, self._there = self._beside()
