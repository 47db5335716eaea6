"""The table and the instrument as solids in motion, for pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive

SIDES = 16  # of a cylinder


@dataclass(frozen=True)
class Solid:
    """One solid, centred on its own frame.

    Args:
        part: the table's part that it belongs to: ``base``, an axis, ``instrument``.
        kind: a box, or a cylinder about its z.
        half: half its size along x, y, z, m, (3,).
    """

    part: str
    kind: Literal["box", "cylinder"]
    half: Array

    def corners(self) -> Array:
        """Corners in its own frame, m, (c, 3)."""
        if self.kind == "box":
            return np.array(list(product((-1.0, 1.0), repeat=3))) * self.half
        turn = 2 * np.pi * np.arange(SIDES) / SIDES
        ring = np.column_stack([np.cos(turn), np.sin(turn), np.ones(SIDES)])
        ends = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        return np.concatenate([ring, ring * [1, 1, -1], ends]) * self.half

    def faces(self) -> Index:
        """Triangles as numbers of corners, (t, 3)."""
        if self.kind == "box":
            quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
            quads.append((1, 5, 7, 3))
            return np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
        found = []
        for k in range(SIDES):
            n = (k + 1) % SIDES
            found += [(k, n, SIDES + k), (n, SIDES + n, SIDES + k)]
            found += [(2 * SIDES, k, n), (2 * SIDES + 1, SIDES + n, SIDES + k)]
        return np.array(found)


@dataclass(frozen=True)
class Scene:
    """Solids at some instants.

    Args:
        solids: of the table and the instrument.
        positions: of their centres, world, m, (n, s, 3), from the axes' common point.
        rotations: from their own frames to the world, (n, s, 3, 3).
    """

    solids: Sequence[Solid]
    positions: Array
    rotations: Array

    def corners(self, k: int) -> Array:
        """Corners of solid ``k`` at each instant, world, m, (n, c, 3)."""
        own = self.solids[k].corners()
        turned = np.einsum("nij,cj->nci", self.rotations[:, k], own)
        return np.asarray(turned + self.positions[:, k, None, :])


@runtime_checkable
class Stage(Protocol):
    """A laboratory that shows its table."""

    def scene(self, setup: Setup, drive: Drive) -> Scene:
        """The nominal table as it stands along a drive."""

    def pictures(self, setup: Setup, drive: Drive, width: int, height: int) -> Iterator[bytes]:
        """A picture of the table at each instant of a drive, RGB, row by row.

        Raises:
            TiltcalError: pictures cannot be drawn on this machine.
        """
