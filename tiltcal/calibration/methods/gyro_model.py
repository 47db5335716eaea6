"""The model of a gyro triad: ``reading = b + (I + S + C) w + G f``, and its static readings."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.methods.common import whitening_of_means
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG_H, EARTH_RATE, G0
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import Fit

TERMS = ("bias", "scale", "cross_axis", "gsens")
EARTH = "earth."
"""Begins the names of the components of the Earth's rate, which are fitted beside the terms."""
FORCE = "force."
"""Begins the names of cross-axis terms of the accelerometer that its norm does not determine."""
PRIOR = (EARTH, FORCE)
"""Parameters in units of their prior, which are not kept."""
SHEARS = ("xy", "xz", "yz")


def parameter_names(name: str, terms: Sequence[str]) -> list[str]:
    """Names of the parameters of some terms, in the order of the vector that is fitted."""
    found = {
        "bias": [f"{name}.bias_{a}" for a in AXES],
        "scale": [f"{name}.scale_{a}" for a in AXES],
        "cross_axis": [f"{name}.cross_{a}{b}" for a in AXES for b in AXES if a != b],
        "gsens": [f"{name}.gsens_{a}{b}" for a in AXES for b in AXES],
    }
    return [n for t in TERMS if t in terms or t == "bias" for n in found[t]]


@dataclass(frozen=True)
class EarthRate:
    """The Earth's rate in the body, as far as attitude and latitude give it.

    Args:
        known: rad/s, (..., 3).
        columns: of what is fitted, each at its prior size, rad/s, (..., 3, q).
    """

    known: Array
    columns: Array

    @classmethod
    def none(cls, *shape: int) -> "EarthRate":
        """No rate. shape: of the rows."""
        return cls(np.zeros((*shape, 3)), np.zeros((*shape, 3, 0)))

    @property
    def names(self) -> list[str]:
        """Of the fitted components."""
        return [f"{EARTH}{k}" for k in range(self.columns.shape[-1])]

    def rate(self, components: Array) -> Array:
        """With these components, (q,), in units of their priors: rad/s, (..., 3)."""
        return np.asarray(self.known + self.columns @ components)

    def subset(self, mask: Mask) -> "EarthRate":
        """Some of the rows. mask: (m,)."""
        return EarthRate(self.known[mask], self.columns[mask])


def earth_in_body(attitude: Array, latitude: float | None) -> EarthRate:
    """The Earth's rate under an attitude whose heading is counted from an unknown direction.

    With a latitude the part along up is known and two horizontal components are fitted, without one
    all three.

    Args:
        attitude: body components of two horizontal directions and of up, (..., 3, 3).
        latitude: rad; None: not known.
    """
    level, up = attitude[..., :2], attitude[..., 2]
    if latitude is None:
        return EarthRate(np.zeros_like(up), EARTH_RATE * attitude)
    known = EARTH_RATE * np.sin(latitude) * up
    return EarthRate(known, EARTH_RATE * np.cos(latitude) * level)


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
        self.earth = np.array(
            [v for n, v in zip(names, values, strict=True) if n.startswith(EARTH)]
        )
        self.shear = np.zeros((3, 3))
        for name, value in zip(names, values, strict=True):
            if name.startswith(FORCE):
                i, j = (AXES.index(a) for a in name.removeprefix(FORCE))
                self.shear[i, j] = self.shear[j, i] = value
            if name.startswith(PRIOR):
                continue
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

    def directions(self, up: Array, size: float) -> Array:
        """Directions of gravity, (m, 3), without cross-axis terms of the accelerometer. size: of
        the prior of these terms.
        """
        turned = up - size * up @ self.shear
        return np.asarray(turned / np.linalg.norm(turned, axis=1)[:, None])


class StaticRates:
    """Readings at rest with their whitening: bias and g-sensitivity have to explain them.

    Args:
        rests: of the gyro, (m,).
        force: specific force at each rest, m/s2, (m, 3).
        earth: the Earth's rate at each, (m,).
    """

    def __init__(self, rests: Poses, force: Array, earth: EarthRate) -> None:
        self.means, self.force, self.earth = rests.means, force / G0, earth
        self.whiten = whitening_of_means(rests)

    def moved(self, errors: Array) -> "StaticRates":
        """With these errors added to the means, rad/s, (m, 3)."""
        other = copy(self)
        other.means = self.means + errors
        return other

    def residual(self, model: GyroModel) -> Array:
        """Whitened, (3 m,)."""
        turning = self.earth.rate(model.earth) @ model.M.T
        error = self.means - model.bias - self.force @ model.G.T - turning
        return np.einsum("mij,mj->mi", self.whiten, error).ravel()
