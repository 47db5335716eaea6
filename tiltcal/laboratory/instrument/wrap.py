"""``tc.wrap``: an instrument on a Gymnasium environment, single or vectorised, or on the sensors of
a MuJoCo model.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.instrument.sources import (
    SENSED_BY,
    Clock,
    ModelSensor,
    Source,
    index_of,
    put,
    require_sources,
    taken,
    triad,
)
from tiltcal.laboratory.scenario import Scenario

Observe = Callable[[Any, dict[str, Array]], Any]
"""(observation, SI readings by sensor name) -> the observation that the policy gets."""


class Fitting:
    """An instrument and the keys or indices of its inputs and of its readings in an observation.

    Args:
        env: single or vectorised.
        instrument: what reads.
        sources: where ``force`` and ``rate`` are found.
        observe: what becomes of the observation; None: the readings of the first accelerometer and
            the first gyro replace force and rate, where these are in the observation.
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
        self.indices = {n: index_of(s, is_dict) for n, s in sources.items() if s is not None}
        self.inputs = {n: self._input(n, s) for n, s in sources.items() if s is not None}
        self.clocks = [(body, Clock(instrument.step_s)) for body in simulated(env)]
        self.pairs = [
            (where, sensors[0])
            for name, where in self.indices.items()
            if where is not None and (sensors := instrument.scenario.sensors(SENSED_BY[name]))
        ]

    def _input(self, name: str, source: Source) -> Callable[[Any], Array]:
        where = self.indices[name]
        if where is not None:
            return lambda observation: triad(taken(observation, where), name)
        if callable(source):
            return lambda observation: triad(source(observation), name)
        bodies = simulated(self.env)
        if not bodies:
            raise TiltcalError(
                f"`{name}`",
                found=f"'{source}', and an environment without a MuJoCo model in this process",
                need="an index into the observation, or a function of it",
                do="give a slice or a function; of environments in processes of their own, put"
                " force and rate into the observation",
            )
        sensors = [(b, ModelSensor(b.model, str(source), name)) for b in bodies]
        return lambda _: triad(np.array([s(b.data.sensordata) for b, s in sensors]), name)

    def begin(self, rows: Any = None, *, seed: int | None = None) -> None:
        """Episodes begin: the instrument is switched on. As ``Instrument.reset``."""
        self.instrument.reset(rows, seed=seed)
        for k, (_, clock) in enumerate(self.clocks):
            if rows is None or rows[k]:
                clock.restart()

    def read(self, observation: Any) -> tuple[Any, dict[str, Array]]:
        """The observation that the policy gets, and all readings. The readings are (k,) each,
        SI.
        """
        for body, clock in self.clocks:
            clock.tick(float(body.data.time))
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
        self.fitting.begin(seed=seed)
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
        self.fitting.begin(mask, seed=seed)
        self.over[:] = False
        observation, readings = self.fitting.read(observation)
        return observation, {**info, "readings": readings}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One step, and one sample of each; an episode that begins again switches its instrument
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
            self.fitting.begin(rows)


def simulated(env: Any) -> list[Any]:
    """The environments of this process that simulate with MuJoCo: all of them, or none."""
    bodies = [body.unwrapped for body in getattr(env, "envs", [env])]
    return bodies if all(hasattr(b, "model") and hasattr(b, "data") for b in bodies) else []


def step_of(env: Any, step_s: float | None) -> float:
    """The time step of an environment, s.

    Raises:
        TiltcalError: it does not say, and none is given.
    """
    if step_s is not None:
        return step_s
    with suppress(AttributeError):  # a vector environment may ask processes of their own
        steps = env.get_attr("dt") if hasattr(env, "get_attr") else [env.unwrapped.dt]
        if len(set(steps)) == 1:
            return float(steps[0])
    raise TiltcalError(
        f"environment {type(env.unwrapped).__name__}",
        found="no time step `dt`, or not the same of all",
        need="the time between two observations",
        do="give step_s",
    )


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


def wrap(
    target: Any,
    scenario: Scenario,
    *,
    force: Source | None = None,
    rate: Source | None = None,
    observe: Callable[[Any, dict[str, Array]], Any] | None = None,
    step_s: float | None = None,
    envs: int = 1,
    seed: int | None = 0,
    lost: Literal["hold", "nan"] = "hold",
) -> Any:
    """The chain of errors that a scenario states, on somebody's simulation, step by step.

    Args:
        target: a Gymnasium environment, a Gymnasium vector environment, or an MjModel.
        scenario: sensors and their effects.
        force: specific force at the sensors, body frame, m/s2: a key of a dict observation, indices
            (a slice or numbers) into a flat one, a function of the observation that returns (...,
            3), or the name of a MuJoCo accelerometer.
        rate: angular rate against inertial space, body frame, rad/s: alike; of a MuJoCo gyro.
        observe: (observation, SI readings by sensor name) -> observation. Without it readings
            replace force and rate; they stand in ``info["readings"]`` in any case.
        step_s: between observations; None: the environment's ``dt``, the model's time step.
        envs: of an MjModel, states that are read together; an environment states it itself.
        seed: of the random effects; environment k has seed + k. None: without them and without
            quantisation, and a warning that names what is left out.
        lost: what stands for a lost sample: the last one, or NaN.

    Returns:
        A Gymnasium environment, or a ``ModelInstrument``.

    Raises:
        TiltcalError: an effect cannot act step by step, or an input is missing.
    """
    sources = {"force": force, "rate": rate}
    if hasattr(target, "nsensordata"):
        return ModelInstrument(target, scenario, sources, step_s, envs, seed, lost)
    if not (hasattr(target, "reset") and hasattr(target, "observation_space")):
        raise TiltcalError(
            "target of wrap",
            found=type(target).__name__,
            need="a Gymnasium environment or an MjModel",
            do="for another simulation, call Instrument.step with force and rate",
        )
    return fitted(target, scenario, sources, observe, step_s, seed, lost)


class ModelInstrument:
    """An instrument on the sensors of a MuJoCo model.

    ``mj_step`` leaves the sensors of the state before the step: call ``mj_forward`` first where a
    reading has to belong to the present state.

    Args: as of ``wrap``.
    """

    def __init__(
        self,
        model: Any,
        scenario: Scenario,
        sources: dict[str, Source | None],
        step_s: float | None,
        envs: int,
        seed: int | None,
        lost: Literal["hold", "nan"],
    ) -> None:
        require_sources(scenario, sources)
        step = float(model.opt.timestep) if step_s is None else step_s
        self.instrument = Instrument(scenario, step, envs=envs, seed=seed, lost=lost)
        self.clock = Clock(step)
        self.inputs = {
            name: ModelSensor(model, source, name) if isinstance(source, str) else source
            for name, source in sources.items()
            if source is not None
        }

    def reset(self, rows: Any = None, *, seed: int | None = None) -> None:
        """The power is switched on; rows: (envs,) bool, None: all."""
        self.instrument.reset(rows, seed=seed)
        self.clock.restart()

    def read(self, data: Any) -> dict[str, Array]:
        """The readings of this step, SI, (envs, k) by sensor name.

        Args:
            data: MjData, or the ``sensordata`` of several states, (envs, nsensordata).

        Raises:
            TiltcalError: the MjData is not one step after the last.
        """
        if hasattr(data, "sensordata"):
            self.clock.tick(float(data.time))
        values = np.asarray(getattr(data, "sensordata", data))
        found: dict[str, Array | None] = {"force": None, "rate": None}
        for name, source in self.inputs.items():
            taken = source(values) if callable(source) else values[..., source]
            found[name] = triad(taken, name)
        return self.instrument.step(found["force"], found["rate"])
