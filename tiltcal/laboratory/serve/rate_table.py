"""The table behind the wire: axes, interlock, faults, and the instrument that it carries. It knows
nothing of sockets and of the wall clock: its time is advanced by who owns it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import Mover
from tiltcal.laboratory.instrument.carried import CarriedInstrument
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.sensor_columns import to_column
from tiltcal.laboratory.serve.axis import AxisDrive
from tiltcal.laboratory.serve.frame import FrameFormat
from tiltcal.setup.tables import angle_channel
from tiltcal.setup.trajectory import Drive, Jet

BLOCK = 128  # frames whose motion is computed at once


@dataclass(frozen=True)
class Frame:
    """The readings of one instant, in the units of a recording.

    Args:
        counter: from 0 on; time: s; values: of each column; lost: it never leaves the table.
    """

    counter: int
    time: float
    values: list[float]
    lost: bool = False


class RateTable:
    """A table with drives that obey limits, and the instrument on it.

    The motion is prescribed: smooth trapezoids of the rate within the limits of each axis.

    Args:
        scenario: rig, sensors, effects, climate; its sequence is not used.
        seed: of the random effects; None: without them and without quantisation.
        mover: what moves.

    Raises:
        TiltcalError: the scenario has no table with axes, no sensor or ``[dynamics]``; or an effect
            needs the whole recording.
    """

    def __init__(self, scenario: Scenario, seed: int | None, mover: Mover = closed_form) -> None:
        require_served(scenario)
        self.scenario, self.seed = scenario, seed
        self.rate_hz = max(s.rate_hz for s in scenario.sensor)
        self.instrument = CarriedInstrument(
            scenario, 1 / self.rate_hz, seed=seed, lost="nan", mover=mover
        )
        self.axes = {name: AxisDrive() for name in scenario.rig.axis_names}
        self.mount, self.interlock = scenario.rig.mount, True
        self.counter, self.time, self.to_lose = 0, 0.0, 0
        sensors = [f"{s.name}_{a}_{s.column_unit}" for s in scenario.sensor for a in s.axes]
        angles = [f"{angle_channel(name)}_deg" for name in self.axes]
        self.format = FrameFormat((*angles, *sensors, "temperature_degC"))

    def advance(self, time: float) -> Iterator[Frame]:
        """The frames up to an instant, s; what is demanded next acts from there on."""
        last = int(np.floor(time * self.rate_hz + 1e-9))
        while self.counter <= last:
            numbers = np.arange(self.counter, min(last, self.counter + BLOCK - 1) + 1)
            stamps = self._within_limits(numbers / self.rate_hz)
            yield from self._frames(stamps)
        self.time = max(self.time, time)

    def _within_limits(self, stamps: Array) -> Array:
        """The stamps until an axis passes a limit of its angle, where it is stopped."""
        for axis in self.axes.values():
            x, v = np.asarray(axis.jet(stamps).x), np.asarray(axis.jet(stamps).v)
            outside = ((x > axis.high) & (v > 0)) | ((x < axis.low) & (v < 0))
            if axis.mode == "rate" and outside.any():
                stamps = stamps[: int(np.argmax(outside)) + 1]
                axis.stop(float(stamps[-1]))
                axis.mode = "off"
        return stamps

    def drive(self, stamps: Array) -> Drive:
        """What the encoders say at these stamps, and how far the axes slipped. stamps: s, (n,)."""
        slips = {n: Jet(a.slip * np.ones_like(stamps)) for n, a in self.axes.items() if a.slip}
        axes = {name: axis.jet(stamps) for name, axis in self.axes.items()}
        return self.instrument.drive(stamps, axes, self.mount, slips)

    def _frames(self, stamps: Array) -> Iterator[Frame]:
        drive = self.drive(stamps)
        motions = self.instrument.motions(drive)
        angles = np.column_stack([np.asarray(jet.x) / DEG for jet in drive.axes.values()])
        for k, time in enumerate(stamps):
            found = self.instrument.step(motions, slice(k, k + 1))
            values = angles[k].tolist()
            for sensor in self.scenario.sensor:
                due = self.counter % round(self.rate_hz / sensor.rate_hz) == 0
                column = to_column(
                    sensor, found[sensor.name], sensor.column_unit, self.seed is not None
                )
                values += column[0].tolist() if due else [float("nan")] * len(sensor.axes)
            values.append(float(drive.temperature[k]))
            lost, self.to_lose = self.to_lose > 0, max(self.to_lose - 1, 0)
            yield Frame(self.counter, float(time), values, lost)
            self.counter += 1

    def moving(self) -> bool:
        """Whether an axis moves."""
        return any(axis.moving(self.time) for axis in self.axes.values())

    def trip(self) -> None:
        """All drives come to rest and are off."""
        for axis in self.axes.values():
            axis.stop(self.time)
            axis.mode = "off"

    def reset(self) -> None:
        """As switched on, where it stands: drives off, limits as at first, no faults."""
        self.trip()
        for name, axis in self.axes.items():
            self.axes[name] = replace(AxisDrive(), pieces=axis.pieces, slip=axis.slip)
        self.interlock, self.to_lose = True, 0


def require_served(scenario: Scenario) -> None:
    """Refuse a scenario that no table can be served from.

    Raises:
        TiltcalError: naming what is in the way.
    """
    found, do = "", ""
    if not scenario.rig.axes:
        found, do = f"table {scenario.rig.table}", "choose a table with axes"
    elif scenario.dynamics is not None:
        found, do = "[dynamics]", "leave it out: served motion is prescribed, within limits"
    elif not scenario.sensor:
        found, do = "no sensors", "add [[sensor]]"
    if found:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found=found,
            need="a table with axes that carries a sensor, moved as prescribed",
            do=do,
        )
