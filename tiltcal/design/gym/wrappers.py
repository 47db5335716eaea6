"""Wrappers that make an environment more like a given table."""

from typing import Any

import gymnasium
import numpy as np

from tiltcal.core.errors import TiltcalError


class StepAngles(gymnasium.ActionWrapper[Any, Any, Any]):
    """Angles in multiples of ``step_deg``, as an indexing table takes them.

    Raises:
        TiltcalError: the step does not divide a turn.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], step_deg: float) -> None:
        super().__init__(env)
        if step_deg <= 0 or abs(360 / step_deg - round(360 / step_deg)) > 1e-9:
            raise TiltcalError(
                "StepAngles",
                found=f"{step_deg:g} deg",
                need="a step that divides a turn",
                do="take 5 or 15, for example",
            )
        self.share = step_deg / 180

    def action(self, action: Any) -> Any:
        """The action on the steps."""
        found = np.array(action, dtype=np.float32)
        found[:2] = (np.round(found[:2] / self.share) * self.share + 1) % 2 - 1
        return found
