"""The ground: slow tilt of the floor, gusts, and the Earth's magnetic field."""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import FrameEffect, TermEffect
from tiltcal.effects.hysteresis_and_lag import recursion
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.sense import Sense
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.effects.traits import Family
from tiltcal.setup.trajectory import Jet, sampled_jet


def base_tilt_turns(slot: str, east: Jet, north: Jet) -> Sequence[Turn]:
    """A tilt of the base about East, then North, at the slot ``base``."""
    return (Turn("x", east), Turn("y", north)) if slot == "base" else ()


class FloorTiltDrift(FrameEffect):
    id = "floor_tilt_drift"
    needs = "time"
    stage = "environment"
    title = "the pier or floor tilts slowly or in steps"
    parameters = (
        Parameter("tilt_east", "arcsec", (10, 50, 200)),
        Parameter("tilt_north", "arcsec", (10, 50, 200)),
        Parameter("span", "s", (3600, 3600, 3600), positive=True, shape=True),
    )
    physics = (
        "Sun, load and water table tilt a building; the vector stays in the world while the table"
        " turns."
    )
    equation = (
        "R_base gains Rx(east x(t)) Ry(north x(t)), x = 0..1 over the recording, or over span_s and"
        " then held"
    )
    source = "Agnew 1986; Physics: Environment"
    excited_by = "time, in several headings"
    look = "a ramp of both channels that turns with the table's heading"
    linear = True
    on_table = True
    form = "any"
    family = Family(tilt=(("base", "time"),))

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        return [{"span": span.duration}]

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        elapsed = context.drive.elapsed
        span = self.value("span") or max(float(elapsed[-1]), 1e-12)
        inside = elapsed <= span
        ramp = Jet(np.minimum(elapsed / span, 1.0), inside / span, np.zeros_like(elapsed))
        return base_tilt_turns(
            slot, ramp.scaled(self.value("tilt_east")), ramp.scaled(self.value("tilt_north"))
        )


class WindGust(FrameEffect):
    id = "wind_gust"
    needs = "time"
    stage = "environment"
    title = "gusts tilt a compliant base"
    parameters = (
        Parameter("tilt_east", "arcsec", (1, 20, 100), positive=True),
        Parameter("tilt_north", "arcsec", (1, 20, 100), positive=True),
        Parameter("tau", "s", (5, 5, 20), positive=True, default=5.0),
    )
    physics = "Wind pressure on a mast bends it; gusts come and go within seconds."
    equation = "tilt = C q(t), q a first-order process of unit variance with time constant tau"
    source = "Gelb 1974; Physics: Environment"
    excited_by = "time"
    look = "slow coherent wander of both channels, 0.05-1 Hz, fixed in the world"
    random = True
    on_table = True

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        if slot != "base" or context.rng is None:
            return ()
        time = context.drive.time
        decay = np.exp(-np.diff(time) / self.value("tau"))
        jets = []
        for name in ("tilt_east", "tilt_north"):
            drive = context.rng.standard_normal(len(time))
            drive[1:] *= np.sqrt(1 - decay**2)
            jets.append(sampled_jet(time, self.value(name) * recursion(decay, drive)))
        return base_tilt_turns(slot, jets[0], jets[1])


class MagneticField(TermEffect):
    id = "magnetic_field"
    stage = "environment"
    kinds = frozenset({"fog"})
    order = 15
    title = "bias that follows the Earth's field"
    parameters = tuple(Parameter(f"bias_{d}", "deg_h", (0.1, 2, 5)) for d in "enu")
    physics = (
        "The Faraday effect in the coil makes a bias proportional to the field along the input"
        " axis."
    )
    equation = "FOG rate += b . a, b fixed in the world"
    source = "Lefevre 2014; Physics: Environment"
    excited_by = "heading and attitude changes of the FOG"
    look = "cosine of heading, as the Earth's rate, but towards magnetic north"
    linear = True
    follows = "tilt"

    def term(self, name: str, sense: Sense) -> tuple[int, Array]:
        east = np.cross(sense.north, sense.up)
        direction = {"e": east, "n": sense.north, "u": sense.up}[name[-1]]
        return 0, np.asarray(direction @ sense.input_vector)
