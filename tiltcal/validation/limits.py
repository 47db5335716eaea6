"""Acceptance limits of a calibration method: verdict, tilt error, parameters against the truth."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Verdict
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import Accept, MethodTable
from tiltcal.validation.accuracy import TiltError, normalised_error, true_parameters


@dataclass(frozen=True)
class Limit:
    """One acceptance limit: what was reached, what was allowed, in words."""

    name: str
    reached: float
    allowed: str
    passed: bool


def limits_of(
    scenario: Scenario, table: MethodTable, found: Sequence[Calibration], tilt: TiltError | None
) -> Iterable[Limit]:
    """All limits of a method over its runs. tilt: error of the first run."""
    yield _verdict_limit(table, [c.verdict for c in found])
    if table.expect == "cannot_tell":
        return
    if table.accept.parameters:
        yield _parameter_limit(scenario, table, found)
    if tilt is not None:
        yield from _tilt_limits(table.accept, *tilt.in_arcsec)


def _verdict_limit(table: MethodTable, verdicts: Sequence[Verdict]) -> Limit:
    wrong = sum(v != table.expect for v in verdicts)
    allowed = _rare(len(verdicts), table.accept.false_alarm) if table.expect == "good" else 0
    words = ", ".join(
        f"{v} x{verdicts.count(v)}" if len(verdicts) > 1 else v for v in dict.fromkeys(verdicts)
    )
    expected = f"{table.expect}, at most {allowed} others"
    return Limit(f"verdict ({words})", float(wrong), expected, wrong <= allowed)


def _tilt_limits(accept: Accept, before: float, after: float, bound: float) -> Iterable[Limit]:
    """Limits of the tilt error. before, after: arcsec; bound: predicted by the covariance."""
    if accept.tilt_arcsec is not None:
        allowed = accept.tilt_arcsec
        yield Limit("tilt error, arcsec rms", after, f"<= {allowed:g}", after <= allowed)
    if accept.tilt_over_bound is not None:
        allowed, ratio = accept.tilt_over_bound, _ratio(after, bound)
        ok = after <= allowed * bound
        yield Limit("tilt error over its bound", ratio, f"<= {allowed:g}", ok)
    if accept.better_by is not None:
        allowed, ratio = accept.better_by, _ratio(before, after)
        ok = before >= allowed * after
        yield Limit("tilt error before over after", ratio, f">= {allowed:g}", ok)


def _ratio(a: float, b: float) -> float:
    """a / b; a perfect b makes it infinite."""
    return a / b if b else np.inf


def _rare(runs: int, false_alarm: float) -> int:
    """How many of ``runs`` good calibrations may be called suspect: each has a few tests at 0.1
    %.
    """
    from scipy.stats import binom

    return int(binom.isf(false_alarm, runs, 5e-3)) if runs > 1 else 0


def _parameter_limit(scenario: Scenario, table: MethodTable, found: Sequence[Calibration]) -> Limit:
    """All parameters of all runs against the truth: the sum of squared errors in units of their
    covariance (NEES).
    """
    from scipy.special import chdtri

    total, dof = 0.0, 0
    for c in found:
        nees, n = normalised_error(c, true_parameters(scenario, scenario.effects, c))
        total, dof = total + nees, dof + n
    if dof == 0:
        return Limit("parameters against the truth", 0.0, "a truth to compare with", False)
    rare = table.accept.false_alarm / 2
    low, high = chdtri(dof, 1 - rare), chdtri(dof, rare)
    name, allowed = (
        "parameters, NEES per degree of freedom",
        f"{low / dof:.3g} ... {high / dof:.3g}",
    )
    return Limit(name, total / dof, allowed, bool(low <= total <= high))
