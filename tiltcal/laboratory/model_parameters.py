"""Effects of a scenario as parameters of MuJoCo's system identification, and its result as effects.

The file is the one that ``mujoco.sysid.ParameterDict`` saves and loads: a table of name, value,
bounds and whether it is frozen. Values are SI: rad, m/s2, rad/(N m).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import require_document
from tiltcal.core.optional_library import library
from tiltcal.effects.base import Effect, FrameEffect
from tiltcal.effects.file_values import number_of
from tiltcal.effects.parameter import by_name
from tiltcal.laboratory.own_model import why_not
from tiltcal.laboratory.scenario import Scenario

BEYOND = 100.0  # bounds over the largest plausible size, and over the value


@dataclass(frozen=True)
class ModelParameter:
    """A number of an effect as an optimiser sees it.

    Args:
        name: the effect's address and its parameter name, ``joint_axis_tilt[elbow].tilt_x``.
        effect: number of the effect in the scenario.
        key: parameter name.
        value: SI.
        low, high: between which it is searched.
        frozen: known physics, and what gives a shape and no size.
    """

    name: str
    effect: int
    key: str
    value: float
    low: float
    high: float
    frozen: bool

    def to_file(self) -> dict[str, Any]:
        """As ``mujoco.sysid`` writes a parameter."""
        return {
            "name": self.name,
            "nominal": [self.value],
            "min_value": [self.low],
            "max_value": [self.high],
            "value": [self.value],
            "frozen": self.frozen,
        }


def model_parameters(scenario: Scenario) -> tuple[list[ModelParameter], dict[str, str]]:
    """The numbers of a scenario's effects, and why each effect that has none is left out, by its
    address.
    """
    found: list[ModelParameter] = []
    left: dict[str, str] = {}
    taken: set[str] = set()
    for number, effect in enumerate(scenario.effects):
        if (reason := why_not(effect, scenario)) is not None:
            left[effect.address] = reason
            continue
        address, copies = effect.address, 1
        while address in taken:  # known physics and its found change are two effects
            copies += 1
            address = f"{effect.address}#{copies}"
        taken.add(address)
        found += _numbers(effect, number, address, scenario)
    return found, left


def _numbers(effect: Effect, number: int, address: str, scenario: Scenario) -> list[ModelParameter]:
    """The numbers of one effect."""
    stated = by_name(effect.parameters)
    springs = isinstance(effect, FrameEffect) and bool(effect.compliances(scenario.rig))
    known = effect.role is None and not effect.fit
    found = []
    for key, value in effect.values.items():
        parameter = stated[key]
        reach = BEYOND * max(max(parameter.plausible) * parameter.factor, abs(value))
        low = 0.0 if value >= 0 and (springs or parameter.positive) else -reach
        frozen = known or parameter.is_shape
        found.append(ModelParameter(f"{address}.{key}", number, key, value, low, reach, frozen))
    return found


def parameter_file(parameters: Sequence[ModelParameter]) -> str:
    """The file that ``mujoco.sysid.ParameterDict.load_from_disk`` reads.

    Raises:
        TiltcalError: the library that writes it is not installed.
    """
    yaml = library("yaml", "sysid", "a parameter file of mujoco.sysid")
    text: str = yaml.safe_dump({p.name: p.to_file() for p in parameters})
    return text


def read_values(path: Path) -> dict[str, float]:
    """The values of a parameter file, by name.

    Raises:
        TiltcalError: it is not one.
    """
    yaml = library("yaml", "sysid", "a parameter file of mujoco.sysid")
    try:
        table = yaml.safe_load(require_document(path, "parameters").read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise _not_one(path, str(error).splitlines()[0]) from error
    if not isinstance(table, dict) or not table:
        raise _not_one(path, "no table of parameters")
    return {str(name): _value(path, name, entry) for name, entry in table.items()}


def _value(path: Path, name: Any, entry: Any) -> float:
    value = entry.get("value") if isinstance(entry, dict) else None
    if not isinstance(value, list) or len(value) != 1:
        raise _not_one(path, f"{name}: no list of one value")
    return number_of(value[0], f"parameters {path.name}, {name}")


def _not_one(path: Path, found: str) -> TiltcalError:
    return TiltcalError(
        f"parameters {path.name}",
        found=found,
        need="a file that mujoco.sysid wrote: each name with value: [number]",
        do="save it with ParameterDict.save_to_disk",
    )


def with_values(scenario: Scenario, values: Mapping[str, float]) -> tuple[Effect, ...]:
    """The effects of a scenario at values that an optimiser has found.

    A value that has changed loses its standard uncertainty.

    Args:
        scenario: that the parameters were taken from.
        values: SI, by the name of the parameter; others stay as they are.

    Raises:
        TiltcalError: the scenario has no such parameter.
    """
    known = {p.name: p for p in model_parameters(scenario)[0]}
    effects = list(scenario.effects)
    for name, value in values.items():
        if name not in known:
            raise TiltcalError(
                "parameters",
                found=f"'{name}'",
                need=f"a parameter of the scenario '{scenario.name}'",
                do=nearest(name, list(known) or ["it has none"]),
            )
        parameter, effect = known[name], effects[known[name].effect]
        if value != parameter.value:
            effects[parameter.effect] = replace(
                effect,
                values={**effect.values, parameter.key: value},
                sigmas={k: s for k, s in effect.sigmas.items() if k != parameter.key},
            )
    return tuple(effects)
