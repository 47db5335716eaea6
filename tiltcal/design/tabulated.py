"""Changes of the readings with the table's angles: of a few axes as trigonometric polynomials,
differenced once on a grid, then cheap; of more axes, where a grid would be too large, differenced
at each pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.static_instrument import Still, watch
from tiltcal.effects.base import Effect
from tiltcal.setup.sensor import Sensor

NODES = 24  # a turn, of each axis
MOST_AXES = 3  # of a grid: 24^3 poses
ORDER = 6  # highest harmonic of an axis that is kept
# of its prior size: the step by which an effect is differenced, so that its square does not count
SMALL = 1e-4
TRIED = 60  # poses between the nodes
COARSE = 0.02  # misfit, of the largest change, from which an effect is too fine for these harmonics


class PoseColumns(Protocol):
    """Columns of parameters at any angles."""

    @property
    def columns(self) -> int:
        """Number of parameters."""

    def at(self, angles: Array) -> Array:
        """The columns, (n, k, p). angles: rad, (n, axes)."""

    def only(self, kept: Sequence[int]) -> "PoseColumns":
        """Those of some parameters, by their numbers."""


@dataclass(frozen=True)
class DifferencedColumns:
    """Columns that are differenced wherever they are asked for.

    Args:
        still: the table at rest.
        sensor: sensor of the readings.
        effects: effects, one a column.
    """

    still: Still
    sensor: Sensor
    effects: tuple[Effect, ...]

    @property
    def columns(self) -> int:
        """Number of parameters."""
        return len(self.effects)

    def at(self, angles: Array) -> Array:
        """The columns, (n, k, p). angles: rad, (n, axes)."""
        if not self.effects:
            return np.zeros((len(angles), len(self.sensor.axes), 0))
        return changes_of(self.still, self.sensor, self.effects, angles)

    def only(self, kept: Sequence[int]) -> "DifferencedColumns":
        """Those of some parameters, by their numbers."""
        return replace(self, effects=tuple(self.effects[k] for k in kept))


@dataclass(frozen=True)
class TabulatedColumns:
    """Columns as harmonics of the angles.

    Args:
        coefficients: ((2 ORDER + 1)^axes, k, p), of the products of 1, cos, sin, cos 2 ... of each
            axis.
    """

    coefficients: Array

    @property
    def columns(self) -> int:
        """Number of parameters."""
        return int(self.coefficients.shape[-1])

    def at(self, angles: Array) -> Array:
        """The columns, (n, k, p). angles: rad, (n, axes)."""
        shape = self.coefficients.shape
        return np.asarray(harmonics(angles) @ self.coefficients.reshape(shape[0], -1)).reshape(
            len(angles), *shape[1:]
        )

    def only(self, kept: Sequence[int]) -> "TabulatedColumns":
        """Those of some parameters, by their numbers."""
        return TabulatedColumns(self.coefficients[:, :, list(kept)])


def harmonics(angles: Array) -> Array:
    """Products over the axes of 1, cos a, sin a, cos 2a ..., (n, (2 ORDER + 1)^axes). The shape is
    (n, terms).

    Args:
        angles: rad, (n, axes).
    """
    found = np.ones((len(angles), 1))
    for a in angles.T:
        k = np.outer(a, np.arange(1, ORDER + 1))
        part = np.concatenate([np.ones((len(a), 1)), np.cos(k), np.sin(k)], axis=1)
        found = (found[:, :, None] * part[:, None, :]).reshape(len(a), -1)
    return found


def tabulate(
    still: Still, sensor: Sensor, effects: Sequence[Effect]
) -> tuple[PoseColumns, list[bool]]:
    """The changes that effects make at their size, and of each whether these harmonics represent
    it.

    What changes from one line of an encoder to the next they do not represent: no design can rely
    on it.
    """
    axes, k = len(still.axes), len(sensor.axes)
    if axes > MOST_AXES or not effects:
        return DifferencedColumns(still, sensor, tuple(effects)), _held(still, sensor, effects)
    turn = np.arange(NODES) * 2 * np.pi / NODES
    grid = np.stack(np.meshgrid(*[turn] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
    tried = np.random.default_rng(0).uniform(-np.pi, np.pi, (TRIED, axes))
    changes = changes_of(still, sensor, effects, np.vstack([grid, tried]))
    basis = harmonics(grid)
    inverse = basis.T / (basis**2).sum(axis=0)[:, None]  # the products are orthogonal on the grid
    coefficients = (inverse @ changes[: len(grid)].reshape(len(grid), k * len(effects))).reshape(
        len(inverse), k, len(effects)
    )
    table = TabulatedColumns(coefficients)
    misfit = np.abs(table.at(tried) - changes[len(grid) :]).max(axis=(0, 1), initial=0.0)
    return table, list(misfit <= COARSE * np.abs(changes).max(axis=(0, 1), initial=0.0))


def _held(still: Still, sensor: Sensor, effects: Sequence[Effect]) -> list[bool]:
    """Of each effect, whether the harmonics represent its change along each axis alone."""
    rng, axes = np.random.default_rng(0), len(still.axes)
    held = np.ones(len(effects), dtype=bool)
    for axis in range(axes if effects else 0):
        angles = np.tile(rng.uniform(-np.pi, np.pi, axes), (NODES + TRIED, 1))
        angles[:NODES, axis] = np.arange(NODES) * 2 * np.pi / NODES
        angles[NODES:, axis] = rng.uniform(-np.pi, np.pi, TRIED)
        basis = harmonics(angles[:, [axis]])
        changes = changes_of(still, sensor, effects, angles).reshape(len(angles), -1)
        fitted = np.linalg.lstsq(basis[:NODES], changes[:NODES], rcond=None)[0]
        shape = (TRIED, len(sensor.axes), len(effects))
        misfit = np.abs(basis[NODES:] @ fitted - changes[NODES:]).reshape(shape).max(axis=(0, 1))
        largest = np.abs(changes).reshape(-1, *shape[1:]).max(axis=(0, 1))
        held &= misfit <= COARSE * largest
    return list(held)


def changes_of(still: Still, sensor: Sensor, effects: Sequence[Effect], angles: Array) -> Array:
    """What each effect changes at its size, to first order, in the sensing form (force), (n, k, p).

    Args:
        still: the instrument at standstill.
        sensor: sensor of the readings.
        effects: effects that act.
        angles: rad, (n, axes).
    """
    found = np.zeros((len(angles), len(sensor.axes), len(effects)))
    seen = watch(still, angles)
    for j, effect in enumerate(effects):
        sizes = effect.sizes
        small = replace(
            effect, values={**effect.values, **{name: SMALL * v for name, v in sizes.items()}}
        )
        change = seen.changes(small).get(sensor.name)
        if change is not None:
            found[:, :, j] = change / SMALL
    # the watch has turned forces into angles: d asin(f/g) = df / (g cos)
    if sensor.kind == "inclinometer":
        g = still.scenario.site.gravity
        ideal = seen.ideal[sensor.name]
        found *= np.sqrt(np.maximum(g * g - ideal**2, (1e-3 * g) ** 2))[:, :, None]
    return found
