"""Variance over the Cramer-Rao bound with fresh seeds, through MuJoCo: the scenarios that state a
tilt error.
"""

import secrets

import numpy as np

from tests.benchmarks import sized
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import Calibration
from tiltcal.core.assets import folder
from tiltcal.laboratory.scenario import Scenario, load_scenario
from tiltcal.validation.accuracy import (
    TiltError,
    attitude_error,
    normalised_error,
    tilt_error,
    true_parameters,
)

CASES = (
    "six_faces_dual",
    "tumble_three_axis",
    "norm_by_hand",
    "two_position_level",
    "two_position_steep",
    "placing_table_both_axes",
    "north_four_positions",
    "gyro_rates_three",
)
DRAWS = sized(40, 2)


def _error(scenario: Scenario, found: Calibration) -> TiltError:
    gyro = (
        "base.roll" not in found.parameters
        and not scenario.named(found.sensors()[0]).is_accelerometer
    )
    return (attitude_error if gyro else tilt_error)(scenario, scenario.effects, found)


def main() -> None:
    """Mean NEES per parameter, and rms tilt error over what the covariance predicts."""
    from tiltsim.laboratory import MujocoLaboratory

    laboratory = MujocoLaboratory()
    for name in CASES:
        scenario = load_scenario(folder("scenarios") / f"{name}.toml")
        method = scenario.method[0]
        nees, dof, ratio = 0.0, 0, []
        first = secrets.randbelow(2**31)
        for k in range(DRAWS):
            found = calibrate(
                str(method.name), laboratory.record(scenario, first + k), scenario, **method.options
            )
            value, n = normalised_error(found, true_parameters(scenario, scenario.effects, found))
            tilt = _error(scenario, found)
            nees, dof = nees + value, dof + n
            ratio.append((tilt.after / tilt.bound) ** 2)
        print(
            f"{name}: {DRAWS} fresh seeds from {first}: "
            f"NEES per parameter {nees / dof:.3f} (chance: 1 +- {2 * np.sqrt(2 / dof):.3f}), "
            f"rms tilt error over its bound {np.sqrt(np.mean(ratio)):.3f}"
        )
