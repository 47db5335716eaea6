"""The third harmonic of a bearing's wobble."""

from collections.abc import Sequence

from tiltcal.effects.base import FrameEffect
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Parameter
from tiltcal.setup.tables import bearing


class ThirdHarmonicWobble(FrameEffect):
    id = "table_wobble_third"
    stage = "table"
    title = "three-lobed tilt of the rotation axis"
    parameters = (
        Parameter("cos", "arcsec", (1, 10, 100)),
        Parameter("sin", "arcsec", (1, 10, 100)),
    )
    axis_wise = True
    physics = "A bearing race with three lobes tilts the axis three times a turn."
    equation = "rotation vector (c + i s) exp(3 i a) of the stator's frame, along the next two axes"
    source = "bearing inspection of this laboratory"
    excited_by = "a full turn"
    look = "on a vertical axis the sensor sees order 2"
    linear = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        axis = self.axis or context.rig.axis_names[0]
        if slot != bearing(axis):
            return ()
        angle, c, s = context.axes[axis], self.value("cos"), self.value("sin")
        i = "xyz".index(dict(context.rig.axes)[axis])
        first, second = "xyz"[(i + 1) % 3], "xyz"[(i + 2) % 3]
        return Turn(first, angle.harmonic(3, c, -s)), Turn(second, angle.harmonic(3, s, c))
