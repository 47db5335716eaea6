"""A calibration method that costs nothing: errors drawn from a stated covariance, as rows of runs.

The tilt error is the quadratic form that the covariance of six faces gives it, so that its degrees
of freedom are those of a real method.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.core.frames import sphere
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.validation.accuracy import estimated_up, tilt_error
from tiltcal.validation.runs import ParameterRow, Row

AXES = "xyz"
NAMES = (
    *(f"accel.bias_{a}" for a in AXES),
    *(f"accel.scale_{a}" for a in AXES),
    *(f"accel.cross_{a}{b}" for a in AXES for b in AXES if a != b),
)
G = 9.80123
SIGMA = np.array([3e-5] * 3 + [4e-6] * 3 + [7e-6] * 6)


def scenario(**accept: object) -> Scenario:
    """Twelve adjustable parameters, twenty runs, and these limits."""
    return parse_scenario(
        {
            "schema": 1,
            "name": "fake",
            "site": {"gravity_m_s2": G, "latitude_deg": 39.9},
            "rig": {"table": "dual"},
            "sensor": [
                {
                    "name": "accel",
                    "kind": "accelerometer",
                    "rate_hz": 50,
                    "adjustable": ["bias", "scale", "cross_axis"],
                }
            ],
            "effect": [{"id": "acc_bias", "bias_x_ug": 3000, "bias_z_ug": -900}],
            "method": [{"name": "six_position", "runs": 20, "accept": accept}],
        }
    )


@dataclass(frozen=True)
class Geometry:
    """What errors of the parameters do to the tilt.

    Args:
        factor: L of the covariance L L', (12, 12); tilt: square root of the quadratic form of the
            mean square tilt, (k, 12).
        bound: rad; dof: of the squared tilt; before: rad.
    """

    factor: np.ndarray
    tilt: np.ndarray
    bound: float
    dof: float
    before: float


@cache
def geometry() -> Geometry:
    """Parameters that depend on each other: scale with bias, cross-axis terms in pairs."""
    R = np.eye(12)
    for i in range(3):
        R[i, 3 + i] = R[3 + i, i] = 0.3
    for i in range(6, 11):
        R[i, i + 1] = R[i + 1, i] = 0.2
    C = R * np.outer(SIGMA, SIGMA)
    estimates = {n: Estimate(0.0, s, "1") for n, s in zip(NAMES, SIGMA, strict=True)}
    found = Calibration("six_position", "good", estimates, C)
    setup = scenario()
    error = tilt_error(setup, setup.effects, found)
    up = sphere(400)
    columns = []
    for name in NAMES:
        step = 1e-7
        moved = replace(found, parameters=estimates | {name: Estimate(step, 0.0, "1")})
        shifted = estimated_up(moved.correct(setup.sensor[0], up * G, G), G)
        columns.append((shifted - up).ravel() / step / np.sqrt(len(up)))
    D = np.array(columns).T
    tilt = np.linalg.cholesky(D.T @ D + 1e-18 * np.eye(12)).T
    return Geometry(np.linalg.cholesky(C), tilt, error.bound, error.dof, error.before)


def drawn(rng: np.random.Generator, runs: int = 20) -> np.ndarray:
    """Errors of a correct method, (runs, 12)."""
    return rng.normal(size=(runs, 12)) @ geometry().factor.T


def rows_of(
    errors: np.ndarray, *, stated: float = 1.0, tests: int = 0, verdict: str = "good"
) -> list[Row]:
    """The rows of a method with these errors, (runs, 12), that states ``stated`` times the sigmas
    of a correct one.
    """
    g = geometry()
    nees = np.sum(np.linalg.solve(g.factor, errors.T) ** 2, axis=0) / stated**2
    after = np.linalg.norm(errors @ g.tilt.T, axis=1)
    sigma = (SIGMA * stated).tolist()
    return [
        Row(
            "fake",
            "fake",
            seed,
            verdict,
            tests,
            tuple(
                ParameterRow(n, "1", e, s, 0.0)
                for n, e, s in zip(NAMES, errors[seed].tolist(), sigma, strict=True)
            ),
            float(nees[seed]),
            12,
            g.before,
            float(after[seed]),
            g.bound * stated,
            g.dof,
        )
        for seed in range(len(errors))
    ]


def at_the_bound() -> dict[str, float]:
    """Every limit exactly at what a correct method is expected to reach."""
    g = geometry()
    return {
        "tilt_arcsec": g.bound / ARCSEC,
        "tilt_over_bound": 1.0,
        "better_by": g.before / g.bound,
    }
