"""An unknown heading of the table, found from the Earth's rate that FOGs and gyros read; a note
where the latitude is missing.

The Earth's horizontal rate is linear in cosine and sine of the heading, so the deviance beside the
calibration is a trigonometric polynomial of the second order: five headings tell all of it.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults.prepare import calibrated
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import robust_white
from tiltcal.statistics.noise_spectrum import NoiseModel

TRIED = 5  # headings: as many as the polynomial has coefficients
GRID = np.deg2rad(np.arange(0.0, 360.0, 0.01))  # rad: a parabola through three of them is exact
RIVAL = 9.0  # of deviance: 3 sigma of one degree of freedom
NO_LATITUDE = (
    "latitude_deg is not stated: the model of {} has no Earth's rate, which then counts as an error"
    " of the sensor"
)


def with_heading(
    scenario: Scenario, recordings: Sequence[Recording], law: type[NoiseModel]
) -> tuple[Scenario, tuple[str, ...]]:
    """The set-up at the heading that fits best, and a note that says which, where it is unknown and
    the recordings tell it; else as it was, with a note where the latitude is missing.

    Args:
        scenario: what is known of the set-up.
        recordings: of it, as they were read: a fault of theirs is the same at every heading.
        law: kind of noise model.
    """
    site = scenario.site
    rates = [s.name for s in scenario.sensor if not s.is_accelerometer]
    if not (rates and scenario.rig.axes):
        return scenario, ()
    if site.latitude_deg is None:
        return scenario, (NO_LATITUDE.format(", ".join(rates)),)
    if site.heading_deg != "unknown":
        return scenario, ()
    headings = 360.0 / TRIED * np.arange(TRIED)
    tried = [_left(_at(scenario, h), recordings, law) for h in headings]
    noise = [robust_white(r) for r in tried[0]]
    each = [
        sum(float(r @ r) / s**2 for r, s in zip(left, noise, strict=True) if s > 0)
        for left in tried
    ]
    deviance, curvature = _over_the_circle(np.deg2rad(headings), np.array(each))
    if np.ptp(deviance) < RIVAL:  # any heading fits
        return scenario, ()
    best = int(np.argmin(deviance))
    heading, sigma = np.rad2deg(GRID[best]), np.rad2deg(np.sqrt(2 / curvature[best]))
    lowest = (deviance < np.roll(deviance, 1)) & (deviance < np.roll(deviance, -1))
    near = np.rad2deg(GRID[lowest & (deviance - deviance[best] < RIVAL)])
    others = "".join(f" or {h:.2f}" for h in near if h != heading)
    told = (
        f"heading_deg was unknown: {heading:.2f} +- {sigma:.2f} (in white noise){others} fits best,"
        " with the rest of the calibration; it is used"
    )
    return _at(scenario, float(heading)), (told,)


def _at(scenario: Scenario, heading: float) -> Scenario:
    """The set-up at a heading, deg."""
    site = scenario.site.model_copy(update={"heading_deg": float(heading)})
    return scenario.model_copy(update={"site": site})


def _left(
    scenario: Scenario, recordings: Sequence[Recording], law: type[NoiseModel]
) -> list[Array]:
    """What the calibrated set-up leaves of each channel, its rows weighed, (n,) each."""
    known = [e for e in scenario.effects if not e.repair]
    observations = observe(scenario, recordings, known)
    start, _ = calibrated(observations, law)
    left = observations.residuals(start.effects)
    return [c.weighed(r) for c, r in zip(observations.channels, left, strict=True)]


def _over_the_circle(headings: Array, deviance: Array) -> tuple[Array, Array]:
    """The polynomial through some deviances, and its second derivative, on the grid."""
    order = np.arange(TRIED // 2 + 1)

    def waves(at: Array) -> Array:
        return np.hstack([np.cos(np.outer(at, order)), np.sin(np.outer(at, order[1:]))])

    coefficients = np.linalg.solve(waves(headings), deviance)
    second = -(np.concatenate([order, order[1:]]) ** 2)
    return waves(GRID) @ coefficients, waves(GRID) @ (second * coefficients)
