"""What can be wrong with the readings of a placing sweep: another mounting than stated, a channel
that clips.
"""

import numpy as np

from tiltcal.calibration.validity import Test
from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import DEG
from tiltcal.recordings.static_poses import Poses

FAR = 0.3  # of g: another mounting reads further off than any error of a sensor
SHORT = 0.02  # of g: a channel that falls short by this where it is largest is clipped
TURNS = (0, 90, 180, 270)


def require_mounting(poses: Poses, which: Index, g: float, source: str) -> None:
    """Refuse readings that contradict the stated mounting.

    Raises:
        TiltcalError: naming the time, and the mounting that the readings look like.
    """
    for number in np.unique(which):
        mine = np.flatnonzero(which == number)
        off = _misfit(poses, mine, np.eye(3), g)
        if off < FAR:
            continue
        misfits = [_misfit(poses, mine, rotation("z", d * DEG), g) for d in TURNS]
        better = int(np.argmin(misfits))
        guess = (
            f" but look like one turned by a further Rz({TURNS[better]})"
            if misfits[better] < FAR / 2
            else ""
        )
        raise TiltcalError(
            f"{source}, mounting from {poses.spans[mine[0]].start_s:.6g} s",
            found=f"readings up to {off:.2g} g off the stated mounting{guess}",
            need="the mounting that was used",
            do="correct the metadata line `# mount: ...`, or rig.mount",
        )


def _misfit(poses: Poses, mine: Index, turn: Array, g: float) -> float:
    """The 90 % quantile over the dwells of the largest difference from the readings expected after
    a turn, in g.

    A channel that reads too little in the right direction clips; that is not a mounting.
    """
    expected = (poses.up[mine] @ turn)[:, list(poses.sensor.axis_indices)]
    seen = poses.means[mine] / g
    error = np.abs(seen - expected)
    clipped = (
        (np.sign(seen) == np.sign(expected))
        & (np.abs(seen) < np.abs(expected))
        & (np.abs(seen) > 0.1)
    )
    return float(np.quantile(np.where(clipped, 0.0, error).max(axis=1), 0.9))


def channel_tests(poses: Poses, g: float) -> list[Test]:
    """Channels that stay at one reading where more acts on them, by name."""
    clipped = []
    for i, axis in enumerate(poses.sensor.axes):
        expected = poses.up[:, poses.sensor.axis_indices[i]]
        seen = poses.means[:, i] / g
        top = np.abs(seen).max()
        at_stop = (np.abs(seen) > top - SHORT / 4) & (np.abs(expected) - np.abs(seen) > SHORT)
        if at_stop.sum() >= 3 and np.ptp(expected[at_stop]) > 2 * SHORT:
            acts = np.abs(expected[at_stop]).max() * g
            clipped.append(
                f"{axis} stays at {top * g:.4g} m/s2 on {at_stop.sum()} dwells where up to"
                f" {acts:.4g} act"
            )
    said = (
        "saturated: " + "; ".join(clipped) + "; the placing angle of the other axis is wrong there"
        if clipped
        else "none clips"
    )
    ok = not clipped
    return [
        Test(
            "channels within range",
            float(len(clipped)),
            len(poses.sensor.axes),
            float(ok),
            ok,
            said,
        )
    ]
