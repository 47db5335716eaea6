"""The limit that coarse codes set: nothing smaller than their effect is named."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, columns_of, summed
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.electronics.converter import AdcQuantisation, AdcStuckBit
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
    return effect.needs in BLURRED or getattr(effect, "coordinate", "").split("_")[0] in (
        "rate",
        "transverse",
        "coning",
    )


def drop_below_code(
    fitted: FittedModel, whitened: WhitenedModel, floors: Mapping[str, float], blurred: bool = False
) -> FittedModel:
    """The fitted model without findings that are nowhere larger than the effect of coarse codes;
    for curves, without the part that calibration absorbs.

    Args:
        fitted: the model.
        whitened: all hypotheses under its noise.
        floors: of the channels with coarse codes, SI.
        blurred: whether the table's angles are cut.
    """
    observations = whitened.observations
    calibration = columns_of(observations, fitted.nuisance, fitted.effects)
    kept: list[FittedTerm] = []
    for places in fitted.findings():
        inside = [fitted.terms[k] for k in places]
        curve = not inside[0].hypothesis.textbook  # it may be large where it was not held
        largest: dict[str, float] = {}
        for i, change in summed(inside, observations, fitted.effects).items():
            name = observations.channels[i].sensor
            if curve:
                Q = column_space(
                    np.column_stack([np.zeros_like(change), *(c[i] for c in calibration if i in c)])
                )
                size = float(np.sqrt(np.mean((change - Q @ (Q.T @ change)) ** 2)))
            else:
                size = float(np.abs(change).max())
            largest[name] = max(largest.get(name, 0.0), size)
        smooth = not (blurred and needs_motion(inside[0].effect))
        seen = any(size > floors.get(name, 0.0) > 0 for name, size in largest.items()) or not set(
            largest
        ) & set(floors)
        if smooth and seen:
            kept += inside
    return refit(replace(fitted, terms=tuple(kept)), whitened)
