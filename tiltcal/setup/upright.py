"""The direction up in the body of an instrument on a table, at the nominal geometry."""

from collections.abc import Mapping, Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.setup.chain import Chain
from tiltcal.setup.trajectory import Drive, Jet


def up_in_body(
    moving: Sequence[tuple[str, str]],
    chain: Chain | None,
    axes: Mapping[str, Jet],
    drive: Drive,
) -> Array:
    """The unit vector up in the body, (n, 3).

    Args:
        moving: axes that move the instrument with the coordinate axis that each turns about or
            slides along, outermost first.
        chain: the links of a user's own model; None on a table.
        axes: angles, rad, and places, m.
        drive: has the mountings.
    """
    up = np.zeros((len(drive.time), 3))
    up[:, 2] = 1.0
    for name, axis in moving:
        if chain is not None:
            up = up @ chain.links[name].R
            if chain.links[name].slides:
                continue
        i = "xyz".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        c, s = axes[name].cos_sin
        up[:, j], up[:, k] = c * up[:, j] + s * up[:, k], c * up[:, k] - s * up[:, j]
    if chain is not None:
        up = up @ chain.instrument.R
    starts = [row for row, _ in drive.mounts]
    for row, (_, R) in zip(starts, drive.mounts, strict=True):
        end = min((r for r in starts if r > row), default=len(up))
        up[row:end] = up[row:end] @ R
    return up
