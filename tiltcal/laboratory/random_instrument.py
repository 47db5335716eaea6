"""A plausible instrument and table of a grade, drawn from the catalogue's ranges with a seed."""

from collections.abc import Sequence

import numpy as np

from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import GRADES, Effect
from tiltcal.forward.signal_chain import stream
from tiltcal.setup.setup import Sensor, Setup

ORDINARY = (
    "table_levelling",
    "table_encoder_zero",
    "table_encoder_eccentricity",
    "table_encoder_2rev",
    "table_axis_wobble",
    "axis_nonorthogonality",
    "table_sag",
    "mount_misalignment",
    "acc_bias",
    "acc_scale",
    "acc_cross_axis",
    "acc_K2",
    "acc_K3",
    "acc_Kip",
    "acc_Kio",
    "acc_Kpo",
    "acc_temp_bias",
    "acc_temp_scale",
    "acc_noise",
    "gyr_bias",
    "gyr_scale",
    "gyr_misalignment",
    "gyr_gsens",
    "gyr_temp",
    "gyr_noise",
    "fog_bias",
    "fog_scale",
    "fog_axis_error",
)
"""What every instrument on every table has; rarer effects are named by the scenario."""
SPREAD = (0.1, 1.0)  # of the plausible size, log-uniform


def draw_instrument(setup: Setup, grade: str, seed: int) -> list[Effect]:
    """One effect of each ordinary id on each sensor or axis, sizes log-uniform below the plausible
    one, signs at random.

    Args:
        setup: site, rig, sensors.
        grade: precision, mid_mems or consumer.
        seed: the same draws the same instrument; each effect has its own stream.
    """
    found: list[Effect] = []
    for id in ORDINARY:
        cls = CATALOGUE[id]
        if (cls.stage == "table" or cls.on_table) and not setup.rig.axes:
            continue
        sensors: Sequence[Sensor | None] = setup.sensors(*cls.kinds) if cls.kinds else [None]
        axes: Sequence[str | None] = (
            setup.rig.axis_names if cls.axis_wise and id != "table_sag" else [None]
        )
        for sensor in sensors:
            for axis in axes:
                rng = stream(seed, "grade", id, sensor.name if sensor else axis)
                values = {}
                for p in cls.parameters:
                    for name in p.expand(sensor.axes if sensor else ()):
                        size = p.plausible[GRADES.index(grade)] * np.exp(
                            rng.uniform(*np.log(SPREAD))
                        )
                        values[f"{name}{p.suffix}"] = float(
                            size if p.positive else size * rng.choice([-1.0, 1.0])
                        )
                found.append(
                    make_effect(
                        id, values, setup, sensor=sensor.name if sensor else None, axis=axis
                    )
                )
    return found
