"""Statistics over the runs of a method, with 95 % intervals, as plain values for JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC
from tiltcal.validation.limits import dof_of_mean, rms_interval, tilts
from tiltcal.validation.runs import Row

LEVEL = 0.95


def statistics_of(rows: Sequence[Row], quantile: float) -> dict[str, Any]:
    """Statistics over runs.

    Args:
        rows: one a run; those with an error are left out.
        quantile: of the tilt error.

    Returns:
        tilt_arcsec: rms before, after and bound; the interval of the rms after (chi-square with the
            degrees of freedom that the covariance states), a quantile with its interval (order
            statistics, binomial; null where so few runs do not determine it), the worst run.
        nees_per_dof: with its interval (chi-square).
        verdicts: how often each was given, with its share and the interval of that (Wilson).
        parameters: mean error (Student's t) and rms error (chi-square), in the parameter's unit;
            standard deviation of the error over the rms of the stated sigma (chi-square); share of
            runs whose error is within 1.96 sigma (Wilson).
    """
    kept = [r for r in rows if r.error is None]
    return {
        "runs": len(rows),
        "failed": len(rows) - len(kept),
        "tilt_arcsec": _tilt(kept, quantile),
        "verdicts": _verdicts(rows),
        "nees_per_dof": _nees(kept),
        "parameters": _parameters(kept),
    }


def _tilt(rows: Sequence[Row], quantile: float) -> dict[str, Any] | None:
    from scipy.stats import quantile_test

    known = [r for r in rows if r.tilt_after is not None]
    if not known:
        return None
    _, after, bound = errors = tilts(known).T / ARCSEC
    rms = np.sqrt(np.mean(errors**2, axis=1)).tolist()
    dof = dof_of_mean(bound, np.array([r.tilt_dof for r in known]))
    interval: Any = quantile_test(after, p=quantile).confidence_interval(LEVEL)
    worst = int(np.argmax(after))
    return {
        "before_rms": rms[0],
        "after_rms": rms[1],
        "after_rms_interval_95": list(rms_interval(rms[1], dof)),
        "after_dof": dof,
        "bound_rms": rms[2],
        "quantile": quantile,
        "after_quantile": float(np.quantile(after, quantile)),
        "after_quantile_interval_95": [_number(interval.low), _number(interval.high)],
        "after_worst": float(after[worst]),
        "worst_seed": known[worst].seed,
    }


def _nees(rows: Sequence[Row]) -> dict[str, Any] | None:
    from scipy.special import chdtri

    total, dof = sum(r.nees for r in rows), sum(r.nees_dof for r in rows)
    if not dof:
        return None
    interval = [total / float(chdtri(dof, p)) for p in (0.025, 0.975)]
    return {"value": total / dof, "dof": dof, "interval_95": interval}


def _verdicts(rows: Sequence[Row]) -> dict[str, Any]:
    shown = [r.shown_verdict for r in rows]
    return {v: share_of(shown.count(v), len(shown)) for v in sorted(set(shown))}


def share_of(count: int, n: int) -> dict[str, Any]:
    """A count as a share of n, with its 95 % interval (Wilson)."""
    from scipy.stats import binomtest

    interval: Any = binomtest(count, n).proportion_ci(LEVEL, method="wilson")
    return {
        "count": count,
        "share": count / n,
        "interval_95": [float(interval.low), float(interval.high)],
    }


def _parameters(rows: Sequence[Row]) -> dict[str, Any]:
    errors: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in rows:
        for p in row.parameters:
            if p.truth is not None:
                errors.setdefault((p.name, p.unit), []).append((p.value - p.truth, p.sigma))
    return {
        name: {"unit": unit} | _errors(*np.array(pairs).T) for (name, unit), pairs in errors.items()
    }


def _errors(error: Array, sigma: Array) -> dict[str, Any]:
    from scipy.stats import norm, t

    n, mean, rms = len(error), float(error.mean()), float(np.sqrt(np.mean(error**2)))
    half = float(t.isf(0.025, n - 1) * error.std(ddof=1) / np.sqrt(n)) if n > 1 else None
    inside = int((np.abs(error) <= norm.isf((1 - LEVEL) / 2) * sigma).sum())
    return {
        "runs": n,
        "mean_error": mean,
        "mean_error_interval_95": None if half is None else [mean - half, mean + half],
        "rms_error": rms,
        "rms_error_interval_95": list(rms_interval(rms, n)),
        "sd_over_sigma": _over(error, sigma),
        "coverage_95": share_of(inside, n),
    }


def _over(error: Array, sigma: Array) -> dict[str, Any] | None:
    """Standard deviation of the errors over the rms of their stated sigmas."""
    stated = float(np.sqrt(np.mean(sigma**2)))
    if len(error) < 2 or not stated > 0:
        return None
    ratio = float(error.std(ddof=1)) / stated
    return {"value": ratio, "interval_95": list(rms_interval(ratio, len(error) - 1))}


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
