"""The sensors of a scenario on motion that is not ours, step by step and causal."""

import warnings
from collections.abc import Sequence
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import DelayEffect, Effect, SignalEffect
from tiltcal.effects.events import active_in
from tiltcal.effects.stepwise import Rows
from tiltcal.laboratory.instrument.chain import INPUT, History, SensorChain, Surroundings
from tiltcal.laboratory.laboratory import NEW
from tiltcal.laboratory.scenario import Scenario

NONE = np.empty(0, np.intp)


class Instrument:
    """The whole chain of errors that a scenario states, on the motion of any simulation.

    The readings are those of the laboratory for the same motion: the effects are the same, in the
    same order. ``docs/instrument.md`` lists the differences.

    Args:
        scenario: its sensors and their effects; its table is not used.
        step_s: between two calls of ``step``, s.
        envs: environments that are stepped together.
        seed: of the first environment, the next ones have the next numbers; None: without random
            effects and quantisation, and a warning that names what is left out.
        lost: what stands for a lost sample: the last one (``hold``) or NaN (``nan``).
        effects: instead of those of the scenario.

    Raises:
        TiltcalError: an effect needs later samples, the whole recording or the table's readout; or
            a sensor's samples fall between the steps.
    """

    def __init__(
        self,
        scenario: Scenario,
        step_s: float,
        *,
        envs: int = 1,
        seed: int | None = 0,
        lost: Literal["hold", "nan"] = "hold",
        effects: Sequence[Effect] | None = None,
    ) -> None:
        self.scenario, self.step_s, self.envs, self.lost = scenario, step_s, envs, lost
        self.effects = live_effects(scenario) if effects is None else effects
        self._checked = False
        self._rate_hz = round(1 / step_s, 9)
        self.random = seed is not None
        if not self.random and effects is None:
            _say_what_is_off(self.effects)
        self._build(seed)

    def reset(self, rows: Mask | None = None, *, seed: int | None = None) -> None:
        """The power is switched on: the next step is the first sample.

        Args:
            rows: environments, (envs,) bool; None: all.
            seed: of new streams for all environments; None: they continue where they are. An
                instrument without random effects stays without.
        """
        if rows is None and seed is not None and self.random:
            self._build(seed)
            return
        which: Rows = slice(None) if rows is None else np.flatnonzero(rows)
        self.count[which], self._begins = 0, True
        for chain in self.chains:
            chain.restart(which)

    def _build(self, seed: int | None) -> None:
        around = Surroundings(self.scenario, self.step_s)
        self.chains = [
            SensorChain(sensor, around, self.effects, self.envs, seed)
            for sensor in self.scenario.sensor
        ]
        longest = max(chain.longest_s for chain in self.chains) / self.step_s
        self.history = History(longest, self.envs, INPUT)
        self.count, self._begins = np.zeros(self.envs, np.intp), True

    def step(
        self, force: Array | None, rate: Array | None, angular_acceleration: Array | None = None
    ) -> dict[str, Array]:
        """The readings now; a sensor that is not due keeps its last ones.

        Args:
            force: specific force at the sensors, body frame, m/s2, (envs, 3) or (3,).
            rate: angular rate against inertial space, body frame, rad/s, alike.
            angular_acceleration: rad/s2, alike. Each may be None where nothing
                needs it.

        Returns:
            SI readings by sensor name, (envs, k); they are not written to again.

        Raises:
            TiltcalError: a sensor or an effect needs what is not given.
        """
        inputs = np.full((self.envs, INPUT), np.nan)
        for first, part in zip((0, 3, 6), (force, rate, angular_acceleration), strict=True):
            if part is not None:
                inputs[:, first : first + 3] = part
        if not self._checked:
            absent = np.repeat([part is None for part in (force, rate, angular_acceleration)], 3)
            for chain in self.chains:
                chain.require_inputs(np.where(absent, np.nan, 1.0))
            self._checked = True
        begun = np.flatnonzero(self.count == 0) if self._begins else NONE
        self.history.add(inputs, begun)
        self._begins = False
        elapsed = self.count / self._rate_hz
        found = {chain.sensor.name: self._read(chain, elapsed) for chain in self.chains}
        self.count += 1
        return found

    def _read(self, chain: SensorChain, elapsed: Array) -> Array:
        due: Rows = slice(None)
        if chain.every > 1:
            due = self._due(chain.every)
            if not isinstance(due, slice) and not len(due):
                return chain.readings
        values = chain.read(self.history, elapsed[due], due)
        if self.lost == "hold" and np.isnan(values).any():
            values = np.where(np.isnan(values), chain.readings[due], values)
        if isinstance(due, slice):
            chain.readings = values
        else:
            chain.readings = chain.readings.copy()
            chain.readings[due] = values
        return chain.readings

    def _due(self, every: int) -> Rows:
        """The environments whose sensor is sampled every so many steps, and now."""
        due = self.count % every == 0
        return slice(None) if due.all() else np.flatnonzero(due)


def _say_what_is_off(effects: Sequence[Effect]) -> None:
    """Warn of random effects that an instrument without a seed leaves out."""
    if off := [e.address for e in effects if e.random]:
        warnings.warn(f"seed=None leaves out {', '.join(off)}", stacklevel=3)


def live_effects(scenario: Scenario) -> list[Effect]:
    """The effects of a scenario that act on its sensors.

    Raises:
        TiltcalError: one acts on the table, its readout, the mounting or the surroundings, or there
            is no sensor.
    """
    if not scenario.sensor:
        raise TiltcalError(
            f"scenario {scenario.name}",
            found="no sensors",
            need="at least one [[sensor]]",
            do="add one",
        )
    effects = [e for e in active_in(scenario.effects, NEW) if not e.is_identity]
    for effect in effects:
        if not isinstance(effect, SignalEffect | DelayEffect):
            raise TiltcalError(
                f"effect {effect.address}",
                found=f"an effect of the {effect.stage}, which acts on the laboratory's own motion",
                need="effects of sensors, electronics, timing and data",
                do="leave it out, or model it in the simulation that is wrapped",
            )
    return effects
