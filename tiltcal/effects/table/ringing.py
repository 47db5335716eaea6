"""Ringing of the structure after a move."""

from itertools import product

import numpy as np

from tiltcal.effects.base import AngleEffect
from tiltcal.effects.mechanisms import Mechanism, Ring
from tiltcal.effects.parameter import Parameter
from tiltcal.effects.spans import CoordinateRanges
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Drive, Jet, Standstills

EARLY = Parameter("early", "s", (0.1, 0.1, 0.1), shape=True)
"""How long before the end of a move, by the readout, a structure is let go."""
EIGHTHS = (-1 / 8, 1 / 8)
"""Of a period, by which ringing is looked for before and after: with either sign these are the four
quadrants of its phase.
"""


class SettlingTransient(AngleEffect):
    id = "settling_transient"
    needs = "motion"
    stage = "table"
    title = "ringing after a move"
    parameters = (
        Parameter("amplitude", "arcsec", (2, 20, 200)),
        Parameter("frequency", "hz", (20, 10, 5), positive=True, default=10.0),
        Parameter("tau", "s", (0.2, 0.5, 2), positive=True, default=0.5),
        EARLY,
    )
    physics = "The structure rings when a move stops, released before the readout stands still."
    equation = "A exp(-s/tau) cos(2 pi f s), s = early + time since the end of the move"
    source = "Piersol and Paez 2009; Physics: Table mechanics"
    excited_by = "the first samples after each move"
    look = "a decaying tone at the start of each dwell"
    linear = True
    superposes = True
    follows = "move"

    @classmethod
    def shapes(cls, span: CoordinateRanges) -> list[dict[str, float]]:
        trials = product((1.0, 2.0, 3.0, 5.0, 8.0, 12.0), (0.15, 0.5, 1.5), EIGHTHS)
        return [
            {"frequency": f, "tau": t, "early": part / f}
            for f, t, part in trials
            if f < 0.45 * span.rate_hz
        ]

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return ringing(drive, *map(self.value, ("amplitude", "frequency", "tau", "early")))

    def dynamics(self, rig: Rig, gravity: float) -> tuple[Mechanism, ...]:
        if self.value("early"):
            return ()  # a structure is let go when the move ends
        axis = self.axis or rig.axis_names[0]
        size, frequency, tau = (self.value(n) for n in ("amplitude", "frequency", "tau"))
        return (Ring(axis, dict(rig.axes)[axis], size, frequency, tau),)


def ringing(drive: Drive, amplitude: float, frequency: float, tau: float, early: float) -> Jet:
    """A decaying cosine from the end of each move on; nothing before the first, (n,). amplitude:
    rad; frequency: Hz; tau: s; early: s, by which it began before the end.
    """
    standstills = Standstills.at(drive.standstills, drive.time, drive.stop)
    t, active = (
        standstills.since(drive.time),
        standstills.contains(drive.time) & (np.cumsum(drive.stop < 0) > 0),
    )
    rate = -1 / tau + 2j * np.pi * frequency
    wave = amplitude * np.exp(rate * np.where(active, t + early, 0.0)) * active
    return Jet(
        *(np.asarray(part.real, dtype=float) for part in (wave, rate * wave, rate * rate * wave))
    )
