"""The limit that coarse codes set: nothing smaller than their effect is named."""

from collections.abc import Sequence

import numpy as np

from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, summed, waves_of
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_named
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.electronics.converter import AdcQuantisation, AdcStuckBit
from tiltcal.effects.learned import Learned
from tiltcal.laboratory.scenario import Scenario
from tiltcal.statistics.least_squares import column_space

BLURRED = ("motion", "direction")  # needs of what moves tell: rates, and which way a table came


def code_floors(scenario: Scenario, faults: Sequence[Fault]) -> dict[str, float]:
    """Size, SI, below which the codes of a sensor, or of the table's readout, determine the misfit;
    by sensor. What truncated axes do to a reading adds up.
    """
    floors: dict[str, float] = {}
    cut = sum(f.effect.value("step") for f in faults if isinstance(f.effect, DataTruncation))
    if cut:
        for sensor in scenario.sensor:
            size = scenario.site.gravity if sensor.kind == "accelerometer" else 1.0
            size = sensor.rate_hz if sensor.quantity == "rate" else size
            floors[sensor.name] = size * cut
    for fault in faults:
        if isinstance(fault.effect, AdcQuantisation):
            for name in fault.sensors:
                floors[name] = max(floors.get(name, 0.0), fault.effect.value("lsb"))
        # nothing but a table tells which readings lack it
        if isinstance(fault.effect, AdcStuckBit) and not scenario.rig.axes:
            floors[fault.sensors[0]] = max(
                floors.get(fault.sensors[0], 0.0), fault.effect.value("bit_value")
            )
    return floors


def needs_motion(effect: Effect) -> bool:
    """Whether only rates, accelerations or the direction of approach show an effect: truncated
    angles hide it.
    """
    follows = isinstance(effect, Learned) and coordinate_named(effect.coordinate).follows
    return effect.needs in BLURRED or follows == "rate"


def above_codes(terms: Sequence[FittedTerm], fitted: FittedModel, whitened: WhitenedModel) -> bool:
    """Whether a cause is anywhere larger than what coarse codes do to a reading, or acts on no
    sensor with coarse codes; of a curve, which may be large where it was not held, the part that
    calibration does not absorb. What only motion shows is hidden where the angles are truncated.

    Args:
        terms: the law, then its deviation.
        fitted: a model, for its calibration.
        whitened: has the sensors with coarse codes.
    """
    floors, observations = whitened.floors, whitened.observations
    if observations.cut and needs_motion(terms[0].hypothesis.effect):
        return False
    if not floors:
        return True
    curve = not terms[0].hypothesis.textbook
    about = whitened.columns.shared_about or fitted.effects
    calibration = waves_of(whitened.columns, fitted.nuisance if curve else (), about)
    met = False
    for i, change in summed(terms, whitened).items():
        floor = floors.get(observations.channels[i].sensor)
        if floor is None:
            continue
        met = True
        Q = column_space(
            np.column_stack([np.zeros_like(change), *(c[i] for c in calibration if i in c)])
        )
        left = observations.channels[i].of_waves(change - Q @ (Q.T @ change))
        size = float(np.sqrt(np.mean(left**2)) if curve else np.abs(left).max())
        if size > floor:
            return True
    return not met
