"""What a campaign found: statistics of each method at each combination of levels, and how much each
random factor contributes.

First-order and total sensitivity indices are computed by ``scipy``. The noise of the runs is one
more factor, which A shares with AB: it adds to the variance and to no factor's total index.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.units import ARCSEC
from tiltcal.validation.campaign.campaign_file import Campaign
from tiltcal.validation.campaign.campaign_runs import PointRun, Recorded
from tiltcal.validation.campaign.points import cells_of, count_of
from tiltcal.validation.campaign.results import Results, provenance_of
from tiltcal.validation.run_statistics import statistics_of
from tiltcal.validation.runs import Row

LEVEL = 0.95
RESAMPLES = 999
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
    values = {n: _values(campaign, rows, r) for n, r in _responses(first).items()}
    found: dict[str, Any] = {n: {"reason": r} for n, v in values.items() if (r := _reason(v))}
    whole = [n for n in values if n not in found]
    if whole:
        indices = _indices(campaign, np.stack([values[n] for n in whole], axis=1))
        found |= dict(zip(whole, indices, strict=True))
    return {name: found[name] for name in values}


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


def _values(
    campaign: Campaign, rows: Mapping[tuple[str, int], Sequence[Row]], response: Response
) -> Array:
    """A response at A, B and the exchanged points, (2 + d, n)."""
    names = ["A", "B", *(f"AB{k}" for k in range(1, len(campaign.distributions) + 1))]
    samples = range(campaign.table.samples)
    return np.array([[_mean(rows.get((m, j), ()), response) for j in samples] for m in names])


def _mean(rows: Sequence[Row], response: Response) -> float:
    """Over the runs of a point; not a number where one has none."""
    values = [np.nan if r.error or (v := response(r)) is None else v for r in rows]
    return float(np.mean(values)) if values else np.nan


def _reason(values: Array) -> str | None:
    """Why a response has no indices."""
    missing = int((~np.isfinite(values)).sum())
    if missing:
        return f"{missing} of {values.size} points have no such result"
    return None if values[:2].std() > 0 else "it never varies"


def _indices(campaign: Campaign, values: Array) -> list[dict[str, Any]]:
    """Indices of each response.

    Args:
        values: as of ``_values``, (2 + d, s, n).
    """
    from scipy.stats import bootstrap, sobol_indices

    factors, n = campaign.distributions, campaign.table.samples

    def indices(which: Index) -> Array:
        """Of the points with these numbers, (2, s, d)."""
        v = values[..., which]
        found = sobol_indices(func={"f_A": v[0], "f_B": v[1], "f_AB": v[2:]}, n=n)
        shape = (v.shape[1], len(factors))
        return np.stack([found.first_order.reshape(shape), found.total_order.reshape(shape)])

    spread: Any = bootstrap(
        (np.arange(n),),
        indices,
        confidence_level=LEVEL,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=False,
        rng=np.random.default_rng(campaign.seed),
    )
    low, high = spread.confidence_interval
    best, titles = indices(np.arange(n)), [f.title for f in factors]
    return [
        {
            kind: {
                title: {"value": float(x), "interval_95": [float(a), float(b)]}
                for title, x, a, b in zip(titles, best[k, i], low[k, i], high[k, i], strict=True)
            }
            for k, kind in enumerate(("first_order", "total"))
        }
        for i in range(values.shape[1])
    ]


SHOWN = 20  # failed runs that are named one by one

Finished = list[tuple[PointRun, Recorded]]


def summary_of(results: Results) -> dict[str, Any]:
    """The summary as plain values for JSON.

    Returns:
        cells: one for each combination of levels, with ``values`` and, by method, what
        ``statistics_of`` returns, and ``sensitivity`` where there are distributions. faults: runs
        whose process had to go, by kind; failed: the first of all runs without a result.
    """
    campaign = results.campaign
    labels = [values for values, _ in cells_of(campaign)]
    cells, failed = list[dict[str, Any]](), list[dict[str, Any]]()
    faults, runs, seconds = dict[str, int](), 0, 0.0
    for number, finished in _by_cell(results):
        cells.append({"values": labels[number]} | _cell(results, finished))
        runs += len(finished)
        for run, recorded in finished:
            seconds += recorded.seconds
            if recorded.fault:
                faults[recorded.fault] = faults.get(recorded.fault, 0) + 1
            failed += [_failed(run, r) for r in recorded.rows if r.error][: SHOWN - len(failed)]
    return {
        "schema": 1,
        "name": campaign.table.name,
        "provenance": provenance_of(campaign),
        "runs": runs,
        "runs_planned": count_of(campaign) * campaign.table.runs,
        "seconds_of_runs": seconds,
        "faults": faults,
        "failed": failed,
        "cells": cells,
    }


def _by_cell(results: Results) -> Iterator[tuple[int, Finished]]:
    """The runs of each combination of levels."""
    for number, group in groupby(results.runs(), key=lambda pair: pair[0].point.cell):
        yield number, list(group)


def _cell(results: Results, finished: Finished) -> dict[str, Any]:
    """Statistics by method. Of a design these are of A and B, which are independent draws."""
    found: dict[str, Any] = {"methods": {}}
    for k, method in enumerate(_methods(finished)):
        rows: Sequence[Row] = [
            recorded.rows[k]
            for run, recorded in finished
            if not run.point.matrix.startswith("AB") and k < len(recorded.rows)
        ]
        found["methods"][method] = statistics_of(rows, results.campaign.table.quantile)
        if results.campaign.distributions:
            indices = sensitivity_of(results.campaign, finished, k)
            found["methods"][method]["sensitivity"] = indices
    return found


def _methods(finished: Finished) -> list[str]:
    """The methods' names, each with a number where two are of one name."""
    titles = [row.method for row in finished[0][1].rows]
    return [t if titles.count(t) == 1 else f"{t} {k}" for k, t in enumerate(titles, start=1)]


def _failed(run: PointRun, row: Row) -> dict[str, Any]:
    return {
        "values": run.point.values,
        "seed": run.seed,
        "method": row.method,
        "error": row.error,
    }
