"""One effect of the amended scenario that belongs to a finding."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Part:
    """One effect of the amended scenario that belongs to a finding.

    Args:
        effect: its id there; ``learned`` for a curve.
        description: in words.
        stage: of the chain; sensor: that it acts on; axis: of the table, or channel.
        axes: channels that hold its signal, the strongest first.
        parameters: name with unit -> (value, standard uncertainty; None where it was not fitted),
            as the amended scenario has them; empty for a curve.
        curve: keys of a learned curve, as the amended scenario has them.
        energy_share: product of its signal with that of the whole finding over the energy of the
            latter, both whitened and without what calibration and other findings may take. The
            shares of a finding add up to 1; parts that cancel have shares of opposite signs.
        recording: of several, the one that an event happened in or a line in time is in.
    """

    effect: str
    description: str
    stage: str
    sensor: str | None = None
    axis: str | None = None
    axes: tuple[str, ...] = ()
    parameters: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    curve: Mapping[str, Any] = field(default_factory=dict)
    energy_share: float = 1.0
    recording: str | None = None

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        found: dict[str, Any] = {
            "effect": self.effect,
            "description": self.description,
            "stage": self.stage,
            "sensor": self.sensor,
            "axis": self.axis,
            "axes": list(self.axes),
            **({} if self.recording is None else {"recording": self.recording}),
        }
        if self.curve:
            found |= self.curve
        else:
            found["parameters"] = {
                name: {"value": v, "sigma": s} for name, (v, s) in self.parameters.items()
            }
        return found | {"energy_share": self.energy_share}
