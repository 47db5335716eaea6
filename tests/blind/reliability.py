"""Whether stated probabilities hold: of a hundred statements of 90 %, ninety are to be so."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from blind.table import wilson

Plain = dict[str, Any]
EDGES = (0.0, 0.5, 0.75, 0.9, 0.99, 1.0)
RESAMPLES = 2000
WHAT = {"name": "the likeliest name is the true one", "exists": "something is there"}


def reliability(results: Sequence[Plain]) -> Plain:
    """By what is stated: bins, Brier score and expected calibration error with 95 % intervals.
    Empty where no answer states a probability.
    """
    out = {}
    for what in WHAT:
        cases = [r["stated"][what] for r in results if what in r.get("stated", {})]
        if cases:
            out[what] = summary([np.array(c, float) for c in cases])
    return out


def summary(cases: Sequence[np.ndarray]) -> Plain:
    """cases: (statements, 2) each, probability and whether it is so. Whole cases are resampled:
    statements on one recording err together.
    """
    every = np.vstack(cases)
    return {
        "cases": len(cases),
        "bins": [_bin(every, k) for k in range(len(EDGES) - 1)],
        "brier": {"value": brier(every), "interval": _bootstrap(cases, brier)},
        "calibration_error": {
            "value": calibration_error(every),
            "interval": _bootstrap(cases, calibration_error),
        },
    }


def which_bin(p: np.ndarray) -> np.ndarray:
    """The bin of each probability; every bin holds its lower edge, the last one both. p: (n,)."""
    return np.clip(np.searchsorted(EDGES, p, side="right") - 1, 0, len(EDGES) - 2)


def _bin(every: np.ndarray, k: int) -> Plain:
    own = every[which_bin(every[:, 0]) == k]
    n, right = len(own), int(own[:, 1].sum())
    return {
        "from": EDGES[k],
        "to": EDGES[k + 1],
        "n": n,
        "right": right,
        "stated": float(own[:, 0].mean()) if n else None,
        "interval": wilson(right, n),
    }


def brier(every: np.ndarray) -> float:
    """Mean squared distance of what is stated from what is so. every: (n, 2)."""
    return float(np.mean((every[:, 0] - every[:, 1]) ** 2))


def calibration_error(every: np.ndarray) -> float:
    """Mean over the statements of |stated - frequency| of their bin. every: (n, 2)."""
    own = which_bin(every[:, 0])
    gaps = [abs(every[own == k].mean(0) @ [1, -1]) * (own == k).sum() for k in np.unique(own)]
    return float(sum(gaps) / len(every))


def _bootstrap(
    cases: Sequence[np.ndarray], figure: Callable[[np.ndarray], float]
) -> tuple[float, float]:
    rng = np.random.default_rng(0)
    draws = [
        figure(np.vstack([cases[k] for k in rng.integers(len(cases), size=len(cases))]))
        for _ in range(RESAMPLES)
    ]
    low, high = np.quantile(draws, [0.025, 0.975])
    return float(low), float(high)


def show(told: Plain) -> str:
    """In text; nothing where nothing is stated."""
    out = []
    for what, own in told.items():
        out.append(f"\nstated probability that {WHAT[what]}: {own['cases']} cases")
        out.append(f"{'stated':>14s} {'mean':>8s} {'so':>11s} {'rate':>8s}  95 % interval")
        out += [_line(b) for b in own["bins"]]
        for name, key in (("Brier score", "brier"), ("calibration error", "calibration_error")):
            low, high = own[key]["interval"]
            out.append(f"{name:20s} {own[key]['value']:.4f}  ({low:.4f} .. {high:.4f})")
    return "\n".join(out)


def _line(b: Plain) -> str:
    low, high = b["interval"]
    rate = f"{100 * b['right'] / b['n']:6.1f} %" if b["n"] else "-"
    mean = f"{100 * b['stated']:6.1f} %" if b["n"] else "-"
    return (
        f"{b['from']:6.2f} .. {b['to']:4.2f} {mean:>8s} {b['right']:5d}/{b['n']:<5d} {rate:>8s}"
        f"  {100 * low:.1f} .. {100 * high:.1f} %"
    )
