"""What coarse codes do to a misfit: nothing smaller than that is named."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.diagnosis.account import Account, Term, settle, summed
from tiltcal.diagnosis.evidence import Ledger
from tiltcal.diagnosis.faults import Fault
from tiltcal.diagnosis.select import findings
from tiltcal.scenario import Scenario


def code_floors(scenario: Scenario, faults: Sequence[Fault]) -> dict[str, float]:
    """Size, SI, below which the codes of a sensor, or of the table's readout, make whatever they like; by sensor."""
    floors: dict[str, float] = {}
    for fault in faults:
        if fault.effect.id in ("adc_quantisation", "gyr_quantisation"):
            for name in fault.sensors:
                floors[name] = max(floors.get(name, 0.0), fault.effect.value("lsb"))
        if fault.effect.id == "adc_stuck_bit" and not scenario.rig.axes:  # nothing but a table tells which readings lack it
            floors[fault.sensors[0]] = max(floors.get(fault.sensors[0], 0.0), fault.effect.value("bit_value"))
        if fault.effect.id == "data_truncation":
            for sensor in scenario.sensor:
                size = scenario.site.gravity if sensor.kind == "accelerometer" else 1.0
                size = sensor.rate_hz if sensor.quantity == "rate" else size
                floors[sensor.name] = max(floors.get(sensor.name, 0.0), size * fault.effect.value("step"))
    return floors


def above(account: Account, ledger: Ledger, floors: Mapping[str, float], blurred: bool = False) -> Account:
    """The account without findings that are nowhere larger than what coarse codes do.

    Args:
        blurred: whether the table's angles are cut: rates and accelerations derived from them say nothing.
    """
    observations = ledger.observations
    kept: list[Term] = []
    for places in findings(account):
        inside = [account.terms[k] for k in places]
        largest: dict[str, float] = {}
        for i, change in summed(inside, observations, account.effects).items():
            name = observations.channels[i].sensor
            largest[name] = max(largest.get(name, 0.0), float(np.abs(change).max()))
        smooth = not (blurred and inside[0].effect.needs == "motion")
        seen = any(size > floors.get(name, 0.0) > 0 for name, size in largest.items()) or not set(largest) & set(floors)
        if smooth and seen:
            kept += inside
    return settle(replace(account, terms=tuple(kept)), ledger)
