"""Many copies of a scenario's rig that are moved step by step: what both environments of
``rig_environment`` step.
"""

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.design.gym.axis_motion import AxisLimits, AxisMotion, Ranges
from tiltcal.design.gym.sensor_information import information_of
from tiltcal.laboratory.instrument.carried import CarriedInstrument
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.trajectory import Drive, Jet

READOUT = "readout"
# of a reading in an observation, SI: far beyond what such sensors read
LARGEST = {"accelerometer": 2000.0, "inclinometer": np.pi, "gyro": 200.0, "fog": 200.0}


class Rigs:
    """Rigs of one scenario with their instruments; ``step`` changes them in place.

    Args:
        scenario: a file, or a scenario; its sequence is not used.
        count: rigs.
        noise: whether random effects and quantisation act.
        rate_deg_s, acceleration_deg_s2: largest of each axis; rate_mm_s, acceleration_mm_s2: of
            each that slides.
        limits_deg: lowest and highest angle by axis; others turn without end. limits_mm: of axes
            that slide; others have the range of their joint.
        duration_s: of an episode.

    Raises:
        TiltcalError: the rig has no axes or no sensor, an axis that slides has no limits, or an
            effect cannot act step by step.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        count: int,
        *,
        noise: bool = True,
        rate_deg_s: float = 100.0,
        acceleration_deg_s2: float = 100.0,
        limits_deg: Ranges | None = None,
        rate_mm_s: float = 200.0,
        acceleration_mm_s2: float = 500.0,
        limits_mm: Ranges | None = None,
        duration_s: float = 60.0,
    ) -> None:
        known = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        _require_movable(known, duration_s)
        self.scenario, self.count, self.duration_s = known, count, duration_s
        self.step_s = 1 / max(sensor.rate_hz for sensor in known.sensor)
        table, ranges = known.rig.kind, known.rig.ranges
        joints = {name: ranges[name] for name in table.sliding & ranges.keys()}
        limits = AxisLimits.stated(
            table,
            {"deg": rate_deg_s, "mm": rate_mm_s},
            {"deg": acceleration_deg_s2, "mm": acceleration_mm_s2},
            {"deg": limits_deg, "mm": {**joints, **(limits_mm or {})}},
        )
        self.slides = np.array([name in table.sliding for name in table.axis_names])
        self.motion = AxisMotion.at_rest(limits, self.step_s, count)
        seed = known.seed if noise else None
        self.instrument = CarriedInstrument(known, self.step_s, envs=count, seed=seed)
        self.information = information_of(known, count)
        self.steps = np.zeros(count, np.intp)

    @property
    def elapsed(self) -> Array:
        """Since each episode began, s, (count,)."""
        return np.asarray(self.steps * self.step_s)

    def restart(self, rows: Mask, seed: int | None = None) -> None:
        """These rigs rest with all axes at zero, and are switched on. rows: (count,); seed: of all
        instruments anew.
        """
        self.motion.restart(rows)
        self.instrument.reset(None if seed is not None else rows, seed=seed)
        for information in self.information.values():
            information.restart(rows)
        self.steps[rows] = 0

    def move(self, actions: Array, rows: Mask) -> None:
        """These rigs move on by a step. actions: demanded rates over the largest, (count, axes)."""
        self.motion.move(np.clip(actions, -1.0, 1.0) * self.motion.limits.rate, rows)
        self.steps = self.steps + rows

    def drive(self) -> Drive:
        """What each rig does now, one a row."""
        motion = self.motion
        axes = {
            name: Jet(motion.place[:, i], motion.rate[:, i], motion.acceleration[:, i])
            for i, name in enumerate(self.scenario.rig.axis_names)
        }
        return self.instrument.drive(self.elapsed, axes, self.scenario.rig.mount)

    def sample(self, rows: Mask) -> tuple[dict[str, Array], dict[str, Any], Array]:
        """One sample of all sensors.

        Args:
            rows: rigs whose sample counts as information, (count,).

        Returns:
            Observation, info, and nats gained by each rig, (count,).
        """
        drive = self.drive()
        motions = self.instrument.motions(drive)
        found = self.instrument.step(motions, slice(None))
        readings = {name: values.copy() for name, values in found.items()}
        nats = np.zeros(self.count)
        for name, sense in self.instrument.senses(motions, drive).items():
            every = round(1 / (self.scenario.named(name).rate_hz * self.step_s))
            nats += self.information[name].add(sense, rows & (self.steps % every == 0))
        info = {
            "readout": self.motion.place.copy(),
            "readings": readings,
            "elapsed_s": self.elapsed,
        }
        return self._observation(readings), info, nats

    def _observation(self, readings: dict[str, Array]) -> dict[str, Array]:
        """The readout, rad within half a turn, or m, and the readings, SI; zero where none came
        yet.
        """
        place = self.motion.place
        turned = (place + np.pi) % (2 * np.pi) - np.pi
        seen = {READOUT: np.where(self.slides, place, turned)}
        for sensor in self.scenario.sensor:
            most = LARGEST[sensor.kind]
            seen[sensor.name] = np.nan_to_num(np.clip(readings[sensor.name], -most, most))
        return seen

    def observation_space(self) -> spaces.Dict:
        """``readout``, rad within half a turn, or m, (axes,), and by its name each sensor's
        readings, SI, (k,).
        """
        limits = self.motion.limits
        low = np.where(self.slides, limits.low, -np.pi)
        high = np.where(self.slides, limits.high, np.pi)
        found: dict[str, spaces.Space[Any]] = {READOUT: spaces.Box(low, high, dtype=np.float64)}
        for sensor in self.scenario.sensor:
            found[sensor.name] = _reading_box(sensor)
        return spaces.Dict(found)

    def action_space(self) -> spaces.Box:
        """Demanded rate of each axis over the largest, (axes,)."""
        return spaces.Box(-1.0, 1.0, (len(self.slides),), dtype=np.float32)

    def over(self) -> Mask:
        """Whether the time of each episode is used up, (count,)."""
        return np.asarray(self.elapsed >= self.duration_s - self.step_s / 2)


def _reading_box(sensor: Sensor) -> spaces.Box:
    most = LARGEST[sensor.kind]
    return spaces.Box(-most, most, (len(sensor.axes),), dtype=np.float64)


def _require_movable(scenario: Scenario, duration_s: float) -> None:
    """Refuse a scenario that no environment can be made from.

    Raises:
        TiltcalError: naming what is in the way.
    """
    found, do = "", ""
    if not scenario.rig.axes:
        found, do = f"table {scenario.rig.table}", "choose a rig with axes"
    elif not scenario.sensor:
        found, do = "no sensors", "add [[sensor]]"
    elif scenario.dynamics is not None:
        found, do = "[dynamics]", "leave it out: the motion is what the actions ask for"
    elif READOUT in [sensor.name for sensor in scenario.sensor]:
        found, do = f"a sensor named '{READOUT}'", "give it another name"
    elif not 0 < duration_s < np.inf:
        found, do = f"duration_s = {duration_s:g}", "give a positive duration"
    if found:
        raise TiltcalError(
            f"environment of scenario {scenario.name}",
            found=found,
            need="a rig with axes that carries a sensor",
            do=do,
        )
