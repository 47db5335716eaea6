"""An effect drawn at random, concealed in a simulated recording: what ``tiltcal demo`` lets the
diagnosis find.
"""

from typing import Any

import numpy as np

from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import GRADES

GRADE = GRADES.index("mid_mems")
SIZES = (0.3, 1.0)  # of the plausible size
SHAPES = {
    "time": (60.0, 140.0),
    "tau": (25.0, 70.0),
}  # s: an event inside the recording, a course that it shows
CONCEALABLE = (
    "table_levelling",
    "table_encoder_eccentricity",
    "table_encoder_2rev",
    "table_axis_wobble",
    "axis_nonorthogonality",
    "table_sag",
    "table_backlash",
    "mount_compliance",
    "mount_slip",
    "acc_K2",
    "acc_K3",
    "acc_Kip",
    "acc_Kio",
    "acc_Kpo",
    "acc_scale_asym",
    "acc_temp_bias",
    "acc_temp_scale",
    "acc_warmup",
    "acc_bias_step",
    "acc_hysteresis",
    "data_latency",
    "channel_mux_skew",
)
TILTS_DEG, TURNS_DEG = range(15, 375, 60), range(20, 380, 72)


def bench() -> dict[str, Any]:
    """What an honest user states: a tumble of 30 poses on a dual-axis table in a room that warms up
    and down.
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
        "rig": {"table": "dual"},
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
                "outer_deg": float(a),
                "inner_deg": float(b),
                "rate_deg_s": 25.0,
                "dwell_s": 3.0,
            }
            for a, b in poses
        ],
    }


def ordinary(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Noise and the linear errors of an ordinary triad, which calibration re-tunes."""
    bias = {f"bias_{a}_ug": float(rng.normal(0, 10000)) for a in "xyz"}
    scale = {f"scale_{a}_ppm": float(rng.normal(0, 3000)) for a in "xyz"}
    cross = {
        f"cross_{a}{b}_ppm": float(rng.normal(0, 2000)) for a in "xyz" for b in "xyz" if a != b
    }
    terms = (
        ("acc_noise", {"white_ug_rthz": 20.0, "walk_ug_rts": 0.2}),
        ("acc_bias", bias),
        ("acc_scale", scale),
        ("acc_cross_axis", cross),
    )
    return [{"id": id, "sensor": "accel", **values} for id, values in terms]


def concealed(rng: np.random.Generator) -> dict[str, Any]:
    """One effect of the catalogue on one axis, at a plausible size."""
    cls = CATALOGUE[str(rng.choice(CONCEALABLE))]
    table: dict[str, Any] = {"id": cls.id, "role": "concealed"}
    if cls.kinds:
        table["sensor"] = "accel"
    if cls.axis_wise:
        table["axis"] = "outer"
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
