"""Learned effects as tables of a scenario file."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.core.errors import TiltcalError, nearest, one_of
from tiltcal.core.frames import AXES
from tiltcal.effects.curve_coordinates import COORDINATES, INPUTS, MOTION, WAY
from tiltcal.effects.learned import (
    Learned,
    LearnedDelay,
    LearnedReading,
    LearnedReadout,
    LearnedTilt,
)
from tiltcal.effects.parameter import STAGES
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import angle_channel, axis_names, axis_of

KINDS: dict[str, type[Learned]] = {
    "reading": LearnedReading,
    "readout": LearnedReadout,
    "tilt": LearnedTilt,
    "stamps": LearnedDelay,
}


AMOUNTS = {
    "lag_s": "lag",
    "period": "period",
    "power": "power",
    "play": "play",
    "rise_s": "rise",
    "fall_s": "fall",
}
"""Keys of numbers that are not negative, and the fields that they are of."""
_KEYS = {
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


def make_learned(
    table: Mapping[str, Any],
    setup: Setup,
    *,
    sensor: str | None,
    axis: str | None,
    role: str | None,
    subject: str,
) -> Learned:
    """A learned effect from a file's table: ``on`` reading, readout, tilt or stamps;
    ``coordinate``, ``knots``, ``coefficients``.

    Raises:
        TiltcalError: a key or a word is wrong.
    """
    subject = f"{subject} learned"
    _check_keys(table, subject)
    on = _word(table, "on", "reading", KINDS, subject)
    coordinate = _word(table, "coordinate", "", (*_angles(), *COORDINATES), subject)
    place = _word(table, "place", "sensor", STAGES, subject)
    knots, numbers = (
        _numbers(table.get(key, ()), f"{subject}, key {key}") for key in ("knots", "coefficients")
    )
    _check_knots(knots, numbers, subject)
    slot, turn = _where(on, coordinate, table, setup, sensor, axis, subject)
    amounts: dict[str, Any] = {key: _amount(table, key, subject) for key in AMOUNTS}
    instants = _instants(table, coordinate, amounts, numbers, subject)
    _check_power(amounts["power"], knots, numbers, subject)
    whether: dict[str, Any] = {
        key: bool(table.get(key)) for key in ("per_input", "relaxing", "odd", "holds")
    }
    _check_relaxing(whether["relaxing"], on, coordinate, amounts["lag_s"], subject)
    return KINDS[on](
        {f"c{k}": value for k, value in enumerate(numbers)},
        sensor,
        axis,
        role,
        coordinate=coordinate,
        knots=tuple(knots),
        slot=slot,
        turn=turn,
        place=place,
        beside=_beside(table, setup, subject),
        times=_times(table, setup, subject),
        instants=instants,
        **whether,
        **{field: amounts[key] for key, field in AMOUNTS.items()},
    )


def _check_keys(table: Mapping[str, Any], subject: str) -> None:
    for key in table:
        if key not in _KEYS:
            raise TiltcalError(
                subject,
                found=f"unknown key '{key}'",
                need="a key of it",
                do=nearest(key, sorted(_KEYS)),
            )


def _check_power(
    power: float, knots: Sequence[float], numbers: Sequence[float], subject: str
) -> None:
    if power and (knots or len(numbers) > 1):
        raise TiltcalError(
            subject,
            found=f"power with {len(knots)} knots and {len(numbers)} coefficients",
            need="one coefficient, no knots",
            do="leave out the power, or the curve",
        )


def _check_knots(knots: Sequence[float], numbers: Sequence[float], subject: str) -> None:
    if knots and (len(knots) != len(numbers) or len(knots) < 2 or np.any(np.diff(knots) <= 0)):
        raise TiltcalError(
            subject,
            found=f"{len(knots)} knots, {len(numbers)} coefficients",
            need="two or more increasing knots, one coefficient each",
            do="correct the lists",
        )


def _instants(
    table: Mapping[str, Any],
    coordinate: str,
    amounts: Mapping[str, float],
    numbers: Sequence[float],
    subject: str,
) -> tuple[float, ...]:
    """When transients have their peaks, s; none of another curve."""
    instants = _numbers(table.get("instants", ()), f"{subject}, key instants")
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


def _angles() -> list[str]:
    return [angle_channel(axis) for axis in axis_names()]


def _amount(table: Mapping[str, Any], key: str, subject: str) -> float:
    value = table.get(key, 0.0)
    if not isinstance(value, int | float) or not value >= 0:
        need = "seconds, not negative" if key == "lag_s" else "a number, not negative"
        raise TiltcalError(f"{subject}, key {key}", found=repr(value), need=need, do="correct it")
    return float(value)


def _beside(table: Mapping[str, Any], setup: Setup, subject: str) -> str:
    """The second angle of a product; empty where there is none."""
    if "beside" not in table:
        return ""
    beside = _word(table, "beside", "", _angles(), subject)
    if axis_of(beside) not in setup.rig.axis_names or axis_of(str(table.get("coordinate"))) is None:
        raise TiltcalError(
            f"{subject}, key beside",
            found=f"'{beside}' over '{table.get('coordinate')}'",
            need="two angles of this table",
            do="correct it",
        )
    return beside


def _times(table: Mapping[str, Any], setup: Setup, subject: str) -> str:
    """What a curve is multiplied by; empty where that is nothing. What a sensor feels, no frame
    does.
    """
    if table.get("times") and table.get("beside"):
        raise TiltcalError(
            f"{subject}, key times",
            found=f"'{table['times']}' and beside = '{table['beside']}'",
            need="one of them",
            do="leave one out",
        )
    angles = [angle_channel(axis) for axis in setup.rig.axis_names]
    ways = [f"{WAY}{axis}" for axis in setup.rig.kind.turning]
    felt = INPUTS if table.get("on", "reading") == "reading" else ()
    factors = ("", "temperature", "time", "speed", *angles, *ways, *felt)
    return _word(table, "times", "", factors, subject)


def _check_relaxing(relaxing: bool, on: str, coordinate: str, lag: float, subject: str) -> None:
    if relaxing and (on == "reading" or not lag or coordinate in ("temperature", "warming")):
        raise TiltcalError(
            f"{subject}, key relaxing",
            found=f"on = '{on}', coordinate = '{coordinate}', lag_s = {lag:g}",
            need="a tilt or a readout over a motion or a force, with a lag_s",
            do="leave it out, or give a lag_s",
        )


def _where(
    on: str,
    coordinate: str,
    table: Mapping[str, Any],
    setup: Setup,
    sensor: str | None,
    axis: str | None,
    subject: str,
) -> tuple[str, str]:
    """Slot and turn of a tilt, both empty for the others, once coordinate and axis are known to fit
    the place.
    """
    axis_named = axis_of(coordinate)
    of_frames = ["time", "temperature", "warming", *MOTION]
    if on == "stamps":
        if coordinate != "time" or axis is not None:
            raise TiltcalError(
                subject,
                found=f"coordinate '{coordinate}', axis {axis}",
                need="coordinate 'time' and no axis: all channels of a sensor are late together",
                do="correct it",
            )
        return "", ""
    if on == "tilt" and table.get("slot") == "mount":
        of_frames += [name for name in INPUTS if name.startswith("force")]
    if on != "reading" and axis_named is None and coordinate not in of_frames:
        raise TiltcalError(
            subject,
            found=f"coordinate '{coordinate}'",
            need=f"a table angle, {', '.join(of_frames[:-1])} or {of_frames[-1]}",
            do="correct it",
        )
    if axis_named is not None and axis_named not in setup.rig.axis_names:
        raise TiltcalError(
            subject,
            found=f"coordinate '{coordinate}'",
            need="an axis of this table",
            do="correct it",
        )
    axes = setup.named(str(sensor)).axes if on == "reading" else setup.rig.axis_names
    if on != "tilt":
        one_of(str(axis), axes, subject, "axis")
        return "", ""
    slot = _word(table, "slot", "", setup.rig.kind.slots, subject)
    return slot, _word(table, "turn", "", AXES, subject)


def _word(
    table: Mapping[str, Any], key: str, default: str, valid: Collection[str], subject: str
) -> str:
    return one_of(str(table.get(key, default)), valid, f"{subject}, key {key}")


def _numbers(values: Any, subject: str) -> list[float]:
    if not isinstance(values, list | tuple) or not all(
        isinstance(v, int | float) and np.isfinite(v) for v in values
    ):
        raise TiltcalError(
            subject, found=repr(values)[:60], need="a list of numbers", do="correct it"
        )
    return [float(v) for v in values]


def learned_table(effect: Learned) -> dict[str, Any]:
    """A learned effect as the table of a scenario file: the inverse of ``make_learned``."""
    on = next(word for word, cls in KINDS.items() if isinstance(effect, cls))
    table: dict[str, Any] = {
        "id": "learned",
        "on": on,
        "coordinate": effect.coordinate,
        "place": effect.place,
    }
    table |= {
        key: value
        for key in ("sensor", "axis", "role", "seen_in", "slot", "turn")
        if (value := getattr(effect, key))
    }
    if effect.earlier:
        table["earlier"] = list(effect.earlier)
    if not effect.lasts:
        table["lasts"] = False
    if effect.knots:
        table["knots"] = list(effect.knots)
    if effect.instants:
        table |= {"instants": list(effect.instants), "rise_s": effect.rise, "fall_s": effect.fall}
    shape = (
        ("per_input", effect.per_input),
        ("times", effect.times),
        ("relaxing", effect.relaxing),
        ("lag_s", effect.lag),
        ("play", effect.play),
        ("period", effect.period),
        ("beside", effect.beside),
        ("power", effect.power),
        ("odd", effect.odd),
        ("holds", effect.holds),
    )
    table |= {key: value for key, value in shape if value}
    return table | {"coefficients": [float(c) for c in effect.coefficients]}
