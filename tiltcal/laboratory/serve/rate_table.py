"""The table behind the wire: axes, interlock, faults, and the instrument that it carries. It knows
nothing of sockets and of the wall clock: its time is advanced by who owns it.

``Mechanics`` is the interface to a motion that is run by time steps.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import Mover
from tiltcal.laboratory.instrument.carried import CarriedInstrument
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.sensor_columns import to_column
from tiltcal.laboratory.serve.axis import AxisDrive
from tiltcal.laboratory.serve.frame import FrameFormat
from tiltcal.setup.tables import angle_channel
from tiltcal.setup.trajectory import Drive, Jet


class Mechanics(Protocol):
    """Servos and structure that follow what is asked of them, as far as the time goes."""

    @property
    def realised(self) -> tuple[str, ...]:
        """Addresses of the effects that are mechanics here."""

    def advance(self, time: float, asked: Callable[[Array], Drive]) -> None:
        """Step until the state at an instant is known, s. asked: of the motors, at the times of the
        steps to come, (n,).

        Raises:
            TiltcalError: the run diverges.
        """

    def halt(self) -> dict[str, float]:
        """After that, stand still at the last sound state; the angle of each axis there, rad."""

    def observed(self, asked: Drive) -> Drive:
        """What encoders and structure do at the times of ``asked``, which were stepped."""

    def remount(self, mount: str) -> None:
        """The instrument is remounted."""


@runtime_checkable
class MechanicalLaboratory(Protocol):
    """A laboratory with mechanics."""

    def mechanics(self, scenario: Scenario) -> Mechanics:
        """Those of a scenario with ``[dynamics]``."""


BLOCK = 128  # frames whose motion is computed at once
SETTLED = 0.01  # deg/s or mm/s, of an axis that no longer moves


@dataclass(frozen=True)
class Frame:
    """The readings of one instant, in the units of a recording.

    Args:
        counter: from 0 on.
        time: s.
        values: of each column.
        lost: it never leaves the table.
    """

    counter: int
    time: float
    values: list[float]
    lost: bool = False


class RateTable:
    """A table with drives that obey limits, and the instrument on it.

    What is asked of the axes are smooth trapezoids of the rate within the limits of each. Without
    mechanics that is their motion; with them it is what their servos follow, a few time steps
    behind the commands.

    Args:
        scenario: rig, sensors, effects, climate; its sequence is not used.
        seed: of the random effects; None: without them and without quantisation.
        mover: what moves.
        mechanics: of a scenario with ``[dynamics]``.

    Raises:
        TiltcalError: the scenario has no table with axes, no sensor, or ``[dynamics]`` without
            mechanics; or an effect needs the whole recording.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int | None,
        mover: Mover = closed_form,
        mechanics: Mechanics | None = None,
    ) -> None:
        require_served(scenario, mechanics)
        self.scenario, self.seed, self.mechanics = scenario, seed, mechanics
        self.rate_hz = max(s.rate_hz for s in scenario.sensor)
        self.instrument = CarriedInstrument(
            scenario,
            1 / self.rate_hz,
            seed=seed,
            lost="nan",
            mover=mover,
            realised=() if mechanics is None else mechanics.realised,
        )
        rig = scenario.rig
        self.axes = {name: AxisDrive.of(rig, name) for name in rig.axis_names}
        self.mount, self.interlock = scenario.rig.mount, True
        self.counter, self.time, self.to_lose = 0, 0.0, 0
        sensors = [f"{s.name}_{a}_{s.column_unit}" for s in scenario.sensor for a in s.axes]
        axis_columns = [f"{angle_channel(name)}_{rig.kind.unit(name)}" for name in self.axes]
        self.format = FrameFormat((*axis_columns, *sensors, "temperature_degC"))

    def advance(self, time: float) -> Iterator[Frame]:
        """The frames up to an instant, s; what is demanded next acts from there on."""
        last = int(np.floor(time * self.rate_hz + 1e-9))
        while self.counter <= last:
            numbers = np.arange(self.counter, min(last, self.counter + BLOCK - 1) + 1)
            stamps = self._within_limits(numbers / self.rate_hz)
            yield from self._frames(stamps)
        self.time = max(self.time, time)
        self._follow(self.time)  # what is demanded next replaces what was asked until now

    def _within_limits(self, stamps: Array) -> Array:
        """The stamps until an axis passes a limit of its readout, where it is stopped."""
        for axis in self.axes.values():
            x, v = np.asarray(axis.jet(stamps).x), np.asarray(axis.jet(stamps).v)
            outside = ((x > axis.high) & (v > 0)) | ((x < axis.low) & (v < 0))
            if axis.mode == "rate" and outside.any():
                stamps = stamps[: int(np.argmax(outside)) + 1]
                axis.stop(float(stamps[-1]))
                axis.mode = "off"
        return stamps

    def drive(self, stamps: Array) -> Drive:
        """The readout of the encoders at these stamps, and how far the axes slipped. stamps: s,
        (n,), not before those of the last call.
        """
        if self.mechanics is None:
            return self._asked(stamps)
        self._follow(float(stamps[-1]))
        return self.mechanics.observed(self._asked(stamps))

    def _follow(self, time: float) -> None:
        """Let the mechanics follow until an instant, s; where they diverge, the drives trip and the
        axes stand still.
        """
        if self.mechanics is None:
            return
        try:
            self.mechanics.advance(time, self._asked)
        except TiltcalError:
            for name, angle in self.mechanics.halt().items():
                self.axes[name].hold(self.time, angle)
                self.axes[name].mode = "off"
            self.mechanics.advance(time, self._asked)

    def _asked(self, stamps: Array) -> Drive:
        """What the axes are asked for, and how far they slipped. stamps: s, (n,)."""
        slips = {n: Jet(a.slip * np.ones_like(stamps)) for n, a in self.axes.items() if a.slip}
        axes = {name: axis.jet(stamps) for name, axis in self.axes.items()}
        return self.instrument.drive(stamps, axes, self.mount, slips)

    def readout(self, name: str) -> tuple[float, float, float]:
        """Position, rate and acceleration of an axis by its encoder now, rad, or m where
        it slides.
        """
        if self.mechanics is None:
            return self.axes[name].at(self.time)
        jet = self.drive(np.array([self.time])).axes[name]
        return tuple(float(np.asarray(part)[0]) for part in (jet.x, jet.v, jet.a))  # type: ignore[return-value]

    def remount(self, mount: str) -> None:
        """The operator remounts the instrument."""
        self.mount = mount
        if self.mechanics is not None:
            self.mechanics.remount(mount)

    def _frames(self, stamps: Array) -> Iterator[Frame]:
        drive = self.drive(stamps)
        motions = self.instrument.motions(drive)
        positions = np.column_stack(
            [np.asarray(jet.x) / self.axes[name].unit for name, jet in drive.axes.items()]
        )
        for k, time in enumerate(stamps):
            found = self.instrument.step(motions, slice(k, k + 1))
            values = positions[k].tolist()
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
        """Whether an axis is asked to move, or still moves."""
        if any(axis.moving(self.time) for axis in self.axes.values()):
            return True
        stepped = self.axes.items() if self.mechanics else ()
        return any(abs(self.readout(name)[1]) > SETTLED * axis.unit for name, axis in stepped)

    def trip(self) -> None:
        """All drives come to a standstill and are off."""
        for axis in self.axes.values():
            axis.stop(self.time)
            axis.mode = "off"

    def reset(self) -> None:
        """As switched on, where it stands: drives off, limits as at first, no faults."""
        self.trip()
        for name, axis in self.axes.items():
            fresh = AxisDrive.of(self.scenario.rig, name)
            self.axes[name] = replace(fresh, pieces=axis.pieces, slip=axis.slip)
        self.interlock, self.to_lose = True, 0


def require_served(scenario: Scenario, mechanics: Mechanics | None) -> None:
    """Refuse a scenario that no table can be served from.

    Raises:
        TiltcalError: naming what is in the way.
    """
    found, do = "", ""
    if not scenario.rig.axes:
        found, do = f"table {scenario.rig.table}", "choose a table with axes"
    elif scenario.dynamics is not None and mechanics is None:
        found, do = "[dynamics] and no mechanics", "leave it out, or install the simulator"
    elif not scenario.sensor:
        found, do = "no sensors", "add [[sensor]]"
    if found:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found=found,
            need="a table with axes that carries a sensor",
            do=do,
        )
