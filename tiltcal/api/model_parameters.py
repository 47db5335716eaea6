"""Round trip with MuJoCo's system identification: a scenario's effects as a file of parameters, and
such a file as the effects of a scenario.
"""

from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.conclusions.parts import amended_table
from tiltcal.laboratory.model_parameters import (
    model_parameters,
    parameter_file,
    read_values,
    with_values,
)
from tiltcal.laboratory.scenario import Scenario


def to_sysid(scenario: Scenario) -> tuple[str, dict[str, str]]:
    """The file that ``mujoco.sysid.ParameterDict.load_from_disk`` reads, and why each effect that
    is not in it was left out, by its address.

    Raises:
        TiltcalError: the scenario has no effect that a model can hold.
    """
    parameters, left_out = model_parameters(scenario)
    if not parameters:
        raise TiltcalError(
            f"scenario '{scenario.name}'",
            found=", ".join(f"{a}: {why}" for a, why in left_out.items()) or "no effects",
            need="an effect that a model can hold",
            do="export amended.toml of a diagnosis that found one",
        )
    return parameter_file(parameters), left_out


def from_sysid(scenario: Scenario, path: Path) -> dict[str, Any]:
    """The table of a scenario whose effects have the values of a parameter file.

    Args:
        scenario: that the parameters were exported from.
        path: as ``mujoco.sysid.ParameterDict.save_to_disk`` writes it.

    Raises:
        TiltcalError: it is no such file, or the scenario has no such parameter.
    """
    effects = with_values(scenario, read_values(path))
    findings = [table.finding for table in scenario.effect]
    numbers = findings + [None] * (len(effects) - len(findings))
    return amended_table(scenario, list(zip(effects, numbers, strict=True)), None)
