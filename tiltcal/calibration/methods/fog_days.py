"""Field calibrations of several days as one: common scale factors, each day its own bias."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.calibration.validity import VERDICTS, chi2_test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG_H


def axis_covariance(axis: Array, error: float) -> Array:
    """Covariance of the scale factors by an error of the FOG's axis: ``-du_i / u_i``, du across u.

    Args:
        axis: input axis of the FOG, (3,).
        error: its standard uncertainty in each direction across it, rad.
    """
    u = np.where(axis == 0, np.inf, axis)
    across = np.eye(3) - np.outer(axis, axis)
    return np.asarray(error**2 * across / np.outer(u, u))


def combined(days: Sequence[Calibration], gyro: str, common: Array) -> Calibration:
    """The weighted mean of the scale factors, with a test that the days agree; the bias is that of
    the last day.

    Args:
        days: calibrations by ``fog_scale``, in order.
        gyro: name of the triad.
        common: covariance of the scale factors that all days share: it does not average, (3, 3).
    """
    scale = [f"{gyro}.scale_{a}" for a in AXES]
    values, weights = [], []
    for day in days:
        place = [list(day.parameters).index(n) for n in scale]
        values.append(np.array([day.value(n) for n in scale]))
        weights.append(np.linalg.inv(np.asarray(day.covariance)[np.ix_(place, place)]))
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    mean = covariance @ np.sum([w @ v for w, v in zip(weights, values, strict=True)], axis=0)
    spread = [float((v - mean) @ w @ (v - mean)) for v, w in zip(values, weights, strict=True)]
    words = f"the scale factors of {len(days)} recordings agree within their noise"
    agree = chi2_test("recordings agree", sum(spread), 3 * (len(days) - 1), words)
    last = days[-1]
    place = [list(last.parameters).index(n) for n in scale]
    whole = np.array(last.covariance)
    whole[np.ix_(place, place)] = covariance + common
    sigmas = np.sqrt(np.diag(covariance + common))
    found = {
        n: Estimate(float(v), float(s), "1") for n, v, s in zip(scale, mean, sigmas, strict=True)
    }
    tests = [agree]
    for k, day in enumerate(days):
        tests += [replace(t, name=f"{t.name}, recording {k + 1}") for t in day.tests]
    verdicts = [day.verdict for day in days] + ["good" if agree.passed else "suspect"]
    return replace(
        last,
        verdict=max(verdicts, key=VERDICTS.index),
        parameters={**last.parameters, **found},
        covariance=whole,
        tests=tests,
        poses=[p for day in days for p in day.poses],
        dof=sum(day.dof for day in days),
        warnings=[*last.warnings, *(_bias(k, day, gyro) for k, day in enumerate(days))],
    )


def _bias(number: int, day: Calibration, gyro: str) -> str:
    """The bias of one recording in words."""
    sizes = ", ".join(f"{day.value(f'{gyro}.bias_{a}') / DEG_H:.4g}" for a in AXES)
    return f"bias of recording {number + 1}: {sizes} deg/h; that of the last is kept"
