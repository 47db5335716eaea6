"""An instrument on a Gymnasium environment, single or vectorised."""

from collections.abc import Callable
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.instrument.sources import (
    ModelSensor,
    Source,
    place,
    put,
    require_sources,
    taken,
    triad,
)
from tiltcal.laboratory.scenario import Scenario

Observe = Callable[[Any, dict[str, Array]], Any]
"""(observation, SI readings by sensor name) -> the observation that the policy gets."""


class Fitting:
    """An instrument and the places where it takes its inputs and leaves its readings.

    Args:
        env: single or vectorised; instrument: what reads.
        sources: where ``force`` and ``rate`` are found.
        observe: what becomes of the observation; None: the readings of the first accelerometer and
            the first gyro take the places of force and rate, where these are in the observation.
    """

    def __init__(
        self,
        env: Any,
        instrument: Instrument,
        sources: dict[str, Source | None],
        observe: Observe | None,
    ) -> None:
        require_sources(instrument.scenario, sources)
        self.env, self.instrument, self.observe = env, instrument, observe
        many = isinstance(env, VectorEnv)
        space = env.single_observation_space if many else env.observation_space
        is_dict = isinstance(space, gymnasium.spaces.Dict)
        self.places = {n: place(s, is_dict) for n, s in sources.items() if s is not None}
        self.inputs = {n: self._input(n, s) for n, s in sources.items() if s is not None}
        kinds = {"force": "accelerometer", "rate": "gyro"}
        self.pairs = [
            (where, sensors[0])
            for name, where in self.places.items()
            if where is not None and (sensors := instrument.scenario.sensors(kinds[name]))
        ]

    def _input(self, name: str, source: Source) -> Callable[[Any], Array]:
        where = self.places[name]
        if where is not None:
            return lambda observation: triad(taken(observation, where), name)
        if callable(source):
            return lambda observation: triad(source(observation), name)
        bodies = getattr(self.env, "envs", [self.env])
        if not all(hasattr(body.unwrapped, "model") for body in bodies):
            raise TiltcalError(
                f"`{name}`",
                found=f"'{source}', and an environment without a MuJoCo model at hand",
                need="a place in the observation, or a function of it",
                do="give a slice or a function",
            )
        sensors = [(b.unwrapped, ModelSensor(b.unwrapped.model, str(source))) for b in bodies]
        return lambda _: triad(np.array([s(b.data.sensordata) for b, s in sensors]), name)

    def read(self, observation: Any) -> tuple[Any, dict[str, Array]]:
        """The observation that the policy gets, and all readings. The readings are (k,) each,
        SI.
        """
        inputs = {name: take(observation) for name, take in self.inputs.items()}
        found = self.instrument.step(inputs.get("force"), inputs.get("rate"))
        single = not isinstance(self.env, VectorEnv)
        readings = {name: r[0] if single else r for name, r in found.items()}
        if self.observe is not None:
            return self.observe(observation, readings), readings
        for where, sensor in self.pairs:
            values = np.array(taken(observation, where))
            values[..., list(sensor.axis_indices)] = readings[sensor.name]
            observation = put(observation, where, values)
        return observation, readings


class InstrumentedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A Gymnasium environment whose observations come from an instrument; all readings stand in
    ``info["readings"]``, SI, (k,). ``reset(seed=...)`` seeds the instrument as well.
    """

    def __init__(self, env: Any, fitting: Fitting) -> None:
        super().__init__(env)
        self.fitting = fitting

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """A new episode: the instrument is switched on."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.fitting.instrument.reset(seed=seed)
        observation, readings = self.fitting.read(observation)
        return observation, {**info, "readings": readings}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One step of the environment, and one sample."""
        observation, reward, over, cut, info = self.env.step(action)
        observation, readings = self.fitting.read(observation)
        return observation, reward, over, cut, {**info, "readings": readings}


class InstrumentedVectorEnv(VectorWrapper[Any, Any, Any, Any, Any]):
    """The same for environments that are stepped together; readings are (envs, k)."""

    def __init__(self, env: Any, fitting: Fitting) -> None:
        super().__init__(env)
        self.fitting = fitting
        self.mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self.over = np.zeros(env.num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """New episodes; of some environments with the option ``reset_mask``."""
        observation, info = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        self.fitting.instrument.reset(mask, seed=seed)
        self.over[:] = False
        observation, readings = self.fitting.read(observation)
        return observation, {**info, "readings": readings}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step, and one sample of each; an episode that begins anew switches its instrument
        on.
        """
        observation, reward, over, cut, info = self.env.step(actions)
        ended = np.logical_or(over, cut)
        if self.mode == AutoresetMode.SAME_STEP:
            self._begin(ended)
        elif self.mode == AutoresetMode.NEXT_STEP:
            self._begin(self.over)
        self.over = ended
        observation, readings = self.fitting.read(observation)
        return observation, reward, over, cut, {**info, "readings": readings}

    def _begin(self, rows: Any) -> None:
        if rows.any():
            self.fitting.instrument.reset(rows)


def step_of(env: Any, step_s: float | None) -> float:
    """The time step of an environment, s.

    Raises:
        TiltcalError: it does not say, and none is given.
    """
    known = getattr(getattr(env, "envs", [env])[0].unwrapped, "dt", None)
    if step_s is not None:
        return step_s
    if known is None:
        raise TiltcalError(
            f"environment {type(env.unwrapped).__name__}",
            found="no time step `dt`",
            need="the time between two observations",
            do="give step_s",
        )
    return float(known)


def fitted(
    env: Any,
    scenario: Scenario,
    sources: dict[str, Source | None],
    observe: Observe | None,
    step_s: float | None,
    seed: int | None,
    lost: Literal["hold", "nan"],
) -> InstrumentedEnv | InstrumentedVectorEnv:
    """``wrap`` for environments."""
    many = isinstance(env, VectorEnv)
    envs = env.num_envs if many else 1
    instrument = Instrument(scenario, step_of(env, step_s), envs=envs, seed=seed, lost=lost)
    fitting = Fitting(env, instrument, sources, observe)
    return InstrumentedVectorEnv(env, fitting) if many else InstrumentedEnv(env, fitting)
