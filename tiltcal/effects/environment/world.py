"""Gravity, Earth's rotation and vibration of the base."""

from dataclasses import replace

import numpy as np

from tiltcal.effects.base import WorldEffect
from tiltcal.effects.mechanisms import Shake, World
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.spans import CoordinateRanges


class GravityMagnitude(WorldEffect):
    row_wise = True
    id = "gravity_magnitude"
    stage = "environment"
    title = "local gravity differs from the assumed"
    parameters = (Parameter("gravity_error", "ppm", (5, 100, 2700)),)
    physics = (
        "Gravity varies with latitude, height and geology; a textbook value in the scenario scales"
        " every reading."
    )
    equation = "g = g_stated (1 + e)"
    source = "WGS 84; Physics: Environment"
    excited_by = "any pose"
    look = "all scale factors shift alike; the norm is off by a constant"
    linear = True
    distinguished_by = {"acc_scale": "only knowledge of the local g from outside"}

    def world(self, world: World) -> World:
        return replace(world, gravity=world.gravity * (1 + self.value("gravity_error")))


class EarthRate(WorldEffect):
    row_wise = True
    id = "earth_rate"
    stage = "environment"
    title = "Earth's rotation left out of the gyro model"
    parameters = (Parameter("rate_error", "unitless", (1, 1, 1)),)
    physics = (
        "Gyros sense rotation against inertial space; the nominal model includes Earth's rate, this"
        " is a deviation from it."
    )
    equation = "w = w_table + (1 + e) R_bw W_e"
    source = "WGS 84; Physics: Environment"
    excited_by = "heading and attitude changes of a gyro"
    look = "cosine of heading on a horizontal gyro axis, constant on a vertical one"
    linear = True
    follows = "rate"

    def world(self, world: World) -> World:
        return replace(world, earth=world.earth * (1 + self.value("rate_error")))


class EarthCoriolis(WorldEffect):
    row_wise = True
    id = "earth_coriolis"
    needs = "motion"
    stage = "environment"
    title = "Coriolis acceleration of a moving lever arm"
    parameters = (Parameter("coriolis_error", "unitless", (1, 1, 1)),)
    physics = (
        "A sensor that moves on the rotating Earth senses 2 W x v; the nominal model includes it,"
        " this is a deviation."
    )
    equation = "f += e R_bw (2 W_e x v + W_e x (W_e x r))"
    source = "Titterton and Weston 2004; Physics: Environment"
    excited_by = "turning with a lever arm"
    look = "odd in the rate, up to 10 ug"
    linear = False

    def world(self, world: World) -> World:
        return replace(world, coriolis=world.coriolis * (1 + self.value("coriolis_error")))


class BaseVibration(WorldEffect):
    row_wise = True
    id = "base_vibration"
    needs = "any"
    stage = "environment"
    title = "lines and coloured vibration of the base"
    parameters = (
        *(Parameter(n, "ug", (30, 2000, 50000)) for n in ("ec", "es", "nc", "ns", "uc", "us")),
        Parameter("frequency", "hz", (60, 60, 60), positive=True, shape=True),
    )
    physics = (
        "Motors, pumps and traffic shake the pier; the acceleration is fixed in the world and turns"
        " with the pose."
    )
    equation = "a_base = (E, N, U) (c cos 2 pi f t + s sin 2 pi f t)"
    source = "Peterson 1993; Physics: Environment"
    excited_by = "any recording; a change of pose shows that it is fixed in the world"
    look = "a line in the spectrum, coherent over the axes"
    on_table = True
    superposes = True
    spectral_line = "time"
    leaves_nothing = True
    follows = "frequency"

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"frequency": f} for f in span.lines.shakes]

    def world(self, world: World) -> World:
        if self.is_identity:
            return world
        cos, sin = (np.array([self.value(d + part) for d in "enu"]) for part in "cs")
        return replace(world, shakes=(*world.shakes, Shake(cos, sin, self.value("frequency"))))
