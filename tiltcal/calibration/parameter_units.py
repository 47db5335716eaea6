"""Units of recovered parameters: those of a user's own method are converted to ours."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

RATIO = "1"
_FIXED = {
    "scale": RATIO,
    "cross": RATIO,
    "gsens": "deg_h_g",
    "K2": "ug_g2",
    "K3": "ug_g3",
    "Koq": "ug_g2",
    "Kip": "ug_g2",
    "Kio": "ug_g2",
    "Kpo": "ug_g2",
}
_SI_OF_THE_CHANNEL = ("bias", "cos", "sin")


def unit_of(name: str, sensors: Mapping[str, Sensor]) -> str | None:
    """The unit of a parameter such as ``accel.bias_x``; None where its name is not known.

    Args:
        name: as CAL.json has it.
        sensors: of the set-up, by name.
    """
    owner, _, term = name.partition(".")
    if owner == "base":
        return "rad"
    stem = term.split("_")[0]
    if stem.rstrip("0123456789") in _SI_OF_THE_CHANNEL and owner in sensors:
        sensor = sensors[owner]
        return "m_s2" if sensor.is_accelerometer else "rad_s" if sensor.of is None else "rad"
    return _FIXED.get(stem)


def in_our_units(result: Calibration, setup: Setup) -> Calibration:
    """The same calibration with every estimate of a known name in the unit that we use for it.

    An empty unit means ours. Values, sigmas and the covariance are converted.

    Raises:
        TiltcalError: a unit is unknown, or of another dimension; a value, sigma or covariance is
            not a finite number.
    """
    subject = f"calibration by {result.method}"
    _require_finite(result, subject)
    sensors = {s.name: s for s in setup.sensor}
    parameters, factors = {}, []
    for name, e in result.parameters.items():
        ours = unit_of(name, sensors)
        unit = e.unit if ours is None else ours
        factor = 1.0 if ours is None else _factor(e, ours, f"{subject}, {name}")
        factors.append(factor)
        parameters[name] = Estimate(float(e.value) * factor, float(e.sigma) * factor, unit)
    covariance = np.asarray(result.covariance) * np.outer(factors, factors)
    by_name = dict(zip(parameters, factors, strict=True))
    references = [
        replace(r, contributions={n: u * by_name[n] for n, u in r.contributions.items()})
        for r in result.references
    ]
    found = replace(result, parameters=parameters, covariance=covariance, references=references)
    if result.assumed_covariance is None:
        return found
    scale = np.outer(factors, factors)
    return replace(found, assumed_covariance=result.assumed_covariance * scale)


def _factor(estimate: Estimate, ours: str, subject: str) -> float:
    """From the unit of an estimate to ours."""
    known = PARAMETER_UNITS | {RATIO: PARAMETER_UNITS["unitless"]}
    stated = str(estimate.unit)
    if stated in ("", ours):
        return 1.0
    quantity = known[ours].quantity
    if stated not in known or known[stated].quantity != quantity:
        valid = [unit for unit, u in known.items() if u.quantity == quantity]
        raise TiltcalError(
            subject,
            found=f"the unit '{stated}'",
            need="one of " + ", ".join(valid),
            do=f"return it in {ours}",
        )
    return known[stated].factor / known[ours].factor


def _require_finite(result: Calibration, subject: str) -> None:
    """Refuse values, sigmas or a covariance that are no finite numbers, and negative sigmas."""
    for name, e in result.parameters.items():
        if not (np.isfinite(e.value) and np.isfinite(e.sigma) and e.sigma >= 0):
            raise TiltcalError(
                f"{subject}, {name}",
                found=f"the value {e.value} with sigma {e.sigma}",
                need="finite numbers, and a sigma of 0 or more",
                do="leave out what was not determined",
            )
    if not np.all(np.isfinite(np.asarray(result.covariance, dtype=float))):
        raise TiltcalError(
            subject,
            found="a covariance with values that are not finite",
            need="finite numbers",
            do="leave out what was not determined",
        )
