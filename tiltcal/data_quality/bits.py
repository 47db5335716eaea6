"""Checks of the codes of a converter: a bit that always reads 0, and a sign that was not extended.

Of a bit that always reads 0 half of all codes never occur, in cycles of twice the bit, wherever the
readings go.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.core.arrays import Array, Mask, Single
from tiltcal.core.quantisation import lsb_width
from tiltcal.data_quality.check import Check, Finding, in_rows
from tiltcal.data_quality.flat import at_least
from tiltcal.data_quality.log import CHANCE, FLAT, Channel, Log

FINEST = 2.0**-16  # of the range of the readings: no smaller bit is looked for
# cells of the histogram in the smallest bit, and codes: a smaller one is lost in noise
IN_A_BIT = 4
# of the file in the smallest bit: what rounds a coarse code to so few looks like half a cycle
CODES = 12
CYCLES = 4  # of the bit in the range of the readings, at least
# mean sine of the phase; 2 / pi where only the lower half of each cycle occurs, 0 by chance
LIKE_HALF = 0.5
ZOOMS = 4  # of eight times each
TRIES = 5  # of the most likely bits
LEAST = 64  # values
FEW = 2000  # readings from which a frequency is refined
SELDOM = 0.25  # share of readings with a bit set above which it is set by chance, half the time


class StuckBit(Check):
    """A bit of the codes that is never set."""

    name = "stuck_bit"
    test = "all bits set"
    looks_at = "readings"
    finds = "a bit of twelve codes or more, over four cycles of it"
    explains = True

    def _find(self, log: Log) -> Iterator[Finding]:
        for c in log.readings:
            if c.is_coarse or (c.repeats.any() and c.repeat_chance > FLAT):
                continue
            if (bit := stuck_bit(c.read)) is not None:
                words = (
                    f"{c.name}: the bit worth {bit:.4g} is never set: half of all codes are missing"
                )
                size, sigma = {"bit_value": bit}, {"bit_value": bit**2 / float(np.ptp(c.read))}
                yield self.finding((c.name,), c.rows, words, size=size, sigma=sigma)


WORDS = (8, 10, 12, 14, 16, 18, 20, 24, 32)  # bits of the registers of sensors
VOID = 0.15  # of the range of the register: codes between the two ends that never occur


class SignNotExtended(Check):
    """Codes in two's complement that were read without their sign."""

    name = "sign_extension"
    test = "signed codes"
    repair = "extend_sign"
    is_certain = True
    looks_at = "readings in whole codes"
    finds = "two steps between the ends of a register, and no code about its middle"

    def _find(self, log: Log) -> Iterator[Finding]:
        for c in log.readings:
            if c.quantity == "raw" and (found := _register(c)) is not None:
                bits, sign = found
                high = c.rows[sign * c.read >= 2.0 ** (bits - 1)]
                words = (
                    f"{c.name}: codes in two's complement of {bits} bits read without their sign:"
                    f" 2^{bits} too {'large' if sign > 0 else 'small'}, {in_rows(high)}"
                )
                size = {"register": sign * 2.0**bits}
                yield self.finding((c.name,), high, words, size=size)

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        columns, done = {}, []
        for f in findings:
            values = log.channels[f.column].values.copy()
            values[f.rows] -= f.size["register"]
            columns[f.column] = values
            done.append(f"{f.count} values of {f.column} given their sign")
        return log.changed(columns), ", ".join(done)


def _register(c: Channel) -> tuple[int, float] | None:
    """Bits of a register that was read without its sign, and -1 where it was negated as well."""
    for sign in (1.0, -1.0):
        codes = sign * c.read
        if codes.min() < 0 or codes.max() < 2.0 ** (WORDS[0] - 1):
            continue
        bits = next((b for b in WORDS if codes.max() < 2.0**b), None)
        if bits is None or np.any(c.sample != np.rint(c.sample)):
            continue
        full = 2.0**bits
        low, high = codes[codes < full / 2], codes[codes >= full / 2]
        if not len(low) or not len(high):
            continue
        void = float(high.min() - low.max())
        jumps = int(np.sum(np.abs(np.diff(codes)) > void))
        # signed codes are near each other about zero, where these are at the two ends
        near = full - float(high.max()) + float(low.min())
        if void > VOID * full and jumps >= 2 and near < void / 4:
            return bits, sign
    return None


def stuck_bit(values: Array) -> float | None:
    """The bit that is never set in these values, (n,), in their unit: codes in two's complement, or
    magnitudes with a sign.
    """
    one = np.ones(len(values))
    for codes, sign in (
        ((values, one), (np.abs(values), np.sign(values))) if values.min() < 0 else ((values, one),)
    ):
        if (bit := _never_set(codes, sign)) is not None:
            return bit
    return None


def _never_set(values: Array, sign: Array) -> float | None:
    """The bit, if a bit of floor(values / bit) is 0 in more cycles, of either sign, than chance
    allows.
    """
    from scipy.fft import next_fast_len, rfft

    span, width = float(np.ptp(values)), lsb_width(values)
    cell = max(width, FINEST * span / IN_A_BIT)
    if len(values) < LEAST or width == 0 or span < 2 * CYCLES * IN_A_BIT * cell:
        return None
    taken = _taken(values, cell)
    n = next_fast_len(4 * len(taken), real=True)
    grid = 1 / (2 * n * cell)  # of the frequencies
    coarsest, finest = CYCLES / span, 1 / (2 * max(IN_A_BIT * cell, CODES * width))
    first, last = int(np.ceil(coarsest / grid)), min(int(finest / grid), n // 2)
    # what the sharing takes off
    kept = (1 + np.cos(2 * np.pi * grid * cell * np.arange(first, last + 1, dtype=np.float32))) / 2
    waves, enough = rfft(taken, n)[first : last + 1] / kept, LIKE_HALF * float(taken.sum())
    tried = len(waves)
    strong = np.flatnonzero(waves.real**2 + waves.imag**2 >= enough**2)
    frequency = grid * (first + strong)  # 1 / (2 bit)
    alike = -(waves[strong] * np.exp(-2j * np.pi * frequency * (values.min() + cell / 2))).imag
    for k in np.argsort(alike)[::-1][:TRIES]:
        if alike[k] < enough:
            break
        best = _least_set(values[:: max(len(values) // FEW, 1)], float(frequency[k]), grid, width)
        if best is None or _bunched(values, best, grid):
            continue
        cycle = sign * (np.floor(values * best) + 1)
        visited, odd = len(np.unique(cycle)), len(np.unique(cycle[is_set(values, best, width)]))
        if at_least(visited - odd, visited, 0.5) * tried < CHANCE:
            return float(1 / (2 * best))
    return None


def _taken(values: Array, cell: float) -> Single:
    """How many cells of a histogram are taken, in pairs of cells: those between two pairs are
    shared by them.
    """
    place = ((values - values.min()) / cell).astype(np.intp)
    taken = np.zeros(2 * (int(place.max()) // 2) + 3, np.float32)
    taken[place] = 1.0  # each value once: rests say no more than moves
    shared = taken[::2].copy()
    shared[:-1] += taken[1::2] / 2
    shared[1:] += taken[1::2] / 2
    return shared


def _bunched(values: Array, frequency: float, reach: float) -> bool:
    """Whether the values cluster within the half that occurs: a grid of coarse codes, not codes
    that lack a bit.
    """
    single = np.unique(values)
    return any(
        abs(np.mean(np.exp(4j * np.pi * f * single))) > LIKE_HALF
        for f in frequency + np.linspace(-reach, reach, 33)
    )


def _least_set(values: Array, frequency: float, reach: float, width: float) -> float | None:
    """The frequency nearby at which the bit would be set least often, by refinement; None where
    that is by chance.
    """
    for _ in range(ZOOMS):
        near = frequency + np.linspace(-reach, reach, 33)
        often = np.array([np.count_nonzero(is_set(values, f, width)) for f in near])
        if often.min() > SELDOM * len(values):
            return None
        frequency, reach = float(near[often == often.min()].mean()), reach / 8
    return frequency


def is_set(values: Array, frequency: float, width: float) -> Mask:
    """Whether the bit would be set, of codes whose digits a file has rounded, (n,).

    Args:
        values: codes, (n,).
        frequency: 1 / (2 bit), in units of the codes.
        width: LSB, in the unit of the codes.
    """
    return np.mod((values + width / 4) * frequency, 1.0) >= 0.5
