"""Every effect of the catalogue at a plausible size, and recordings lively enough to show it."""

from functools import cache

import numpy as np
from builders import INSTRUMENT, schedule_of, setup_of

from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import Effect
from tiltcal.effects.parameter import Parameter
from tiltcal.forward.signal_chain import readings
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

ENCODER = Sensor(name="enc", kind="encoder", axes=("a",), of="outer", rate_hz=INSTRUMENT[0].rate_hz)
SETTINGS = {"time": 20.0, "start": 20.0, "frequency": 3.3, "tau": 30.0}
"""Where and when an effect acts in these short recordings, in file units; any other with a default
keeps that.
"""
# plausible ones are beyond the recordings
SMALL = {
    "full_scale": 5.0,
    "max_rate": 10.0,
    "samples": 25.0,
    "length": 10.0,
}


def is_setting(parameter: Parameter) -> bool:
    """Whether a parameter says where, when or how, not how much."""
    return parameter.is_shape


def words(cls: type[Effect], axes: tuple[str, ...], size: float, part: int) -> dict[str, float]:
    """Its parameters as a scenario writes them, ``size`` times the plausible one, no two parameters
    alike but for switches, which are on at any size but none.
    """
    table: dict[str, float] = {}
    for parameter in cls.parameters:
        for name in parameter.expand(axes):
            if is_setting(parameter):
                value = SETTINGS.get(name, parameter.default / parameter.factor)
            else:
                share = 1 - 0.13 * (len(table) % 5)
                value = size * share * SMALL.get(name, parameter.plausible[part])
            if parameter.switch:
                value = float(size != 0)
            table[name + parameter.suffix] = value
    return table


def sensors_for(cls: type[Effect], setup: Setup) -> list[Sensor | None]:
    """The sensors it can sit on; [None] when it acts on the rig."""
    return [s for s in setup.sensor if s.kind in cls.kinds] if cls.kinds else [None]


def plausible(
    id: str,
    setup: Setup,
    sensor: Sensor | None = None,
    *,
    axis: str | None = None,
    size: float = 1.0,
    part: int = 1,
) -> Effect:
    """An effect at ``size`` times its plausible size of a grade (0 precision, 1 mid, 2
    consumer).
    """
    cls = CATALOGUE[id]
    axes = sensor.axes if sensor else ()
    return make_effect(
        id, words(cls, axes, size, part), setup, sensor=sensor.name if sensor else None, axis=axis
    )


ROUND_TRIP = [
    {"action": "rest", "dwell_s": 1},
    {"action": "sweep", "outer_deg": 360, "step_deg": 45, "rate_deg_s": 90, "dwell_s": 1},
    {"action": "sweep", "outer_deg": 0, "step_deg": 60, "rate_deg_s": 90, "dwell_s": 1},
]
STEPS: dict[str, list[dict[str, object]]] = {
    "placing": ROUND_TRIP,
    "vertical": ROUND_TRIP,
    "dual": [
        {"action": "move", "outer_deg": o, "inner_deg": i, "rate_deg_s": 60, "dwell_s": 1}
        for o, i in [
            (0, 0),
            (30, 100),
            (75, -140),
            (-60, 20),
            (-120, 80),
            (150, 170),
            (20, 10),
            (30, 100),
            (75, -140),
        ]
    ],
    "three": [
        {"action": "rest", "dwell_s": 1},
        *(
            {"action": "turn", "axis": a, "angle_deg": d, "rate_deg_s": 60, "dwell_s": 0.5}
            for a in ("outer", "middle", "inner")
            for d in (400, -350)
        ),
        {
            "action": "oscillate",
            "axis": "middle",
            "amplitude_deg": 20,
            "frequency_hz": 2.0,
            "cycles": 6,
        },
    ],
}


@cache
def lively(table: str) -> tuple[Setup, object, dict[str, np.ndarray]]:
    """A set-up with a whole instrument off the axes, a course with temperature in it, and the
    stamps.
    """
    about = {"lever_arm_m": (0.05, -0.03, 0.08), "readout": "command"}
    setup = setup_of(table, *INSTRUMENT, ENCODER, heading=20.0, **about)
    course = schedule_of(setup, *STEPS[table], swing_degC=4.0, period_s=25.0, ramp_degC_h=100.0)
    time = np.arange(*course.times, 1 / INSTRUMENT[0].rate_hz)
    return setup, course, {s.name: time for s in setup.sensor}


def lively_readings(table: str, *effects: Effect, seed: int | None = None) -> dict[str, np.ndarray]:
    """What the whole instrument reads with these effects."""
    setup, course, times = lively(table)
    return readings(setup, course, times, effects, seed=seed)


def difference(one: dict[str, np.ndarray], two: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Reading by reading; a sample that only one of them has counts as 1."""
    return {
        n: np.where(np.isnan(one[n]) != np.isnan(two[n]), 1.0, np.nan_to_num(one[n] - two[n]))
        for n in one
    }


def largest(readings_: dict[str, np.ndarray], *names: str) -> float:
    """The largest absolute value over the named sensors (all, when none is named)."""
    return max(
        float(np.abs(values).max())
        for name, values in readings_.items()
        if not names or name in names
    )
