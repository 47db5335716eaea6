"""The three accelerometers of a triad at different points."""

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import TermEffect
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense

# the x accelerometer is displaced along y, y along z, z along x
DISPLACED_ALONG = {"x": 1, "y": 2, "z": 0}


class TriadSizeEffect(TermEffect):
    id = "triad_size_effect"
    needs = "motion"
    stage = "mount"
    kinds = frozenset({"accelerometer"})
    order = 5
    title = "the three accelerometers sit at different points"
    parameters = (Parameter("offset_{axis}", "mm", (30, 10, 1)),)
    physics = (
        "Each accelerometer of a triad feels the centripetal and tangential acceleration at its own"
        " position."
    )
    equation = (
        "f_i at r_i: x displaced along y, y along z, z along x; f_i += (dw x r_i + w x (w x r_i))_i"
    )
    source = "Titterton and Weston 2004; Physics: Mount"
    excited_by = "turning"
    look = "a lever arm that differs between the axes"
    linear = True

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        axis = name[-1]
        i, r = "xyz".index(axis), np.zeros(3)
        r[DISPLACED_ALONG[axis]] = 1.0
        w = sense.rate
        sensed = np.cross(sense.angular_acceleration, r) + np.cross(w, np.cross(w, r))
        return self.channel_of(axis, sense), sensed[:, i]
