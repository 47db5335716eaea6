"""Where the specific force and rate of a simulation are found: in an observation, by a function of
it, or in a MuJoCo sensor.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.laboratory.scenario import Scenario

Source = str | slice | Sequence[int] | Callable[[Any], Any]
"""A key of a dict observation or the name of a MuJoCo sensor; indices into a flat observation; or a
function of the observation.
"""

NEEDED = {"force": ("accelerometer", "inclinometer"), "rate": ("gyro", "fog")}


def require_sources(scenario: Scenario, sources: Mapping[str, Source | None]) -> None:
    """Refuse a scenario with a sensor whose input is not given.

    Raises:
        TiltcalError: naming the sensor.
    """
    for name, kinds in NEEDED.items():
        sensors = scenario.sensors(*kinds)
        if sensors and sources[name] is None:
            raise TiltcalError(
                f"sensor {sensors[0].name}",
                found=f"no `{name}` for it",
                need=f"where the simulation has the {name} that it senses",
                do=f"give {name} = a key, a slice, a function or the name of a MuJoCo sensor",
            )


def index_of(source: Source, observation_is_dict: bool) -> Any | None:
    """The key or the indices into an observation; None where the source is elsewhere."""
    if callable(source) or (isinstance(source, str) and not observation_is_dict):
        return None
    return source if isinstance(source, str | slice) else list(source)


def taken(observation: Any, where: Any) -> Array:
    """The values of an observation at a key or at indices, (..., 3)."""
    if isinstance(where, str):
        return np.asarray(observation[where], float)
    return np.asarray(observation, float)[..., where]


def put(observation: Any, where: Any, values: Array) -> Any:
    """A copy of the observation with other values at a key or at indices. values: (k,)."""
    if isinstance(where, str):
        kind = np.asarray(observation[where]).dtype
        return {**observation, where: values.astype(kind)}
    changed = np.array(observation)
    changed[..., where] = values
    return changed


def triad(values: Any, name: str) -> Array:
    """An input as (..., 3).

    Raises:
        TiltcalError: it has another shape.
    """
    found = np.asarray(values, float)
    if found.shape[-1:] != (3,):
        raise TiltcalError(
            f"`{name}`",
            found=f"an array of shape {found.shape}",
            need="x, y and z in the body frame on the last axis",
            do="give three indices, or a function that returns (..., 3)",
        )
    return found


class ModelSensor:
    """A sensor of a MuJoCo model: where it stands in ``sensordata``.

    Args:
        model: MjModel.
        name: of the sensor.

    Raises:
        TiltcalError: there is none of that name.
    """

    def __init__(self, model: Any, name: str) -> None:
        names = [model.sensor(i).name for i in range(model.nsensor)]
        if name not in names:
            raise TiltcalError(
                "MuJoCo model",
                found=f"no sensor '{name}'",
                need="the name of an accelerometer or gyro",
                do=nearest(name, names) if names else "add it to the model",
            )
        first = int(model.sensor_adr[names.index(name)])
        self.where = slice(first, first + int(model.sensor_dim[names.index(name)]))

    def __call__(self, sensordata: Any) -> Array:
        """Its values, (..., 3)."""
        return np.asarray(sensordata, float)[..., self.where]
