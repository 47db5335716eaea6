"""First-order and total sensitivity indices of what a campaign measures, by ``scipy``.

The noise of the runs is one more factor, which A shares with AB: it adds to the variance and to no
factor's total index.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC
from tiltcal.validation.campaign.campaign_file import Campaign
from tiltcal.validation.campaign.campaign_runs import PointRun, Recorded
from tiltcal.validation.runs import Row

LEVEL = 0.95
Response = Callable[[Row], float | None]


def sensitivity_of(
    campaign: Campaign, finished: Sequence[tuple[PointRun, Recorded]], method: int
) -> dict[str, Any]:
    """Indices of each response of a method, with 95 % bootstrap intervals, by factor.

    Returns:
        By response: ``first_order`` and ``total``, by factor, each with ``value`` and
        ``interval_95``; ``reason`` instead where a run has no such response, or it never varies.
    """
    rows: dict[tuple[str, int], list[Row]] = {}
    for run, recorded in finished:
        point = run.point
        if method < len(recorded.rows):
            rows.setdefault((point.matrix, point.sample), []).append(recorded.rows[method])
    first = next(iter(rows.values()))[0]
    return {
        name: _indices(campaign, rows, response) for name, response in _responses(first).items()
    }


def _responses(row: Row) -> dict[str, Response]:
    found: dict[str, Response] = {}
    if row.tilt_after is not None:
        found["tilt_after_arcsec"] = lambda r: (
            None if r.tilt_after is None else r.tilt_after / ARCSEC
        )
    if row.nees_dof:
        found["nees_per_dof"] = lambda r: r.nees / r.nees_dof if r.nees_dof else None
    for p in row.parameters:
        if p.truth is not None:
            found[f"error of {p.name}, {p.unit}"] = _error_of(p.name)
    return found


def _error_of(name: str) -> Response:
    def error(row: Row) -> float | None:
        found = [p for p in row.parameters if p.name == name and p.truth is not None]
        return found[0].value - float(found[0].truth or 0.0) if found else None

    return error


def _indices(
    campaign: Campaign, rows: dict[tuple[str, int], list[Row]], response: Response
) -> dict[str, Any]:
    from scipy.stats import sobol_indices

    factors, n = campaign.distributions, campaign.table.samples
    names = ["A", "B", *(f"AB{k}" for k in range(1, len(factors) + 1))]
    values = np.array(
        [[_mean(rows.get((m, j), []), response) for j in range(n)] for m in names], dtype=float
    )
    if not np.isfinite(values).all():
        missing = int((~np.isfinite(values)).sum())
        return {"reason": f"{missing} of {values.size} points have no such result"}
    if not values[:2].std() > 0:
        return {"reason": "it never varies"}
    A, B, exchanged = values[0], values[1], values[2:]
    # a factor that changes no result has indices of 0, which no bootstrap can spread
    active = (exchanged != A).any(axis=1)
    first, total = ({f.title: _index(0.0, 0.0, 0.0) for f in factors} for _ in range(2))
    if active.any():
        found = sobol_indices(
            func={"f_A": A[None], "f_B": B[None], "f_AB": exchanged[active][:, None]},
            n=n,
            rng=np.random.default_rng(campaign.seed),
        )
        spread: Any = found.bootstrap(LEVEL)
        titles = [f.title for f, acts in zip(factors, active, strict=True) if acts]
        first |= _by_factor(titles, found.first_order, spread.first_order)
        total |= _by_factor(titles, found.total_order, spread.total_order)
    return {"first_order": first, "total": total}


def _mean(rows: Sequence[Row], response: Response) -> float:
    """Over the runs of a point; not a number where one has none."""
    values = [np.nan if r.error or (v := response(r)) is None else v for r in rows]
    return float(np.mean(values)) if values else np.nan


def _by_factor(titles: Sequence[str], index: Array, spread: Any) -> dict[str, Any]:
    interval = spread.confidence_interval
    low, high = np.ravel(interval.low), np.ravel(interval.high)
    return {
        title: _index(x, a, b)
        for title, x, a, b in zip(titles, np.ravel(index), low, high, strict=True)
    }


def _index(value: float, low: float, high: float) -> dict[str, Any]:
    return {"value": float(value), "interval_95": [float(low), float(high)]}
