"""Learned effects as tables of a scenario file."""

from collections.abc import Mapping
from typing import Any

from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.frames import AXES
from tiltcal.effects.curve_coordinates import (
    COORDINATES,
    INPUTS,
    LAST_DIRECTION,
    MOTION,
    TURN_RATE,
    coordinate_named,
)
from tiltcal.effects.learned import (
    Learned,
    LearnedDelay,
    LearnedReading,
    LearnedReadout,
    LearnedTilt,
)
from tiltcal.effects.learned_keys import (
    AMOUNTS,
    amount_of,
    check_keys,
    check_knots,
    check_power,
    check_relaxing,
    instants_of,
    label_of,
    numbers_of,
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
        TiltcalError: a key or its value is wrong.
    """
    subject = f"{subject} learned"
    check_keys(table, subject)
    on = label_of(table, "on", "reading", KINDS, subject)
    coordinates = (*_angles(), *_turn_rates(setup), *COORDINATES)
    coordinate = label_of(table, "coordinate", "", coordinates, subject)
    place = label_of(table, "place", "sensor", STAGES, subject)
    knots, numbers = (
        numbers_of(table.get(key, ()), f"{subject}, key {key}") for key in ("knots", "coefficients")
    )
    check_knots(knots, numbers, subject)
    slot, turn = _where(on, coordinate, table, setup, sensor, axis, subject)
    amounts: dict[str, Any] = {key: amount_of(table, key, subject) for key in AMOUNTS}
    instants = instants_of(table, coordinate, amounts, numbers, subject)
    check_power(amounts["power"], knots, numbers, subject)
    whether: dict[str, Any] = {
        key: bool(table.get(key)) for key in ("per_input", "relaxing", "odd", "holds")
    }
    check_relaxing(whether["relaxing"], on, coordinate, amounts["lag_s"], subject)
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
        beside=_second_angle(table, setup, subject),
        times=_times(table, setup, subject),
        instants=instants,
        **whether,
        **{field: amounts[key] for key, field in AMOUNTS.items()},
    )


def _angles() -> list[str]:
    return [angle_channel(axis) for axis in axis_names()]


def _turn_rates(setup: Setup) -> list[str]:
    return [f"{TURN_RATE}{axis}" for axis in setup.rig.kind.turning]


def _second_angle(table: Mapping[str, Any], setup: Setup, subject: str) -> str:
    """The second angle of a product; empty where there is none."""
    if "beside" not in table:
        return ""
    beside = label_of(table, "beside", "", _angles(), subject)
    if axis_of(beside) not in setup.rig.axis_names or axis_of(str(table.get("coordinate"))) is None:
        raise TiltcalError(
            f"{subject}, key beside",
            found=f"'{beside}' over '{table.get('coordinate')}'",
            need="two angles of this table",
            do="correct it",
        )
    return beside


def _times(table: Mapping[str, Any], setup: Setup, subject: str) -> str:
    """What a curve is multiplied by; empty where that is nothing. A frame
    follows no quantity that only a sensor senses.
    """
    if table.get("times") and table.get("beside"):
        raise TiltcalError(
            f"{subject}, key times",
            found=f"'{table['times']}' and beside = '{table['beside']}'",
            need="one of them",
            do="leave one out",
        )
    angles = [angle_channel(axis) for axis in setup.rig.axis_names]
    last = [f"{LAST_DIRECTION}{axis}" for axis in setup.rig.kind.turning]
    sensed = INPUTS if table.get("on", "reading") == "reading" else ()
    factors = (
        "",
        "temperature",
        "time",
        "speed",
        *angles,
        *last,
        *_turn_rates(setup),
        *sensed,
    )
    return label_of(table, "times", "", factors, subject)


def _require_kind(name: str, setup: Setup, sensor: str, subject: str) -> None:
    """Refuse a coordinate on a sensor that does not sense it."""
    asked = coordinate_named(name)
    if asked.sensors and setup.named(sensor).kind not in asked.sensors:
        raise TiltcalError(
            subject,
            found=f"coordinate '{name}' of sensor '{sensor}'",
            need=asked.need,
            do="correct it",
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
    the stage.
    """
    axis_named = axis_of(coordinate)
    of_frames = ["time", "temperature", "warming", *_turn_rates(setup), *MOTION]
    if on == "stamps":
        if coordinate != "time" or axis is not None:
            raise TiltcalError(
                subject,
                found=f"coordinate '{coordinate}', axis {axis}",
                need="coordinate 'time' and no axis: all channels of a sensor lag together",
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
    _require_kind(coordinate, setup, str(sensor), subject)
    axes = setup.named(str(sensor)).axes if on == "reading" else setup.rig.axis_names
    if on != "tilt":
        one_of(str(axis), axes, subject, "axis")
        return "", ""
    slot = label_of(table, "slot", "", setup.rig.kind.slots, subject)
    return slot, label_of(table, "turn", "", AXES, subject)


def learned_table(effect: Learned) -> dict[str, Any]:
    """A learned effect as the table of a scenario file: the inverse of ``make_learned``."""
    on = next(label for label, cls in KINDS.items() if isinstance(effect, cls))
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
