"""The fitted matrix of a sensor."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import Effect
from tiltcal.laboratory.scenario import Scenario


def sensor_matrix(name: str, scenario: Scenario, effects: Sequence[Effect]) -> Array:
    """Reading per unit of force or rate in the body frame, (k, 3): scale and cross-axis terms of
    these effects.
    """
    sensor = scenario.named(name)
    matrix = np.eye(3)[list(sensor.axis_indices)]
    for effect in effects:
        if effect.sensor == name and effect.role == "calibration":
            for parameter, value in effect.values.items():
                word, _, axes = parameter.rpartition("_")
                if word == "scale":
                    matrix[sensor.axes.index(axes), "xyz".index(axes)] += value
                elif word == "cross":
                    matrix[sensor.axes.index(axes[0]), "xyz".index(axes[1])] += value
    return matrix
