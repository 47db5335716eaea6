"""The best that a fit can do on a user's own model: `mujoco.sysid` given the right effect, free
beside calibration terms. Errors are those of prediction on a second recording without noise.
"""

import logging
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import sysid

from tiltcal.api.simulating import simulator
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltsim.sysid import Exchange

TERMS = {
    "bias": ("acc_bias", [f"bias_{a}_ug" for a in "xyz"]),
    "scale": ("acc_scale", [f"scale_{a}_ppm" for a in "xyz"]),
    "cross_axis": ("acc_cross_axis", [f"cross_{a}{b}_ppm" for a in "xyz" for b in "xyz" if a != b]),
}


def effect(id: str, *free: str, **where: str) -> str:
    """An `[[effect]]` table whose numbers are free and zero."""
    lines = [f'id = "{id}"', 'role = "found"', *(f'{k} = "{v}"' for k, v in where.items())]
    return "\n".join(["[[effect]]", *lines, *(f"{name} = 0" for name in free), ""])


def calibration(*terms: str) -> str:
    """The `[[effect]]` tables of calibration terms, free and zero."""
    return "".join(effect(TERMS[t][0], *TERMS[t][1]) for t in terms)


def fitted_error(file: Path, model: Path, recording: Recording, held_out: Recording) -> float:
    """What sysid leaves of a held-out recording, rms, m/s2, with the effects of a scenario free."""
    logging.getLogger("absl").setLevel(logging.ERROR)
    exchange = Exchange.of(file, model)
    residual = sysid.build_residual_fn(**exchange.problem(recording))
    start = exchange.parameters.move_off_bounds()
    with redirect_stdout(StringIO()):  # it prints every iteration
        found, _ = sysid.optimize(start, residual, "scipy", False, x_scale="jac", max_iters=40)
    other = sysid.build_residual_fn(**exchange.problem(held_out))
    _, predicted, measured = other(found.as_vector(), found, return_pred_all=True)
    return rms(predicted[0][0].data - measured[0][0].data)


def predicted_error(scenario: Scenario, amended: Any, held_out: Recording) -> float:
    """What an amended scenario's table leaves of a held-out recording, rms, m/s2."""
    predicted = simulator().predict(parse_scenario(amended), held_out, None)
    sensor = scenario.sensor[0]
    return rms((predicted.sensor(sensor).values - held_out.sensor(sensor).values)[1:])


def rms(left: Any) -> float:
    return float(np.sqrt(np.mean(left**2)))
