"""The Laboratory made of MuJoCo: a scenario's sequence through mechanics, then the chain of
effects, to a Recording.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

from tiltcal.forward.signal_chain import Mover
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scene import Scene
from tiltcal.laboratory.serve.rate_table import Mechanics
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Course, Drive
from tiltsim.motion import Progress, mujoco_motion


@dataclass(frozen=True)
class MujocoLaboratory(SimulatedLaboratory):
    """Prescribed motion read exactly, or with ``[dynamics]`` a run by time steps.

    Args:
        progress: called with (steps done, steps in all) of a run by time steps.
    """

    mover: Mover = field(default=mujoco_motion)
    progress: Progress | None = None

    def course(self, scenario: Scenario, seed: int | None) -> Course:
        """What the table does: prescribed, or found by stepping the mechanics."""
        if scenario.dynamics is None:
            return scenario.schedule
        from tiltsim.dynamics import run_dynamics

        return run_dynamics(scenario, seed, self.progress)

    def mechanics(self, scenario: Scenario) -> Mechanics:
        """The mechanics of a scenario's table, to be driven step by step."""
        from tiltsim.served_mechanics import ServedMechanics

        return ServedMechanics(scenario)

    def scene(self, setup: Setup, drive: Drive) -> Scene:
        """The nominal table as solids along a drive."""
        from tiltsim.stage import table_scene

        return table_scene(setup, drive)

    def pictures(self, setup: Setup, drive: Drive, width: int, height: int) -> Iterator[bytes]:
        """A picture of the nominal table at each instant of a drive, RGB, row by row.

        Raises:
            TiltcalError: OpenGL is missing.
        """
        from tiltsim.stage import table_pictures

        return table_pictures(setup, drive, width, height)
