"""The order in which poses are visited, so that effects of time and of the direction of approach
are visible.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiltcal.core.arrays import Array
from tiltcal.design.signatures import Signatures, name_of
from tiltcal.design.static_instrument import ROUNDING, Still
from tiltcal.design.time_budget import Clock, unwound
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.setup.trajectory import Drive

Order = npt.NDArray[np.intp]
# improved orders; random ones that show how much of an effect an order can show
STARTS, ORDERS = (
    6,
    24,
)
ON_THE_WAY = 6  # instants of each move


@dataclass(frozen=True)
class PosePath:
    """A Course along poses: the table at rest at each, and at some instants of each move."""

    still: Still
    angles: Array
    clock: Clock

    @property
    def dwell(self) -> float:
        """What each pose is read, s."""
        return max(
            self.clock.shortest,
            min(
                self.clock.longest,
                self.clock.shortest + float(self.clock.spare(self.angles)) / len(self.angles),
            ),
        )

    @property
    def time(self) -> Array:
        """Of all instants, s, (poses times ON_THE_WAY,); the last of each move is the pose
        itself.
        """
        n = len(self.angles)
        middles = self.clock.middles(self.angles, np.full(n, self.dwell))
        moves = self.clock.moves(self.angles)
        part = np.linspace(-1, 0, ON_THE_WAY)  # before the middle of the dwell
        return np.asarray((middles[:, None] + part * (moves[:, None] + 1e-3)).ravel())

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s."""
        return 0.0, self.still.horizon

    def drive(self, time: Array) -> Drive:
        """The drive at ``time``, which has to be this way's own. time: s, (n,)."""
        before = np.vstack([self.clock.origin, self.angles[:-1]])
        part = np.linspace(0, 1, ON_THE_WAY)[:, None]
        along = (before[:, None, :] + part * (self.angles - before)[:, None, :]).reshape(
            len(time), -1
        )
        return self.still.drive(along, time)


def visiting_order(
    seen: Signatures, angles: Array, clock: Clock, rng: np.random.Generator
) -> tuple[Array, dict[str, float]]:
    """The poses in an order that hides no drift and no direction of approach, and what it shows of
    each effect.

    Several orders are improved by exchanges; each is judged by what it leaves of the effects that
    only an order shows, over the most that any of these and of some random orders leaves. The one
    whose least share is largest is taken.

    Args:
        seen: effects that the order can show.
        angles: rad, (n, axes).
        clock: table time of poses.
        rng: source of random numbers.
    """
    quick, n = _Quick(seen, angles, clock), len(angles)
    tried = [quick.improved(quick.nearest(int(k)), rng) for k in rng.permutation(n)[:STARTS]]
    found = [
        unwound(angles[order], clock.limits, clock.origin)
        for order in (*tried, *(rng.permutation(n) for _ in range(ORDERS)))
    ]
    left = [energies_in_order(seen, ordered, clock) for ordered in found]
    most = {name: max(energy[name] for energy in left) for name in left[0]}
    shares = [
        {name: energy[name] / most[name] for name in most if most[name] > 0}
        for energy in left[:STARTS]
    ]
    best = max(range(len(shares)), key=lambda k: min(shares[k].values(), default=1.0))
    return found[best], shares[best]


class _Quick:
    """Judges orders by a linear drift, a warm-up and the direction from which each axis comes, in a
    closed form.
    """

    def __init__(self, seen: Signatures, angles: Array, clock: Clock) -> None:
        self.angles, self.clock = angles, clock
        F = seen.linear(angles).reshape(len(angles), -1)
        self.Q, size, _ = np.linalg.svd(F, full_matrices=False)
        self.Q = self.Q[:, size > 1e-9 * size[0]]
        t = np.linspace(0, 1, len(angles))
        self.courses = np.column_stack([t, np.exp(-3 * t)])
        self.courses -= self.courses.mean(axis=0)
        self.courses /= np.linalg.norm(self.courses, axis=0)

    def nearest(self, first: int) -> Order:
        """Each pose followed by the nearest of those left."""
        left, order = [i for i in range(len(self.angles)) if i != first], [first]
        while left:
            k = min(
                left,
                key=lambda i: float(
                    np.abs(self._turns(self.angles[i] - self.angles[order[-1]])).max()
                ),
            )
            left.remove(k)
            order.append(k)
        return np.array(order)

    def improved(self, order: Order, rng: np.random.Generator) -> Order:
        """Pairs exchanged while that helps."""
        best, worth = order, self.worth(order)
        for _ in range(3):
            for first, second in rng.permutation(
                [(i, j) for i in range(len(order)) for j in range(i)]
            ):
                trial = best.copy()
                trial[[first, second]] = trial[[second, first]]
                if (found := self.worth(trial)) > worth:
                    best, worth = trial, found
        return best

    def worth(self, order: Order) -> float:
        """Least visible share, less the travel: a turn of the table costs a hundredth."""
        Q = self.Q[order]
        visible = 1 - ((Q.T @ self.courses) ** 2).sum(axis=0)
        turns = self._turns(np.diff(self.angles[order], axis=0, prepend=self.clock.origin[None]))
        side = np.sign(np.where(np.abs(turns) > 1e-9, turns, 0.0))
        from_both = 1 - ((Q.T @ side) ** 2).sum(axis=0) / np.maximum((side**2).sum(axis=0), 1)
        travel = np.abs(turns[1:]).max(axis=1).sum() / (2 * np.pi)
        return min(float(visible.min()), float(from_both.min()) + 0.1, 0.97) - 0.01 * float(travel)

    def _turns(self, way: Array) -> Array:
        """The short way round of axes that turn without end, rad, (..., axes). way: rad."""
        endless = np.array([pair is None for pair in self.clock.limits])
        return np.where(endless, (way + np.pi) % (2 * np.pi) - np.pi, way)


def energies_in_order(seen: Signatures, ordered: Array, clock: Clock) -> dict[str, float]:
    """Energy of each such effect that the ordinary terms leave. ordered: angles, rad, (n, axes)."""
    way = PosePath(seen.still, ordered, clock)
    watch = NominalMotion(seen.still.scenario, way, way.time)
    Q = [np.linalg.qr(F)[0] for F in seen.linear(ordered).transpose(1, 0, 2)]
    found: dict[str, float] = {}
    nothing = len(ordered) * ROUNDING**2
    for effect in seen.ordered:
        name = name_of(effect)
        change = watch.changes(effect).get(seen.sensor.name)
        found.setdefault(name, 0.0)
        if change is not None:
            at_rest = change[ON_THE_WAY - 1 :: ON_THE_WAY]
            standstill = [at_rest[:, k] - q @ (q.T @ at_rest[:, k]) for k, q in enumerate(Q)]
            energy, whole = sum(float(r @ r) for r in standstill), float((at_rest**2).sum())
            # grows with the turns a table makes: what counts is the share that stays visible
            winds = effect.needs == "pose"
            found[name] += (
                energy / (whole if winds else 1.0) if energy > max(1e-6 * whole, nothing) else 0.0
            )
    return found
