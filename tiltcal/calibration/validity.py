"""Tests by which a method judges its own result, and the verdict that follows from them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["good", "suspect", "cannot_tell"]
VERDICTS: tuple[Verdict, ...] = ("good", "suspect", "cannot_tell")
SIGNIFICANCE = 1e-3  # of each test: the share of good calibrations that it may call suspect


@dataclass(frozen=True)
class Test:
    """One test of a method's own validity."""

    name: str
    statistic: float
    dof: int
    p_value: float
    passed: bool
    statement: str

    __test__ = False  # not a test case for pytest


def chi2_test(
    name: str, statistic: float, dof: int, statement: str, significance: float = SIGNIFICANCE
) -> Test:
    """A chi-square test; passes while its p-value is above the significance."""
    from scipy.special import chdtrc

    p = float(chdtrc(dof, statistic)) if dof > 0 else 1.0
    return Test(name, float(statistic), int(dof), p, bool(p > significance), statement)


def threshold_test(
    name: str, statistic: float, passed: bool, statement: str, *, dof: int = 0
) -> Test:
    """A test against a fixed threshold: its p-value is 1 where it passes, else 0."""
    return Test(name, float(statistic), dof, float(passed), bool(passed), statement)


def verdict_of(tests: Sequence[Test], determined: bool = True) -> Verdict:
    """The verdict: ``cannot_tell`` when the recording does not determine the model, ``suspect``
    when a test failed, else ``good``.
    """
    if not determined:
        return "cannot_tell"
    return "good" if all(t.passed for t in tests) else "suspect"
