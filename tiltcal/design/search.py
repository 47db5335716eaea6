"""The search: regular paths over the table's angles as starts, gradient ascent, then insertions,
removals and other orders.

Deterministic: a fixed number of trials, their random numbers from the seed. Smooth ascent
(``ascent``) moves all poses at once; what it cannot do (another number of poses, another order, the
same direction from the table's other side) is tried one change at a time, and the best is ascended
again.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.progress import Part, Progress, Stages, silent, unmeasured
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.tasks.run_tasks import values_of
from tiltcal.design.gradient_search import Draft, Problem, ascend
from tiltcal.design.time_budget import Clock

SWEEPS = 5  # over all poses, on steps
ON_STEPS = 2  # drafts that are brought onto steps
PATHS, BEST, HOPS = "improving paths", "improving the best paths", "other ways to few poses"
# measured: of the ascent of a draft; part of a round
ITERATIONS_OF_A_TRIAL = 1.0
CHANGES = 0.5
HOP = (0.05, 1.5)  # rad: standard deviation of a shift, least and largest
HEAT = 0.3  # nats, of what is gone on from
ITERATIONS_OF_A_HOP = 40


@dataclass(frozen=True)
class Effort:
    """How much is tried.

    Args:
        starts: paths.
        begun: sequences beside them, of those that are given.
        first, then: iterations of ascent of all of them, and of the best.
        kept: how many those are.
        rounds: of single changes.
        trials: changes tried in a round.
        hops: changes of all poses at random, each ascended, that the best sequence goes through.
    """

    starts: int = 8  # 18 of them, and three kept, brought 0.03 nats at most in the textbook cells
    begun: int = 4
    first: int = 40
    then: int = 120
    kept: int = 2
    rounds: int = 2
    trials: int = 40
    hops: int = 0

    @property
    def shares(self) -> dict[str, float]:
        """Work of each stage of the search, in iterations of the ascent of a draft."""
        change = self.then + ITERATIONS_OF_A_TRIAL * self.trials
        found = {
            PATHS: float((self.starts + self.begun) * self.first),
            BEST: float(self.kept * self.then),
        }
        rounds = {self.round_name(k): self.kept * change for k in range(self.rounds)}
        return found | rounds | ({HOPS: float(self.hops)} if self.hops else {})

    def round_name(self, number: int) -> str:
        """What a round of changes is called in messages; ``number``: from 0."""
        return f"other numbers and orders, round {number + 1} of {self.rounds}"


def search(
    problem: Problem,
    starts: list[Draft],
    seed: int,
    effort: Effort,
    notice: Progress = silent,
    engine: Engine | None = None,
) -> Draft:
    """The best sequence found.

    Args:
        problem: model, clock and criterion.
        starts: drafts to improve in addition to the regular paths (classic sequences).
        seed: of the paths.
        effort: how much is tried.
        notice: callback for messages on progress, with the time left.
        engine: where drafts are improved; this process if not given. The design is the same.
    """
    rng, stages = np.random.default_rng(seed), Stages(notice, effort.shares)
    drafts = [problem.rated(d.angles, d.z) for d in starts]
    drafts = sorted(drafts, key=_worth(problem), reverse=True)
    begun = [problem.rated(a, np.zeros(len(a))) for a in paths(problem, rng, effort.starts)]
    begun += drafts[: effort.begun]
    stages.begin(PATHS)
    drafts += _ascended(problem, begun, effort.first, engine, stages.part)
    best = sorted(drafts, key=_worth(problem), reverse=True)[: effort.kept]
    stages.begin(BEST)
    best = _ascended(problem, best, effort.then, engine, stages.part)
    for round_ in range(effort.rounds):
        stages.begin(effort.round_name(round_))
        best = [changed(problem, d, rng, effort.trials) for d in best]
        stages.part(CHANGES)
        best = _ascended(problem, best, effort.then, engine)
    if effort.hops:
        stages.begin(HOPS)
        best.append(annealed(problem, max(best, key=_worth(problem)), rng, effort.hops))
    if problem.clock.step > 0:
        best = [on_steps(problem, d) for d in sorted(best, key=_worth(problem))[-ON_STEPS:]]
    return max([*best, *(problem.rated(d.angles, d.z) for d in starts)], key=_worth(problem))


def _worth(problem: Problem) -> Callable[[Draft], tuple[bool, float]]:
    """Drafts whose fit can be judged come first, where the budget has them."""

    def worth(draft: Draft) -> tuple[bool, float]:
        return len(draft.angles) >= problem.least and draft.value > -np.inf, draft.value

    return worth


def _ascended(
    problem: Problem,
    drafts: Sequence[Draft],
    iterations: int,
    engine: Engine | None,
    part: Part = unmeasured,
) -> list[Draft]:
    return values_of(ascend, [(problem, d, iterations) for d in drafts], engine, part)


def poses_worth(problem: Problem) -> int:
    """How many poses a budget is best spent on when a move takes about two seconds."""
    clock, model = problem.clock, problem.model
    overhead = clock.settle + 2.0
    knee = float(np.max(model.white**2 / np.maximum(model.floor**2, 1e-300)))
    dwell = float(np.clip(np.sqrt(min(knee, 1e6) * overhead), clock.shortest, clock.longest))
    return max(1, round(clock.budget / (overhead + dwell)))


def paths(problem: Problem, rng: np.random.Generator, count: int) -> Iterator[Array]:
    """Straight lines over the angles, folded into the limits: steps of one size, so that moves are
    cheap. Angles in rad, (n, axes).
    """
    clock, axes = problem.clock, problem.model.axes
    worth = poses_worth(problem)
    for k in range(count):
        n = max(problem.least, round(worth * (0.8, 0.9, 1.0, 1.1, 1.2, 1.3)[k % 6]))
        slope = rng.uniform(0.2, 1.2, axes) * rng.choice([-1.0, 1.0], axes)
        angles = (
            np.arange(n)[:, None] * slope
            + rng.normal(0, 0.1, (n, axes))
            + rng.uniform(-0.5, 0.5, axes)
            + clock.origin
        )
        while len(angles) > 1 and float(clock.spare(folded(angles, clock))) < 0:
            angles = angles[:-1]
        yield folded(angles, clock)


def folded(angles: Array, clock: Clock) -> Array:
    """Angles reflected at the limits, as often as needed. angles: rad, (n, axes)."""
    found = angles.copy()
    for k, pair in enumerate(clock.limits):
        if pair is not None:
            width = max(pair[1] - pair[0], 1e-9)
            phase = (found[:, k] - pair[0]) % (2 * width)
            found[:, k] = pair[0] + np.where(phase > width, 2 * width - phase, phase)
    return found


def changed(problem: Problem, draft: Draft, rng: np.random.Generator, trials: int) -> Draft:
    """The best draft after one change: a pose less, a pose more, a stretch reversed, a pose from
    the other side.
    """
    candidates = [
        *_shorter(draft),
        *_longer(draft, problem.clock.origin, rng),
        *_reversed(problem, draft),
    ]
    if problem.model.axes == 2 and all(pair is None for pair in problem.clock.limits):
        candidates += list(_other_side(draft, problem.clock.origin))
    rng.shuffle(candidates)
    rated = [
        problem.rated(folded(angles, problem.clock), z) for angles, z in candidates[: 4 * trials]
    ]
    worth = _worth(problem)
    rated.sort(key=worth, reverse=True)
    polished = [ascend(problem, d, 15) for d in rated[: max(trials // 10, 1)]]
    return max([*rated[:1], draft, *polished], key=worth)


def annealed(problem: Problem, draft: Draft, rng: np.random.Generator, hops: int) -> Draft:
    """The best of a walk from maximum to maximum: poses are shifted at random and ascended, and
    what is a little worse is gone on from, less and less so.

    Where moves take most of the table time the maxima are many and far apart: six searches of a
    plan of 60 s differed by 2.3 nats without, by 0.1 with 300 hops.

    Source: Wales and Doye 1997, *Global optimization by basin-hopping*.
    """
    best, worth = draft, _worth(problem)
    for hop in range(hops):
        size = np.exp(rng.uniform(*np.log(HOP)))
        shape = (len(draft.angles), 1) if hop % 2 else draft.angles.shape
        shift = rng.normal(0, size, draft.angles.shape) * rng.choice([0, 1], shape)
        found = problem.rated(folded(draft.angles + shift, problem.clock), draft.z)
        found = ascend(problem, found, ITERATIONS_OF_A_HOP)
        heat = HEAT * (1 - hop / hops)
        if found.value > draft.value - heat * rng.exponential():
            draft = found
        best = max(best, draft, key=worth)
    return best


def _shorter(draft: Draft) -> Iterator[tuple[Array, Array]]:
    if len(draft.angles) > 1:
        for k in range(len(draft.angles)):
            yield np.delete(draft.angles, k, axis=0), np.delete(draft.z, k)


def _longer(draft: Draft, origin: Array, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """A pose between two, anywhere near the way."""
    angles = np.vstack([origin, draft.angles])
    for k in range(len(draft.angles)):
        between = (angles[k] + angles[k + 1]) / 2 + rng.normal(0, 0.15, angles.shape[1])
        yield np.insert(draft.angles, k, between, axis=0), np.insert(draft.z, k, draft.z[k])


def _reversed(problem: Problem, draft: Draft) -> Iterator[tuple[Array, Array]]:
    """2-opt: stretches whose reversal costs the least table time, and the whole way back."""
    n = len(draft.angles)
    order = np.arange(n)
    found = []
    for i in range(n - 1):
        for j in range(i + 1, n):
            turned = np.concatenate([order[:i], order[i : j + 1][::-1], order[j + 1 :]])
            found.append((_ends(draft.angles, i, j, problem.clock), turned))
    for _, turned in sorted(found, key=lambda item: item[0])[:40]:
        yield draft.angles[turned], draft.z[turned]


def _ends(angles: Array, i: int, j: int, clock: Clock) -> float:
    """Seconds that the reversal of poses i..j costs."""
    before = angles[i - 1] if i else clock.origin
    cost = np.abs(angles[j] - before).max() - np.abs(angles[i] - before).max()
    if j + 1 < len(angles):
        cost += np.abs(angles[j + 1] - angles[i]).max() - np.abs(angles[j + 1] - angles[j]).max()
    return float(cost / clock.rate)


def _other_side(draft: Draft, origin: Array) -> Iterator[tuple[Array, Array]]:
    """The dual table turns a direction up from two sides: (a, b) and (-a, b + 180 deg)."""
    for k in range(len(draft.angles)):
        before = draft.angles[k - 1] if k else origin
        other = np.array([-draft.angles[k, 0], draft.angles[k, 1] + np.pi])
        angles = draft.angles.copy()
        angles[k] = before + (other - before + np.pi) % (2 * np.pi) - np.pi
        yield angles, draft.z


def on_steps(problem: Problem, draft: Draft) -> Draft:
    """The draft on the table's steps: rounded, then one change of a pose at a time while that
    helps.
    """
    best = ascend(
        problem, problem.rated(problem.clock.inside(draft.angles), draft.z), 40, dwells_only=True
    )
    for _ in range(SWEEPS):
        before = best.value
        k = 0
        while k < len(best.angles):  # poses that become the same are one: there may be fewer
            for angles, z in _near_on_steps(best, k, problem.clock.step):
                trial = problem.rated(problem.clock.inside(angles), z)
                best = trial if trial.value > best.value else best
            k += 1
        best = ascend(problem, best, 40, dwells_only=True)
        if best.value - before < 1e-3:
            break
    return best


def _near_on_steps(draft: Draft, k: int, step: float) -> Iterator[tuple[Array, Array]]:
    """Pose k some steps away, left out, exchanged with the next, and once more a step away."""
    angles, z = draft.angles, draft.z
    ways = np.vstack([np.eye(angles.shape[1]), -np.eye(angles.shape[1])]) * step
    for turn in np.vstack([ways, 2 * ways, 4 * ways]):
        turned = angles.copy()
        turned[k] += turn
        yield turned, z
    for way in ways:
        yield np.insert(angles, k + 1, angles[k] + way, axis=0), np.insert(z, k + 1, z[k])
    if k + 1 < len(angles):
        order = np.arange(len(angles))
        order[k : k + 2] = k + 1, k
        yield angles[order], z[order]
        yield np.delete(angles, k, axis=0), np.delete(z, k)
