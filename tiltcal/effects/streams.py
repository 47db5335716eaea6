"""Random streams of effects."""

from collections.abc import Callable

import numpy as np

from tiltcal.effects.base import Effect

Streams = Callable[[Effect], np.random.Generator | None]
"""A fresh random stream for an effect, the same at each call; None: random effects are off."""


def no_streams(effect: Effect) -> None:
    """Random effects switched off."""
