"""A finished design: poses, reading times, and the expected uncertainties."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.progress import Progress, silent
from tiltcal.core.tasks.engines import Engine
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.design.classic import CLASSIC, baseline, classic, dwelling, within_limits
from tiltcal.design.criteria import gain, tilt_rms, value
from tiltcal.design.gradient_search import Draft, Problem
from tiltcal.design.search import Effort, poses_worth, search
from tiltcal.setup.tables import DUAL, Table

LARGE = 60  # parameters beyond which fewer paths are tried
SPARING = Effort(starts=6, first=25, then=60, kept=2, rounds=1, trials=20)
# poses up to which more paths are tried: they are cheap, and there are more kinds of good ones
FEW = 25
EAGER = Effort(starts=42, kept=5, rounds=3)
VERY_FEW = 8  # poses, up to which the best path is annealed
THOROUGH = replace(EAGER, hops=300)


@dataclass(frozen=True)
class Forecast:
    """Expected results of a sequence.

    Args:
        nats: gained on the parameters of interest over the prior.
        tilt_arcsec: rms tilt error per axis over the working range.
        sigma: posterior standard deviation of each parameter, in its unit, (p,).
        covariance: of all parameters, in their units, (p, p).
        total_s: table time.
        poses: how many.
    """

    nats: float
    tilt_arcsec: float
    sigma: Array
    covariance: Array
    total_s: float
    poses: int


@dataclass(frozen=True)
class Plan:
    """A designed sequence.

    Args:
        problem: what it was designed for.
        angles: rad, (n, axes).
        dwell: s of reading at each pose, (n,).
        axes: names of the table's axes.
        baselines: forecast of each classic sequence with the same budget and limits; those of which
            the limits forbid every pose, or the budget every length, are not there.
        allowed: of each classic sequence, how many poses of a cycle the limits allow, and of how
            many.
    """

    problem: Problem
    angles: Array
    dwell: Array
    axes: tuple[str, ...]
    baselines: dict[str, Forecast]
    allowed: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def redundant(self) -> bool:
        """Whether a fit of all terms has readings left to be judged by."""
        return len(self.dwell) >= self.problem.least

    @property
    def forecast(self) -> Forecast:
        """What it is expected to bring."""
        return forecast(self.problem, self.angles, self.dwell)

    @property
    def course(self) -> list[Forecast]:
        """What it is expected to have brought once each pose is read."""
        read = range(1, len(self.dwell) + 1)
        return [forecast(self.problem, self.angles[:n], self.dwell[:n]) for n in read]

    def to_json(self) -> dict[str, Any]:
        """The plan for machines: angles in deg, times in s."""
        clock, model, what = self.problem.clock, self.problem.model, self.forecast
        middles = clock.middles(self.angles, self.dwell)
        poses = [
            {f"{name}_deg": float(a / DEG) for name, a in zip(self.axes, row, strict=True)}
            | {
                "settle_s": clock.settle,
                "dwell_s": float(d),
                "read_from_s": float(m - d / 2),
                "read_to_s": float(m + d / 2),
            }
            for row, d, m in zip(self.angles, self.dwell, middles, strict=True)
        ]
        return {
            "schema": 1,
            "criterion": self.problem.criterion,
            "budget_s": clock.budget,
            "rate_deg_s": clock.rate / DEG,
            "total_s": what.total_s,
            "nats": what.nats,
            "tilt_rms_arcsec": what.tilt_arcsec,
            "poses": poses,
            "course": [
                {"total_s": f.total_s, "tilt_rms_arcsec": f.tilt_arcsec, "sigma": f.sigma.tolist()}
                for f in self.course
            ],
            "parameters": [
                {"name": n, "unit": u, "prior": float(p), "sigma": float(s), "interest": bool(i)}
                for n, u, p, s, i in zip(
                    model.names, model.units, model.prior, what.sigma, model.interest, strict=True
                )
            ],
            "start": {
                f"{n}_deg": float(a / DEG) for n, a in zip(self.axes, clock.origin, strict=True)
            },
            "within_limits": {k: list(counts) for k, counts in self.allowed.items()},
            "baselines": {
                k: {"nats": f.nats, "tilt_rms_arcsec": f.tilt_arcsec, "poses": f.poses}
                for k, f in self.baselines.items()
            },
        }


def forecast(problem: Problem, angles: Array, dwell: Array) -> Forecast:
    """Expected results of a sequence.

    Args:
        problem: model, clock and criterion.
        angles: rad, (n, axes).
        dwell: s, (n,).
    """
    model = problem.model
    information = problem.information(angles, dwell)
    covariance = np.linalg.inv(information) * np.outer(model.prior, model.prior)
    return Forecast(
        gain(information, model.interest),
        tilt_rms(information, model.loss) / ARCSEC,
        np.sqrt(np.diag(covariance)),
        covariance,
        problem.clock.total(angles, dwell),
        len(dwell),
    )


def design(
    problem: Problem,
    table: Table = DUAL,
    seed: int = 0,
    effort: Effort | None = None,
    notice: Progress = silent,
    engine: Engine | None = None,
) -> Plan:
    """The sequence with the most information for a budget, never below any classic one.

    Args:
        problem: model, clock and criterion.
        table: table that moves; its classic sequences are the baselines.
        seed: of the search: the same gives the same design.
        effort: how much is tried.
        notice: callback for messages on progress.
        engine: where drafts are improved; this process if not given. The design is the same.
    """
    drafts = {name: baseline(problem, name, table) for name in CLASSIC}
    drafts = {name: d for name, d in drafts.items() if len(d.angles)}
    usual = _effort(len(problem.model.names), poses_worth(problem))
    starts = [*drafts.values(), *dwelling(problem, table)]
    above = replace(problem, floors=_floors(problem, list(drafts.values())))
    best = search(above, starts, seed, effort or usual, notice, engine)
    done = {
        name: forecast(problem, d.angles, problem.dwells(d.angles, d.z))
        for name, d in drafts.items()
    }
    cycles = {name: classic(name, table) for name in CLASSIC}
    inside = {k: (len(within_limits(c, problem.clock)), len(c)) for k, c in cycles.items()}
    dwell = problem.dwells(best.angles, best.z)
    return Plan(problem, best.angles, dwell, table.tilting, done, inside)


def _effort(parameters: int, poses: int) -> Effort:
    if parameters > LARGE:
        return SPARING
    return THOROUGH if poses <= VERY_FEW else EAGER if poses <= FEW else Effort()


def _floors(problem: Problem, classics: Sequence[Draft]) -> tuple[float, float]:
    """The most nats of a classic sequence, and the most in terms of the tilt."""
    every = [problem.information(d.angles, problem.dwells(d.angles, d.z)) for d in classics]
    nats, tilt = (
        max((value(information, problem.model, c) for information in every), default=-np.inf)
        for c in ("D", "tilt")
    )
    return nats, tilt
