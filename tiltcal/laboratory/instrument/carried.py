"""The sensors of a scenario on its own rig, moved by somebody else than its sequence."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_mount
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect, WritingEffect
from tiltcal.effects.events import active_in
from tiltcal.effects.sense import Sense
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import Mover, make_sense, streams_of
from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.laboratory import NEW
from tiltcal.laboratory.scenario import Scenario, fresh
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.trajectory import Drive, Jet, Motion


class CarriedInstrument:
    """The instrument on the rig of its scenario: from the readout of the axes to the readings.

    Sensors at different sites of an own model sense different motions.

    Args:
        scenario: rig, sensors, effects, climate; its sequence is not used.
        step_s: between two samples of the motion, s.
        envs: rigs that are stepped together.
        seed: of the random effects of the first rig, the next ones have the next numbers; None:
            without them and without quantisation.
        lost: what stands for a lost sample: the last one (``hold``) or NaN (``nan``).
        mover: what moves.
        realised: addresses of the effects that mechanics hold, whose memory is theirs.

    Raises:
        TiltcalError: an effect needs the whole recording, or later samples.
    """

    def __init__(
        self,
        scenario: Scenario,
        step_s: float,
        *,
        envs: int = 1,
        seed: int | None = 0,
        lost: Literal["hold", "nan"] = "hold",
        mover: Mover = closed_form,
        realised: Sequence[str] = (),
    ) -> None:
        self.scenario, self.mover, self.seed = scenario, mover, seed
        effects = [e for e in active_in(scenario.effects, NEW) if not e.is_identity]
        self.geometry = geometry_of(effects, realised)
        signal = [e for e in effects if isinstance(e, SignalEffect | DelayEffect)]
        self.setups = []
        self.instruments = []
        for sensors in _by_location(scenario):
            self.setups.append(scenario.seen_by(sensors[0]))
            part = fresh(scenario, sensor=sensors, sequence=())
            self.instruments.append(
                Instrument(part, step_s, envs=envs, seed=seed, lost=lost, effects=signal)
            )

    def reset(self, rows: Mask | None = None, *, seed: int | None = None) -> None:
        """The power is switched on: as ``Instrument.reset``. rows: (envs,) bool; None: all."""
        for instrument in self.instruments:
            instrument.reset(rows, seed=seed)

    def drive(
        self,
        stamps: Array,
        axes: Mapping[str, Jet],
        mount: str,
        structure: Mapping[str, Jet] | None = None,
    ) -> Drive:
        """What the rig does, as the laboratory's effects want it.

        Args:
            stamps: s, (n,).
            axes: readout of each axis, rad, (n,) each.
            mount: rotation from the instrument to the faceplate.
            structure: true minus read angle by axis, rad, and deflections of the rig's own joints.
        """
        climate = self.scenario.climate
        return Drive(
            stamps,
            axes,
            0.0,
            climate.at(stamps),
            climate.reference(0.0),
            np.full(len(stamps), -1),
            ((0, parse_mount(mount)),),
            None,
            np.ones(len(stamps), bool),
            structure=structure or {},
            rows_apart=True,
        )

    def motions(self, drive: Drive) -> list[Motion]:
        """The motion at each site of sensors, (n,) rows each: to be read by ``step``."""
        streams = streams_of(self.seed)
        return [self.mover(setup, drive, self.geometry, streams) for setup in self.setups]

    def senses(self, motions: Sequence[Motion], drive: Drive) -> dict[str, Sense]:
        """What each sensor senses of these motions, by name."""
        return {
            sensor.name: make_sense(sensor, setup, motion, drive)
            for setup, instrument, motion in zip(
                self.setups, self.instruments, motions, strict=True
            )
            for sensor in instrument.scenario.sensor
        }

    def step(self, motions: Sequence[Motion], rows: slice) -> dict[str, Array]:
        """The readings of all sensors, SI, (envs, k) by name, in the order of the scenario.

        Args:
            motions: of ``motions``.
            rows: of them that are sampled now, one for each rig.
        """
        found: dict[str, Array] = {}
        for instrument, motion in zip(self.instruments, motions, strict=True):
            inputs = (motion.force, motion.rate, motion.angular_acceleration)
            found |= instrument.step(*(part[rows] for part in inputs))
        return {sensor.name: found[sensor.name] for sensor in self.scenario.sensor}


def _by_location(scenario: Scenario) -> list[tuple[Sensor, ...]]:
    """The sensors at one location, for each location."""
    locations = list(dict.fromkeys(sensor.place for sensor in scenario.sensor))
    return [tuple(s for s in scenario.sensor if s.place == location) for location in locations]


def geometry_of(effects: Sequence[Effect], realised: Sequence[str] = ()) -> list[Effect]:
    """The effects of table, mounting and surroundings. realised: addresses of those that mechanics
    hold.

    Raises:
        TiltcalError: one remembers earlier motion, or changes what is written.
    """
    found = [e for e in effects if not isinstance(e, SignalEffect | DelayEffect)]
    for effect in found:
        known = effect.row_wise or effect.rows_apart or effect.address in realised
        if isinstance(effect, WritingEffect) or not known:
            raise TiltcalError(
                f"effect {effect.address}",
                found="an effect that needs the motion as a whole",
                need="effects that follow the present motion",
                do="leave it out where the rig is moved step by step; `tiltcal simulate` has it",
            )
    return found
