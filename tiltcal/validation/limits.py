"""Acceptance of a calibration method over all its runs: verdict, required parameters, parameters
against the truth, tilt error.

A correct method is rejected with probability ``false_alarm`` at most: that probability is shared
equally by all tests that decide by chance (Bonferroni).
"""

from collections.abc import Iterator, Sequence

from tiltcal.calibration.validity import SIGNIFICANCE
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import MethodTable
from tiltcal.validation.limit import Judge, Limit
from tiltcal.validation.parameter_limits import (
    missing_limit,
    parameter_judges,
    required_parameters,
)
from tiltcal.validation.runs import Row
from tiltcal.validation.tilt_limits import tilt_limits


def limits_of(scenario: Scenario, table: MethodTable, rows: Sequence[Row]) -> list[Limit]:
    """All limits of a method over its runs.

    Args:
        scenario: that was run.
        table: the method's part of it.
        rows: one a run, none of them with an error.
    """
    certain: list[Limit] = []
    judges: list[Judge] = [lambda share: _verdict_limit(table, rows, share)]
    if table.expect != "cannot_tell":
        if table.accept.parameters or table.accept.required is not None:
            certain.append(missing_limit(required_parameters(scenario, table.accept, rows), rows))
        if table.accept.parameters:
            judges += parameter_judges(rows)
        judges += _tilt_judges(table, rows)
    share = table.accept.false_alarm / len(judges)
    verdict, *others = [judge(share) for judge in judges]
    return [verdict, *(limit for limit in certain if not limit.passed), *others]


def _tilt_judges(table: MethodTable, rows: Sequence[Row]) -> Iterator[Judge]:
    accept = table.accept
    if accept.tilt_arcsec is accept.tilt_over_bound is accept.better_by is None:
        return
    without = [r.seed for r in rows if r.tilt_after is None]
    if without:
        where = f"seed {without[0]}" if len(without) < len(rows) else ""
        n = float(len(rows) - len(without))
        yield lambda _: Limit("runs with a tilt error", n, f"{len(rows)}", False, where=where)
        return
    for limit in tilt_limits(accept, rows):
        yield from limit.judges()


def _verdict_limit(table: MethodTable, rows: Sequence[Row], share: float) -> Limit:
    """Runs with another verdict than the expected one. Where ``good`` is expected of several runs,
    as many may be ``suspect`` as the method's own tests let expect: each fails for a good
    calibration with probability SIGNIFICANCE.
    """
    from scipy.stats import binom

    shown = [r.shown_verdict for r in rows]
    wrong = sum(r.verdict != table.expect for r in rows)
    allowed = 0
    if table.expect == "good" and len(rows) > 1 and all(r.verdict != "cannot_tell" for r in rows):
        tests = max(r.tests for r in rows)
        allowed = int(binom.isf(share, len(rows), 1 - (1 - SIGNIFICANCE) ** tests)) if tests else 0
    words = ", ".join(
        f"{v} x{shown.count(v)}" if len(rows) > 1 else v for v in dict.fromkeys(shown)
    )
    expected = f"{table.expect}, at most {allowed} others"
    return Limit(f"verdict ({words})", float(wrong), expected, wrong <= allowed)
