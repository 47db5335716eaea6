"""Whether what is left of squares repeats at the same angle, or in time: evidence, and where it is
large.

Parts of a recording agree on the angles at which it is large. The sum of the products of every two
parts, each with bursts of its own, is normal by its own squares (self-normalised sums: de la Pena,
Lai and Shao 2009). A cycle is a line with its harmonics in the spectrum (harmonic summing).
"""

import numpy as np
from scipy.special import log_ndtr, logsumexp

from tiltcal.core.arrays import Array, Index
from tiltcal.diagnosis.lines.spectral_peaks import evenly, running_median
from tiltcal.diagnosis.residual_checks.oscillations import log_excess_of_sums

SECTORS = 24  # of a turn
PARTS = (4, 16)  # of a recording, at least and at most: as many as an axis makes turns
FINER = 2  # frequencies a width of a line
SLOWEST = 12  # cycles in a recording: slower ones look like a level that wanders
AROUND = 24  # lines that say what is usual about one
HARMONICS = (1, 2, 4)  # of a cycle, each number as probable as another
TRIED = 41  # periods near that of a line
SIZES = 10.0 ** np.arange(-0.5, 2.5, 0.5)  # expected z of what is there, each as probable


def likeliest_cycle(time: Array, left: Array) -> tuple[float, float]:
    """Period, s, of the cycle that says most, and the logarithm of its Bayes factor, any frequency
    being as probable as another.

    Args:
        time: s, (n,); left: of each row, (n,).
    """
    from scipy.fft import next_fast_len

    values, rate = evenly(time, left)
    size = next_fast_len(FINER * len(values), real=True)
    power = np.abs(np.fft.rfft(values, size)) ** 2
    usual = running_median(power, FINER * AROUND) / np.log(2)
    power = power / np.maximum(usual, np.finfo(float).tiny)
    first = round(SLOWEST * size / len(values))
    count = (len(power) - 1) // max(HARMONICS) - first
    if count < AROUND:
        return 0.0, -np.inf
    lines, total, factors = first + np.arange(count), np.zeros(count), []
    for n in range(1, max(HARMONICS) + 1):
        total = total + power[n * lines]
        if n in HARMONICS:
            factors.append(log_excess_of_sums(total, n))
    factor = logsumexp(factors, axis=0) - np.log(len(HARMONICS) * count)
    best = int(np.argmax(factor))
    return float(size / (lines[best] * rate)), float(factor[best])


def parts_agree(left: Array, phase: Array) -> float:
    """How much parts of a recording agree on where in a turn the noise is large: of unit variance,
    where they do not, and nearly normal where many sectors are visited; the less, the fewer they
    are.

    Args:
        left: of each row, (n,); phase: in turns, (n,).
    """
    turns = float(np.abs(np.diff(phase)).sum())
    parts = int(np.clip(round(turns), *PARTS))
    part = np.arange(len(left)) * parts // len(left)
    cell = part * SECTORS + sectors_of(phase)
    sums, rows = (
        np.bincount(cell, of, parts * SECTORS).reshape(parts, SECTORS)
        for of in (left, np.ones(len(left)))
    )
    # a part that is noisier as a whole says nothing
    pattern = sums - rows * (sums.sum(axis=1) / np.maximum(rows.sum(axis=1), 1.0))[:, None]
    products = (pattern @ pattern.T)[np.triu_indices(parts, 1)]
    energy = float(products @ products)
    return float(products.sum() / np.sqrt(energy)) if energy > 0 else 0.0


def sectors_of(phase: Array) -> Index:
    """Number of the sector of a turn or a cycle, (n,). phase: in turns, (n,)."""
    return np.floor(phase * SECTORS).astype(np.intp) % SECTORS


def log_agreement(z: float) -> float:
    """Logarithm of the Bayes factor of a positive normal score."""
    variance = SIZES**2
    share = variance / (1 + variance)
    each = z**2 / 2 * share - np.log1p(variance) / 2 + log_ndtr(z * np.sqrt(share)) + np.log(2)
    return float(logsumexp(each) - np.log(len(SIZES)))


def sharpest(time: Array, left: Array, period: float) -> float:
    """The period near one in whose sectors the squares differ most, s.

    Args:
        time: s, (n,); left: of each row, (n,).
        period: of a line, s.
    """
    since = time - time[0]
    tried = 1 / (1 / period + np.linspace(-1, 1, TRIED) / float(since[-1]))

    def apart(one: float) -> float:
        sector = sectors_of(since / one)
        count = np.maximum(np.bincount(sector, minlength=SECTORS), 1)
        return float((np.bincount(sector, left, SECTORS) ** 2 / count).sum())

    return float(max(tried, key=apart))


def noisy_sectors(sums: Array) -> Index:
    """The sectors in a row, round the turn, half of them at most, whose sum is largest; their
    numbers go on beyond the last. sums: (SECTORS,).
    """
    twice = np.concatenate([[0.0], np.cumsum(np.tile(sums - sums.mean(), 2))])
    best, found = -np.inf, np.arange(1, dtype=np.intp)
    for width in range(1, SECTORS // 2 + 1):
        within = twice[width : width + SECTORS] - twice[:SECTORS]
        k = int(np.argmax(within))
        if within[k] > best:
            best, found = float(within[k]), k + np.arange(width)
    return found
