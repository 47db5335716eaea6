"""Turns whose total angle about an axis is stated: what gravity alone cannot tell of them,
multiples of 360 deg and turns about the vertical.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.frames import parse_turn
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import PoseSpan

FULL = 2 * np.pi


@dataclass(frozen=True)
class StatedAngles:
    """The stated angles of some turns.

    Args:
        turn: number of the turn that each is of, (q,).
        angle: counter-clockwise about the axis, rad, (q,).
        axis: of the body that is nearest to that of the turn, unit vectors, (q, 3).
        sigma: standard uncertainty, rad, (q,).
    """

    turn: Index
    angle: Array
    axis: Array
    sigma: Array

    def subset(self, mask: Mask) -> Self:
        """Those of some of the turns. mask: (turns,)."""
        number = np.cumsum(mask) - 1
        kept = mask[self.turn]
        return replace(self.at(kept), turn=number[self.turn[kept]])

    def at(self, kept: Mask) -> Self:
        """Some of them, (q,)."""
        return replace(
            self,
            turn=self.turn[kept],
            angle=self.angle[kept],
            axis=self.axis[kept],
            sigma=self.sigma[kept],
        )

    def __len__(self) -> int:
        return len(self.turn)

    def errors(self, rotations: Array, integrals: Array) -> Array:
        """Stated less integrated angle of each, rad, (k, q).

        The axis of a turn is the direction of the integral of its rate. About it the rotation that
        is left when the stated one is undone is the error but for whole turns; the integral, which
        is the angle where the axis stands still, tells how many.

        Args:
            rotations: of body components over each turn, (k, m, 3, 3).
            integrals: of the rate over each turn, rad, (k, m, 3).
        """
        from scipy.spatial.transform import Rotation

        shape = (len(rotations), len(self))
        integral = integrals[:, self.turn]
        way = np.sign(np.einsum("kqi,qi->kq", integral, self.axis))
        size = np.linalg.norm(integral, axis=2)
        axis = integral * (way / np.maximum(size, 1e-300))[..., None]
        undone = Rotation.from_rotvec((axis * self.angle[:, None]).reshape(-1, 3)).as_matrix()
        left = rotations[:, self.turn] @ undone.reshape(*shape, 3, 3)
        vector = Rotation.from_matrix(left.reshape(-1, 3, 3)).as_rotvec().reshape(*shape, 3)
        error = np.einsum("kqi,kqi->kq", vector, axis)
        turns = np.round((self.angle - way * size - error) / FULL)
        return np.asarray(error + FULL * turns)


NO_ANGLES = StatedAngles(np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 3)), np.zeros(0))


def stated_angles(recording: Recording, rests: Sequence[PoseSpan], sigma: float) -> StatedAngles:
    """The angles that the labels of the rows between rests state: of several labels of one turn
    that on most rows.

    Args:
        recording: with labels such as ``turn z 360``.
        rests: before, between and after the turns.
        sigma: standard uncertainty of an angle whose label states none, rad.
    """
    if recording.labels is None:
        return NO_ANGLES
    found = []
    for k, (before, after) in enumerate(pairwise(rests)):
        between = (recording.time >= before.end_s) & (recording.time <= after.start_s)
        labels = [str(w) for w in recording.labels[between] if w]
        words, counts = np.unique(labels, return_counts=True)
        for word in words[np.argsort(-counts)]:
            if (turn := parse_turn(str(word))) is not None:
                axis, angle, own = turn
                found.append((k, angle, axis, sigma if own is None else own))
                break
    if not found:
        return NO_ANGLES
    return StatedAngles(*(np.array(column) for column in zip(*found, strict=True)))
