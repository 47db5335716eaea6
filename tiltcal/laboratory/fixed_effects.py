"""Which effects a model of fixed parts can hold: frames that stand elsewhere whatever the motion,
and joints that give way.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.frames import rotation
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect, WorldEffect, WritingEffect
from tiltcal.effects.learned import Learned
from tiltcal.effects.loads import LoadEffect
from tiltcal.effects.mechanisms import Context, World
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Jet

PROBED = np.array([0.0, 0.7, 2.0, 3.6, 5.3])  # s, rad and K: what is fixed is alike at all of them


def why_not(effect: Effect, setup: Setup) -> str | None:
    """Why a model with fixed parameters, moved by the readout, cannot hold an effect; None where it
    can.
    """
    if effect.random:
        return "random"
    if isinstance(effect, Learned):
        return "a curve, no law"
    if isinstance(effect, LoadEffect):
        return "a mass, which sysid has parameters of its own for"
    if isinstance(effect, WritingEffect):
        return "a fault of the file"
    if isinstance(effect, WorldEffect) and effect.world(World.of(setup)).shakes:
        return "a vibration"
    if isinstance(effect, FrameEffect) and not effect.compliances(setup.rig):
        slots = setup.rig.kind.slots
        if any(_constant_turns(effect, setup, slot) is None for slot in slots):
            return "turns a frame with the motion"
    return None


def fixed_error(effect: AngleEffect, setup: Setup, axis: str) -> float | None:
    """True angle of an axis minus its readout, rad, where it is the same at all angles; None where
    it varies.
    """
    if not effect.acts_on(axis, setup.rig):
        return 0.0
    return None if effect.random else _value(effect.deviation(_probe(setup).drive, axis, None))


def fixed_turn(setup: Setup, effects: Sequence[Effect], slot: str) -> Array:
    """Product of the turns at a slot that do not depend on the motion, in its frame, (3, 3)."""
    R = np.eye(3)
    for effect in effects:
        if isinstance(effect, FrameEffect) and not effect.compliances(setup.rig):
            for axis, angle in _constant_turns(effect, setup, slot) or ():
                R = R @ rotation(axis, angle)
    return R


def _constant_turns(effect: FrameEffect, setup: Setup, slot: str) -> list[tuple[str, float]] | None:
    """(axis, rad) of each turn at a slot; None where one of them varies."""
    if effect.mechanised or effect.random:
        return None
    turns = effect.turns(slot, _probe(setup))
    angles = [_value(turn.angle) for turn in turns]
    if any(angle is None for angle in angles):
        return None
    return [(t.axis, a) for t, a in zip(turns, angles, strict=True) if a is not None]


def _value(jet: Jet) -> float | None:
    """A jet's value where it never changes; None where it does."""
    steady = np.ptp(jet.x) == 0 and not np.any(jet.v) and not np.any(jet.a)
    return float(np.mean(jet.x)) if steady else None


def _probe(setup: Setup) -> Context:
    """A motion on which everything that varies differs from row to row."""
    n = len(PROBED)
    moving = Jet(PROBED, np.ones(n), np.ones(n))
    axes = dict.fromkeys(setup.rig.axis_names, moving)
    drive = Drive(PROBED, axes, 0.0, PROBED, 0.0, np.full(n, -1, np.intp))
    return Context.along(drive, axes, setup.rig, setup.site.gravity)
