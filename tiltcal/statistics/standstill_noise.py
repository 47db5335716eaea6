"""Noise coefficients Q, N, B, K and R of a record at standstill, and whether they are its noise.

The spectrum ``Q^2 s^2 rate^2 + N^2 rate + B^2 / s + K^2 / (rate s^2)`` with s = 2 sin(pi f / rate)
is fitted to squared cosine coefficients by the largest Whittle likelihood, with a free level and a
free straight line, whose slope is R. ``goodness_of_fit`` tests it by the same likelihood; the Allan
deviation is the same model seen over averaging times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.statistics.allan import TERMS, AllanDeviation, freedoms, slopes
from tiltcal.statistics.goodness_of_fit import ModelTest, NeighbourCounts, spectrum_test
from tiltcal.statistics.standstill_spectrum import POWERS, PowerBins, StandstillSpectrum

SIGNIFICANT = 3.0  # standard uncertainties below which a term is not in the record
FITTED = ("Q", "N", "B", "K")  # in the order of POWERS
SCORINGS = 60  # of a likelihood whose Fisher scoring converges in about ten
CLOSE = 1e-6  # of twice the log likelihood: far below what a test could notice
LINE_STEPS = 3  # fits of slope and spectrum in turn; the third changes p by less than 1 %


@dataclass(frozen=True)
class StandstillNoise:
    """Coefficients of ``s2 = 3 Q2/tau2 + N2/tau + (2 ln2/pi) B2 + K2 tau/3 + R2 tau2/2``.

    Args:
        values: of Q, N, B, K, R, in the unit of the record and seconds; 0 where the term is not in
            the record.
        sigmas: standard uncertainties; they mean nothing where the model does not fit.
        held: which terms the record determines.
        curve: the Allan deviation, with the degrees of freedom of these terms.
        test: whether the model fits.
        notes: how the record was read, where not sample by sample.
    """

    values: dict[str, float]
    sigmas: dict[str, float]
    held: dict[str, bool]
    curve: AllanDeviation
    test: ModelTest
    notes: tuple[str, ...] = ()

    @property
    def fits(self) -> bool:
        """Whether the coefficients are the noise of the record."""
        return self.test.fits

    @property
    def fitted_deviation(self) -> Array:
        """Allan deviation of the coefficients at the averaging times of the curve, (m,)."""
        squares = np.array([self.values[t] ** 2 for t in TERMS])
        return np.asarray(np.sqrt(slopes(self.curve.tau) @ squares))

    @property
    def limits(self) -> dict[str, float]:
        """The most that the Allan deviation allows of each term, whatever the others are: its own
        curve touches the upper 95 % end of the measured one.
        """
        high = self.curve.interval(0.95)[1]
        most = (high[:, None] / np.sqrt(slopes(self.curve.tau))).min(axis=0)
        return dict(zip(TERMS, most.tolist(), strict=True))

    @property
    def effective(self) -> dict[str, float]:
        """Coefficients to simulate: the values where the model fits. Where it does not, those that
        are not above their limit, and N at its limit: a fit that fails may lack it.
        """
        if self.fits:
            return self.values
        limits = self.limits
        return {t: min(self.values[t], limits[t]) for t in TERMS} | {"N": limits["N"]}


def fit_noise(
    spectrum: StandstillSpectrum, curve: AllanDeviation, samples: NeighbourCounts
) -> StandstillNoise:
    """The most likely coefficients. A term below three sigmas is left out and the others re-fitted;
    the test is that of all terms.

    Args:
        spectrum: of the record.
        curve: its Allan deviation.
        samples: its neighbouring samples.
    """
    bins, variances, slope, slope_sigma = _with_line(spectrum)
    model = bins.shapes @ variances
    tested = spectrum_test(bins, model, int(np.count_nonzero(variances)), spectrum.rate_hz)
    tested = replace(tested, notes=samples.notes())
    kept, variances, spread = _significant(bins)
    size = np.array([1 / spectrum.rate_hz, spectrum.rate_hz**-0.5, 1.0, spectrum.rate_hz**0.5])
    values = dict.fromkeys(TERMS, 0.0)
    sigmas = dict.fromkeys(TERMS, 0.0)
    for k, variance, sigma in zip(kept, variances, spread, strict=True):
        root = float(np.sqrt(variance))
        values[FITTED[k]] = root * float(size[k])
        sigmas[FITTED[k]] = float(sigma * size[k]) / (2 * root) if root else 0.0
    if abs(slope) > SIGNIFICANT * slope_sigma:
        values["R"], sigmas["R"] = abs(slope), slope_sigma
    curve = _with_freedom_of(values, curve, samples.pairs + 1, spectrum.rate_hz)
    return StandstillNoise(values, sigmas, {t: values[t] > 0 for t in TERMS}, curve, tested)


def _with_freedom_of(
    values: dict[str, float], curve: AllanDeviation, n: int, rate_hz: float
) -> AllanDeviation:
    """The curve of n samples with the degrees of freedom of these terms: the reciprocals of those
    of each, weighted by its share of the variance.
    """
    variances = slopes(curve.tau) * np.array([values[t] ** 2 for t in TERMS])
    shares = variances / variances.sum(axis=1, keepdims=True)
    each = freedoms(np.rint(curve.tau * rate_hz), n)
    return replace(curve, freedom=1 / (shares / each).sum(axis=1))


def _with_line(spectrum: StandstillSpectrum) -> tuple[PowerBins, Array, float, float]:
    """Powers without the line; variances, (4,); slope of the line, per second, with its standard
    uncertainty: generalised least squares of the line and the likelihood in turn.
    """
    density = np.ones(len(spectrum.s))
    for _ in range(LINE_STEPS):
        information = spectrum.line**2 / density
        slope = float(spectrum.line / density @ spectrum.coefficients / information.sum())
        bins = spectrum.bins(slope, information)
        variances = _most_likely(bins, range(len(POWERS)))
        density = np.column_stack([spectrum.s**p for p in POWERS]) @ variances
    return bins, variances, slope, float(information.sum() ** -0.5)


def _significant(bins: PowerBins) -> tuple[list[int], Array, Array]:
    """Which terms are in the record, their variances and the standard uncertainties of these."""
    kept = list(range(len(POWERS)))
    while True:
        v = _most_likely(bins, kept)
        shapes = bins.shapes[:, kept]
        weighted = shapes * (np.sqrt(bins.weight / 2) / (shapes @ v))[:, None]
        size = np.sqrt((weighted**2).sum(axis=0))
        weighted /= size
        spread = np.sqrt(np.diag(np.linalg.pinv(weighted.T @ weighted))) / size
        weakest = int(np.argmin(v / spread))
        if len(kept) == 1 or v[weakest] > SIGNIFICANT * spread[weakest]:
            return kept, v, spread
        kept.pop(weakest)


def _most_likely(bins: PowerBins, kept: Sequence[int]) -> Array:
    """Variances of the largest likelihood, (k,), none negative: Fisher scoring, steps halved until
    they raise it.
    """
    from scipy.optimize import nnls

    shapes = bins.shapes[:, list(kept)]
    mean = bins.power / bins.weight
    smallest = np.finfo(float).eps ** 2 * float(mean.max())

    def deviance(model: Array) -> float:
        return float(bins.weight @ np.log(model) + (bins.power / model).sum())

    def scored(model: Array) -> Array:
        root = np.sqrt(bins.weight) / model
        columns = shapes * root[:, None]
        size = np.sqrt((columns**2).sum(axis=0))
        return np.asarray(nnls(columns / size, mean * root)[0] / size)

    v = scored(mean + float(np.median(mean)))
    cost = deviance(model := np.maximum(shapes @ v, smallest))
    for _ in range(SCORINGS):
        step = scored(model) - v
        for share in 0.5 ** np.arange(20):
            model = np.maximum(shapes @ (v + share * step), smallest)
            if (found := deviance(model)) <= cost:
                break
        else:
            break
        v, gain, cost = v + share * step, cost - found, found
        if gain < CLOSE:
            break
    return v
