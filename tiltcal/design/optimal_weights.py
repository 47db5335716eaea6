"""Weights on a grid of poses: what they can reach at best, and bounds that no weights can pass."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.signatures import Field

CLOSE = 1.002  # upper over lower bound at which a reference is accurate enough
CUTS = 4  # planes of a bound


def most_visible(field: Field, rounds: int = 600) -> tuple[float, float]:
    """What the best weights found leave of an effect, and what no weights can pass.

    Multiplicative ascent; the largest energy at any pose is the bound (equivalence theorem).
    Where convergence is slow, cutting planes.
    """
    n = len(field.F)
    w = best = np.full(n, 1 / n)
    least, upper = 0.0, np.inf
    for k in range(rounds):
        r = field.left_over(w)[:, 0]
        mean = float(w @ r)
        best, least = (w, mean) if mean > least else (best, least)
        upper = min(upper, float(r.max()))
        if upper < CLOSE * least:
            return least, upper
        w = w * np.exp((1.0 + 4.0 * k / rounds) * (r / mean - 1).clip(-1, 1))
        w /= w.sum()
    least, below = certified(field, np.ones(1), best, planes=60)
    return least, min(upper, below)


def most_log_det(field: Field, rounds: int = 200) -> float:
    """What no weights can pass of the log determinant per term, mean of the channels (D-optimality,
    equivalence theorem).
    """
    n = len(field.F)
    w, upper = np.full(n, 1 / n), np.inf
    for _ in range(rounds):
        value, slope = field.log_det(w)
        upper = min(upper, value + float(np.log(slope.max())))
        if slope.max() < 1.0005:
            break
        w = w * slope
        w /= w.sum()
    return upper


def best_weights(field: Field, references: Array, rounds: int = 300) -> Array:
    """Weights with the greatest least share. references: most of each effect, (effects,); the
    weights, (n,).

    Multiplicative ascent of the mix of effects that a soft minimum picks, ever sharper.
    """
    n = len(field.F)
    w = np.full(n, 1 / n)
    best, least = w, -np.inf
    for k in range(rounds):
        r = field.left_over(w) / references
        seen = w @ r
        if seen.min() > least:
            best, least = w, float(seen.min())
        mix = np.exp(-80 * (0.2 + 2.0 * k / rounds) * (seen - seen.min()))
        pull = r @ (mix / mix.sum())
        w = w * np.exp(0.8 * (pull / float(w @ pull) - 1).clip(-1, 1))
        w /= w.sum()
    return best


def certified(
    field: Field, references: Array, best: Array, planes: int = CUTS, log_det: float | None = None
) -> tuple[float, float]:
    """The greatest least share found, and what no weights can pass, by cutting planes (Kelley
    1960). references: (effects,); best: (n,).

    Terms fitted with other weights v leave at least the energy that the best terms leave, so that
    share_e(w) <= sum_x w(x) r_e(x; v) for all w and v, and log det is concave. Each round solves a
    linear programme over w and takes v between its solution and the best weights so far.

    Args:
        field: of all poses.
        references: most of each effect.
        best: weights to start from.
        planes: how many v.
        log_det: of the linear terms, which the weights have to keep; any unless given.
    """
    from scipy.optimize import linprog

    n = len(best)
    rows: list[Array] = []
    right: list[float] = []
    v, least, upper = best, -np.inf, np.inf
    for _ in range(planes):
        left = field.left_over(v) / references
        value, slope = field.log_det(v)
        if (v @ left).min() > least and (log_det is None or value >= log_det):
            best, least = v, float((v @ left).min())
        rows += [np.append(-share, 1.0) for share in left.T]
        right += [0.0] * len(references)
        if log_det is not None:
            rows.append(np.append(-slope, 0.0))
            right.append(value - 1 - log_det)
        found = linprog(
            np.append(np.zeros(n), -1.0),
            A_ub=np.array(rows),
            b_ub=np.array(right),
            A_eq=np.append(np.ones(n), 0.0)[None, :],
            b_eq=[1.0],
            bounds=[(0, None)] * n + [(None, None)],
            method="highs",
        )
        upper = min(upper, -float(found["fun"]))
        if upper < CLOSE * least:
            break
        solution = found["x"][:-1].clip(0)
        v = (solution / solution.sum() + 3 * best) / 4
    return least, upper
