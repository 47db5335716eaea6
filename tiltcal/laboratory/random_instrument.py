"""A plausible instrument and table of a grade, drawn from the catalogue's ranges with a seed."""

from collections.abc import Sequence

import numpy as np

from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import Effect
from tiltcal.effects.parameter import GRADES, STAGES
from tiltcal.forward.signal_chain import stream
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

SPREAD = (0.1, 1.0)  # of the plausible size, log-uniform


def ordinary_effects() -> list[type[Effect]]:
    """What every instrument on every table has; rarer effects are named by the scenario.

    In the order of the chain, those of one axis before those of the whole table.
    """
    ordinary = [cls for cls in CATALOGUE.values() if cls.ordinary]
    return sorted(ordinary, key=lambda cls: (STAGES.index(cls.stage), not cls.axis_wise))


def draw_instrument(setup: Setup, grade: str, seed: int) -> list[Effect]:
    """One of each ordinary effect on each sensor or axis, sizes log-uniform below the plausible
    one, signs at random.

    Args:
        setup: site, rig, sensors.
        grade: precision, mid_mems or consumer.
        seed: the same draws the same instrument; each effect has its own stream.
    """
    found: list[Effect] = []
    for cls in ordinary_effects():
        if not cls.shows_on(setup.rig):
            continue
        sensors: Sequence[Sensor | None] = setup.sensors(*cls.kinds) if cls.kinds else [None]
        axes = (None,) if cls.axis_by_gravity else cls.axes_on(setup.rig)
        for sensor in sensors:
            for axis in axes:
                rng = stream(seed, "grade", cls.id, sensor.name if sensor else axis)
                values = {}
                for p in cls.parameters:
                    for name in p.expand(sensor.axes if sensor else ()):
                        size = p.plausible[GRADES.index(grade)] * np.exp(
                            rng.uniform(*np.log(SPREAD))
                        )
                        drawn = size if p.positive else size * rng.choice([-1.0, 1.0])
                        if p.stands_on(setup.rig):
                            values[f"{name}{p.suffix}"] = float(drawn)
                found.append(
                    make_effect(
                        cls.id, values, setup, sensor=sensor.name if sensor else None, axis=axis
                    )
                )
    return found
