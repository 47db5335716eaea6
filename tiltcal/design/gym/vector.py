"""Many calibrations as one Gymnasium vector environment, stepped together by array operations."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tiltcal.design.gym.calibrations import Bench, Task
from tiltcal.design.gym.environment import with_options
from tiltcal.design.gym.spaces import (
    DWELLS,
    action_space,
    menu,
    observation_space,
    observe,
    pose_of,
)


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
        self.menu = menu()
        return spaces.Discrete(len(self.menu) * len(DWELLS))

    def poses(self, actions: Any) -> tuple[Any, Any]:
        """Angles and dwells of the actions."""
        number = np.asarray(actions)
        return self.menu[number // len(DWELLS)], np.array(DWELLS)[number % len(DWELLS)]
