"""An unknown heading of the table, found from the Earth's rate that FOGs and gyros read.

The Earth's horizontal rate is linear in cosine and sine of the heading, so the deviance beside the
calibration is a trigonometric polynomial of the second order: five headings tell all of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data_quality.prepare import PreparedData
from tiltcal.laboratory.scenario import Scenario
from tiltcal.statistics.dwell_noise import robust_white

TRIED = 5  # headings: as many as the polynomial has coefficients
GRID = np.deg2rad(np.arange(0.0, 360.0, 0.01))
RIVAL = 9.0  # of deviance: 3 sigma of one degree of freedom


def with_heading(scenario: Scenario, prepared: Callable[[Scenario], PreparedData]) -> PreparedData:
    """Recordings prepared at the heading that fits best, where it is unknown and a sensor reads the
    Earth's rate; a note says which.

    Args:
        scenario: what is known of the set-up.
        prepared: the recordings, by a scenario.
    """
    site = scenario.site
    rates = [s for s in scenario.sensor if not s.is_accelerometer]
    unknown = site.heading_deg == "unknown" and site.latitude_deg is not None
    if not (unknown and rates and scenario.rig.axes):
        return prepared(scenario)
    headings = 360.0 / TRIED * np.arange(TRIED)
    tried = [prepared(_at(scenario, h)) for h in headings]
    deviance, curvature = _over_the_circle(np.deg2rad(headings), _deviances(tried))
    best = int(np.argmin(deviance))
    if not curvature[best] > 0:  # nothing reads the horizontal rate
        return prepared(scenario)
    heading, sigma = np.rad2deg(GRID[best]), np.rad2deg(np.sqrt(2 / curvature[best]))
    lowest = (deviance < np.roll(deviance, 1)) & (deviance < np.roll(deviance, -1))
    near = np.rad2deg(GRID[lowest & (deviance - deviance[best] < RIVAL)])
    others = "".join(f" or {h:.2f}" for h in near if h != heading)
    told = f"heading_deg was unknown: {heading:.2f} +- {sigma:.2f}{others} fits best, with the rest"
    found = prepared(_at(scenario, float(heading)))
    return replace(found, notes=(*found.notes, f"{told} of the calibration; it is used"))


def _at(scenario: Scenario, heading: float) -> Scenario:
    """The set-up at a heading, deg."""
    site = scenario.site.model_copy(update={"heading_deg": float(heading)})
    return scenario.model_copy(update={"site": site})


def _deviances(tried: Sequence[PreparedData]) -> Array:
    """Of each, under the white noise of the one that leaves least, (n,)."""
    left = [
        [c.weighed(r) for c, r in zip(o.channels, o.residuals(each.start.effects), strict=True)]
        for each, o in ((each, each.observations) for each in tried)
    ]
    energies = np.array([[float(r @ r) for r in channels] for channels in left])
    least = left[int(np.argmin(energies.sum(axis=1)))]
    return np.asarray(energies @ [1 / robust_white(r) ** 2 for r in least])


def _over_the_circle(headings: Array, deviance: Array) -> tuple[Array, Array]:
    """The polynomial through some deviances, and its second derivative, on the grid."""
    order = np.arange(TRIED // 2 + 1)

    def waves(at: Array) -> Array:
        return np.hstack([np.cos(np.outer(at, order)), np.sin(np.outer(at, order[1:]))])

    coefficients = np.linalg.solve(waves(headings), deviance)
    second = -(np.concatenate([order, order[1:]]) ** 2)
    return waves(GRID) @ coefficients, waves(GRID) @ (second * coefficients)
