"""The model of a gyro triad: ``reading = b + (I + S + C) w + G f``, and its static readings."""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.methods.common import whitening_of_means
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG_H, G0
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import Fit

TERMS = ("bias", "scale", "cross_axis", "gsens")


def parameter_names(name: str, terms: Sequence[str]) -> list[str]:
    """Names of the parameters of some terms, in the order of the vector that is fitted."""
    found = {
        "bias": [f"{name}.bias_{a}" for a in AXES],
        "scale": [f"{name}.scale_{a}" for a in AXES],
        "cross_axis": [f"{name}.cross_{a}{b}" for a in AXES for b in AXES if a != b],
        "gsens": [f"{name}.gsens_{a}{b}" for a in AXES for b in AXES],
    }
    return [n for t in TERMS if t in terms or t == "bias" for n in found[t]]


def unit_of(name: str) -> str:
    """Unit of a parameter in CAL.json."""
    if ".bias_" in name:
        return "rad_s"
    return "deg_h_g" if ".gsens_" in name else "1"


class GyroModel:
    """Bias (3,), sensitivity M (3, 3) and g-sensitivity G (3, 3), rad/s per g, of a fit or a
    parameter vector.
    """

    def __init__(self, fit: Fit | Array, names: Sequence[str]) -> None:
        values = [fit.value(n) for n in names] if isinstance(fit, Fit) else fit
        self.bias, self.M, self.G = np.zeros(3), np.eye(3), np.zeros((3, 3))
        for name, value in zip(names, values, strict=True):
            term, _, axes = name.split(".")[1].partition("_")
            i, j = AXES.index(axes[0]), AXES.index(axes[-1])
            if term == "bias":
                self.bias[i] = value
            elif term == "gsens":
                self.G[i, j] = value * DEG_H
            else:
                self.M[i, j] += value

    def rate(self, reading: Array, force: Array) -> Array:
        """True rate, rad/s, from readings and the force in g, (..., 3)."""
        return (reading - self.bias - force @ self.G.T) @ np.linalg.inv(self.M).T


class StaticRates:
    """Readings at rest with their whitening: bias and g-sensitivity have to explain them.

    Args:
        rests: of the gyro, (m,).
        force: specific force at each rest, m/s2, (m, 3).
    """

    def __init__(self, rests: Poses, force: Array) -> None:
        self.means, self.force = rests.means, force / G0
        self.whiten = whitening_of_means(rests)

    def residual(self, model: GyroModel) -> Array:
        """Whitened, (3 m,)."""
        error = self.means - model.bias - self.force @ model.G.T
        return np.einsum("mij,mj->mi", self.whiten, error).ravel()
