"""The smooth fit of placing-angle tables: ``b = b0 + sum c_n cos(n beta) + s_n sin(n beta)``.

What straight lines between the entries of a placing-angle table miss.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import whitening
from tiltcal.calibration.methods.placing_sweep import AxisTable
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.statistics.least_squares import Fit, linear_fit

ORDERS = (1, 2, 3, 4)


def smooth_fits(
    axes: Sequence[AxisTable], sensor: str, harmonics: int | None
) -> tuple[dict[str, Fit], list[Test], list[str]]:
    """The smooth fit of each axis with its test, and notes on axes that no fit describes.

    Args:
        axes: with their tables.
        sensor: name.
        harmonics: to fit; unless given the fewest from 2 to 4 that describe the table.
    """
    fits: dict[str, Fit] = {}
    tests, notes = [], []
    for a in axes:
        for order in ORDERS[1:] if harmonics is None else (harmonics,):
            names = smooth_names(sensor, a.axis, order)
            if len(names) > len(a.angles):
                break
            fit, test = _smooth_fit(a, names, order)
            if test.passed or harmonics is not None:
                fits[a.axis] = fit
                tests.append(test)
                break
        else:
            notes.append(
                f"no smooth fit of up to {ORDERS[-1]} harmonics describes the table of axis"
                f" {a.axis}"
            )
    return fits, tests, notes


def _smooth_fit(a: AxisTable, names: Sequence[str], order: int) -> tuple[Fit, Test]:
    """Harmonics up to an order, fitted to the entries of a table."""
    whiten = whitening(a.sensor.covariance)
    common = a.sensor.common.times(whiten).propagated()
    fit = linear_fit(names, whiten @ basis(a.angles, order), whiten @ a.sensor.value, common)
    words = (
        f"{len(names)} terms describe {len(a.angles)} entries (variance"
        f" {len(names) / len(a.angles):.2g} of an entry's)"
    )
    return fit, chi2_test(f"smooth fit of {a.axis}", fit.chi2, fit.dof, words)


def smooth_names(sensor: str, axis: str, order: int) -> list[str]:
    """``bias_y, cos1_y, sin1_y, ...`` of a sensor."""
    waves = [f"{sensor}.{part}{n}_{axis}" for n in range(1, order + 1) for part in ("cos", "sin")]
    return [f"{sensor}.bias_{axis}", *waves]


def basis(beta: Array, order: int) -> Array:
    """1, cos beta, sin beta, cos 2 beta, ... (n, 2 order + 1)."""
    waves = [part(n * beta) for n in range(1, order + 1) for part in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(beta), *waves])


def joint_fit(axes: Sequence[AxisTable], smooth: dict[str, Fit]) -> Fit:
    """The smooth parameters of all axes as one fit; its residuals are those of the single visits.

    Sweeps of different axes share no sample: the covariance is block-diagonal.
    """
    from scipy.linalg import block_diag

    fits, solved = smooth.values(), [t for a in axes for t in a.solved]
    p = sum(len(f.names) for f in fits)
    visits = replace(solved[0].visits, columns=np.concatenate([t.visits.columns for t in solved]))
    return Fit(
        tuple(n for f in fits for n in f.names),
        np.concatenate([np.zeros(0), *(f.values for f in fits)]),
        block_diag(*(f.covariance for f in fits)) if p else np.zeros((0, 0)),
        visits.weight(np.concatenate([t.residuals for t in solved])),
        tuple(n for f in fits for n in f.dropped),
        rank=sum(t.rank for t in solved),
        contributions=np.concatenate(
            [np.zeros((0, visits.columns.shape[1])), *(f.contributions for f in fits)]
        ),
    )


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
