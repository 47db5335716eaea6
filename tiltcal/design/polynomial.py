"""Textbook models of a triad in units of g: what each channel adds per unit coefficient, as
polynomials of up.

==============  ==========
===================================================================================
name            parameters  regressors of channel i at up = (x, y, z)
==============  ==========
===================================================================================
linear          12          1, x, y, z
K2              15          and u_i^2
K2K3            18          and u_i^2, u_i^3
quadratic       27          and x^2 - y^2, 3 z^2 - 1, x y, x z, y z
cubic           48          and seven independent products of third degree
==============  ==========
===================================================================================
"""

from functools import partial

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import one_of
from tiltcal.core.frames import sphere
from tiltcal.design.model import Model

KINDS = ("linear", "K2", "K2K3", "quadratic", "cubic")
WHITE = 1e-4  # g per root hertz: 1e-3 g per sample at 100 Hz
FLOOR = 2e-5  # g per pose
PRIOR = 0.03
_NAMES = {
    "linear": (),
    "K2": ("K2",),
    "K2K3": ("K2", "K3"),
    "quadratic": ("xx-yy", "3zz-1", "xy", "xz", "yz"),
    "cubic": ("xx-yy", "3zz-1", "xy", "xz", "yz", "x3", "y3", "z3", "xxy", "yyz", "zzx", "xyz"),
}


def regressors(up: Array, kind: str) -> Array:
    """What each channel adds per unit coefficient, (..., 3, q). up: (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(up), -1, 0)
    common = [np.ones_like(x), x, y, z]
    if kind in ("quadratic", "cubic"):
        common += [x * x - y * y, 3 * z * z - 1, x * y, x * z, y * z]
    if kind == "cubic":
        common += [x**3, y**3, z**3, x * x * y, y * y * z, z * z * x, x * y * z]
    shared = np.stack(common, axis=-1)
    blocks = np.repeat(shared[..., None, :], 3, axis=-2)
    own = [up**power for power in {"K2": (2,), "K2K3": (2, 3)}.get(kind, ())]
    return np.concatenate([blocks, *(o[..., None] for o in own)], axis=-1)


def dual_up(angles: Array) -> Array:
    """Up in the body frame on the dual table, mounted straight, (..., 3).

    Args:
        angles: outer, inner, rad, (..., 2).
    """
    a, b = angles[..., 0], angles[..., 1]
    return np.stack([np.sin(a) * np.sin(b), np.sin(a) * np.cos(b), np.cos(a)], axis=-1)


def spread_out(blocks: Array) -> Array:
    """(n, 3, q) regressors of each channel -> (n, 3, 3 q) with every channel its own columns."""
    n, k, q = blocks.shape
    full = np.zeros((n, k, k, q))
    full[:, np.arange(k), np.arange(k)] = blocks
    return full.reshape(n, k, k * q)


def textbook_model(kind: str, drift: bool, horizon: float) -> Model:
    """A textbook model on the dual table, with a linear bias drift over ``horizon`` seconds as a
    nuisance if asked for.

    Args:
        kind: name of the model, one of ``KINDS``.
        drift: whether a bias drift is a nuisance.
        horizon: length of the recording, s.
    """
    one_of(kind, KINDS, "textbook model")
    stems = ["bias", "x", "y", "z", *_NAMES[kind]]
    names = [f"{axis}.{stem}" for axis in "xyz" for stem in stems]
    p = len(names)
    names += [f"{axis}.drift" for axis in "xyz"] if drift else []
    up = sphere(400)
    loss = np.zeros((len(names), len(names)))
    loss[:p, :p] = tilt_loss(up, spread_out(regressors(up, kind)) * PRIOR)
    return Model(
        tuple(names),
        ("g",) * len(names),
        np.full(len(names), PRIOR),
        np.arange(len(names)) < p,
        partial(_rows, kind, horizon if drift else None),
        np.full(3, WHITE),
        np.full(3, FLOOR),
        loss,
        drift,
    )


def _rows(kind: str, horizon: float | None, angles: Array, time: Array) -> Array:
    """Columns of a textbook model, with a drift over a horizon if there is one, (n, 3, p)."""
    fixed = spread_out(regressors(dual_up(angles), kind))
    if horizon is None:
        return fixed * PRIOR
    drift = (time / horizon)[:, None, None] * np.eye(3)
    return np.concatenate([fixed, drift], axis=2) * PRIOR


def tilt_loss(up: Array, columns: Array) -> Array:
    """W with mean square tilt error per axis = tr(C W), (p, p): the part across ``up`` of what the
    parameters add.

    Args:
        up: working directions, (n, 3).
        columns: reading per parameter over g, (n, 3, p).
    """
    across = columns - up[:, :, None] * np.einsum("ni,nip->np", up, columns)[:, None, :]
    flat = across.reshape(-1, across.shape[2])
    return np.asarray(flat.T @ flat / (2 * len(up)))
