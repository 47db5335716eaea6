"""``tc.wrap``: an instrument on a Gymnasium environment or on the sensors of a MuJoCo model."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.instrument.sources import ModelSensor, Source, require_sources, triad
from tiltcal.laboratory.scenario import Scenario


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
        force: specific force at the sensors, body frame, m/s2: a key of a dict observation, places
            (a slice or numbers) in a flat one, a function of the observation that returns (..., 3),
            or the name of a MuJoCo accelerometer.
        rate: angular rate against inertial space, body frame, rad/s: alike; of a MuJoCo gyro.
        observe: (observation, SI readings by sensor name) -> observation. Without it readings take
            the places of force and rate; they stand in ``info["readings"]`` in any case.
        step_s: between observations; None: the environment's ``dt``, the model's time step.
        envs: of an MjModel, states that are read together; an environment says it itself.
        seed: of the random effects; environment k has seed + k. None: without them and without
            quantisation.
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
    from tiltcal.laboratory.instrument.environments import fitted

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
        self.inputs = {
            name: ModelSensor(model, source) if isinstance(source, str) else source
            for name, source in sources.items()
            if source is not None
        }

    def reset(self, rows: Any = None, *, seed: int | None = None) -> None:
        """The power is switched on; rows: (envs,) bool, None: all."""
        self.instrument.reset(rows, seed=seed)

    def read(self, data: Any) -> dict[str, Array]:
        """The readings of this step, SI, (envs, k) by sensor name.

        Args:
            data: MjData, or the ``sensordata`` of several states, (envs, nsensordata).
        """
        values = np.asarray(getattr(data, "sensordata", data))
        found: dict[str, Array | None] = {"force": None, "rate": None}
        for name, source in self.inputs.items():
            taken = source(values) if callable(source) else values[..., source]
            found[name] = triad(taken, name)
        return self.instrument.step(found["force"], found["rate"])
