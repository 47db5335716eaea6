"""Where the specific force and rate of a simulation are found: in an observation, by a function of
it, or in a MuJoCo sensor.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.laboratory.scenario import Scenario

Source = str | slice | Sequence[int] | Callable[[Any], Any]
"""A key of a dict observation or the name of a MuJoCo sensor; indices into a flat observation; or a
function of the observation.
"""

SENSED_BY = {"force": "accelerometer", "rate": "gyro"}
"""Kind of the MuJoCo sensor of each input."""
MEANING = {"force": "specific force, m/s2", "rate": "angular rate, rad/s"}
OFF_STEP = 1e-3
"""Of a step, by which the time between two readings may be off it. After a day of steps of 1 ms the
difference of two times is right to 1e-8 of a step; a step too many is off by a whole one.
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
        input: what it is to give, ``force`` or ``rate``.

    Raises:
        TiltcalError: there is none of that name, or it senses something else.
    """

    def __init__(self, model: Any, name: str, input: str) -> None:
        names = [model.sensor(i).name for i in range(model.nsensor)]
        kinds = [_kind_of(model, i) for i in range(model.nsensor)]
        able = [n for n, kind in zip(names, kinds, strict=True) if kind == SENSED_BY[input]]
        subject = f"MuJoCo model, `{input}`"
        add = f'add <{SENSED_BY[input]} name="..." site="..."/> to its <sensor> element'
        if name not in names:
            raise TiltcalError(
                subject,
                found=f"no sensor '{name}'",
                need=f"the name of {_an(SENSED_BY[input])}",
                do=nearest(name, able) if able else add,
            )
        number = names.index(name)
        if kinds[number] != SENSED_BY[input]:
            raise TiltcalError(
                subject,
                found=f"sensor '{name}', {_an(kinds[number])}, which senses something else",
                need=f"{_an(SENSED_BY[input])}: the {MEANING[input]}, in the frame of its site",
                do=f"give {' or '.join(able)}" if able else add,
            )
        first = int(model.sensor_adr[number])
        self.where = slice(first, first + int(model.sensor_dim[number]))

    def __call__(self, sensordata: Any) -> Array:
        """Its values, (..., 3)."""
        return np.asarray(sensordata, float)[..., self.where]


def _kind_of(model: Any, number: int) -> str:
    """The kind of a sensor as MJCF calls it, such as ``framelinacc``."""
    simulator = import_module(type(model).__module__.partition(".")[0])  # whose model it is
    kind = simulator.mjtSensor(int(model.sensor_type[number]))
    return str(kind.name).removeprefix("mjSENS_").lower()


def _an(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


class Clock:
    """Compares the time of a simulation with the step that an instrument was made for.

    Args:
        step_s: between two readings, s.
    """

    def __init__(self, step_s: float) -> None:
        self.step_s = step_s
        self._last: float | None = None

    def restart(self) -> None:
        """The next reading is the first."""
        self._last = None

    def tick(self, time: float) -> None:
        """A reading at a time of the simulation, s.

        Raises:
            TiltcalError: the time since the last reading is not the step.
        """
        last, self._last = self._last, time
        if last is None:
            return
        if abs(time - last - self.step_s) > OFF_STEP * self.step_s:
            again = ", or call reset() where the simulation begins again" if time < last else ""
            raise TiltcalError(
                "time of the simulation",
                found=f"{time - last:.6g} s since the last reading",
                need=f"{self.step_s:.6g} s, the step that the instrument was made for",
                do=f"read once a step, give step_s = the time between two readings{again}",
            )
