"""Speed of ``wrap`` on one MuJoCo model and on 64 environments: a triad and a gyro with the usual
chain.
"""

import time

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from tests.benchmarks import sized
from tiltcal.laboratory.instrument.wrap import wrap
from tiltcal.laboratory.scenario import Scenario, parse_scenario

ENVS, RATE = 64, 200
ROUNDS, STEPS = sized((5, 768), (1, 8))
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


class Still(VectorEnv):  # type: ignore[type-arg]
    """Environments whose observation, force and rate, never changes: what wrapping them costs."""

    def __init__(self) -> None:
        self.num_envs = ENVS
        self.single_observation_space = gymnasium.spaces.Box(-100, 100, (6,))
        self.single_action_space = gymnasium.spaces.Box(-1, 1, (1,))
        self.observation_space = batch_space(self.single_observation_space, ENVS)
        self.action_space = batch_space(self.single_action_space, ENVS)
        self.observation = np.random.default_rng(2).normal(size=(ENVS, 6))
        self.zero, self.never = np.zeros(ENVS), np.zeros(ENVS, bool)

    def reset(self, *, seed=None, options=None):  # type: ignore[no-untyped-def]
        return self.observation, {}

    def step(self, actions):  # type: ignore[no-untyped-def]
        return self.observation, self.zero, self.never, self.never, {}


MODEL = f"""<mujoco><option timestep="{1 / RATE}"/><worldbody><body><freejoint/>
<geom size="0.1" mass="1"/><site name="s"/></body></worldbody><sensor>
<accelerometer name="acc" site="s"/><gyro name="gyr" site="s"/></sensor></mujoco>"""
SHORT, OFTEN = sized((64, 100), (4, 2))


def one_model(scenario: Scenario) -> float:
    """Least time of a reading of one MuJoCo model, us: of many short rounds, so that a loaded
    machine leaves some of them alone.
    """
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    instrument = wrap(model, scenario, force="acc", rate="gyr", seed=1)
    least = np.inf
    for _ in range(OFTEN):
        start = time.perf_counter()
        for _ in range(SHORT):
            data.time += model.opt.timestep
            instrument.read(data)
        least = min(least, (time.perf_counter() - start) / SHORT)
    return least * 1e6


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
    print(f"wrap, {len(EFFECTS)} effects, one MjModel: {one_model(scenario):.0f} us (<= 150)")
    env = wrap(Still(), scenario, force=slice(0, 3), rate=slice(3, 6), step_s=1 / RATE, seed=1)
    env.reset()
    actions = np.zeros((ENVS, 1))
    rounds = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(STEPS):
            env.step(actions)
        rounds.append((time.perf_counter() - start) / STEPS * 1e6)
    step = min(rounds)
    channels = sum(len(s.axes) for s in scenario.sensor)
    print(
        f"wrap, {len(EFFECTS)} effects, {channels} channels, {ENVS} environments: "
        f"{step:.0f} us for a step of all; {step / channels / ENVS:.2f} us a step, channel and "
        f"environment (<= 3); {step / channels:.0f} us a channel for all environments"
    )
