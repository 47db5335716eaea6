"""Errors of the references of a simulated laboratory, drawn from their stated uncertainties."""

import numpy as np

from tiltcal.effects import Effect, make_effect
from tiltcal.effects.table.readout import SettingScatter
from tiltcal.forward.signal_chain import stream
from tiltcal.laboratory.scenario import Scenario, fresh
from tiltcal.recordings.references import (
    DIVISOR,
    OF_SITE,
    effect_of_source,
    site_with_error,
)
from tiltcal.setup.setup import Setup


def with_reference_errors(scenario: Scenario, seed: int) -> Scenario:
    """The laboratory as it may truly be: each stated source with an error from its distribution.

    What is drawn at each stop is drawn by the simulation itself.

    Args:
        scenario: with its ``[[budget]]`` tables.
        seed: of the errors.

    Raises:
        TiltcalError: a source is unknown, or does not fit the set-up.
    """
    rng = stream(seed, "references")
    site: Setup = scenario
    errors: list[Effect] = []
    for k, table in enumerate((t for t in scenario.budget if not t.assumed), start=1):
        for key, size in (table.model_extra or {}).items():
            flat = table.distribution == "rectangular"
            draw = rng.uniform(-np.sqrt(3), np.sqrt(3)) if flat else rng.normal()
            at_stops = table.id == SettingScatter.id
            error = float(size) / DIVISOR[table.distribution] * (1.0 if at_stops else draw)
            if table.id in OF_SITE:
                site = site_with_error(site, key, error)
                continue
            id, name = effect_of_source(table.id, key)
            errors.append(
                make_effect(
                    id,
                    {name: error},
                    scenario,
                    sensor=table.sensor,
                    axis=table.axis,
                    subject=f"budget {k}",
                )
            )
    if not errors and site is scenario:
        return scenario
    found = fresh(scenario, site=site.site)
    found.__dict__["effects"] = (*scenario.effects, *errors)
    return found
