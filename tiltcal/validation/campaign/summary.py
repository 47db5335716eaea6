"""What a campaign found: statistics of each method at each combination of levels, and how much each
random factor contributes.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

from tiltcal.validation.campaign.campaign_runs import PointRun, Recorded
from tiltcal.validation.campaign.points import cells_of, count_of
from tiltcal.validation.campaign.results import Results, provenance_of
from tiltcal.validation.campaign.sensitivity import sensitivity_of
from tiltcal.validation.run_statistics import statistics_of
from tiltcal.validation.runs import Row

SHOWN = 20  # failed runs that are named one by one

Finished = list[tuple[PointRun, Recorded]]


def summary_of(results: Results) -> dict[str, Any]:
    """The summary as plain values for JSON.

    Returns:
        cells: one for each combination of levels, with ``values`` and, by method, what
        ``statistics_of`` says, and ``sensitivity`` where there are distributions. faults: runs
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
