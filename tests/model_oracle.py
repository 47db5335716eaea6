"""The best that a fit can do on a user's own model: `mujoco.sysid` given the right effect, free
beside calibration terms. Errors are those of prediction on a second recording without noise.
"""

import logging
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from model_rig import Mapped, poses_and_moves
from mujoco import sysid

from tiltcal.api.simulating import simulator
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltsim.sysid import Exchange

TERMS = {
    "bias": ("acc_bias", [f"bias_{a}_ug" for a in "xyz"]),
    "scale": ("acc_scale", [f"scale_{a}_ppm" for a in "xyz"]),
    "cross_axis": ("acc_cross_axis", [f"cross_{a}{b}_ppm" for a in "xyz" for b in "xyz" if a != b]),
}


def law(id: str, axis: str | None = None, **sizes: float) -> str:
    """An `[[effect]]` table with the sizes of its numbers."""
    where = [f'axis = "{axis}"'] if axis else []
    lines = [f'id = "{id}"', *where, 'role = "found"', *(f"{k} = {v}" for k, v in sizes.items())]
    return "\n".join(["[[effect]]", *lines, ""])


def recorded(axes: dict[str, Mapped], poses: int = 4, seed: int = 1) -> tuple[Recording, Any, Any]:
    """Moves between random poses, their stamps and their readouts with derivatives."""
    time, jets = poses_and_moves(np.random.default_rng(seed), list(axes), poses)
    columns = {f"accelerometer_{a}_m_s2": np.zeros(len(time)) for a in "xyz"}
    for axis, jet in jets.items():
        columns |= axes[axis].column(axis, jet[0])
    return Recording.from_columns(time, columns), time, jets


def forces_by_both(file: Path, model: Path, axes: dict[str, Mapped]) -> tuple[Any, Any, Any]:
    """Forces on the user's own model with the effects of a scenario built in, by the closed form,
    and without effects, (n, 3) each.
    """
    exchange = Exchange.of(file, model)
    recording, time, _ = recorded(axes)
    course = replay(recording, exchange.scenario)
    effects = exchange.effects(exchange.parameters)
    times = {"accelerometer": time}
    closed = readings(exchange.scenario, course, times, effects)["accelerometer"]
    own = readings(exchange.scenario, course, times, effects, mover=exchange._move)["accelerometer"]
    return own, closed, readings(exchange.scenario, course, times, ())["accelerometer"]


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
