"""Checks of a placing sweep: the stated mounting, clipped channels, sweeps in one direction only,
missing angles; and notes on the tables.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.methods.placing_sweep import AxisTable, Drift
from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.recordings.static_poses import Poses

OTHER_MOUNTING = 0.3  # of g: another mounting differs by more than any error of a sensor
CLIPPED = 0.02  # of g: by which a clipped channel is too small where it is largest
QUARTERS = range(0, 360, 90)
REPEATED = 0.5  # share of the angles; with fewer repeated visits the drift is poorly known
REMOUNT = {"x": "Rz(90)", "y": "identity"}


def require_mounting(poses: Poses, which: Index, g: float, source: str) -> None:
    """Refuse readings that contradict the stated mounting. which: numbers of the poses, (n,).

    Raises:
        TiltcalError: naming the time, and the mounting that the readings look like.
    """
    for number in np.unique(which):
        mine = np.flatnonzero(which == number)
        off = _misfit(poses, mine, np.eye(3), g)
        if off < OTHER_MOUNTING:
            continue
        misfits = [_misfit(poses, mine, rotation("z", d * DEG), g) for d in QUARTERS]
        better = int(np.argmin(misfits))
        guess = ""
        if misfits[better] < OTHER_MOUNTING / 2:
            guess = f" but look like one turned by a further Rz({QUARTERS[better]})"
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


def range_tests(poses: Poses, g: float) -> list[Test]:
    """Channels that stay at one reading where more acts on them, by name."""
    clipped = []
    for i, axis in enumerate(poses.sensor.axes):
        expected = poses.up[:, poses.sensor.axis_indices[i]]
        seen = poses.means[:, i] / g
        top = np.abs(seen).max()
        at_stop = (np.abs(seen) > top - CLIPPED / 4) & (np.abs(expected) - np.abs(seen) > CLIPPED)
        if at_stop.sum() >= 3 and np.ptp(expected[at_stop]) > 2 * CLIPPED:
            acts = np.abs(expected[at_stop]).max() * g
            clipped.append(
                f"{axis} stays at {top * g:.4g} m/s2 on {at_stop.sum()} dwells where up to"
                f" {acts:.4g} act"
            )
    words = "no channel is clipped"
    if clipped:
        words = (
            f"saturated: {'; '.join(clipped)}; the placing angle of the other axis is wrong there"
        )
    count, axes = len(clipped), len(poses.sensor.axes)
    return [threshold_test("channels within range", count, not clipped, words, dof=axes)]


def sweep_tests(axes: Sequence[AxisTable]) -> list[Test]:
    """Sweeps in one direction, and missing angles, by name."""
    one_way = [a.axis for a in axes if any(s.repeated < REPEATED for s in a.sweeps)]
    least = min(s.both_ways for a in axes for s in a.sweeps)
    words = (
        f"{100 * least:.0f} % of the inner angles were approached from both sides, a linear drift"
        " is subtracted"
    )
    if one_way:
        words = (
            f"one-way sweep of axis {' and '.join(one_way)}: a linear drift of the zero enters the"
            " table in full and cannot be detected; sweep up and down"
        )
    return [
        threshold_test("up and down", least, not one_way, words, dof=len(axes)),
        _angles_complete(axes),
    ]


def _angles_complete(axes: Sequence[AxisTable]) -> Test:
    missing = {a.axis: a.missing for a in axes if a.missing}
    ranges = "; ".join(
        f"axis {a.axis}: {a.angles[0] / DEG:.4g} ... {a.angles[-1] / DEG:.4g} deg" for a in axes
    )
    words = f"every step was visited ({ranges})"
    if missing:
        named = "; ".join(
            f"axis {x}: {', '.join(f'{m:.4g}' for m in angles[:12])} deg"
            for x, angles in missing.items()
        )
        words = f"no dwell at {named}: interpolated between their neighbours"
    return threshold_test("angles complete", sum(map(len, missing.values())), not missing, words)


def table_notes(axes: Sequence[AxisTable], g: float, drift: Drift) -> list[str]:
    """The range and the contents of the tables, and what to record next."""
    notes = []
    for a in axes:
        first, last = a.angles[[0, -1]] / DEG
        notes.append(
            f"the table of axis {a.axis} is valid for placing angles {first:.4g} ... {last:.4g}"
            " deg; beyond, in negative or mirrored quadrants, the bias differs: those samples are"
            " left empty"
        )
        notes += _drift_notes(a, g, drift)
        notes.append(_axle_note(a, g))
    for axis in {"x", "y"} - {a.axis for a in axes}:
        notes.append(
            f"axis {axis} has no table: remount ({REMOUNT[axis]}) and sweep again; its reading is"
            " passed on unchanged"
        )
    return notes


def _drift_notes(a: AxisTable, g: float, drift: Drift) -> list[str]:
    drifts = [t.drift for t in a.solved if t.drift is not None]
    notes = []
    if drifts and drift == "warm_up":
        sizes = ", ".join(f"{d / g * 1e6:.3g} ug" for d in drifts)
        notes.append(f"warm-up of axis {a.axis}, subtracted: {sizes} at the start of each sweep")
    elif drifts:
        rates = ", ".join(f"{60 * d / g * 1e6:.3g} ug/min" for d in drifts)
        notes.append(f"drift of axis {a.axis}, subtracted: {rates}")
    if len(drifts) == len(a.solved) and not any(s.both_ways > 0.5 for s in a.sweeps):
        notes.append(
            f"axis {a.axis} was swept in one direction each time: hysteresis cannot be detected"
        )
    return notes


def _axle_note(a: AxisTable, g: float) -> str:
    """Whether the tilt of the table's axis is inside the table of a sensor axis."""
    if a.axle is None:
        return (
            "the tilt and wobble of the table's own axis are inside the table of axis"
            f" {a.axis}; a second sweep, reversed by a remount of 180 deg, separates them"
        )
    n = len(a.axle.value)
    lean = float(np.mean(a.axle.value)) / g / ARCSEC
    sigma = float(np.sqrt(a.axle.covariance.sum())) / n / g / ARCSEC
    return (
        f"table separated from sensor on axis {a.axis}: the table's axis leans by {lean:.4g} +-"
        f" {sigma:.2g} arcsec, subtracted"
    )
