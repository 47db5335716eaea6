"""Poses of known attitude: wrong, swapped and missing faces, and the rotation of the fixture."""

import numpy as np

from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array, Index
from tiltcal.core.frames import AXES, angle_between
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.recordings.static_poses import Poses, group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.least_squares import Fit

OFF = 30 * DEG  # from the stated direction: another face than stated
FACES = {
    f"{'+' if s > 0 else '-'}{a}": s * np.eye(3)[i] for i, a in enumerate(AXES) for s in (1, -1)
}


def face_tests(poses: Poses) -> list[Test]:
    """Wrong, swapped and missing faces, by name; none for a sensor with fewer than three axes."""
    if len(poses.sensor.axes) < 3:
        return []
    return [_faces_as_stated(poses), _faces_complete(poses)]


def _faces_as_stated(poses: Poses) -> Test:
    measured = poses.means / np.linalg.norm(poses.means, axis=1)[:, None]
    off = angle_between(measured, poses.up)
    wrong = np.flatnonzero(off > OFF)
    found = []
    for k in wrong:
        span = poses.spans[k]
        stated = span.label or "by the readout"
        found.append(
            f"the dwell at {span.start_s:.6g} s is stated {stated} but reads {_face(measured[k])}"
        )
    found += _swapped(poses, measured, wrong)
    words = "; ".join(found) or "every dwell reads the face that is stated"
    return threshold_test("faces as stated", off.max() / DEG, not found, words, dof=len(poses))


def _swapped(poses: Poses, measured: Array, wrong: Index) -> list[str]:
    """Pairs of dwells that would both be right with their faces exchanged."""
    near = measured @ poses.up.T > np.cos(OFF)
    starts = [span.start_s for span in poses.spans]
    return [
        f"these two are swapped: {starts[i]:.6g} s and {starts[j]:.6g} s"
        for n, i in enumerate(wrong)
        for j in wrong[n + 1 :]
        if near[i, j] and near[j, i]
    ]


def _faces_complete(poses: Poses) -> Test:
    missing = [face for face, e in FACES.items() if np.max(poses.up @ e) < 0.5]
    words = "every axis was recorded up and down"
    if missing:
        words = f"no pose within 60 deg of {', '.join(missing)} up"
    group = group_directions(poses.up)
    first = np.unique(group, return_index=True)[1]
    repeated = [
        f"{_face(poses.up[k])} {n} times"
        for k, n in zip(first, np.bincount(group), strict=True)
        if n > 1
    ]
    if missing and repeated:
        words += f", but {', '.join(repeated)}: recorded twice instead?"
    return threshold_test("faces complete", len(missing), not missing, words, dof=6)


def _face(direction: Array) -> str:
    """The axis nearest to a direction, such as ``+x``."""
    i = int(np.argmax(np.abs(direction)))
    return ("+" if direction[i] > 0 else "-") + AXES[i]


def fixture_rotation(fit: Fit, sensor: Sensor) -> str:
    """The rotation of the fixture that would give the same antisymmetric cross-axis terms, in
    words.
    """
    words = (
        "a rotation common to all poses (fixture or mounting) cannot be distinguished from the"
        " antisymmetric part of the cross-axis terms"
    )
    pairs = [("yz", "zy"), ("zx", "xz"), ("xy", "yx")]
    names = [[f"{sensor.name}.cross_{ij}" for ij in pair] for pair in pairs]
    if not all(n in fit.names for pair in names for n in pair):
        return words
    sizes = []
    for axis, pair in zip(AXES, names, strict=True):
        i, j = (fit.names.index(n) for n in pair)
        C = fit.covariance
        angle = (fit.values[i] - fit.values[j]) / 2 / ARCSEC
        sigma = np.sqrt(C[i, i] + C[j, j] - 2 * C[i, j]) / 2 / ARCSEC
        sizes.append(f"{axis} {angle:.4g} +- {sigma:.2g}")
    return (
        f"{words}: here it would be a rotation of {', '.join(sizes)} arcsec; the symmetric part,"
        " scale and bias do not depend on it"
    )
