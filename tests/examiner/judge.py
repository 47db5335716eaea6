"""A case through the product: the verdict, whether its numbers are wrong, and what it said."""

import re
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from examiner import reversals, sweeps, triads, turns  # noqa: F401  they register their systems
from examiner.case import Case
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Setup

IMPOSSIBLE = 1e-6  # probability of a right result so far off


@dataclass
class Outcome:
    """What became of a case.

    Args:
        verdict: of the calibration, or "refused".
        wrong: its parameters contradict the truth.
        z: root of NEES over the number of parameters.
        words: of failed tests and warnings, or of the refusal.
    """

    verdict: str
    wrong: bool
    z: float
    words: str


def judged(case: Case) -> Outcome:
    """Run the case's method on it."""
    site: dict[str, float] = {"gravity_m_s2": 9.80123}
    if case.latitude is not None:
        site["latitude_deg"] = case.latitude
    setup = Setup.model_validate(
        {"site": site, "rig": {"table": case.table}, "sensor": case.sensors}
    )
    labels = None if case.labels is None else np.array(case.labels, dtype=object)
    recording = Recording.from_columns(case.time, case.columns, labels=labels, source="case.csv")
    try:
        found = calibrate(case.method, recording, setup, **case.options)
    except TiltcalError as error:
        return Outcome("refused", False, np.nan, str(error))
    failed = [f"{t.name}: {t.statement}" for t in found.tests if not t.passed]
    nees, number = _nees(found, case)
    wrong = bool(chi2.sf(nees, number) < IMPOSSIBLE) if number else False
    words = "; ".join(failed or found.warnings)
    return Outcome(found.verdict, wrong, float(np.sqrt(nees / max(number, 1))), words)


def _nees(found: Calibration, case: Case) -> tuple[float, int]:
    """Errors in units of the stated covariance, and how many."""
    if found.bias_tables:
        entries = {
            f"table {name} {e['angle_deg']:g}": e
            for name, table in found.bias_tables.items()
            for e in table
        }
        z = [
            (entries[n]["value"] - v) / entries[n]["sigma"]
            for n, v in case.truth.items()
            if n in entries
        ]
        between = _between(found, case)
        return float(np.sum(np.square(z))) + between, len(z)
    names = [n for n in found.parameters if n in case.truth]
    error = np.array([found.parameters[n].value - case.truth[n] for n in names])
    if "base.azimuth" in names:
        k = names.index("base.azimuth")
        error[k] = (error[k] + np.pi) % (2 * np.pi) - np.pi
    place = [list(found.parameters).index(n) for n in names]
    C = np.asarray(found.covariance)[np.ix_(place, place)]
    root = np.sqrt(np.diag(C))
    values, vectors = np.linalg.eigh(C / np.outer(root, root))
    part = vectors.T @ (error / root)
    kept = values > 1e-9
    return float(np.sum(part[kept] ** 2 / values[kept])), int(kept.sum())


def _between(found: Calibration, case: Case) -> float:
    """Errors of the interpolated table between its entries, as chi-square beyond what their sigmas
    say.
    """
    extra = 0.0
    for name, table in found.bias_tables.items():
        angle = np.array([e["angle_deg"] for e in table])
        value = np.array([e["value"] for e in table])
        sigma = np.array([e["sigma"] for e in table])
        truth = {
            float(re.split(r" ", n)[-1]): v
            for n, v in case.truth.items()
            if n.startswith(f"table {name} ")
        }
        at = np.array([a for a in truth if angle[0] < a < angle[-1] and a not in angle])
        if len(at):
            z = (np.interp(at, angle, value) - np.array([truth[a] for a in at])) / np.interp(
                at, angle, sigma
            )
            extra += max(float(np.max(z**2)) - 25.0, 0.0)
    return extra
