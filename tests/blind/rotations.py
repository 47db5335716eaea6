"""Rotation matrices of many angles at once; R turns components of the moved frame into those of the
fixed one.
"""

import numpy as np

ARCSEC = np.pi / 648000
DEG = np.pi / 180
G0 = 9.80665


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Right-handed turns about x, y or z (0, 1, 2). angle: (n,), returns (n, 3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*np.shape(angle), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., i, i] = out[..., j, j] = c
    out[..., i, j], out[..., j, i] = -s, s
    return out


def by_vector(psi: np.ndarray) -> np.ndarray:
    """exp of a rotation vector, to third order: the vectors here are far below 0.1 rad. psi: (...,
    3) -> (..., 3, 3).
    """
    S = skew(psi)
    S2 = S @ S
    return np.eye(3) + S + S2 / 2 + S2 @ S / 6


def skew(v: np.ndarray) -> np.ndarray:
    """The matrix of v x (.). v: (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def unskew(S: np.ndarray) -> np.ndarray:
    """v of its skew matrix, the symmetric part ignored. S: (..., 3, 3)."""
    return (
        np.stack(
            [S[..., 2, 1] - S[..., 1, 2], S[..., 0, 2] - S[..., 2, 0], S[..., 1, 0] - S[..., 0, 1]],
            -1,
        )
        / 2
    )
