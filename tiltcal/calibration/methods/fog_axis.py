"""The FOG's axis against gravity: the scale factors that it gives must carry the accelerometer's
direction of up through every turn.
"""

import numpy as np

from tiltcal.calibration.methods.field_log import FieldLog
from tiltcal.calibration.methods.fog_filter import Filtered
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG

NAME = "axis of the FOG"
# rad: of a direction by an accelerometer that is not calibrated: 5 mg of bias, scale and axes
DIRECTION = 5e-3
STEP = 1e-4  # of a scale factor, for its slope
LEAST_TURN = 30 * DEG


def axis_test(log: FieldLog, state: Filtered) -> Test:
    """Do the scale factors by the FOG carry gravity as the accelerometer sees it?

    An error du of the FOG's axis is -du_i / u_i of scale; the gyro's cross-coupling adds to it.
    """
    turns = _turns(log)
    if log.force is None or len(turns) < 2:
        words = "not tested: it needs an accelerometer triad and turns between standstills"
        return threshold_test(NAME, 0.0, True, words)
    base = _carried(log, turns, state.scale)
    slopes = np.array(
        [(_carried(log, turns, state.scale + STEP * e) - base) / STEP for e in np.eye(3)]
    )
    seen = np.array([_up(log, after) for _, after in turns])
    sigma = DIRECTION * np.sqrt(2)
    A, r = slopes.reshape(3, -1).T / sigma, (seen - base).ravel() / sigma
    information = A.T @ A
    if np.linalg.cond(information) > 1e8:
        words = "not tested: every turn was about the vertical"
        return threshold_test(NAME, 0.0, True, words)
    covariance = np.linalg.inv(information)
    off = covariance @ A.T @ r
    total = covariance + state.scale_covariance
    statistic = float(off @ np.linalg.solve(total, off))
    sizes = ", ".join(
        f"{a} {v * 1e6:.0f} +- {s * 1e6:.0f}"
        for a, v, s in zip(AXES, off, np.sqrt(np.diag(total)), strict=True)
    )
    words = f"gravity asks for scale factors that differ by {sizes} ppm"
    test = chi2_test(NAME, statistic, 3, words)
    if test.passed:
        return test
    lean = float(np.linalg.norm(off * log.axis)) / DEG
    causes = (
        f": the FOG's input_axis is off (by {lean:.2g} deg), its scale factor is, or the gyro's"
        " axes are not orthogonal"
    )
    return chi2_test(NAME, statistic, 3, words + causes)


def _turns(log: FieldLog) -> list[tuple[int, int]]:
    """Numbers of the rests before and after each turn."""
    found = []
    for k in range(int(log.rest.max())):
        rows = _between(log, k)
        angle = np.abs(log.turned[rows] * log.span[rows, None]).sum(axis=0).max(initial=0.0)
        if angle > LEAST_TURN:
            found.append((k, k + 1))
    return found


def _between(log: FieldLog, k: int) -> Array:
    """Rows from the end of a rest to the beginning of the next; none where either is missing."""
    before, after = np.flatnonzero(log.rest == k), np.flatnonzero(log.rest == k + 1)
    if not len(before) or not len(after):
        return np.zeros(0, dtype=np.intp)
    return np.arange(before[-1] + 1, after[0])


def _up(log: FieldLog, k: int) -> Array:
    """Direction of up at a rest, body frame, (3,)."""
    assert log.force is not None
    mean = log.force[log.rest == k].mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _carried(log: FieldLog, turns: list[tuple[int, int]], scale: Array) -> Array:
    """Up after each turn by the gyro alone, from the accelerometer's before it, (m, 3)."""
    from scipy.spatial.transform import Rotation

    found = []
    for k, _ in turns:
        rows = _between(log, k)
        angles = log.turned[rows] / (1 + scale) * log.span[rows, None]
        up = _up(log, k)
        for R in Rotation.from_rotvec(-angles).as_matrix():
            up = R @ up
        found.append(up)
    return np.array(found)
