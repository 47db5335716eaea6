"""Variance over the Cramer-Rao bound with fresh seeds, through MuJoCo: the scenarios that state a tilt error."""

import secrets

import numpy as np

from tiltcal.accuracy import normalised_error, tilt_error, true_parameters
from tiltcal.assets import folder
from tiltcal.methods.registry import calibrate
from tiltcal.scenario import load_scenario

CASES = (
    "six_faces_dual",
    "tumble_three_axis",
    "norm_by_hand",
    "two_position_level",
    "two_position_steep",
    "placing_table_both_axes",
)
DRAWS = 40


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
            found = calibrate(str(method.name), laboratory.record(scenario, first + k), scenario, **method.options)
            value, n = normalised_error(found, true_parameters(scenario, scenario.effects, found))
            tilt = tilt_error(scenario, scenario.effects, found)
            nees, dof = nees + value, dof + n
            ratio.append((tilt.after / tilt.bound) ** 2)
        print(
            f"{name}: {DRAWS} fresh seeds from {first}: "
            f"NEES per parameter {nees / dof:.3f} (chance: 1 +- {2 * np.sqrt(2 / dof):.3f}), "
            f"rms tilt error over its bound {np.sqrt(np.mean(ratio)):.3f}"
        )
