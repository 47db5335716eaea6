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
FINEST_COMPUTED = 2.0**-14  # the same of readings on no grid, which only a simulation makes
# cells of the histogram in the smallest bit, and codes: a smaller one is lost in noise
IN_A_BIT = 4
# of the file in the smallest bit: what rounds a coarse code to so few looks like half a cycle
CODES = 12
CYCLES = 4  # of the bit in the range of the readings, at least
# mean sine of the phase; 2 / pi where only the lower half of each cycle occurs, 0 by chance
LIKE_HALF = 0.5
ZOOMS = 4  # of eight times each
IN_A_CYCLE = 4  # readings, which do not all meet it at the same phase
SAME = 0.25  # of a cycle: phases that are nearer are one and the same but for noise
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
            if (bit := stuck_bit(c.sample, FINEST if c.lsb else FINEST_COMPUTED)) is not None:
                words = (
                    f"{c.name}: the bit worth {bit:.4g} is never set: half of all codes are missing"
                )
                size, sigma = {"bit_value": bit}, {"bit_value": bit**2 / float(np.ptp(c.read))}
                yield self.finding((c.name,), c.rows, words, size=size, sigma=sigma)


REGISTERS = (8, 10, 12, 14, 16, 18, 20, 24, 32)  # bits of the registers of sensors
VOID = 0.15  # of the range of a register: codes between the two ends that never occur
EXACT = 1 / 16  # of the range, within which a step between two rows is one of it
STEPS = 2  # between the ends


class SignNotExtended(Check):
    """Codes in two's complement that were read without their sign."""

    name = "sign_extension"
    test = "signed codes"
    repair = "extend_sign"
    looks_at = "readings in whole codes"
    finds = "two steps of the range of a register, and codes in the middle that never occur"

    def _find(self, log: Log) -> Iterator[Finding]:
        for c in log.readings:
            if c.quantity == "raw" and (found := _register(c)) is not None:
                bits, high = found
                rows = c.rows[high]
                words = (
                    f"{c.name}: steps of 2^{bits} between neighbouring rows, and no code between:"
                    f" two's complement of {bits} bits read without its sign, {in_rows(rows)}"
                )
                yield self.finding((c.name,), rows, words, size={"register": 2.0**bits})

    def _repair(self, log: Log, findings: Sequence[Finding]) -> tuple[Log, str]:
        columns, done = {}, []
        for f in findings:
            values = log.channels[f.column].values.copy()
            values[f.rows] -= f.size["register"]
            columns[f.column] = values
            done.append(f"{f.count} values of {f.column} given their sign")
        return log.changed(columns), ", ".join(done)


def _register(c: Channel) -> tuple[int, Mask] | None:
    """Bits of a register that was read without its sign, and the readings that are too large."""
    single = np.unique(c.sample)
    if len(single) < LEAST or np.any(single != np.rint(single)):
        return None
    k = int(np.argmax(np.diff(single)))
    low, high = float(single[k]), float(single[k + 1])
    step = np.abs(np.diff(c.read))
    across = step[(c.read[1:] >= high) != (c.read[:-1] >= high)]
    if len(across) < STEPS:
        return None
    bits = min(REGISTERS, key=lambda b: abs(np.log2(np.median(across)) - b))
    full = 2.0**bits
    exact = np.abs(across - full) < EXACT * full
    if high - low < VOID * full or not exact.all():
        return None
    return bits, np.asarray(c.read >= high)


def stuck_bit(values: Array, finest: float = FINEST) -> float | None:
    """The bit that is never set in these values, in their unit: codes in two's complement, or
    magnitudes with a sign.

    Args:
        values: (n,).
        finest: no smaller bit is looked for, of the range of the values.
    """
    one = np.ones(len(values))
    for codes, sign in (
        ((values, one), (np.abs(values), np.sign(values))) if values.min() < 0 else ((values, one),)
    ):
        if (bit := _never_set(codes, sign, finest)) is not None:
            return bit
    return None


def _never_set(values: Array, sign: Array, finest_bit: float) -> float | None:
    """The bit, if a bit of floor(values / bit) is 0 in more cycles, of either sign, than chance
    allows.
    """
    from scipy.fft import next_fast_len, rfft

    span, width = float(np.ptp(values)), lsb_width(values)
    cell = max(width, finest_bit * span / IN_A_BIT)
    if len(values) < LEAST or width == 0 or not np.isfinite(span / width):
        return None
    if span < 2 * CYCLES * IN_A_BIT * cell:
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
    some = values[:: max(len(values) // FEW, 1)]
    for k in np.argsort(alike)[::-1][:TRIES]:
        if alike[k] < enough:
            break
        best = _least_set(some, float(frequency[k]), grid, width)
        if best is None or _bunched(some, best, grid):
            continue
        _, number = np.unique(sign * (np.floor(values * best) + 1), return_inverse=True)
        told = (np.bincount(number) >= IN_A_CYCLE)[number] | ~_at_one_phase(values, best)
        many = np.bincount(number, told) > 0
        wrong = np.bincount(number, is_set(values, best, width)) > 0
        visited, odd = int(many.sum()), int((many & wrong).sum())
        if at_least(visited - odd, visited, 0.5) * tried < CHANCE:
            return float(1 / (2 * best))
    return None


def _at_one_phase(values: Array, frequency: float) -> Mask:
    """Readings whose step from the one before is by whole cycles, as in a steady turn, (n,)."""
    turns = np.diff(values, prepend=np.nan) * frequency
    whole = np.abs(turns - np.rint(turns)) < SAME
    return np.asarray(whole & (np.abs(turns) > 1 / 2))


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
