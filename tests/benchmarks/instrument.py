"""Speed of the instrument on 64 environments: a triad and a gyro with the usual chain."""

import time

import numpy as np

from tiltcal.laboratory.instrument.instrument import Instrument
from tiltcal.laboratory.scenario import parse_scenario

ENVS, STEPS, RATE = 64, 3000, 200
EFFECTS = [
    {"id": "acc_bias", "bias_x_ug": 3000},
    {"id": "acc_noise", "white_ug_rthz": 40, "flicker_ug": 10, "walk_ug_rts": 0.3},
    {"id": "acc_bandwidth", "tau_ms": 5},
    {"id": "acc_saturation", "full_scale_m_s2": 20},
    {"id": "acc_temp_bias", "temp_bias_x_ug_degC": 100},
    {"id": "adc_quantisation", "sensor": "accel", "lsb_si": 1e-3},
    {"id": "data_latency", "sensor": "accel", "latency_ms": 12},
    {"id": "data_duplicate", "sensor": "accel", "share_unitless": 0.01},
    {"id": "gyr_bias", "bias_x_deg_s": 0.5},
    {"id": "gyr_noise", "white_deg_rth": 0.3, "flicker_deg_h": 10},
    {"id": "gyr_bandwidth", "tau_ms": 5},
    {"id": "gyr_saturation", "full_scale_deg_s": 250},
    {"id": "data_latency", "sensor": "gyro", "latency_ms": 12},
]


def main() -> None:
    sensors = [("accel", "accelerometer"), ("gyro", "gyro")]
    scenario = parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": "handheld"},
            "sensor": [{"name": n, "kind": k, "rate_hz": RATE} for n, k in sensors],
            "effect": EFFECTS,
        }
    )
    instrument = Instrument(scenario, 1 / RATE, envs=ENVS, seed=1)
    rng = np.random.default_rng(2)
    force, rate = rng.normal(size=(2, ENVS, 3))
    instrument.step(force, rate)
    start = time.perf_counter()
    for _ in range(STEPS):
        instrument.step(force, rate)
    step = (time.perf_counter() - start) / STEPS * 1e6
    channels = sum(len(s.axes) for s in scenario.sensor)
    print(
        f"instrument, {len(EFFECTS)} effects, {channels} channels, {ENVS} environments: "
        f"{step:.0f} us for a step of all; {step / channels / ENVS:.2f} us a step, channel and "
        f"environment (<= 3); {step / channels:.0f} us a channel for all environments"
    )
