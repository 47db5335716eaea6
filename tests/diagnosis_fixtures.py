"""A small laboratory for diagnoses: a dual-axis tumble (or another table) with noise and one thing
left out, in memory.
"""

import numpy as np

from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording

SENSORS = {
    "accel": {
        "name": "accel",
        "kind": "accelerometer",
        "rate_hz": 10.0,
        "adjustable": ["bias", "scale", "cross_axis"],
    },
    "incl": {
        "name": "incl",
        "kind": "inclinometer",
        "axes": ["x", "y"],
        "rate_hz": 10.0,
        "adjustable": ["bias", "scale", "cross_axis"],
    },
}
NOISE = {
    "accel": {"id": "acc_noise", "sensor": "accel", "white_ug_rthz": 25.0},
    "incl": {"id": "acc_noise", "sensor": "incl", "white_ug_rthz": 25.0},
}
ORDINARY = [
    {"id": "acc_bias", "bias_x_ug": 3000.0, "bias_y_ug": -2000.0},
    {"id": "acc_scale", "scale_x_ppm": 1500.0, "scale_y_ppm": -800.0},
    {"id": "acc_cross_axis", "cross_xy_ppm": 900.0, "cross_yx_ppm": -700.0},
]

BY_HAND = parse_scenario(
    {
        "schema": 1,
        "name": "turned by hand",
        "site": {"gravity_m_s2": 9.81, "latitude_deg": 45.0},
        "rig": {"table": "handheld"},
        "sensor": [
            {
                "name": "gyro",
                "kind": "gyro",
                "rate_hz": 50.0,
                "adjustable": ["bias", "scale", "cross_axis"],
            },
            {
                "name": "fog",
                "kind": "fog",
                "axes": ["a"],
                "input_axis": [0.6, 0.0, 0.8],
                "rate_hz": 50.0,
                "adjustable": ["bias", "scale"],
            },
        ],
    }
)


def turned_by_hand(rng, time: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a gyro triad and a FOG turned together by hand, resting now and then, for
    ``BY_HAND``.
    """
    rate = np.column_stack([np.sin((0.5 + 0.2 * k) * time) * (time % 20 > 5) for k in range(3)])
    read = rate + rng.normal(0, 1e-3, rate.shape)
    columns = {f"gyro_{a}_rad_s": read[:, k] for k, a in enumerate("xyz")}
    return columns | {"fog_a_rad_s": rate @ [0.6, 0.0, 0.8] + rng.normal(0, 1e-5, len(time))}


def tumble(count: int = 30) -> list[dict]:
    """Poses of a dual table in an order that visits both axes both ways."""
    steps = []
    for k in range(count):
        outer, inner = (137.5 * k) % 360.0 - 180.0, (222.5 * k) % 360.0 - 180.0
        steps.append(
            {
                "action": "move",
                "outer_deg": outer,
                "inner_deg": inner,
                "rate_deg_s": 60.0,
                "dwell_s": 4.0,
            }
        )
    return [{"action": "rest", "dwell_s": 4.0}, *steps]


def turns() -> list[dict]:
    """Several turns of a vertical table by steps, there and back."""
    there = [
        {"action": "move", "outer_deg": 30.0 * k, "rate_deg_s": 30.0, "dwell_s": 3.0}
        for k in range(1, 25)
    ]
    back = [
        {"action": "move", "outer_deg": 30.0 * k, "rate_deg_s": 30.0, "dwell_s": 3.0}
        for k in range(23, -1, -1)
    ]
    return [{"action": "rest", "dwell_s": 3.0}, *there, *back]


def bench(
    *left_out: dict,
    table: str = "dual",
    sensor: str = "accel",
    noise: bool = True,
    **climate: float,
) -> Scenario:
    """What really stands in the laboratory."""
    return parse_scenario(
        {
            "schema": 1,
            "name": f"{table} bench",
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": table},
            "climate": {"start_degC": 22.0, **climate},
            "sensor": [SENSORS[sensor]],
            "effect": [
                *({**e, "sensor": sensor} for e in ORDINARY),
                *([NOISE[sensor]] if noise else []),
                *left_out,
            ],
            "sequence": tumble() if table == "dual" else turns(),
        }
    )


def honest(scenario: Scenario) -> Scenario:
    """What an honest user knows of it."""
    table = scenario.model_dump(
        exclude={"effect", "sequence"}, exclude_defaults=True, by_alias=True
    )
    return parse_scenario({"schema": 1, **table})


def stating(scenario: Scenario, *effects: dict) -> Scenario:
    """What an honest user knows of it, with these effects."""
    table = honest(scenario).model_dump(exclude_defaults=True, by_alias=True)
    return parse_scenario({"schema": 1, **table, "effect": list(effects)})


def shorter(scenario: Scenario, poses: int) -> Scenario:
    """The same dual table with a tumble of fewer poses."""
    table = scenario.model_dump(exclude_defaults=True, by_alias=True)
    return parse_scenario({"schema": 1, **table, "sequence": tumble(poses)})


def recorded(scenario: Scenario, seed: int) -> Recording:
    """A recording of it, by the closed form."""
    return SimulatedLaboratory().record(scenario, seed)


def rewritten(recording: Recording, **columns: np.ndarray) -> Recording:
    """A copy with some columns replaced."""
    kept = {n: columns.get(n, recording.column(n)) for n in recording.column_names}
    return Recording.from_columns(
        recording.time, kept, labels=recording.labels, metadata=recording.metadata
    )


def faults_of(truth: Scenario, recording: Recording) -> dict[str, Fault]:
    """Faults of the data that a diagnosis mends before any physics, by id."""
    return {f.effect.id: f for f in prepare(honest(truth), [recording]).faults}
