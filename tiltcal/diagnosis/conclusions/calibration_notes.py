"""What is said of the calibration where the adjustable terms take up what they should not."""

import numpy as np

from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import PRIOR

FAR = 5.0  # standard deviations of their prior: one term in two million is as large
AT_ONE_POINT = (
    "The table does not move, and the adjustable terms take up whatever the readings of its stops"
    " are off: only changes in time were tested. Record more attitudes, and the moves between them."
)


def untested_of(observations: Observations, rank: int) -> list[str]:
    """What was not tested, where all is at rest, at so few stops that the fitted parameters take up
    every mean.

    Args:
        observations: what was read; rank: independent parameters fitted to it.
    """
    stops = [channel.stop for channel in observations.channels]
    still = observations.scenario.rig.axes and all(bool((stop >= 0).all()) for stop in stops)
    few = sum(len(np.unique(stop)) for stop in stops) <= rank
    return [AT_ONE_POINT] if still and few else []


def implausible(fitted: FittedModel) -> list[str]:
    """The adjustable terms that are far larger than any instrument's, as notes."""
    found = []
    for term in fitted.nuisance:
        effect, words = term.effect, []
        for name, value in zip(term.names, term.values, strict=True):
            times = abs(value) / term.hypothesis.size(name)
            if times > FAR * PRIOR:
                words.append(f"{name} is {times:.3g} times a plausible size")
        if words:
            where = f" of {effect.sensor}" if effect.sensor else ""
            found.append(
                f"calibration: {effect.id}{where}: {', '.join(words)}; check the units, the gravity"
                " and the axes that the scenario states"
            )
    return found
