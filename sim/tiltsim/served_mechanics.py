"""The mechanics of a served table: stepped as far as its time goes, driven by the present
demand.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.scenario import Scenario, fresh
from tiltcal.setup.sequence import Step
from tiltcal.setup.trajectory import Drive
from tiltsim.build import build, mechanisms_of, resolved
from tiltsim.dynamics import (
    BLOCK,
    PREROLL,
    Log,
    Recorder,
    Servos,
    observed,
    stepped,
    unprinted_warnings,
)

AHEAD = 4  # steps beyond an instant that its rate, acceleration and interpolation need


class ServedMechanics:
    """Servos that follow their demand, step by step.

    Args:
        scenario: with ``[dynamics]``; its sequence is not used.

    Raises:
        TiltcalError: an effect rings at the end of each move of a sequence, which a served table
            does not have.
    """

    def __init__(self, scenario: Scenario) -> None:
        at_standstill = fresh(scenario, sequence=(Step(action="rest", dwell_s=1.0),))
        self.scenario = at_standstill
        self.effects = [e for e in scenario.effects if not e.is_identity]
        self.servos = Servos(at_standstill, self.effects)
        if self.servos.rig.rings:
            raise TiltcalError(
                f"scenario {scenario.name}",
                found=f"a structure that rings, {self.servos.rig.rings[0].body}",
                need="effects that do not know the sequence",
                do="leave it out of what is served; `tiltcal simulate` has it",
            )
        self.realised = self.servos.realised
        model = self.servos.rig.model
        self.columns = {model.joint(i).name: int(model.jnt_dofadr[i]) for i in range(model.njnt)}
        self.dt = float(model.opt.timestep)
        self.recorder, self.done = Recorder(1), -round(PREROLL / self.dt)
        self.advance(0.0, at_standstill.schedule.drive)

    def advance(self, time: float, asked: Callable[[Array], Drive]) -> None:
        """Step until the state at an instant is known, s.

        Args:
            time: s.
            asked: of the motors, at the times of the steps to come, s, (n,).

        Raises:
            TiltcalError: the run diverges.
        """
        self.servos.asked = lambda times: replace(asked(times), structure={})  # slips are beyond it
        last = int(np.ceil(time / self.dt)) + AHEAD
        with unprinted_warnings():
            while self.done < last:
                n = min(BLOCK, last - self.done)
                times = self.dt * np.arange(self.done, self.done + n, dtype=float)
                self.recorder.add(times, *stepped(self.scenario, self.servos, times), self.dt)
                self.done += n

    def halt(self) -> dict[str, float]:
        """Stop at the last valid state: the angle of each motor there, rad."""
        data = self.servos.data
        assert self.recorder.carry is not None
        data.qpos[:] = self.recorder.carry[1][-1]
        data.qvel[:], data.qacc_warmstart[:] = 0.0, 0.0
        self.recorder.carry = None
        return {name: float(data.qpos[self.columns[name]]) for name in self.servos.names}

    def observed(self, asked: Drive) -> Drive:
        """What encoders and structure do at the times of ``asked``, none of them beyond what was
        stepped; rows that are past are forgotten.
        """
        log = self.recorder.log()
        states = log.joints(asked.time)
        first = max(int(np.searchsorted(log.time, asked.time[-1])) - 1, 0)
        kept = Log(log.time[first:], log.x[first:], log.v[first:], log.a[first:])
        self.recorder.parts = [(kept.time, kept.x, kept.v, kept.a)]
        return observed(self.scenario, asked, states, self.columns, self.realised)

    def remount(self, mount: str) -> None:
        """The operator remounts the instrument; the mount's springs start from where they were."""
        mechanisms = mechanisms_of(self.scenario, self.effects)
        found = resolved(self.scenario, self.effects, mechanisms)
        rig = build(self.scenario, self.effects, found, mount)
        self.servos.rig.model.body("mount").quat = rig.model.body("mount").quat
