"""What straight lines between the entries of a placing-angle table miss."""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.methods.placing_smooth import ORDERS
from tiltcal.calibration.methods.placing_sweep import AxisTable
from tiltcal.calibration.validity import Test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC, DEG

# rms of x (h - x) / 2 over a step h, in units of its largest value h^2 / 8
RMS_OF_PARABOLA = float(np.sqrt(8 / 15))
LARGEST = 3.0  # of the noise of an entry: its sigma then says most of the error
LEAST_ANGLES = 2 * max(ORDERS) + 1  # as many as the terms of the widest smooth fit
SMALL = 0.01  # of what the table takes away


def interpolation_error(a: AxisTable) -> Array:
    """Rms error of linear interpolation beside each entry, m/s2, (n,): ``step^2/8 b''`` with b''
    by second differences, less what their noise adds.
    """
    x, v, C = a.angles, a.sensor.value, a.sensor.covariance
    n = len(x)
    if n < 3:
        return np.zeros(n)
    before, after = x[1:-1] - x[:-2], x[2:] - x[1:-1]
    D = np.zeros((n - 2, n))
    k = np.arange(n - 2)
    D[k, k] = 2 / (before * (before + after))
    D[k, k + 2] = 2 / (after * (before + after))
    D[k, k + 1] = -D[k, k] - D[k, k + 2]
    squared = np.maximum((D @ v) ** 2 - np.einsum("ij,jk,ik->i", D, C, D), 0.0)
    largest = np.sqrt(squared) * np.maximum(before, after) ** 2 / 8
    inner = RMS_OF_PARABOLA * largest
    return np.asarray(np.concatenate([inner[:1], inner, inner[-1:]]))


def interpolation_test(axes: Sequence[AxisTable], g: float, lookup: str) -> Test:
    """Whether the steps are small enough for the table to be read between its entries."""
    worst, few, words = 0.0, False, []
    for a in axes:
        error = interpolation_error(a)
        noise = float(np.sqrt(np.mean(np.diag(a.sensor.covariance))))
        size = float(np.sqrt(np.mean(error**2)))
        taken = float(np.sqrt(np.mean(a.sensor.value**2)))
        worst = max(worst, size / max(LARGEST * noise, SMALL * taken, 1e-12))
        few = few or len(a.angles) < LEAST_ANGLES
        words.append(
            f"between steps of {a.step / DEG:.4g} deg linear interpolation misses"
            f" {size / g / ARCSEC:.3g} arcsec rms of axis {a.axis}, {size / max(noise, 1e-12):.2g}"
            " times the noise of an entry"
        )
    if few:
        words.append(f"fewer than {LEAST_ANGLES} angles do not show how the bias bends")
    ok = not few and (worst <= 1 or lookup == "smooth")
    hint = "" if ok else ": sweep in smaller steps, or use --option lookup=smooth"
    return threshold_test("interpolation", worst, ok, "; ".join(words) + hint, dof=len(axes))
