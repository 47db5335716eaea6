"""Effects on what the links of a user's own model carry."""

from abc import abstractmethod
from collections.abc import Sequence

from tiltcal.effects.base import Effect
from tiltcal.setup.loads import Mass
from tiltcal.setup.setup import Rig


class LoadEffect(Effect):
    """Which masses do the links carry in addition to those of the model? It shows through what
    bends under them alone.
    """

    @abstractmethod
    def masses(self, rig: Rig) -> Sequence[Mass]:
        """Point masses on the links; none on a rig without links."""


def masses_of(effects: Sequence[Effect], rig: Rig) -> tuple[Mass, ...]:
    """What the links carry by all of these effects."""
    return tuple(m for e in effects if isinstance(e, LoadEffect) for m in e.masses(rig))
