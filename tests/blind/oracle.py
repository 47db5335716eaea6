"""How far an effect stands out of the noise, and which others could pass for it.

The recording is thinned to some 800 instants, each standing for a mean of its neighbours. Columns
are differences of the full model, whitened with the true noise; the adjustable terms are projected
out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from blind.catalogue import bound, listed, settled
from blind.laboratory import Lab
from blind.noise import whitener
from blind.spec import Shape, Spec
from blind.world import Past, Physics, felt, readings, truth_of

INSTANTS = 800
SHAPES = 6  # how many shapes of a rival with a time, a period or a lag are tried
CREDIBLE = 1.5  # times the plausible size: the largest that makes a rival
TELL = 12.0  # separated non-centrality at which two effects can be told apart


def space(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what columns span, whatever their lengths; columns that others make up
    add nothing. (n, k) -> (n, rank).
    """
    length = np.linalg.norm(columns, axis=0)
    unit = columns[:, length > 0] / length[length > 0]
    U, s, _ = np.linalg.svd(unit, full_matrices=False)
    return U[:, s > 1e-9 * s.max(initial=0.0)]


@dataclass(frozen=True)
class Found:
    """What an oracle knows of one concealed effect."""

    lam: float
    own: float  # what is left of it after its textbook form has been fitted
    left: dict[str, float]  # the same for every credible rival
    energy: dict[str, float]

    @property
    def inseparable(self) -> list[str]:
        """Listed effects that nobody can tell from it here."""
        return sorted(i for i, left in self.left.items() if left < TELL)

    @property
    def tolerated(self) -> list[str]:
        """Those that chance, or its odd form, may put into the class: an estimate of 12 scatters by
        7.
        """
        return sorted(
            i for i, left in self.left.items() if left < max(30.0, 0.04 * self.lam, self.own)
        )


class Oracle:
    """The adjustable terms and the noise of one recording, ready to judge signals."""

    def __init__(self, lab: Lab, rng: np.random.Generator) -> None:
        # a grid of rivals draws no case's numbers
        self.lab, self.rng, self.past = (
            lab,
            rng.spawn(1)[0],
            Past(lab),
        )
        n = int(lab.track.end_s * lab.rate_hz)
        self.every = max(1, n // INSTANTS)
        self.t = (np.arange(0, n - self.every + 1, self.every) + self.every / 2) / lab.rate_hz
        if lab.unlocked or lab.kind == "six_any":  # what a hand does between poses is not known
            self.t = self.t[lab.track.since_move(self.t)[0] > 0]
        self.state = felt(lab, (), self.t, self.past)
        self.sigma = np.array([lab.sensors[s].sigma for s, _ in lab.channels])
        self.zero = readings(lab, (), self.t, self.past, self.state)
        self.W = whitener(lab, self.t, self.every)
        self.Q = space(self.white(adjustable(lab, self.state, self.zero)))

    def means(self, rows: np.ndarray) -> np.ndarray:
        """What the instants stand for: means of their neighbours. rows: (n, channels), every sample
        of the recording.
        """
        n = len(self.t) * self.every
        return rows[:n].reshape(len(self.t), self.every, -1).mean(1)

    def signal(self, physics: Sequence[Physics]) -> np.ndarray:
        """What the effects add to the readings. Returns (n, channels)."""
        state = None if any(h.mechanical for h in physics) else self.state
        return readings(self.lab, physics, self.t, self.past, state) - self.zero

    def white(self, columns: np.ndarray) -> np.ndarray:
        """Whitened. columns: (n, channels, k) -> (rows, k)."""
        seen = self._seen(columns)
        return np.einsum("mn,nck->mck", self.W, seen, optimize=True).reshape(-1, columns.shape[2])

    def _seen(self, columns: np.ndarray) -> np.ndarray:
        """What a recording without any angle readout can know: the norm at rest, the FOG against
        the gyro.
        """
        scaled = columns / self.sigma[None, :, None]
        if self.lab.kind == "six_any":
            up = self.state.f / self.lab.gravity
            return np.einsum("nc,nck->nk", up, scaled)[:, None]
        if self.lab.kind == "field_turns":
            u = np.append(-self.lab.sensors[1].input_axis, 1.0) * self.sigma
            return np.einsum("c,nck->nk", u / np.linalg.norm(u), scaled)[:, None]
        return scaled

    def residual(self, columns: np.ndarray) -> np.ndarray:
        """Whitened columns without what the adjustable terms can take. (n, channels, k) -> (rows,
        k).
        """
        X = self.white(columns)
        return X - self.Q @ (self.Q.T @ X)

    def columns(self, spec: Spec, shape: Shape) -> np.ndarray:
        """One per parameter, of a tenth of its plausible size, scaled up. Returns (n, channels,
        parameters).
        """
        steps = 0.1 * spec.plausible * spec.unit * np.eye(len(spec.names))
        return np.stack([self.signal([spec.physics(p, shape)]) for p in steps], 2) / 0.1

    def shapes(self, spec: Spec) -> list[Shape]:
        """A grid of textbook shapes."""
        first = spec.shapes(self.rng, self.lab)
        return (
            first
            if first == [{}] or len(first) > 1
            else first + [spec.shapes(self.rng, self.lab)[0] for _ in range(SHAPES)]
        )

    @cached_property
    def rivals(self) -> list[tuple[Spec, list[Shape], list[np.ndarray]]]:
        """Residual columns of every listed effect, for a grid of its textbook shapes."""
        grids = [(spec, self.shapes(spec)) for spec in listed(self.lab)]
        return [
            (spec, grid, [self.residual(self.columns(spec, shape)) for shape in grid])
            for spec, grid in grids
        ]

    def alike(self, spec: Spec, grid: list[Shape], shape: Shape) -> list[np.ndarray]:
        """Columns of a rival at the very instant, period or time constant of what is concealed."""
        same = {k: v for k, v in shape.items() if k in ("time", "tau", "hertz") and k in grid[0]}
        return [self.residual(self.columns(spec, {**grid[0], **same}))] if same else []

    @staticmethod
    def left_by(columns: list[np.ndarray], r: np.ndarray) -> float:
        """Energy of the residual signal r that the effect at credible sizes leaves; inf where it
        takes incredible ones.
        """
        best = np.inf
        for U in columns:
            # what is not seen stays small
            size = np.linalg.solve(U.T @ U + np.eye(U.shape[1]), U.T @ r)
            if np.abs(size).max() <= CREDIBLE:
                best = min(best, float(((r - U @ size) ** 2).sum()))
        return best

    def judge(
        self, spec: Spec, shape: Shape, physics: Physics, beside: Sequence[np.ndarray] = ()
    ) -> Found:
        """Non-centrality and rivals of a concealed effect; ``beside``: residual columns of what
        else is concealed.
        """
        s = self.signal([physics])
        r = self.residual(s[:, :, None])[:, 0]
        energy = self._energy(r)
        B = space(np.column_stack(beside)) if beside else np.zeros((len(r), 0))
        r = r - B @ (B.T @ r)
        lam = float(r @ r)
        rivals: dict[str, float] = {}
        plain = {k: v for k, v in shape.items() if k not in ODD}
        own = (
            [self.residual(self.columns(spec, plain))]
            if spec.listed and plain.get("form") not in ODD
            else []
        )
        for other, grid, columns in self.rivals:
            if other.id == spec.id:
                own += columns
            elif (
                left := self.left_by(
                    [U - B @ (B.T @ U) for U in columns + self.alike(other, grid, shape)], r
                )
            ) < 0.9 * lam:
                rivals[other.id] = min(left, rivals.get(other.id, np.inf))
        return Found(lam, self.left_by([U - B @ (B.T @ U) for U in own], r), rivals, energy)

    def _energy(self, r: np.ndarray) -> dict[str, float]:
        if self.lab.kind in ("six_any", "field_turns"):
            return {}
        share = (r.reshape(len(self.t), -1) ** 2).sum(0)
        names = [
            f"{self.lab.sensors[s].name}.{self.lab.sensors[s].axes[i]}"
            for s, i in self.lab.channels
        ]
        return {n: round(float(e / share.sum()), 3) for n, e in zip(names, share, strict=True)}


ODD = (
    "pieces",
    "relax",
    "steps",
    "wave",
    "more",
    "round",
    "lag",
    "bend",
    "second",
    "creep",
    "wander",
    "power",
    "dead",
)


def adjustable(lab: Lab, state, zero: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Derivatives of the readings by bias, scale and cross-axis terms. Returns (n, channels,
    terms).
    """
    n, columns = len(state.t), []
    for c, (s, _i) in enumerate(lab.channels):
        x = truth_of(lab, s, state)
        steep = np.ones(n)
        if lab.sensors[s].kind == "inclinometer":
            steep = 1 / (lab.gravity * np.cos(zero[:, c]))
        for part in (np.ones(n), *x.T):
            column = np.zeros((n, len(lab.channels)))
            column[:, c] = steep * part
            columns.append(column)
    return np.stack(columns, 2)


def prediction(
    oracle: Oracle, other: Lab, drawn: Sequence[tuple[Spec, Shape, np.ndarray]], noise: np.ndarray
) -> dict[str, float]:
    """Rms error of another recording's prediction, in units of a sample's sigma: by who knows the
    form, by who does not.

    Both are fitted to the recording itself, with its own noise. noise: (n, channels) of its rows.
    """
    there = Oracle(other, oracle.rng)
    A, A_there = (
        adjustable(oracle.lab, oracle.state, oracle.zero),
        adjustable(other, there.state, there.zero),
    )
    own = [oracle.signal([spec.physics(p, shape)]) for spec, shape, p in drawn]
    own_there = [
        there.signal([bound(spec, other).physics(p, settled(spec, shape))])
        for spec, shape, p in drawn
    ]
    y = sum(own, oracle.means(noise))
    out = {}
    for name, more, more_there in (("nominal", [], []), ("oracle", own, own_there)):
        X, Y = (
            np.concatenate([C, *(s[:, :, None] for s in S)], 2)
            for C, S in ((A, more), (A_there, more_there))
        )
        error = Y @ _fitted(oracle.white(X), oracle.white(y[:, :, None])[:, 0]) - sum(
            own_there, np.zeros_like(there.zero)
        )
        out[name] = float(np.sqrt(np.mean((error / there.sigma) ** 2)))
    return out


def _fitted(X: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least squares; what is not excited at all stays zero. X: (rows, k), y: (rows,)."""
    scale = np.linalg.norm(X, axis=0)
    scale[scale < 1e-9 * scale.max()] = np.inf
    return np.linalg.lstsq(X / scale, y, rcond=1e-9)[0] / scale
