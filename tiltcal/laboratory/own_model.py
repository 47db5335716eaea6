"""A user's own model in a scenario: ``[rig] mjcf``, its axes and the instrument's site, and which
effects a model of fixed parts can represent: frames with a constant offset, and compliant
joints.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.extensions import load
from tiltcal.core.frames import rotation
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect, WorldEffect, WritingEffect
from tiltcal.effects.learned import Learned
from tiltcal.effects.loads import LoadEffect
from tiltcal.effects.mechanisms import Context, World
from tiltcal.setup.chain import Chain, LinkFrame
from tiltcal.setup.part import StrictTable
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Jet

GROUP = "tiltcal.models"
Reader = Callable[["ModelReference", Path, Sequence[str]], tuple[Chain, Mapping[str, LinkFrame]]]


class ModelAxis(StrictTable):
    """A joint behind a column; a text stands for its name alone."""

    joint: str
    """Name of the joint in the model."""
    sign: Literal[1, -1] = 1
    """-1 where the readout counts against the joint."""
    offset_deg: float = 0.0
    """Angle of a joint that turns, at readout zero, deg."""
    offset_mm: float = 0.0
    """Position of a joint that slides, at readout zero, mm."""
    gear_ratio: Annotated[float, Field(gt=0)] | None = None
    """Turns of the motor for one of the joint."""


class ModelReference(StrictTable):
    """A model as the scenario states it, and what of it is recorded."""

    mjcf: str
    """MJCF or URDF, in the scenario's folder."""
    axes: dict[str, ModelAxis] = Field(min_length=1)
    """Joint of each table axis, by the name in its column `table_<axis>_deg` or `_mm`."""
    site: str
    """Site or body where the instrument sits."""

    @field_validator("axes", mode="before")
    @classmethod
    def _plain_names(cls, stated: Any) -> Any:
        if not isinstance(stated, dict):
            return stated
        return {k: {"joint": v} if isinstance(v, str) else v for k, v in stated.items()}


def with_links(table: dict[str, Any], stated: ModelReference, folder: Path) -> dict[str, Any]:
    """A scenario's table with the links of its model, and the frames of its sensors, instead of the
    names of them.

    Raises:
        TiltcalError: no simulator is installed, or the model cannot be read.
    """
    readers = [reader for _, reader in load(GROUP)]
    if not readers:
        raise TiltcalError(
            f"model {stated.mjcf}",
            found="no simulator installed",
            need="the package tiltsim",
            do="install tiltcal with its simulator",
        )
    reader: Reader = readers[0]
    sensors = [s for s in table.get("sensor", ()) if isinstance(s, dict)]
    sites = [s["site"] for s in sensors if isinstance(s.get("site"), str)]
    chain, frames = reader(stated, folder, sites)
    rig = {k: v for k, v in table["rig"].items() if k not in ModelReference.model_fields}
    rig |= {"model": stated.mjcf, "site": stated.site, **chain.model_dump(exclude_defaults=True)}
    return {**table, "rig": rig, "sensor": [_at_site(s, frames) for s in table.get("sensor", ())]}


def _at_site(sensor: Any, frames: Mapping[str, LinkFrame]) -> Any:
    """A sensor's table with the frame of the site that it names."""
    if not isinstance(sensor, dict) or not isinstance(sensor.get("site"), str):
        return sensor
    others = {k: v for k, v in sensor.items() if k != "site"}
    return {**others, "place": frames[sensor["site"]].model_dump()}


PROBED = np.array([0.0, 0.7, 2.0, 3.6, 5.3])  # s, rad and K: what is fixed is alike at all of them


def why_not(effect: Effect, setup: Setup) -> str | None:
    """Why a model with fixed parameters, moved by the readout, cannot represent an effect; None
    where it can.
    """
    if effect.random:
        return "random"
    if isinstance(effect, Learned):
        return "a curve, no formula"
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
