"""The instrument at rest at table angles: what it senses there, and whether an effect depends on
the path to a pose.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import Effect, SignalEffect, TermEffect
from tiltcal.effects.sense import Sense
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.tables import tables
from tiltcal.setup.trajectory import Drive, Jet

ROUNDING = 1e-10  # m/s2, rad: a change that is none
POINTWISE = ("pose", "time", "temperature", "any")  # needs of effects that may show in a pose


@dataclass(frozen=True)
class Still:
    """Poses of a scenario's table.

    Args:
        scenario: rig, sensors, climate; the instrument is where ``rig`` has it.
        horizon: s of table time: drifts run from 0 to 1 over it.
    """

    scenario: Scenario
    horizon: float

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Table axes that a design moves: those that turn gravity in the body frame, outermost
        first.

        Raises:
            TiltcalError: the table has none.
        """
        rig = self.scenario.rig
        if not rig.kind.tilting and rig.kind.chain is not None:
            raise TiltcalError(
                f"design, model {rig.model}",
                found="no axis that tilts the instrument where it sits",
                need="a joint under it that changes what gravity does to it",
                do="map one in [rig.axes], or name a sensor that sits elsewhere",
            )
        if not rig.kind.tilting:
            turns = "turns about the vertical only" if rig.axes else "has no axis to command"
            *able, last = (table.name for table in tables().values() if table.tilting)
            raise TiltcalError(
                f"design, table {rig.table}",
                found=f"a table that {turns}: no pose of it changes what gravity does to a sensor",
                need=f"{', '.join(able)} or {last}",
                do="design for another table",
            )
        return rig.kind.tilting

    def up(self, angles: Array) -> Array:
        """Up in the body frame, (n, 3). angles: of ``axes``, rad, (n, axes)."""
        v = np.tile([0.0, 0.0, 1.0], (len(angles), 1))
        table = self.scenario.rig.kind
        for name, about in table.moving:
            if table.chain is not None:
                v = v @ table.chain.links[name].R
            if name not in self.axes:  # it slides, or stands upright
                continue
            i = "xyz".index(about)
            j, m = (i + 1) % 3, (i + 2) % 3
            angle = angles[:, self.axes.index(name)]
            c, s = np.cos(angle), np.sin(angle)
            v[:, j], v[:, m] = c * v[:, j] + s * v[:, m], c * v[:, m] - s * v[:, j]  # R(e, q)^T v
        if table.chain is not None:
            v = v @ table.chain.instrument.R
        return np.asarray(v @ self.scenario.rig.mount_rotation)

    def drive(self, angles: Array, time: Array) -> Drive:
        """The table at rest at each of these angles.

        Args:
            angles: rad, (n, axes).
            time: s, (n,).
        """
        zero = np.zeros(len(angles))
        where = {name: Jet(angles[:, k], zero, zero) for k, name in enumerate(self.axes)}
        reach = self.scenario.rig.reach
        axes = {
            name: where.get(name, Jet(zero + stands, zero, zero))
            for name, stands in zip(
                self.scenario.rig.axis_names, reach.start * reach.sizes, strict=True
            )
        }
        climate = self.scenario.climate
        return Drive(
            time,
            axes,
            0.0,
            climate.at(time),
            climate.reference(self.horizon),
            np.arange(len(angles)),
            ((0, self.scenario.rig.mount_rotation),),
            None,
            np.ones(len(angles), bool),
            rows_apart=True,
        )


@dataclass(frozen=True)
class Poses:
    """A Course that is given by its poses: row n stands at angles n."""

    still: Still
    angles: Array

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s: one pose a second."""
        return 0.0, float(len(self.angles))

    def drive(self, time: Array) -> Drive:
        """The drive at the poses' own times. time: s, (n,)."""
        return self.still.drive(self.angles, time)


def watch(still: Still, angles: Array) -> NominalMotion:
    """What effects change at poses, one second apart. angles: rad, (n, axes)."""
    return NominalMotion(still.scenario, Poses(still, angles), np.arange(len(angles), dtype=float))


def still_sense(still: Still, sensor: Sensor, angles: Array, time: Array) -> Sense:
    """What a sensor senses at poses; a further row at the horizon gives effects the length of the
    recording.

    Args:
        still: the instrument at standstill.
        sensor: sensor of the readings.
        angles: rad, (n, axes).
        time: s, (n,).
    """
    return sense_of(still, sensor, still.up(angles), time, angles)


def sense_of(
    still: Still, sensor: Sensor, up: Array, time: Array, angles: Array | None = None
) -> Sense:
    """The same at directions of up in the body frame, (n, 3).

    Args:
        still: the instrument at standstill.
        sensor: sensor of the readings.
        up: up in the body frame, (n, 3).
        time: s, (n,).
        angles: rad, (n, axes).
    """
    g = still.scenario.site.gravity
    up = np.vstack([up, up[-1:]])
    elapsed = np.append(time, still.horizon)
    zero, climate = np.zeros_like(up), still.scenario.climate
    where = (
        {}
        if angles is None
        else {name: np.append(angles[:, k], angles[-1, k]) for k, name in enumerate(still.axes)}
    )
    return Sense(
        elapsed,
        elapsed,
        g * up,
        zero,
        up,
        zero,
        zero,
        climate.at(elapsed) - climate.reference(still.horizon),
        sensor.axis_indices,
        sensor.kind,
        np.zeros(3),
        g,
        sensor.rate_hz,
        sensor.full_scale,
        where,
        np.arange(len(up)),
        turn_rates=dict.fromkeys(where, np.zeros(len(up))),
    )


def pointwise(still: Still, sensor: Sensor, effect: Effect) -> bool:
    """Whether an effect shows at poses, with the same amount wherever in the sequence the pose
    stands.
    """
    if effect.needs not in POINTWISE or (effect.needs != "pose" and not _of_sensor(effect)):
        return False
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, (7, len(still.axes)))
    time = rng.uniform(0, still.horizon, 7)
    order = np.array([3, 0, 6, 2, 5, 1, 4])
    with np.errstate(all="ignore"):
        there = _changes(still, sensor, effect, angles, time)
        turned = _changes(still, sensor, effect, angles[order], time[order])
    size = float(np.abs(there).max(initial=0.0))
    return bool(
        np.isfinite(there).all()
        and size > ROUNDING
        and np.abs(there[order] - turned).max(initial=0.0) <= 1e-6 * size
    )


def _of_sensor(effect: Effect) -> bool:
    return isinstance(effect, TermEffect) and effect.stage == "sensor"


def _changes(still: Still, sensor: Sensor, effect: Effect, angles: Array, time: Array) -> Array:
    if _of_sensor(effect) and isinstance(effect, SignalEffect):
        sense = still_sense(still, sensor, angles, time)
        return effect.apply(np.zeros((len(time) + 1, len(sensor.axes))), sense, None)[:-1]
    return (
        watch(still, angles)
        .changes(effect)
        .get(sensor.name, np.zeros((len(time), len(sensor.axes))))
    )
