"""Designed sequences that can be saved, tabulated and simulated."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tiltcal.api.table_scene import table_in
from tiltcal.core.arrays import Array
from tiltcal.core.files import make_folder
from tiltcal.core.progress import Progress, silent
from tiltcal.core.tabular import Tabular
from tiltcal.core.tasks.engines import Engine
from tiltcal.design.bound import Efficiency, efficiencies
from tiltcal.design.feasibility import check_possible
from tiltcal.design.goals import Goal, goals_of, least_time
from tiltcal.design.gradient_search import Problem
from tiltcal.design.plan import Plan
from tiltcal.design.plan import design as find_plan
from tiltcal.design.static_instrument import Still
from tiltcal.design.steps import designed_table, printable, steps_of, write_plan
from tiltcal.laboratory.scenario import Scenario
from tiltcal.report.design import poses_of_plan, write_design
from tiltcal.setup.sensor import Sensor


@dataclass(frozen=True)
class DesignedSequence(Tabular):
    """The poses with the most information per table time.

    Args:
        plan: poses, reading times and the expected uncertainties.
        scenario: that it was designed for.
        up: the up direction of each pose in the body frame, (n, 3).
        unseen: effects that no pose shows.
        inseparable: terms that these poses do not separate from the others.
        efficiencies: lower bounds on its information per parameter over the most that is possible.
        goals: that its time was chosen by.
    """

    plan: Plan
    scenario: Scenario
    up: Array
    unseen: tuple[str, ...]
    inseparable: tuple[str, ...]
    efficiencies: Efficiency
    goals: tuple[Goal, ...] = ()

    @property
    def efficiency(self) -> float:
        """Lower bound on the information per parameter over the most that any poses give that are
        read at these times for as long.
        """
        return self.efficiencies.at_its_times

    @property
    def reaches_goals(self) -> bool:
        """Whether every goal is expected to be reached."""
        return _worst(self.plan, self.goals) <= 1

    def table(self) -> dict[str, Any]:
        """The scenario with this sequence instead of its own, as ``parse_scenario`` takes it."""
        name = f"{self.scenario.name}, designed"
        return designed_table(self.scenario, steps_of(self.plan, self.up), name)

    def as_columns(self) -> Mapping[str, Sequence[float]]:
        """Angles, deg, and reading times, s, one row a pose."""
        poses = self.plan.to_json()["poses"]
        return {name: [pose[name] for pose in poses] for name in poses[0]}

    def headline(self) -> str:
        """Poses, time, and what they bring."""
        what, clock = self.plan.forecast, self.plan.problem.clock
        return (
            f"{what.poses} poses in {what.total_s:.1f} s of {clock.budget:g} s: expected rms tilt"
            f" error per axis {what.tilt_arcsec:.3f} arcsec, {what.nats:.2f} nats gained"
        )

    def __str__(self) -> str:
        return printable(self.plan, self.up, self.efficiencies, self._goals_reached())

    def _goals_reached(self) -> list[tuple[Goal, float]]:
        """Goals with what is expected."""
        names = self.plan.problem.model.names
        return [(goal, goal.reached(self.plan.forecast, names)) for goal in self.goals]

    def to_json(self) -> dict[str, Any]:
        """The plan for machines, with what poses cannot show."""
        told = {"unseen": list(self.unseen), "untold": list(self.inseparable)}
        goals = [
            {
                "name": g.name,
                "limit": g.limit,
                "expected": e,
                "unit": g.unit,
                "reached": e <= g.limit,
            }
            for g, e in self._goals_reached()
        ]
        shares = {
            "efficiency": self.efficiencies.at_its_times,
            "efficiency_of_all": self.efficiencies.of_all,
        }
        return self.plan.to_json() | shares | {"goals": goals} | told

    def save(self, folder: Path | str) -> None:
        """Write design.toml, steps.csv, steps.txt, segments.csv, design.json and report.html to a
        folder.
        """
        path = make_folder(Path(folder))
        write_plan(self.plan, self.scenario, self.up, path, str(self), self.to_json())
        poses = poses_of_plan(self.plan, self.up, self.scenario)
        table = table_in(poses, self.scenario)
        title, missing = self.scenario.name, self._missing()
        write_design(self.plan, path / "report.html", title, poses, table, missing)

    def _missing(self) -> list[str]:
        """What no pose shows or separates, a sentence each."""
        apart = (
            f"{n}: not separable from the other terms by these poses." for n in self.inseparable
        )
        return [*(f"{name}: not visible in any pose." for name in self.unseen), *apart]


def designed(
    scenario: Scenario,
    sensor: Sensor,
    problem: Problem,
    unseen: tuple[str, ...],
    everything: bool,
    seed: int,
    progress: Progress = silent,
    engine: Engine | None = None,
) -> DesignedSequence:
    """The sequence of a design problem.

    Args:
        scenario: rig, sensors and effects.
        sensor: sensor that the sequence is designed for.
        problem: terms, clock and criterion.
        unseen: effects that it leaves out.
        everything: whether terms that no poses determine are reported instead of refused.
        seed: of the search.
        progress: receives what is being done.
        engine: where drafts are improved; this process if not given.

    Raises:
        TiltcalError: no set of poses within the limits determines a term of interest.
    """
    still = Still(scenario.seen_by(sensor), problem.clock.budget)
    undetermined = check_possible(problem, still.axes, everything)
    plan = find_plan(problem, still.scenario.rig.kind, seed, notice=progress, engine=engine)
    shares = efficiencies(problem, plan.angles, plan.dwell)
    return DesignedSequence(plan, scenario, still.up(plan.angles), unseen, undetermined, shares)


ProblemIn = Callable[[float], tuple[Problem, tuple[str, ...]]]
"""table time, s -> a design problem, and the effects that poses cannot show."""


def designed_for_goals(
    scenario: Scenario,
    sensor: Sensor,
    problem_in: ProblemIn,
    budget: float,
    goals: Sequence[str],
    everything: bool,
    seed: int,
    progress: Progress = silent,
    engine: Engine | None = None,
) -> DesignedSequence:
    """The sequence of the least table time that is expected to reach all goals, to 3 %; that of all
    of the budget where it reaches fewer, or no goal is given.

    Args:
        scenario, sensor, everything, seed, progress, engine: as in ``designed``.
        problem_in: the problem.
        budget: longest table time, s.
        goals: as ``goals_of`` takes them.

    Raises:
        TiltcalError: a goal does not read, or no set of poses within the limits determines a term
            of interest.
    """
    problem, _ = problem_in(budget)
    wanted = goals_of(goals, problem.model)

    def found_in(time: float) -> tuple[float, DesignedSequence]:
        if wanted:
            progress(f"poses of {time:.0f} s")
        found = designed(scenario, sensor, *problem_in(time), everything, seed, progress, engine)
        return _worst(found.plan, wanted), replace(found, goals=wanted)

    if not wanted:
        return found_in(budget)[1]
    return least_time(budget, problem.clock.settle + problem.clock.shortest, found_in)


def _worst(plan: Plan, goals: Sequence[Goal]) -> float:
    """Largest ratio of what is expected to its goal."""
    forecast, names = plan.forecast, plan.problem.model.names
    return max((goal.reached(forecast, names) / goal.limit for goal in goals), default=0.0)
