"""Calibration as a Gymnasium environment: one, or many as a vector environment that array
operations step together.
"""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tiltcal.core.errors import TiltcalError
from tiltcal.design.gym.calibrations import Bench, Task
from tiltcal.design.gym.spaces import (
    DWELLS,
    action_space,
    menu,
    observation_space,
    observe,
    pose_of,
)


class Calibration(gymnasium.Env[Any, Any]):
    """Choose the next pose and dwell until the table time is used up.

    Reward: nats gained on the parameters of interest, 1/2 log det of their information, nuisances
    fitted; it telescopes, so the return is what the whole sequence is worth. ``info``: seconds
    spent, nats per second, whether the pose was refused because it would overrun (which ends the
    episode), and the time elapsed.

    Args:
        render_mode: None only.
        task: keywords of ``Task``: model, drift, budget_s, rate_deg_s, settle_s, shortest_s,
            longest_s, limits_deg.
    """

    metadata = {"render_modes": []}

    def __init__(self, render_mode: str | None = None, **task: Any) -> None:
        self.render_mode = render_mode
        self.task = self._asked = Task(**task)
        self.bench = Bench(self.task, 1)
        self.observation_space = observation_space(self.task)
        self.action_space: spaces.Space[Any] = action_space()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """The prior, axes at zero. options: ``budget_s`` for this episode."""
        super().reset(seed=seed)
        self.task = with_options(self._asked, options)
        self.bench = Bench(self.task, 1)
        return observe(self.bench)[0], {"elapsed_s": 0.0}

    def poses(self, action: Any) -> tuple[Any, Any]:
        """Angles and dwell of an action."""
        return pose_of(np.asarray(action)[None], self.task)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Go there, settle, read."""
        angles, dwell = self.poses(action)
        before = int(self.bench.steps[0])
        nats, over, spent = self.bench.step(angles, dwell, np.ones(1, dtype=bool))
        seconds = float(spent[0])
        info = {
            "spent_s": seconds,
            "nats_per_s": float(nats[0]) / seconds if seconds else 0.0,
            "refused": int(self.bench.steps[0]) == before,
            "elapsed_s": float(self.bench.elapsed[0]),
        }
        return observe(self.bench)[0], float(nats[0]), bool(over[0]), False, info


class CalibrationDiscrete(Calibration):
    """The same with a menu: 26 directions (faces, edges, corners) times three dwells; action = 3 *
    direction + dwell.
    """

    def __init__(self, render_mode: str | None = None, **task: Any) -> None:
        super().__init__(render_mode, **task)
        self.menu = menu(self.task)
        self.action_space = spaces.Discrete(len(self.menu) * len(DWELLS))

    def poses(self, action: Any) -> tuple[Any, Any]:
        """Angles and dwell of an action."""
        number = np.asarray(action).reshape(1)
        return self.menu[number // len(DWELLS)], np.array(DWELLS)[number % len(DWELLS)]


def with_options(task: Task, options: dict[str, Any] | None) -> Task:
    """The task of an episode.

    Raises:
        TiltcalError: an option that there is not.
    """
    unknown = set(options or {}) - {"budget_s"}
    if unknown:
        raise TiltcalError(
            "environment, reset options",
            found=", ".join(sorted(unknown)),
            need="budget_s",
            do="leave the others out",
        )
    return replace(task, budget_s=float(options["budget_s"])) if options else task


class CalibrationVector(VectorEnv[Any, Any, Any]):
    """``Calibration`` times ``num_envs``; an episode that is over begins again with the next step,
    whose action is not used.

    Args:
        num_envs: how many.
        render_mode: None only.
        task: keywords of ``Task``.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int = 1, render_mode: str | None = None, **task: Any) -> None:
        self.num_envs, self.render_mode = num_envs, render_mode
        self.task = self._asked = Task(**task)
        self.bench = Bench(self.task, num_envs)
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = self._single_action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.zeros(num_envs, dtype=bool)

    def _single_action_space(self) -> spaces.Space[Any]:
        return action_space()

    def poses(self, actions: Any) -> tuple[Any, Any]:
        """Angles and dwells of the actions."""
        return pose_of(np.asarray(actions), self.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """All begin again. options: ``budget_s``."""
        super().reset(seed=seed, options=options)
        self.task = with_options(self._asked, options)
        self.bench = Bench(self.task, self.num_envs)
        self._over = np.zeros(self.num_envs, dtype=bool)
        return observe(self.bench), {"elapsed_s": np.zeros(self.num_envs)}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """All go there, settle, read; those that were over begin again instead."""
        angles, dwell = self.poses(actions)
        live = ~self._over
        if not live.all():
            self.bench.restart(self._over)
        before = self.bench.steps
        nats, over, spent = self.bench.step(angles, dwell, live)
        info = {
            "spent_s": spent,
            "nats_per_s": np.divide(nats, spent, out=np.zeros_like(nats), where=spent > 0),
            "refused": live & (self.bench.steps == before),
            "elapsed_s": self.bench.elapsed.copy(),
        }
        self._over = over
        return observe(self.bench), nats, over.copy(), np.zeros(self.num_envs, dtype=bool), info


class CalibrationDiscreteVector(CalibrationVector):
    """``CalibrationDiscrete`` times ``num_envs``."""

    def _single_action_space(self) -> spaces.Space[Any]:
        self.menu = menu(self.task)
        return spaces.Discrete(len(self.menu) * len(DWELLS))

    def poses(self, actions: Any) -> tuple[Any, Any]:
        """Angles and dwells of the actions."""
        number = np.asarray(actions)
        return self.menu[number // len(DWELLS)], np.array(DWELLS)[number % len(DWELLS)]
