"""Which sources dominate the uncertainty of a calibration, and what would halve it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from tiltcal.calibration.result import Calibration
from tiltcal.core.units import unit_sign
from tiltcal.validation.uncertainty_budget import Line, UncertaintyBudget

MOST = 0.8  # of the variance: the sources that are named make up as much
REPEATS = 4  # halves what averages; with all other sources at half their size, U is halved exactly


@dataclass(frozen=True)
class Improvement:
    """One kind of parameter.

    Args:
        parameter: of its kind with the largest U.
        dominant: sources with their shares of the variance, as text.
        next: what halves U, as text.
    """

    parameter: str
    dominant: str
    next: str


def improvements(budget: UncertaintyBudget, calibration: Calibration) -> list[Improvement]:
    """The sources that dominate each kind of parameter, and what would halve its U.

    Args:
        budget: of the calibration.
        calibration: with its references.
    """
    largest: dict[str, str] = {}
    for name, u in budget.combined.items():
        kind = name.rpartition("_")[0]
        if u > 0 and u > budget.combined.get(largest.get(kind, ""), 0.0):
            largest[kind] = name
    # noise, and what is drawn at each stop, average over repeated sequences
    averaging = {r.name for r in calibration.references if r.at_stops}
    averaging.add(budget.lines[0].name)
    return [_improvement(budget, name, averaging) for name in largest.values()]


def _improvement(budget: UncertaintyBudget, name: str, averaging: set[str]) -> Improvement:
    whole = budget.combined[name] ** 2
    lines = sorted(budget.lines, key=lambda line: -line.contributions[name])
    shares = [line.contributions[name] ** 2 / whole for line in lines]
    count = next(k for k in range(1, len(lines) + 1) if sum(shares[:k]) >= MOST)
    named = zip(lines[:count], shares, strict=False)
    dominant = ", ".join(f"{line.name} {100 * share:.0f} %" for line, share in named)
    pairs = list(zip(lines, shares, strict=True))
    random = sum(share for line, share in pairs if line.name in averaging)
    fixed = [(line, share) for line, share in pairs if line.name not in averaging and share > 0]
    return Improvement(name, dominant, _halving(random, fixed))


def _halving(random: float, fixed: Sequence[tuple[Line, float]]) -> str:
    """What halves U, as text.

    Args:
        random: share of the variance that averages over repeated sequences.
        fixed: the other sources with theirs, the largest first.
    """
    left = 0.25 - sum(share for _, share in fixed)
    if left > 0 and random / left <= REPEATS * (1 + 1e-9):
        return f"record the sequence {ceil(random / left - 1e-9)} times"
    repeats = f", and record the sequence {REPEATS} times" if random > 0.01 else ""
    for count in range(1, len(fixed) + 1):
        better, others = fixed[:count], fixed[count:]
        allowed = 0.25 - random / REPEATS - sum(share for _, share in others)
        factor = allowed / sum(share for _, share in better)
        if factor > 0.01 or count == len(fixed):
            break
    sizes = ", ".join(
        f"{line.name} to {line.size * factor**0.5:.2g} {unit_sign(line.unit)} (now {line.size:g})"
        for line, _ in better
    )
    return f"know {sizes}{repeats}"
