"""Limits of the tilt error over all runs.

Each limit is a number for each run, and the tilt error is compared with it in four ways: its rms
over runs, its expectation by the method's own covariance, its worst run, and a quantile. Chance is
what that covariance states: the squared error of a run is bound^2 chi2(dof) / dof. A limit below
the bound gets the chance of an error at the limit, never that of a larger one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario_tables import Accept
from tiltcal.validation.limit import Judge, Limit
from tiltcal.validation.runs import Row

ROUNDING = 1e-9


@dataclass(frozen=True)
class TiltLimit:
    """Tilt errors of runs over one limit.

    Args:
        stem: its name; rms_name: that of its rms.
        ratio: error after calibration over the limit, (n,); own: the bound over it, (n,).
        dof: of the squared errors, (n,); seeds: of the runs.
        shown: from such a ratio to the figure in which the limit is stated.
        sign: ``<=`` or ``>=`` of that figure.
        quantile: that is judged.
    """

    stem: str
    rms_name: str
    ratio: Array
    own: Array
    dof: Array
    seeds: Sequence[int]
    shown: Callable[[float], float]
    sign: str
    quantile: float

    def judges(self) -> Iterator[Judge]:
        """What decides: with one run its error and its bound."""
        yield self.rms
        if self.stem != "tilt error over its bound":
            yield self.expected
        if len(self.ratio) > 1:
            yield self.worst
            yield self.below_quantile

    def rms(self, share: float) -> Limit:
        """The rms over runs."""
        reached = float(np.sqrt(np.mean(self.ratio**2)))
        dof = dof_of_mean(self.own, self.dof)
        own = min(float(np.sqrt(np.mean(self.own**2))), 1.0)
        allowed = max(1.0, own * float(_chance(share, dof)))
        ends = [self.shown(x) for x in rms_interval(reached, dof)]
        figure = self.shown(reached)
        return Limit(
            self.rms_name,
            figure,
            self._words(allowed),
            reached <= allowed,
            (min(ends), max(ends)),
        )

    def expected(self, share: float) -> Limit:
        """The error that the covariance predicts: refused where its mean square over runs is above
        the limit by more than its own scatter (Student's t).
        """
        from scipy.stats import t

        squares, n = self.own**2, len(self.own)
        mean = float(np.mean(squares))
        spread = float(np.std(squares, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
        slack = float(t.isf(share, n - 1)) * spread if spread else 0.0
        passed = mean - slack <= 1.0 + ROUNDING
        name = f"{self.stem}, expected by the covariance"
        return Limit(name, self.shown(np.sqrt(mean)), self._words(np.sqrt(1 + slack)), passed)

    def worst(self, share: float) -> Limit:
        """Every run by itself."""
        allowed = self._allowed(share / len(self.ratio))
        k = int(np.argmax(self.ratio / allowed))
        passed = bool(np.all(self.ratio <= allowed))
        figure, words = self.shown(self.ratio[k]), self._words(allowed[k])
        return Limit(
            f"{self.stem}, worst run", figure, words, passed, where=f"seed {self.seeds[k]}"
        )

    def below_quantile(self, share: float) -> Limit:
        """The number of runs beyond the quantile of an error at the limit (binomial)."""
        from scipy.stats import binom

        beyond = 1 - self.quantile
        n, count = len(self.ratio), int(np.sum(~(self.ratio <= self._allowed(beyond))))
        most = int(binom.isf(share, n, beyond))
        name = f"{self.stem}, runs beyond the {100 * self.quantile:g} % quantile"
        return Limit(name, float(count), f"<= {most} of {n}", count <= most)

    def _allowed(self, share: float) -> Array:
        """Largest ratio of each run by itself, (n,)."""
        return np.maximum(1.0, np.minimum(self.own, 1.0) * _chance(share, self.dof))

    def _words(self, allowed: float) -> str:
        limit = f"{self.sign} {self.shown(1.0):.4g}"
        by_chance = f" ({self.shown(allowed):.4g} with chance)" if allowed > 1 + ROUNDING else ""
        return limit + by_chance


def tilt_limits(accept: Accept, rows: Sequence[Row]) -> Iterator[TiltLimit]:
    """The limits of the tilt error that are set. rows: with tilt errors, all of them."""
    before, after, bound = tilts(rows).T
    dof, seeds = np.array([r.tilt_dof for r in rows]), [r.seed for r in rows]

    def made(
        stem: str, rms_name: str, limit: Array, shown: Callable[[float], float], sign: str = "<="
    ) -> TiltLimit:
        ratio, own = _over(after, limit), _over(bound, limit)
        return TiltLimit(stem, rms_name, ratio, own, dof, seeds, shown, sign, accept.quantile)

    if (largest := accept.tilt_arcsec) is not None:
        limit = np.full(len(rows), largest * ARCSEC)
        yield made("tilt error, arcsec", "tilt error, arcsec rms", limit, lambda x: x * largest)
    if (factor := accept.tilt_over_bound) is not None:
        name = "tilt error over its bound"
        yield made(name, name, factor * bound, lambda x: x * factor)
    if (least := accept.better_by) is not None:
        name = "tilt error before over after"
        yield made(name, name, before / least, lambda x: least / x if x else np.inf, ">=")


def tilts(rows: Sequence[Row]) -> Array:
    """Tilt error before, after and as predicted, rad rms, (n, 3) of the rows that have one."""
    found = [(r.tilt_before, r.tilt_after, r.tilt_bound) for r in rows if r.tilt_before is not None]
    return np.array(found, dtype=float).reshape(-1, 3)


def dof_of_mean(scale: Array, dof: Array) -> float:
    """Degrees of freedom of the mean of ``scale_r^2 chi2(dof_r) / dof_r`` over runs: its sum over
    its largest weight, as for one run. scale, dof: (n,).
    """
    weights = scale**2 / dof
    largest = float(np.max(weights, initial=0.0))
    total = float(np.sum(scale**2))
    return total / largest if 0 < largest < np.inf else float(np.sum(dof))


def rms_interval(rms: float, dof: float) -> tuple[float, float]:
    """95 % interval of an rms whose square has ``dof`` degrees of freedom (chi-square)."""
    from scipy.special import chdtri

    low, high = (dof / float(chdtri(dof, p)) for p in (0.025, 0.975))
    return float(rms * np.sqrt(low)), float(rms * np.sqrt(high))


def _chance(share: float, dof: Array | float) -> Array:
    """Ratio of an rms to its expectation that is exceeded with probability ``share``."""
    from scipy.special import chdtri

    return np.asarray(np.sqrt(chdtri(dof, share) / dof))


def _over(a: Array, b: Array) -> Array:
    """a / b, 0 where a is 0 and infinite where only b is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(a == 0, 0.0, a / b)
