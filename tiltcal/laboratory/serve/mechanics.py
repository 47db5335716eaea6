"""The mechanics behind a served table, where its motion is run by time steps."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from tiltcal.core.arrays import Array
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.trajectory import Drive


class Mechanics(Protocol):
    """Servos and structure that follow what is asked of them, as far as the time goes."""

    @property
    def realised(self) -> tuple[str, ...]:
        """Addresses of the effects that are mechanics here."""

    def advance(self, time: float, asked: Callable[[Array], Drive]) -> None:
        """Step until the state at an instant is known, s. asked: of the motors, at the times of the
        steps to come, (n,).

        Raises:
            TiltcalError: the run diverges.
        """

    def halt(self) -> dict[str, float]:
        """After that, rest where the last sound state was: the angle of each axis there, rad."""

    def observed(self, asked: Drive) -> Drive:
        """What encoders and structure do at the times of ``asked``, which were stepped."""

    def remount(self, mount: str) -> None:
        """The instrument is mounted anew."""


@runtime_checkable
class MechanicalLaboratory(Protocol):
    """A laboratory with mechanics."""

    def mechanics(self, scenario: Scenario) -> Mechanics:
        """Those of a scenario with ``[dynamics]``."""
