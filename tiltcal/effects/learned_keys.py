"""Keys of the table of a learned effect: their valid values."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.core.errors import TiltcalError, nearest, one_of

AMOUNTS = {
    "lag_s": "lag",
    "period": "period",
    "power": "power",
    "play": "play",
    "rise_s": "rise",
    "fall_s": "fall",
}
"""Keys of numbers that are not negative, and the fields that they are of."""
KNOWN = {
    "coordinate",
    "knots",
    "beside",
    "odd",
    "coefficients",
    "on",
    "slot",
    "turn",
    "per_input",
    "times",
    "relaxing",
    "holds",
    "instants",
    "place",
    *AMOUNTS,
}


def check_keys(table: Mapping[str, Any], subject: str) -> None:
    """Every key is a key of a learned effect; ``subject``: what errors name.

    Raises:
        TiltcalError: one is not.
    """
    for key in table:
        if key not in KNOWN:
            raise TiltcalError(
                subject,
                found=f"unknown key '{key}'",
                need="a key of it",
                do=nearest(key, sorted(KNOWN)),
            )


def check_power(
    power: float, knots: Sequence[float], numbers: Sequence[float], subject: str
) -> None:
    """A power stands alone, with one coefficient.

    Raises:
        TiltcalError: it does not.
    """
    if power and (knots or len(numbers) > 1):
        raise TiltcalError(
            subject,
            found=f"power with {len(knots)} knots and {len(numbers)} coefficients",
            need="one coefficient, no knots",
            do="leave out the power, or the curve",
        )


def check_knots(knots: Sequence[float], numbers: Sequence[float], subject: str) -> None:
    """Knots increase, and have a coefficient each.

    Raises:
        TiltcalError: they do not.
    """
    if knots and (len(knots) != len(numbers) or len(knots) < 2 or np.any(np.diff(knots) <= 0)):
        raise TiltcalError(
            subject,
            found=f"{len(knots)} knots, {len(numbers)} coefficients",
            need="two or more increasing knots, one coefficient each",
            do="correct the lists",
        )


def instants_of(
    table: Mapping[str, Any],
    coordinate: str,
    amounts: Mapping[str, float],
    numbers: Sequence[float],
    subject: str,
) -> tuple[float, ...]:
    """When transients have their peaks, s; none of another curve.

    Raises:
        TiltcalError: they are not alone, or lack a rise or a fall.
    """
    instants = numbers_of(table.get("instants", ()), f"{subject}, key instants")
    rise, fall = amounts["rise_s"], amounts["fall_s"]
    if not (instants or rise or fall):
        return ()
    alone = coordinate == "time" and not any(k in table for k in ("knots", "period", "power"))
    if not (alone and rise and fall and len(instants) == len(numbers)):
        raise TiltcalError(
            f"{subject}, key instants",
            found=f"{len(instants)} instants and {len(numbers)} coefficients over '{coordinate}',"
            f" rise_s = {rise:g}, fall_s = {fall:g}",
            need="instants over time with a coefficient each, a rise_s, a fall_s, no other form",
            do="correct it",
        )
    return tuple(instants)


def amount_of(table: Mapping[str, Any], key: str, subject: str) -> float:
    """A number that is not negative; 0 where the key is not given.

    Raises:
        TiltcalError: it is none.
    """
    value = table.get(key, 0.0)
    if not isinstance(value, int | float) or not value >= 0:
        need = "seconds, not negative" if key == "lag_s" else "a number, not negative"
        raise TiltcalError(f"{subject}, key {key}", found=repr(value), need=need, do="correct it")
    return float(value)


def check_relaxing(relaxing: bool, on: str, coordinate: str, lag: float, subject: str) -> None:
    """Only a lagged curve of a tilt or a readout leaves something.

    Raises:
        TiltcalError: it cannot.
    """
    if relaxing and (on == "reading" or not lag or coordinate in ("temperature", "warming")):
        raise TiltcalError(
            f"{subject}, key relaxing",
            found=f"on = '{on}', coordinate = '{coordinate}', lag_s = {lag:g}",
            need="a tilt or a readout over a motion or a force, with a lag_s",
            do="leave it out, or give a lag_s",
        )


def label_of(
    table: Mapping[str, Any], key: str, default: str, valid: Collection[str], subject: str
) -> str:
    """The value of a key, which is a valid label.

    Raises:
        TiltcalError: it is not.
    """
    return one_of(str(table.get(key, default)), valid, f"{subject}, key {key}")


def numbers_of(values: Any, subject: str) -> list[float]:
    """A list of numbers.

    Raises:
        TiltcalError: it is none.
    """
    if not isinstance(values, list | tuple) or not all(
        isinstance(v, int | float) and np.isfinite(v) for v in values
    ):
        raise TiltcalError(
            subject, found=repr(values)[:60], need="a list of numbers", do="correct it"
        )
    return [float(v) for v in values]
