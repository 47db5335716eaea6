"""How force and rate in the body frame respond to a small turn at each place of the chain: first
order, exact in time.

At an instant the motion depends on a turn's angle, rate and acceleration at that instant only.
Three probes through the closed form, one for each, therefore hold the response to any turn at that
place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.effects.base import AngleEffect, Effect, FrameEffect
from tiltcal.effects.loads import LoadEffect, masses_of
from tiltcal.effects.mechanisms import Context, Turn
from tiltcal.effects.parameter import Parameter, Stage
from tiltcal.forward.kinematics import force_and_rate, true_angles
from tiltcal.setup.loads import Mass
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive, Jet

STEP = 1e-4  # rad, rad/s, rad/s2: central differences of sines leave its square


@dataclass(frozen=True)
class _TurnProbe(FrameEffect):
    """One turn at one slot."""

    stage: ClassVar[Stage] = "table"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    slot: str = ""
    turn: Turn = field(default_factory=lambda: Turn("x", Jet(0.0)))

    def turns(self, slot: str, context: Context) -> Sequence[Turn]:
        return (self.turn,) if slot == self.slot else ()


@dataclass(frozen=True)
class _AngleProbe(AngleEffect):
    """A deviation of one axis."""

    stage: ClassVar[Stage] = "table"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    jet: Jet = field(default_factory=lambda: Jet(0.0))

    def deviation(self, drive: Drive, axis: str, rng: np.random.Generator | None) -> Jet:
        return self.jet


Place = tuple[str, str]
"""(slot, coordinate axis) of a turn; ("axis", name) of a table axis."""


def moves_smoothly(effect: Effect) -> bool:
    """Whether all that an effect does is turn frames or axes by angles that do not ask for the
    force there.
    """
    return isinstance(effect, AngleEffect | LoadEffect) or (
        isinstance(effect, FrameEffect) and not effect.mechanised
    )


class Responses:
    """Answers of force and rate along a nominal drive, each place probed when it is first asked
    for.

    Args:
        setup: site, rig, sensors; drive: what the table does.
    """

    def __init__(self, setup: Setup, drive: Drive) -> None:
        self.setup, self.drive = setup, drive
        self._kept: dict[Place, tuple[tuple[Array | None, Array | None], ...]] = {}
        self._contexts: dict[tuple[Mass, ...], Context] = {}
        self._loaded(())

    def turns(self, effect: Effect, beside: Sequence[Effect] = ()) -> dict[Place, Jet]:
        """The small turns of an effect that ``moves_smoothly``, place by place; beside: what is
        there anyway, of which loads and what bends under them matter.
        """
        rig = self.setup.rig
        if isinstance(effect, AngleEffect):
            return {
                ("axis", n): effect.slight(self.drive, n)
                for n in rig.axis_names
                if effect.acts_on(n, rig)
            }
        masses = masses_of(beside, rig)
        if isinstance(effect, LoadEffect):
            bending = [e for e in beside if isinstance(e, FrameEffect) and e.compliances(rig)]
            more = self._turned(bending, self._loaded((*masses, *effect.masses(rig))))
            less = self._turned(bending, self._loaded(masses))
            return {place: jet - less[place] for place, jet in more.items()}
        assert isinstance(effect, FrameEffect)
        return self._turned([effect], self._loaded(masses))

    def _turned(self, effects: Sequence[FrameEffect], context: Context) -> dict[Place, Jet]:
        found: dict[Place, Jet] = {}
        for slot in self.setup.rig.kind.slots:
            for turn in (t for e in effects for t in e.turns(slot, context)):
                place = (slot, turn.axis)
                found[place] = found[place] + turn.angle if place in found else turn.angle
        return found

    def _loaded(self, masses: tuple[Mass, ...]) -> Context:
        """The nominal motion with masses on its links."""
        if masses not in self._contexts:
            kept = dict(list(self._contexts.items())[:1])  # without any; the others change in a fit
            axes, gravity = true_angles(self.setup, self.drive, ()), self.setup.site.gravity
            context = Context.along(self.drive, axes, self.setup.rig, gravity, masses)
            self._contexts = {**kept, masses: context}
        return self._contexts[masses]

    @property
    def nominal(self) -> Context:
        """The nominal motion."""
        return self._loaded(())

    def to(self, turns: Mapping[Place, Jet]) -> tuple[Array, Array]:
        """Change of force and rate by small turns, (n, 3) each."""
        n = len(self.drive.time)
        force, rate = np.zeros((n, 3)), np.zeros((n, 3))
        for place, jet in turns.items():
            for part, (df, dw) in zip((jet.x, jet.v, jet.a), self.of(place), strict=True):
                if np.any(part):
                    by = np.broadcast_to(np.asarray(part), n)[:, None]
                    force = force if df is None else force + df * by
                    rate = rate if dw is None else rate + dw * by
        return force, rate

    def of(self, place: Place) -> tuple[tuple[Array | None, Array | None], ...]:
        """Per unit of angle, rate and acceleration: change of force and of rate, (n, 3) each; None
        where there is none.
        """
        if place not in self._kept:
            self._kept[place] = tuple(self._probed(place, k) for k in range(3))
        return self._kept[place]

    def _probed(self, place: Place, which: int) -> tuple[Array | None, Array | None]:
        up, down = (
            force_and_rate(
                self.setup,
                self.drive,
                [_probe(place, [sign * STEP * (k == which) for k in range(3)])],
            )
            for sign in (1, -1)
        )
        force, rate = ((one - other) / (2 * STEP) for one, other in zip(up, down, strict=True))
        return (force if force.any() else None), (rate if rate.any() else None)


def _probe(place: Place, jet: Sequence[float]) -> Effect:
    small = Jet(*jet)
    if place[0] == "axis":
        return replace(_AngleProbe(axis=place[1]), jet=small)
    return replace(_TurnProbe(), slot=place[0], turn=Turn(place[1], small))
