"""Instruments by their files: CAL.json, or the scenario that a diagnosis amended."""

import json
from pathlib import Path

import numpy as np

from tiltcal.calibration.result import Calibration, Estimate, load_calibration
from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import (
    AngleEffect,
    Effect,
    FrameEffect,
    SignalEffect,
    TermEffect,
    WorldEffect,
)
from tiltcal.effects.sensor.dynamics import AccBandwidth
from tiltcal.instrument.terms import term_name
from tiltcal.laboratory.scenario import Scenario, load_scenario

AMENDED = "amended"
"""Method of a calibration that is the effects of a scenario."""
FILTERS = AccBandwidth.order
"""From this order on the chain filters, clips and converts a reading: that has no inverse."""


def load_instrument(path: Path | str) -> Calibration:
    """A calibration from CAL.json, or from a scenario with effects such as ``amended.toml``.

    Raises:
        TiltcalError: it is neither.
    """
    path = Path(path)
    return instrument_of(load_scenario(path)) if path.suffix == ".toml" else load_calibration(path)


def instrument_of(scenario: Scenario) -> Calibration:
    """The effects on the signals of a scenario as a calibration.

    Terms of the model equation become parameters, with the uncertainties that are stated; other
    effects are corrected as they are. Effects of table, mount and environment are kept for `check`,
    which knows the table's angles. Noise, filters, converters and clocks are left out.

    Raises:
        TiltcalError: no effect acts on a sensor.
    """
    parameters: dict[str, Estimate] = {}
    others: list[Effect] = []
    for effect in scenario.effects:
        if isinstance(effect, WorldEffect | AngleEffect | FrameEffect) and not effect.random:
            others.append(effect)
        if not isinstance(effect, SignalEffect) or effect.random or effect.order >= FILTERS:
            continue
        shaped = any(p.is_shape and effect.value(p.name) for p in effect.parameters)
        if isinstance(effect, TermEffect) and effect.row_wise and not shaped:
            for name, value in effect.sizes.items():
                key = f"{effect.sensor}.{term_name(name)}"
                before = parameters.get(key, Estimate(0.0, 0.0, "si"))
                sigma = float(np.hypot(before.sigma, effect.sigmas.get(name, 0.0)))
                parameters[key] = Estimate(before.value + value, sigma, "si")
        else:
            others.append(effect)
    if not parameters and not any(e.sensor for e in others):
        raise TiltcalError(
            f"scenario {scenario.name}",
            found="no effect on a sensor",
            need="an amended scenario, or a calibration (CAL.json)",
            do="name amended.toml of `tiltcal diagnose`, or make a CAL.json with"
            " `tiltcal calibrate`",
        )
    bare = scenario.bare
    parameters["temperature.T0"] = Estimate(scenario.site.temperature_degC, 0.0, "degC")
    return Calibration(
        AMENDED,
        "cannot_tell",
        parameters,
        np.diag([e.sigma**2 for e in parameters.values()]),
        warnings=[f"the effects of scenario {scenario.name}, not a calibration of its own"],
        provenance={"setup": json.loads(bare.model_dump_json(exclude_none=True))},
        effects=others,
    )
