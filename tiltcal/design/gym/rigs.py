"""Many copies of a scenario's rig that are moved step by step: what both environments of
``rig_environment`` step.

Axes follow demanded rates as far as their accelerations allow; the information is that of the
readings on the terms that a calibration may adjust.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from tiltcal.calibration.methods.terms import effect_of_term
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.design.terms import STEEPEST
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import TermEffect
from tiltcal.effects.sense import Sense
from tiltcal.forward.jacobian import candidates, white_noise
from tiltcal.laboratory.instrument.carried import CarriedInstrument
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.setup.reach import Reach
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.tables import Table
from tiltcal.setup.trajectory import Drive, Jet

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest readout by axis."""


@dataclass(frozen=True)
class AxisLimits:
    """What the axes of a rig can do, in rad, or m of those that slide.

    Args:
        rate, acceleration: largest, 1/s, 1/s2, (axes,).
        low, high: of the readout, (axes,).
        start: of the readout when an episode begins, (axes,).
    """

    rate: Array
    acceleration: Array
    low: Array
    high: Array
    start: Array

    @classmethod
    def of(
        cls, reach: Reach, rate: Mapping[str, float], acceleration: Mapping[str, float]
    ) -> "AxisLimits":
        """Axes that turn go on without end where they have no limits.

        Args:
            reach: where the axes may stand.
            rate, acceleration: largest by unit of the readout, 1/s and 1/s2.

        Raises:
            TiltcalError: a rate is not positive, an axis slides without limits, or cannot move.
        """
        table = reach.table
        for unit in ("deg", "mm"):
            _require_positive(f"rate_{unit}_s", rate[unit])
            _require_positive(f"acceleration_{unit}_s2", acceleration[unit])
        for name in table.axis_names:
            ends = reach.limits(name)
            if ends is None and name in table.sliding:
                need = "its lowest and highest position"
                raise _refused("limits_mm", f"no axis {name}, which slides", need)
            if ends is not None and ends[0] == ends[1]:
                raise _refused(f"limits of {name}", f"{ends[0]:g} alone", "room to move")
        units = [table.unit(name) for name in table.axis_names]
        fastest, hardest = (np.array([of[u] for u in units]) for of in (rate, acceleration))
        ends_and_start = (part * reach.sizes for part in (reach.low, reach.high, reach.start))
        return cls(fastest * reach.sizes, hardest * reach.sizes, *ends_and_start)


def _require_positive(token: str, value: float) -> None:
    if not 0 < value < np.inf:
        raise _refused(token, f"{value:g}", "a positive number")


def _stated(
    table: Table, unit: str, ranges: Ranges | None
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Axes of this unit with their limits."""
    names = [name for name in table.axis_names if table.unit(name) == unit]
    for axis, ends in (ranges or {}).items():
        yield one_of(axis, names, f"environment, limits_{unit}", "axis"), ends


@dataclass
class AxisMotion:
    """Where the axes of many rigs are, with exact derivatives: accelerations are linear within a
    step.

    Args:
        limits: of the axes.
        step_s: of a demand.
        position, rate, acceleration: present state, rad, rad/s and rad/s2; m, m/s and m/s2 of
            axes that slide; (rigs, axes).
    """

    limits: AxisLimits
    step_s: float
    position: Array
    rate: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, limits: AxisLimits, step_s: float, count: int) -> "AxisMotion":
        """All axes where they start."""
        shape = (count, len(limits.low))
        return cls(
            limits, step_s, np.tile(limits.start, (count, 1)), np.zeros(shape), np.zeros(shape)
        )

    def restart(self, rows: Mask) -> None:
        """Set these rigs to standstill where they start. rows: mask, (rigs,)."""
        self.position[rows] = self.limits.start
        for part in (self.rate, self.acceleration):
            part[rows] = 0.0

    def move(self, rate: Array, rows: Mask) -> None:
        """One step of these rigs towards demanded rates, rad/s or m/s, (rigs, axes).

        The rate is reached in two steps, or as fast as the acceleration allows; before a limit
        an axis brakes.
        """
        h, x, v, a = self.step_s, self.position, self.rate, self.acceleration
        most = self.limits.acceleration
        demand = np.clip(rate, *self._safe())
        next_a = np.clip((demand - v) / h - a / 2, -most, most)
        live = rows[:, None]
        self.position = np.where(live, x + h * (v + h * (2 * a + next_a) / 6), x)
        self.rate = np.where(live, v + h * (a + next_a) / 2, v)
        self.acceleration = np.where(live, next_a, a)

    def _safe(self) -> tuple[Array, Array]:
        """Lowest and highest rate from which each axis stops before its limits, rad/s or m/s:
        with half the acceleration, and two steps to begin.
        """
        limits = self.limits
        ahead = 2 * self.step_s * np.abs(self.rate) + 2 * limits.acceleration * self.step_s**2
        above = np.maximum(limits.high - self.position - ahead, 0.0)
        below = np.maximum(self.position - limits.low - ahead, 0.0)
        fastest = (np.sqrt(limits.acceleration * distance) for distance in (below, above))
        lowest, highest = (np.minimum(rate, limits.rate) for rate in fastest)
        return -lowest, highest


def _refused(token: str, found: str, need: str) -> TiltcalError:
    return TiltcalError(f"environment, {token}", found=found, need=need, do="correct it")


GRADE = "mid_mems"  # whose plausible sizes are the prior


@dataclass(frozen=True)
class AdjustableTerm:
    """One number that a calibration re-tunes.

    Args:
        effect: effect of the term.
        name: parameter name without axes and unit.
        size: prior standard deviation, SI.
    """

    effect: TermEffect
    name: str
    size: float


def adjustable_terms(scenario: Scenario, sensor: Sensor) -> list[AdjustableTerm]:
    """The numbers of a sensor's ``adjustable`` list that are linear terms of the sensor; effects of
    table and electronics that stand there are not among them.
    """
    ids = set()
    for term in sensor.adjustable:
        if term not in CATALOGUE:
            ids.add(effect_of_term(term, sensor).id)
        elif issubclass(CATALOGUE[term], TermEffect) and CATALOGUE[term].stage == "sensor":
            ids.add(term)
    found = []
    for id, owner, _, name, parameter, size in candidates(scenario, GRADE):
        if id in ids and owner == sensor.name:
            effect = CATALOGUE[id](sensor=owner)
            assert isinstance(effect, TermEffect)
            si = size * PARAMETER_UNITS[parameter.unit].factor
            found.append(AdjustableTerm(effect, name, si))
    return found


class SensorInformation:
    """Information of many rigs on the adjustable terms of one sensor, sample by sample.

    The noise of a sample is the white noise that the scenario states, or a usual one. The
    covariance takes a sample in by a rank-one update (Sherman and Morrison 1950).

    Args:
        scenario: source of noise and terms.
        sensor: sensor of the terms.
        count: number of rigs.
    """

    def __init__(self, scenario: Scenario, sensor: Sensor, count: int) -> None:
        self.sensor = sensor
        self.terms = adjustable_terms(scenario, sensor)
        self.sigma = white_noise(sensor, scenario.effects)
        size = len(self.terms)
        self.covariance = np.tile(np.eye(size), (count, 1, 1))

    def restart(self, rows: Mask) -> None:
        """Reset these rigs to the prior. rows: mask, (rigs,)."""
        self.covariance[rows] = np.eye(len(self.terms))

    def add(self, sense: Sense, rows: Mask) -> Array:
        """Nats that a sample of these rigs brings, (rigs,): the rise of half the log determinant of
        the information over the prior.

        Args:
            sense: what the sensor senses, one row a rig.
            rows: (rigs,).
        """
        nats = np.zeros(len(rows))
        if not self.terms:
            return nats
        columns = self.columns(sense) / self.sigma
        columns[~rows] = 0.0
        C = self.covariance
        for channel in range(columns.shape[1]):
            row = columns[:, channel]
            Cr = np.matmul(C, row[..., None])[..., 0]
            grown = 1 + np.einsum("ni,ni->n", row, Cr)
            C -= Cr[..., :, None] * Cr[..., None, :] / grown[:, None, None]
            nats += np.log(grown) / 2
        return nats

    def columns(self, sense: Sense) -> Array:
        """Change of the readings per prior standard deviation, SI, (rigs, channels, terms)."""
        columns = np.zeros((len(sense.time), len(self.sensor.axes), len(self.terms)))
        for j, term in enumerate(self.terms):
            channel, column = term.effect.term(term.name, sense)
            if channel >= 0:
                columns[:, channel, j] = term.size * column
        if self.sensor.kind == "inclinometer":  # its terms act on the force: d asin = df/(g cos)
            share = sense.force[:, list(self.sensor.axis_indices)] / sense.gravity
            across = np.sqrt(np.maximum(1 - share**2, STEEPEST**2))
            columns /= (sense.gravity * across)[:, :, None]
        return columns


def information_of(scenario: Scenario, count: int) -> Mapping[str, SensorInformation]:
    """That of all sensors, by name."""
    return {s.name: SensorInformation(scenario, s, count) for s in scenario.sensor}


READOUT = "readout"
# of a reading in an observation, SI: far beyond what such sensors read
LARGEST = {"accelerometer": 2000.0, "inclinometer": np.pi, "gyro": 200.0, "fog": 200.0}


class Rigs:
    """Rigs of one scenario with their instruments; ``step`` changes their state.

    Args:
        scenario: a file, or a scenario; its sequence is not used.
        count: rigs.
        noise: whether random effects and quantisation act.
        rate_deg_s, acceleration_deg_s2: largest of each axis that turns.
        rate_mm_s, acceleration_mm_s2: largest of each axis that slides.
        limits_deg: lowest and highest angle by axis, in addition to the limits of the rig and the
            ranges of a model's joints; axes without any turn without end.
        limits_mm: the same of axes that slide.
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
        table, given = known.rig.kind, {"deg": limits_deg, "mm": limits_mm}
        stated = dict(pair for unit in given for pair in _stated(table, unit, given[unit]))
        limits = AxisLimits.of(
            known.rig.narrowed(stated, {}).reach,
            {"deg": rate_deg_s, "mm": rate_mm_s},
            {"deg": acceleration_deg_s2, "mm": acceleration_mm_s2},
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
        """Set these rigs to standstill where they start, and switch them on.

        Args:
            rows: mask of the rigs, (count,).
            seed: seed of all instruments; none: instruments continue their own.
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
            name: Jet(motion.position[:, i], motion.rate[:, i], motion.acceleration[:, i])
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
            "readout": self.motion.position.copy(),
            "readings": readings,
            "elapsed_s": self.elapsed,
        }
        return self._observation(readings), info, nats

    def _observation(self, readings: dict[str, Array]) -> dict[str, Array]:
        """The readout, rad within half a turn, or m, and the readings, SI; zero where none came
        yet.
        """
        position = self.motion.position
        turned = (position + np.pi) % (2 * np.pi) - np.pi
        seen = {READOUT: np.where(self.slides, position, turned)}
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
