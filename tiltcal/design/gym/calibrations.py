"""Many calibrations of a triad on a dual table at once: what each knows, where its table stands,
what time is left.

The posterior covariance is kept channel by channel and takes a pose in by a rank-one update
(Sherman and Morrison 1950);
channels with the same regressors share one. Units: g, prior standard deviations, s, rad.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.units import DEG
from tiltcal.design.polynomial import FLOOR, KINDS, PRIOR, WHITE, dual_up, regressors
from tiltcal.design.time_budget import Clock
from tiltcal.setup.reach import Reach
from tiltcal.setup.tables import DUAL

SLACK = 1e-3  # s by which an episode may overrun: actions are float32
HALF_TURN = 180.0  # deg, the longest move the short way round


@dataclass(frozen=True)
class Task:
    """What is to be calibrated, and with what.

    Args:
        model: linear, K2, K2K3, quadratic or cubic.
        drift: whether the biases drift linearly, as a nuisance.
        budget_s: of table time.
        rate_deg_s: of moves.
        settle_s: after each.
        shortest_s, longest_s: of a dwell.
        limits_deg: lowest and highest angle of an axis, outer or inner; without one it turns
            without end.
    """

    model: str = "linear"
    drift: bool = True
    budget_s: float = 300.0
    rate_deg_s: float = 20.0
    settle_s: float = 5.0
    shortest_s: float = 5.0
    longest_s: float = 60.0
    limits_deg: Mapping[str, tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        one_of(self.model, KINDS, "textbook model")
        clock = self.clock
        longest_move = float(
            np.where(self.endless, HALF_TURN, self.reach.high - self.reach.low).max()
        )
        least = (
            longest_move / self.rate_deg_s + 2 * self.settle_s + self.longest_s + self.shortest_s
        )
        if clock.budget < least:
            raise TiltcalError(
                "environment, budget_s",
                found=f"{self.budget_s:g} s",
                need=f"{least:g} s: an episode has more than one step",
                do="raise it, or shorten longest_s",
            )

    @cached_property
    def reach(self) -> Reach:
        """Where the axes may stand."""
        return Reach.of(DUAL, self.limits_deg or {}, {})

    @cached_property
    def endless(self) -> Mask:
        """Which axes turn without end, (2,)."""
        return np.array([self.reach.limits(axis) is None for axis in DUAL.axis_names])

    @property
    def clock(self) -> Clock:
        """The same for a design."""
        ends = [self.reach.limits(axis) for axis in DUAL.axis_names]
        return Clock(
            self.budget_s,
            self.rate_deg_s * DEG,
            self.settle_s,
            self.shortest_s,
            self.longest_s,
            tuple(None if pair is None else (pair[0] * DEG, pair[1] * DEG) for pair in ends),
        )

    @property
    def width(self) -> int:
        """Parameters of interest of one channel."""
        return int(regressors(np.array([0.0, 0.0, 1.0]), self.model).shape[-1])

    @property
    def blocks(self) -> int:
        """Different covariances: 1 when all channels have the same regressors, else 3."""
        return 3 if self.model in ("K2", "K2K3") else 1


@dataclass
class Bench:
    """The state of ``count`` independent calibrations of one task; ``step`` changes it.

    Args:
        task: what is calibrated.
        count: how many.
        covariance: in units of the prior, (count, blocks, q, q), the drift last.
        drift: information on it alone, (count,).
        angles: rad, (count, 2).
        elapsed: s, (count,).
        steps: poses taken, (count,).
    """

    task: Task
    count: int
    covariance: Array = field(init=False)
    drift: Array = field(init=False)
    angles: Array = field(init=False)
    elapsed: Array = field(init=False)
    steps: "np.ndarray[tuple[int], np.dtype[np.intp]]" = field(init=False)

    def __post_init__(self) -> None:
        q = self.task.width + self.task.drift
        self.covariance = np.zeros((self.count, self.task.blocks, q, q))
        self.drift, self.elapsed = np.zeros(self.count), np.zeros(self.count)
        self.angles, self.steps = np.zeros((self.count, 2)), np.zeros(self.count, dtype=np.intp)
        self.restart(np.ones(self.count, dtype=bool))

    def restart(self, which: Mask) -> None:
        """Begin again: the prior, axes at their start, the whole time left. which: (count,)."""
        self.covariance[which] = np.eye(self.covariance.shape[-1])
        self.drift[which], self.elapsed[which], self.steps[which] = 1.0, 0.0, 0
        self.angles[which] = self.task.reach.start * DEG

    def step(self, angles: Array, dwell: Array, live: Mask) -> tuple[Array, Mask, Array]:
        """Go to angles, settle, read; a pose that would overrun is refused and ends its episode.
        An axis without limits goes the short way round, and never leaves its limits otherwise.

        Args:
            angles: rad, (count, 2), any turn of an axis without limits.
            dwell: s, (count,).
            live: those that take part, (count,).

        Returns:
            Nats gained, (count,); whether the episode is over, (count,); seconds spent, (count,).
        """
        task = self.task
        way = angles - self.angles
        turn = np.where(task.endless, (way + np.pi) % (2 * np.pi) - np.pi, way)
        spent = np.abs(turn).max(axis=1) / (task.rate_deg_s * DEG) + task.settle_s + dwell
        taken = live & (self.elapsed + spent <= task.budget_s + SLACK)
        middle = self.elapsed + spent - dwell / 2
        weight = np.where(taken, PRIOR**2 / (WHITE**2 / dwell + FLOOR**2), 0.0)
        nats = self._learn(angles, middle / task.budget_s, weight)
        spent = np.where(taken, spent, 0.0)
        there = np.where(task.endless, angles % (2 * np.pi), angles)
        self.angles = np.where(taken[:, None], there, self.angles)
        self.elapsed = self.elapsed + spent
        self.steps = self.steps + taken
        over = live & (~taken | (task.budget_s - self.elapsed < task.settle_s + task.shortest_s))
        return nats, over, spent

    def _learn(self, angles: Array, when: Array, weight: Array) -> Array:
        """Rank-one update by a pose; nats gained on the parameters of interest."""
        rows = regressors(dual_up(angles), self.task.model)[:, : self.task.blocks]
        if self.task.drift:
            rows = np.concatenate(
                [rows, np.broadcast_to(when[:, None, None], (*rows.shape[:2], 1))], axis=2
            )
        C = self.covariance
        Ca = np.matmul(C, rows[..., None])[..., 0]
        grown = 1 + weight[:, None] * np.einsum("nbi,nbi->nb", rows, Ca)
        C -= (weight[:, None] / grown)[..., None, None] * Ca[..., :, None] * Ca[..., None, :]
        nats = np.log(grown).sum(axis=1) * (3 / self.task.blocks) / 2
        if self.task.drift:  # what was learnt of the drift alone does not count
            more = self.drift + weight * when**2
            nats = nats - 1.5 * np.log(more / self.drift)
            self.drift = more
        return np.asarray(nats)

    def sigmas(self) -> Array:
        """Posterior over prior standard deviation of the parameters of interest, (count, 3, width).
        The shape is (count, 3, width).
        """
        spread = np.sqrt(np.diagonal(self.covariance, axis1=2, axis2=3)[..., : self.task.width])
        return np.broadcast_to(spread, (self.count, 3, self.task.width))

    def nats(self) -> Array:
        """Gained so far, from the covariances: the sum of all rewards, (count,)."""
        p = self.task.width
        return np.asarray(
            -np.linalg.slogdet(self.covariance[..., :p, :p])[1].sum(axis=1)
            * (3 / self.task.blocks)
            / 2
        )
