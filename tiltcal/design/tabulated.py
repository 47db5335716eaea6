"""Changes of the readings on a grid of table angles, and between its nodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.design.still import Still, watch
from tiltcal.effects.base import Effect
from tiltcal.frames import Array
from tiltcal.setup import Sensor

NODES = 72  # a turn, of each axis
COARSE = 0.05  # error of the interpolation, of the largest change, from which an effect is too fine for the grid


@dataclass(frozen=True)
class Table:
    """Columns on a grid that is periodic in every axis.

    Args:
        nodes: (NODES, ..., k, p): change of the channels at each node.
        axes: how many.
    """

    nodes: Array
    axes: int

    @property
    def columns(self) -> int:
        """How many parameters it holds."""
        return int(self.nodes.shape[-1])

    def at(self, angles: Array) -> Array:
        """Cubic interpolation in every axis, (n, k, p). angles: rad, (n, axes)."""
        place = angles / (2 * np.pi / NODES)
        low = np.floor(place).astype(int)
        weights = _cubic(place - low)
        total = np.zeros((len(angles), *self.nodes.shape[self.axes :]))
        for corner in np.ndindex(*(4,) * self.axes):
            index = tuple((low[:, i] + c - 1) % NODES for i, c in enumerate(corner))
            weight = np.prod([weights[c][:, i] for i, c in enumerate(corner)], axis=0)
            total += weight[:, None, None] * self.nodes[index]
        return total


def _cubic(t: Array) -> list[Array]:
    """Lagrange weights of the nodes -1, 0, 1, 2 at t in 0..1; the error on a first harmonic is 1e-6."""
    return [-t * (t - 1) * (t - 2) / 6, (t * t - 1) * (t - 2) / 2, -t * (t + 1) * (t - 2) / 2, t * (t * t - 1) / 6]


def tabulate(still: Still, sensor: Sensor, effects: Sequence[tuple[Effect, str]]) -> Table:
    """The changes that effects make at every node, differenced at their own size."""
    axes, k = len(still.axes), len(sensor.axes)
    nodes = np.zeros((*(NODES,) * axes, k, len(effects)))
    if effects:
        grid = np.stack(np.meshgrid(*[np.arange(NODES) * 2 * np.pi / NODES] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
        seen = watch(still, grid)
        for j, (effect, _) in enumerate(effects):
            change = seen.changes(effect).get(sensor.name)
            if change is not None:
                nodes[..., j] = change.reshape(*(NODES,) * axes, k)
    return Table(nodes, axes)


def too_fine(still: Still, sensor: Sensor, effects: Sequence[tuple[Effect, str]]) -> set[str]:
    """Labels of effects that change within a step of the grid (line-by-line encoder errors): no design can rely on them."""
    table = tabulate(still, sensor, effects)
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (60, len(still.axes)))
    near = table.at(angles)
    seen = watch(still, angles)
    found = set()
    for j, (effect, label) in enumerate(effects):
        true = seen.changes(effect).get(sensor.name, np.zeros(near.shape[:2]))
        if np.abs(true - near[:, :, j]).max() > COARSE * np.abs(true).max(initial=1e-300):
            found.add(label)
    return found
