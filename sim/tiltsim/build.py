"""What a run by time steps is run on: the mechanisms of all effects, those the time step can
follow, and the rig.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from tiltcal.core.frames import parse_mount
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect
from tiltcal.effects.mechanisms import Context, Mechanism, Ring, Spring
from tiltcal.effects.table.readout import ReadoutError
from tiltcal.forward.kinematics import world_of
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import Dynamics
from tiltsim.rig import Rig, RigBuilder

RESOLVED = (
    0.7  # rad: largest phase a free spring may go through in a step; beyond, it follows at once
)


def readout_errors(effects: Sequence[Effect]) -> list[Effect]:
    """The effects that make an encoder, on which its axis' loop is closed, read something else than
    where the axis is.
    """
    return [e for e in effects if isinstance(e, ReadoutError) and not e.is_identity]


def _movers(effects: Sequence[Effect]) -> list[AngleEffect | FrameEffect]:
    return [e for e in effects if isinstance(e, AngleEffect | FrameEffect) and not e.is_identity]


def mechanisms_of(scenario: Scenario, effects: Sequence[Effect]) -> tuple[Mechanism, ...]:
    """The faces of all effects in a run by time steps."""
    gravity = world_of(scenario, effects).gravity
    return tuple(m for e in _movers(effects) for m in e.dynamics(scenario.rig, gravity))


def realised(
    scenario: Scenario, effects: Sequence[Effect], mechanisms: Sequence[Mechanism]
) -> tuple[str, ...]:
    """Addresses of the effects that these mechanisms include whole; springs are not among them, the
    reader knows their joints.
    """
    gravity, whole, missing = world_of(scenario, effects).gravity, [], set()
    for effect in _movers(effects):
        faces = [m for m in effect.dynamics(scenario.rig, gravity) if not isinstance(m, Spring)]
        if faces and all(m in mechanisms for m in faces):
            whole.append(effect.address)
        else:
            missing.add(effect.address)
    return tuple(address for address in dict.fromkeys(whole) if address not in missing)


def resolved(
    scenario: Scenario, effects: Sequence[Effect], mechanisms: Sequence[Mechanism]
) -> tuple[Mechanism, ...]:
    """The mechanisms without the springs and rings that swing faster than the time step can
    follow.
    """
    dt = (scenario.dynamics or Dynamics()).timestep_s
    slow = [
        m for m in mechanisms if not isinstance(m, Ring) or 2 * np.pi * m.frequency * dt <= RESOLVED
    ]
    rig = build(scenario, effects, [m for m in slow if not isinstance(m, Ring)], scenario.rig.mount)
    data, inertia = mujoco.MjData(rig.model), np.empty((rig.model.nv, rig.model.nv))
    mujoco.mj_forward(rig.model, data)
    mujoco.mj_fullM(rig.model, data, inertia)
    # of each joint with all others free: the fastest it can swing
    mobility = np.diag(np.linalg.inv(inertia))
    soft = {
        name.removesuffix("_sag")
        for name, k in rig.springs.items()
        if k * mobility[rig.dof(name)] <= (RESOLVED / dt) ** 2
    }
    return tuple(m for m in slow if not isinstance(m, Spring) or m.body in soft)


def build(
    scenario: Scenario, effects: Sequence[Effect], mechanisms: Sequence[Mechanism], mount: str
) -> Rig:
    """The rig with what never moves built in, and the mechanisms with their true masses."""
    world = world_of(scenario, effects)
    drive = scenario.schedule.drive(np.array(scenario.schedule.times[:1]))
    context = Context.along(drive, drive.axes, scenario.rig, world.gravity)
    slots = scenario.rig.kind.slots
    frames = [e for e in effects if isinstance(e, FrameEffect)]
    fixed = [
        e for e in frames if all(t.angle.constant for slot in slots for t in e.turns(slot, context))
    ]
    builder = RigBuilder(scenario, world, parse_mount(mount))
    builder.install_frames(fixed, drive, drive.axes)
    builder.install_dynamics(scenario.dynamics or Dynamics(), mechanisms)
    return builder.compile_dynamic()
