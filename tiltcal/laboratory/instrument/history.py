"""What an instrument was exposed to in the last steps, and between them."""

from functools import cache
from math import prod

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.effects.stepwise import Rows

NODES = 4  # steps through which what is between them is interpolated: a cubic
WHOLE = 1e-6  # of a step: a delay so near to a whole number of steps is one


class History:
    """The inputs of the last steps of many environments.

    Args:
        longest: delay that is asked for, steps.
        rows: environments; width: numbers of an input.
    """

    def __init__(self, longest: float, rows: int, width: int) -> None:
        self.inputs = np.zeros((int(np.ceil(longest)) + NODES, rows, width))
        self.at = 0

    def add(self, values: Array, begun: Index) -> None:
        """The inputs of a step, (rows, width); environments that have ``begun`` were always there:
        they rested before.
        """
        self.at = (self.at + 1) % len(self.inputs)
        self.inputs[self.at] = values
        if len(begun):
            self.inputs[:, begun] = values[begun]

    def before(self, steps: float, rows: Rows) -> Array:
        """The inputs some steps ago, not before the first, (n, width)."""
        whole = round(steps)
        if abs(steps - whole) < WHOLE:
            return self._ago(whole, rows)
        first, weights = nodes_about(steps)
        nodes = (self.at - first - np.arange(NODES)) % len(self.inputs)
        return np.asarray(np.einsum("s,snw->nw", weights, self.inputs[nodes][:, rows]))

    def _ago(self, steps: int, rows: Rows) -> Array:
        return np.asarray(self.inputs[(self.at - steps) % len(self.inputs)][rows])


@cache
def nodes_about(steps: float) -> tuple[int, Array]:
    """The first of the steps ago through which a cubic gives what was between them, and the weights
    of all, (NODES,).
    """
    first = max(int(np.floor(steps)) - 1, 0)  # the step after it, where there is one, counts
    nodes = range(first, first + NODES)
    weights = (prod((steps - m) / (n - m) for m in nodes if m != n) for n in nodes)
    return first, np.array([*weights])
