"""All checks of a log, in their order: what one repairs or explains, those after it do not see."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.data_quality.bits import SignNotExtended, StuckBit
from tiltcal.data_quality.check import Check, Finding
from tiltcal.data_quality.flat import Clipped, Coarse, Frozen, SentTwice
from tiltcal.data_quality.log import Log
from tiltcal.data_quality.spikes import Spikes
from tiltcal.data_quality.stamps import Bursts, Gaps, GoesBack, Rate, Repeats, TooCoarse, Wraps
from tiltcal.data_quality.units import Circle, Gravity, Thermometer
from tiltcal.data_quality.values import Alternating, AngleWraps, Constant, Equal, Missing

CHECKS: tuple[Check, ...] = (
    Wraps(),
    GoesBack(),
    TooCoarse(),
    Repeats(),
    Gaps(),
    Bursts(),
    Rate(),
    Missing(),
    AngleWraps(),
    Constant(),
    Equal(),
    Alternating(),
    SignNotExtended(),
    Coarse(),
    StuckBit(),
    Frozen(),
    Clipped(),
    SentTwice(),
    Spikes(),
    Gravity(),
    Circle(),
    Thermometer(),
)
BY_NAME = {check.name: check for check in CHECKS}
REPAIRS = {check.repair: check for check in CHECKS if check.repair}


@dataclass(frozen=True)
class Inspection:
    """What the checks say of a log.

    Args:
        findings: in the order of the checks.
        repaired: the log with all repaired whose repair is certain.
    """

    findings: tuple[Finding, ...]
    repaired: Log


def inspect_log(log: Log) -> Inspection:
    """All checks of a log."""
    findings: list[Finding] = []
    explained: frozenset[str] = frozenset()
    for check in CHECKS:
        with np.errstate(all="ignore"):  # readings may be as large as numbers are
            found = check.find(log.without(explained))
        if not found:
            continue
        findings += found
        if check.is_certain:
            log, _ = check.repaired(log, found)
        if check.explains:
            explained |= {column for f in found for column in f.columns}
    return Inspection(tuple(findings), log)


def repair_log(log: Log, wanted: Sequence[str]) -> tuple[Log, list[str]]:
    """The log after the repairs that are wanted, in the order of the checks, and what they did.

    Raises:
        TiltcalError: a repair cannot be made on these data.
    """
    reports = []
    for name, check in REPAIRS.items():
        if name in wanted and (found := check.find(log)):
            log, done = check.repaired(log, found)
            reports.append(f"{name}: {done}")
    return log, reports
