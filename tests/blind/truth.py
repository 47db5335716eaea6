"""What is concealed, and how the truth is written down."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.faults import Fault
from blind.oracle import Found
from blind.spec import Shape, Spec
from blind.world import Physics


@dataclass(frozen=True)
class Hidden:
    """One concealed effect and what the oracle knows of it."""

    spec: Spec
    shape: Shape
    p: np.ndarray  # SI
    found: Found
    textbook: bool

    @property
    def physics(self) -> Physics:
        """The hook."""
        return self.spec.physics(self.p, self.shape)


def told_of(h: Hidden) -> dict[str, Any]:
    """An effect in plain data, parameters in their own units."""
    values = {
        n: float(v / h.spec.unit)
        for n, v in zip(h.spec.names, h.p, strict=True)
        if v or h.spec.together
    }
    return {
        "id": h.spec.id,
        "listed": h.spec.listed,
        "textbook": h.textbook,
        "stage": h.spec.stage,
        "where": list(h.spec.where),
        "sensors": list(h.spec.sensors),
        "parameters": {**values, **h.spec.extra(h.shape)},
        "shape": {k: str(v) for k, v in h.shape.items()},
        "lambda": h.found.lam,
        "own": h.found.own,
        "inseparable": h.found.inseparable,
        "tolerated": h.found.tolerated,
        "left": {k: round(v, 2) for k, v in sorted(h.found.left.items(), key=lambda x: x[1])[:8]},
        "energy": h.found.energy,
    }


def told_of_fault(fault: Fault, said: dict[str, Any]) -> dict[str, Any]:
    """A fault of the data likewise. ``said``: what it told when it was made."""
    return {
        "id": fault.id,
        "listed": True,
        "textbook": True,
        "stage": fault.stage,
        "where": list(fault.where),
        "sensors": [said.pop("sensor", "")],
        "parameters": said,
        "interval_s": said.pop("interval_s", None),
        "lambda": None,
        "inseparable": [],
        "tolerated": [],
        "energy": {},
    }
