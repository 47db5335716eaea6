"""Continuous logs made by hand: poses as dwells with moves between them, noise on top; no product
physics.
"""

import numpy as np

from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Sensor


def log_of(
    means: np.ndarray,
    sensor: Sensor,
    *,
    dwell: int = 60,
    move: int = 12,
    noise: np.ndarray | None = None,
    angles: dict[str, np.ndarray] | None = None,
    labels: list[str] | None = None,
) -> Recording:
    """Dwells at the given mean readings (m, k), SI, joined by straight moves, at the sensor's rate.

    Args:
        noise: (rows, k), added.
        angles: table axis -> angle of each pose, deg.
        labels: of each pose.
    """
    knots = rows_of(len(means), dwell, move)
    n = knots[-1] + 1
    grid = np.arange(n)
    track = lambda values: np.interp(grid, knots, np.repeat(values, 2))  # noqa: E731  each pose holds from knot to knot
    values = np.column_stack([track(means[:, i]) for i in range(means.shape[1])])
    if noise is not None:
        values = values + noise
    unit = {"acceleration": "m_s2", "angle": "rad", "rate": "rad_s"}[sensor.quantity]
    columns = {f"{sensor.name}_{a}_{unit}": values[:, i] for i, a in enumerate(sensor.axes)}
    for name, degrees in (angles or {}).items():
        columns[f"table_{name}_deg"] = track(degrees)
    words = None
    if labels is not None:
        words = np.array(
            [labels[min(i // (dwell + move), len(labels) - 1)] for i in grid], dtype=object
        )
    return Recording.from_columns(grid / sensor.rate_hz, columns, labels=words)


def rows_of(poses: int, dwell: int, move: int) -> np.ndarray:
    """First and last row of each dwell, (2 poses,)."""
    starts = np.arange(poses) * (dwell + move)
    return np.column_stack([starts, starts + dwell - 1]).ravel()


def triad_readings(up: np.ndarray, g: float, bias: np.ndarray, M: np.ndarray) -> np.ndarray:
    """reading = bias + M g up, (m, 3)."""
    return bias + g * up @ M.T
