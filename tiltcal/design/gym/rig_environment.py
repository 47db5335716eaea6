"""The rig of a scenario, an own model included, as Gymnasium environments, one or many at once."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from tiltcal.design.gym.rigs import Rigs
from tiltcal.laboratory.scenario import Scenario


class RigEnvironment(gymnasium.Env[Any, Any]):
    """Turn the axes of a rig and read its instrument, one sample of the fastest sensor a step.

    The action is the demanded rate of each axis over the largest. The observation has the
    readout, rad within half a turn, or m, and the readings, SI. The reward is the nats that the
    sample brings on the terms that the sensors' ``adjustable`` lists name. ``info``: readout and
    readings without bounds, and the time elapsed. An episode is truncated when its time is used up.

    Args:
        scenario: a file, or a scenario.
        render_mode: None only.
        how: keyword arguments of ``Rigs``: noise, rate_deg_s, acceleration_deg_s2, limits_deg,
            duration_s; of axes that slide rate_mm_s, acceleration_mm_s2, limits_mm.
    """

    metadata = {"render_modes": []}

    def __init__(
        self, scenario: str | Path | Scenario, render_mode: str | None = None, **how: Any
    ) -> None:
        self.render_mode = render_mode
        self.rigs = Rigs(scenario, 1, **how)
        self.observation_space = self.rigs.observation_space()
        self.action_space = self.rigs.action_space()
        self._all = np.ones(1, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """At rest where the rig starts, and the first sample. seed: of the instrument."""
        super().reset(seed=seed)
        self.rigs.restart(self._all, seed)
        observation, info, _ = self.rigs.sample(~self._all)
        return _only(observation), _only(info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move for a step, then sample."""
        self.rigs.move(np.asarray(action, float)[None], self._all)
        observation, info, nats = self.rigs.sample(self._all)
        over = bool(self.rigs.over()[0])
        return _only(observation), float(nats[0]), False, over, _only(info)


class RigEnvironmentVector(VectorEnv[Any, Any, Any]):
    """``RigEnvironment`` times ``num_envs``, stepped together by array operations; an episode that
    is over begins again with the next step, whose action is not used. Environment k has the seed
    plus k.

    Args:
        scenario: a file, or a scenario.
        num_envs: how many.
        render_mode: None only.
        how: keyword arguments of ``Rigs``.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        render_mode: str | None = None,
        **how: Any,
    ) -> None:
        self.num_envs, self.render_mode = num_envs, render_mode
        self.rigs = Rigs(scenario, num_envs, **how)
        self.single_observation_space = self.rigs.observation_space()
        self.single_action_space = self.rigs.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """All begin again."""
        super().reset(seed=seed, options=options)
        self.rigs.restart(np.ones(self.num_envs, bool), seed)
        self._over = np.zeros(self.num_envs, bool)
        observation, info, _ = self.rigs.sample(self._over)
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """All move for a step and sample; those that were over begin again instead."""
        live = ~self._over
        if not live.all():
            self.rigs.restart(self._over)
        self.rigs.move(np.asarray(actions, float), live)
        observation, info, nats = self.rigs.sample(live)
        self._over = self.rigs.over()
        return observation, nats, np.zeros(self.num_envs, bool), self._over.copy(), info


def _only(values: dict[str, Any]) -> dict[str, Any]:
    """The values of the one rig that there is."""
    return {k: _only(v) if isinstance(v, dict) else v[0] for k, v in values.items()}
