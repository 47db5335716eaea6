"""Drift: slopes inside the dwells, of one sign throughout."""

import numpy as np

from tiltcal.calibration.validity import SIGNIFICANCE, Test
from tiltcal.core.arrays import Array
from tiltcal.recordings.static_poses import Poses

LEAST_DWELLS = 4


def slope_sigma(poses: Poses) -> Array:
    """Standard deviation of the slope of each dwell by white noise, SI a second, (m, k)."""
    length = np.array([s.end_s - s.start_s for s in poses.spans])
    # of a least-squares line through n samples: 12 variance / (n length^2)
    variance = np.diag(poses.noise) * poses.spread**2 * poses.inflation
    return np.asarray(np.sqrt(12 * variance / poses.counts[:, None]) / length[:, None])


def slope_test(poses: Poses) -> Test:
    """No common slope inside the dwells: Student's t of the slopes, whose scatter over the dwells
    holds white noise and random walk alike.
    """
    from scipy.special import stdtr

    name = "no drift while dwelling"
    if len(poses) < LEAST_DWELLS or np.isnan(poses.slopes).any():
        return Test(name, 0.0, 0, 1.0, True, "not tested: too few dwells, or only their means")
    z = poses.slopes / slope_sigma(poses)
    m, k = z.shape
    t = z.mean(axis=0) * np.sqrt(m) / np.maximum(z.std(axis=0, ddof=1), 1.0)
    worst = int(np.argmax(np.abs(t)))
    p = min(1.0, k * 2 * float(stdtr(m - 1, -abs(t[worst]))))
    ok = p > SIGNIFICANCE
    channel = f"{poses.sensor.name}_{poses.sensor.axes[worst]}"
    rate = float(np.mean(poses.slopes[:, worst]))
    words = f"the slopes inside the dwells have no common sign (t {t[worst]:.2g})"
    if not ok:
        words = (
            f"{channel} drifts inside the dwells by {rate:.3g} m/s2 or rad/s a second on average"
            f" (t {t[worst]:.3g}): a drift of its bias or a warm-up"
        )
    return Test(name, float(t[worst]), m - 1, p, ok, words)


def mean_slope(poses: Poses) -> tuple[Array, Array]:
    """Mean slope inside the dwells and its standard deviation, by its scatter over the dwells and
    not below white noise, SI a second, (k,) each.
    """
    white = slope_sigma(poses)
    weight = 1 / white**2
    mean = (weight * poses.slopes).sum(axis=0) / weight.sum(axis=0)
    scatter = ((poses.slopes - mean) / white).std(axis=0, ddof=1)
    return mean, np.maximum(scatter, 1.0) / np.sqrt(weight.sum(axis=0))
