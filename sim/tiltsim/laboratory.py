"""The Laboratory made of MuJoCo: a scenario's sequence through mechanics, then the chain of
effects, to a Recording.
"""

from dataclasses import dataclass, field

from tiltcal.forward.signal_chain import Mover
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.trajectory import Course
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
