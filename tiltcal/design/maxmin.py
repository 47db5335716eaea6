"""Blind to nothing: the poses whose least visible effect is seen best, with little loss for the ordinary calibration.

share_e = energy of effect e that a design leaves visible, over the most that any design of as many poses could.
Weights on a grid of poses make every energy concave: the greatest least share over all weights is a bound that no number of
poses can pass, and its dual certifies it. Exact poses come from the best weights by gradient ascent of a soft minimum.

Source: T-optimality, Atkinson and Fedorov 1975; maximin efficiency, Dette 1997.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.design.descent import minimise
from tiltcal.design.polynomial import dual_up
from tiltcal.design.signatures import EFFECTS, GROUP, efficiency, left_over, linear_part, signatures
from tiltcal.frames import Array
from tiltcal.units import DEG

GRID = 10 * DEG
SHARP = 80.0  # of the soft minimum
KEPT = 0.987  # D-efficiency that ascent aims at
PENALTY = 400.0
DIFF = 1e-5  # rad


@dataclass(frozen=True)
class MaxMin:
    """A design that is blind to nothing.

    Args:
        angles: rad, (n, 2), in the order of visiting.
        shares: of each effect in ``EFFECTS``; efficiency: D, of the linear terms.
        bound: on the least share of any design; references: most energy a pose of each effect, and how far off at most.
        drift, warmup: share of a linear and of an exponential drift that the order leaves visible.
    """

    angles: Array
    shares: Array
    efficiency: float
    bound: float
    references: Array
    reference_gap: float
    drift: float
    warmup: float


def blind_to_nothing(poses: int = 24, seed: int = 0, starts: int = 10) -> MaxMin:
    """The max-min design of some poses on the dual table."""
    grid = grid_of_poses()
    found = [most_visible(grid, np.eye(len(EFFECTS))[k]) for k in range(len(EFFECTS))]
    references = np.array([upper for _, _, upper in found])
    gap = max(upper / lower - 1 for _, lower, upper in found)
    weights, bound = best_weights(grid, references)
    rng = np.random.default_rng(seed)
    drafts = []
    for k in range(starts):
        chosen = grid[rng.choice(len(grid), poses, replace=k > starts // 2, p=weights)] + rng.normal(0, 0.03, (poses, 2))
        drafts.append(climbed(chosen, references, 60))
    ranked = sorted(drafts, key=lambda a: merit(a, references))
    best = max((climbed(a, references, 250) for a in ranked[-3:]), key=lambda a: merit(a, references))
    ordered, drift, warmup = visiting_order(best, rng)
    return MaxMin(ordered, shares(ordered, references), efficiency(ordered), bound, references, gap, drift, warmup)


def grid_of_poses() -> Array:
    """All poses on the grid, rad, (n, 2)."""
    turn = np.arange(-np.pi, np.pi - 1e-9, GRID)
    return np.stack(np.meshgrid(turn, turn, indexing="ij"), axis=-1).reshape(-1, 2)


def shares(angles: Array, references: Array) -> Array:
    """Share of each effect, (effects,)."""
    n = len(angles)
    return np.asarray(left_over(angles, np.full(n, 1 / n))[0].mean(axis=0) / references)


def merit(angles: Array, references: Array) -> float:
    """Least share, lessened where the linear terms lose too much."""
    return float(shares(angles, references).min() - 10 * max(KEPT - 0.001 - efficiency(angles), 0.0))


def most_visible(grid: Array, mix: Array, rounds: int = 400) -> tuple[Array, float, float]:
    """Weights that leave most of a mix of effects, what they leave, and what no weights can pass.

    Multiplicative ascent; the largest energy at any pose is the bound (equivalence theorem).
    """
    w = np.full(len(grid), 1 / len(grid))
    best, upper = (w, -np.inf), np.inf
    for k in range(rounds):
        r = left_over(grid, w)[0] @ mix
        mean = float(w @ r)
        best = (w, mean) if mean > best[1] else best
        upper = min(upper, float(r.max()))
        if upper / best[1] < 1.004:
            break
        w = w * np.exp((1.0 + 4.0 * k / rounds) * (r / mean - 1).clip(-1, 1))
        w /= w.sum()
    return best[0], best[1], upper


def best_weights(grid: Array, references: Array, rounds: int = 1500) -> tuple[Array, float]:
    """Weights with the greatest least share, and the bound on it: any mix of effects gives one, the softest the best."""
    w = np.full(len(grid), 1 / len(grid))
    best, upper, calm = (w, -np.inf), np.inf, np.empty(0)
    for k in range(rounds):
        r = left_over(grid, w)[0] / references
        seen = w @ r
        best = (w, float(seen.min())) if seen.min() > best[1] else best
        mix = np.exp(-SHARP * (0.2 + 2.0 * k / rounds) * (seen - seen.min()))
        mix /= mix.sum()
        pull = r @ mix
        calm = mix if k == 0 else 0.98 * calm + 0.02 * mix  # the mix swings about the best one
        upper = min(upper, float(pull.max()), float((r @ calm).max()))
        if upper / best[1] < 1.01:
            break
        w = w * np.exp(0.8 * (pull / float(w @ pull) - 1).clip(-1, 1))
        w /= w.sum()
    return best[0], upper


def climbed(angles: Array, references: Array, iterations: int) -> Array:
    """The poses after ascent of the soft minimum of the shares, the linear terms kept."""
    n = len(angles)
    free = np.full(2 * n, np.inf)

    def fall(x: Array) -> tuple[float, Array]:
        return _falling(x.reshape(n, 2), references)

    return minimise(fall, angles.ravel(), -free, free, iterations).reshape(n, 2)


def _falling(angles: Array, references: Array) -> tuple[float, Array]:
    """Minus the soft minimum, with a penalty on lost D-efficiency, and its gradient by the angles, (2 n,).

    The fitted linear terms are at their optimum, so only the poses' own energies move with the poses.
    """
    n = len(angles)
    even = np.full(n, 1 / n)
    energy, _ = left_over(angles, even)
    seen = energy.mean(axis=0) / references
    mix = np.exp(-SHARP * (seen - seen.min()))
    value = float(seen.min() - np.log(mix.sum()) / SHARP)
    mix /= mix.sum()
    F = linear_part(dual_up(angles))
    kept = efficiency(angles)
    lost = max(KEPT - kept, 0.0)
    inverse = np.linalg.inv(F.T @ F / n + 1e-9 * np.eye(4))
    slope = np.empty((n, 2))
    for axis in range(2):
        ahead = angles + DIFF * np.eye(2)[axis]
        moved = energies_with(angles, ahead) @ (mix / references) - energy @ (mix / references)
        of_kept = kept / (2 * n) * np.einsum("ni,ij,nj->n", F, inverse, (linear_part(dual_up(ahead)) - F) / DIFF)
        slope[:, axis] = moved / (n * DIFF) + 2 * PENALTY * lost * of_kept
    return -value + PENALTY * lost**2, -slope.ravel()


def energies_with(fitted: Array, angles: Array) -> Array:
    """Energy at ``angles`` with the linear terms fitted at the poses ``fitted``, (n, effects)."""
    F, G = linear_part(dual_up(fitted)), linear_part(dual_up(angles))
    E, H = signatures(fitted), signatures(angles)
    M = F.T @ F / len(F) + 1e-9 * np.eye(4)
    rest = H.reshape(len(H), -1) - G @ np.linalg.solve(M, F.T @ E.reshape(len(E), -1) / len(F))
    return (rest**2).reshape(H.shape).sum(axis=1) @ np.eye(len(EFFECTS))[GROUP]


def visiting_order(angles: Array, rng: np.random.Generator) -> tuple[Array, float, float]:
    """The poses in an order that hides neither a linear drift nor a warm-up, at little travel.

    Starting from the nearest of those left, pairs are exchanged while the visible shares, or the travel, improve.
    """
    n = len(angles)
    left, order = list(range(1, n)), [0]
    while left:
        k = min(left, key=lambda i: float(np.abs(_wrapped(angles[i] - angles[order[-1]])).max()))
        left.remove(k)
        order.append(k)
    best = np.array(order)
    for _ in range(3):
        for first, second in rng.permutation([(i, j) for i in range(n) for j in range(i)]):
            trial = best.copy()
            trial[[first, second]] = trial[[second, first]]
            if _worth(angles[trial]) > _worth(angles[best]):
                best = trial
    drift, warmup = visible_in_time(angles[best])
    return angles[best], drift, warmup


def _wrapped(turn: Array) -> Array:
    return np.asarray((turn + np.pi) % (2 * np.pi) - np.pi)


def _worth(angles: Array) -> float:
    """Least visible share in time, less the travel: a turn of the table costs a hundredth."""
    travel = np.abs(_wrapped(np.diff(angles, axis=0))).max(axis=1).sum() / (2 * np.pi)
    return min(*visible_in_time(angles), 0.97) - 0.01 * float(travel)


def visible_in_time(angles: Array) -> tuple[float, float]:
    """Share of a linear drift and of a warm-up (time constant a third of the sequence) that the linear terms leave."""
    Q, _ = np.linalg.qr(linear_part(dual_up(angles)))
    t = np.linspace(0, 1, len(angles))
    found = []
    for course in (t, np.exp(-3 * t)):
        centred = course - course.mean()
        rest = course - Q @ (Q.T @ course)
        found.append(float(rest @ rest / (centred @ centred)))
    return found[0], found[1]
