"""The recording of ``tiltcal demo``: an ordinary instrument with one random concealed effect."""

from typing import Any

import numpy as np

from tiltcal.effects.base import Effect
from tiltcal.effects.mount.mounting import MountCompliance, MountSlip
from tiltcal.effects.parameter import GRADES
from tiltcal.effects.sensor.accelerometer import (
    AccBias,
    AccCrossAxis,
    AccK2,
    AccK3,
    AccKio,
    AccKip,
    AccKpo,
    AccScale,
    AccScaleAsym,
)
from tiltcal.effects.sensor.environmental import (
    AccHysteresis,
    AccTempBias,
    AccTempScale,
)
from tiltcal.effects.sensor.noise import AccNoise
from tiltcal.effects.sensor.temporal import AccBiasStep, AccWarmup
from tiltcal.effects.table.geometry import AxisNonorthogonality, AxisWobble, TableLevelling
from tiltcal.effects.table.readout import (
    Encoder2Rev,
    EncoderEccentricity,
    TableBacklash,
    TableSag,
)
from tiltcal.effects.timing.delays import ChannelMuxSkew, DataLatency
from tiltcal.setup.tables import DUAL, angle_key

GRADE = GRADES.index("mid_mems")
SIZES = (0.3, 1.0)  # of the plausible size
SHAPES = {
    "time": (60.0, 140.0),
    "tau": (25.0, 70.0),
}  # s: an event inside the recording, a visible time constant
CONCEALABLE: tuple[type[Effect], ...] = (
    TableLevelling,
    EncoderEccentricity,
    Encoder2Rev,
    AxisWobble,
    AxisNonorthogonality,
    TableSag,
    TableBacklash,
    MountCompliance,
    MountSlip,
    AccK2,
    AccK3,
    AccKip,
    AccKio,
    AccKpo,
    AccScaleAsym,
    AccTempBias,
    AccTempScale,
    AccWarmup,
    AccBiasStep,
    AccHysteresis,
    DataLatency,
    ChannelMuxSkew,
)
TILTS_DEG, TURNS_DEG = range(15, 375, 60), range(20, 380, 72)


def bench() -> dict[str, Any]:
    """The scenario without truth: a tumble of 30 poses on a dual-axis table, in a room with a
    periodic temperature.
    """
    poses = [
        (tilt, turn)
        for k, tilt in enumerate(TILTS_DEG)
        for turn in (TURNS_DEG if k % 2 == 0 else reversed(TURNS_DEG))
    ]
    return {
        "schema": 1,
        "name": "concealed physics",
        "site": {"gravity_m_s2": 9.80123, "latitude_deg": 39.9},
        "rig": {"table": DUAL.name},
        "climate": {"swing_degC": 1.5, "period_s": 130.0},
        "sensor": [
            {
                "name": "accel",
                "kind": "accelerometer",
                "rate_hz": 25.0,
                "adjustable": ["bias", "scale", "cross_axis"],
            }
        ],
        "sequence": [
            {
                "action": "move",
                **dict(zip(map(angle_key, DUAL.axis_names), (float(a), float(b)), strict=True)),
                "rate_deg_s": 25.0,
                "dwell_s": 3.0,
            }
            for a, b in poses
        ],
    }


def ordinary(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Noise and linear errors of an ordinary triad, which calibration adjusts."""
    bias = {f"bias_{a}_ug": float(rng.normal(0, 10000)) for a in "xyz"}
    scale = {f"scale_{a}_ppm": float(rng.normal(0, 3000)) for a in "xyz"}
    cross = {
        f"cross_{a}{b}_ppm": float(rng.normal(0, 2000)) for a in "xyz" for b in "xyz" if a != b
    }
    terms: tuple[tuple[type[Effect], dict[str, float]], ...] = (
        (AccNoise, {"white_ug_rthz": 20.0, "walk_ug_rts": 0.2}),
        (AccBias, bias),
        (AccScale, scale),
        (AccCrossAxis, cross),
    )
    return [{"id": cls.id, "sensor": "accel", **values} for cls, values in terms]


def concealed(rng: np.random.Generator) -> dict[str, Any]:
    """A random effect of the catalogue on one axis, at a plausible size."""
    cls = CONCEALABLE[rng.choice(len(CONCEALABLE))]
    table: dict[str, Any] = {"id": cls.id, "role": "concealed"}
    if cls.kinds:
        table["sensor"] = "accel"
    if cls.axis_wise:
        table["axis"] = DUAL.axis_names[0]
    axis = str(rng.choice(list("xyz")))
    for p in cls.parameters:
        if p.name in SHAPES:
            table[f"{p.name}{p.suffix}"] = float(rng.uniform(*SHAPES[p.name]))
        elif not p.is_shape:
            size = p.plausible[GRADE] * rng.uniform(*SIZES)
            name = p.name.format(axis=axis)
            table[f"{name}{p.suffix}"] = float(
                size if p.positive else size * rng.choice([-1.0, 1.0])
            )
    return table
