"""The sensor off the rotation axes."""

from dataclasses import replace

import numpy as np

from tiltcal.effects.base import WorldEffect
from tiltcal.effects.mechanisms import World
from tiltcal.effects.parameter import Parameter


class LeverArm(WorldEffect):
    row_wise = True
    id = "lever_arm"
    needs = "motion"
    stage = "mount"
    title = "sensor is off the rotation axes"
    parameters = tuple(Parameter(f"lever_{a}", "mm", (5, 50, 100)) for a in "xyz")
    physics = (
        "Off the axes a turning sensor feels centripetal and tangential acceleration, beyond"
        " lever_arm_m."
    )
    equation = "f += dw x r + w x (w x r)"
    source = "Titterton and Weston 2004; Physics: Mount"
    excited_by = "turning"
    look = "even in the rate (w^2) and proportional to the angular acceleration; zero at rest"
    linear = True

    def world(self, world: World) -> World:
        return replace(
            world, lever=world.lever + np.array([self.value(f"lever_{a}") for a in "xyz"])
        )
