"""``tc.wrap``: the instrument on Gymnasium environments, single and vectorised, and on a MuJoCo
model.
"""

import warnings

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import tiltcal as tc
from tiltcal.core.errors import TiltcalError


def bench(*effects, sensors=("accel", "gyro"), rate=50.0):
    kinds = {"accel": "accelerometer", "gyro": "gyro"}
    return tc.parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": 9.80123},
            "rig": {"table": "handheld"},
            "sensor": [{"name": n, "kind": kinds[n], "rate_hz": rate} for n in sensors],
            "effect": list(effects),
        }
    )


BIASED = (
    {"id": "acc_bias", "bias_x_ug": 1e5, "sensor": "accel"},
    {"id": "gyr_noise", "white_deg_rth": 30, "sensor": "gyro"},
)


class Counting(gymnasium.Env):
    """Six numbers: force, rate; each step adds one to all. An episode has four steps."""

    dt = 0.02
    observation_space = gymnasium.spaces.Box(-1e6, 1e6, (6,), np.float64)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.k = 0
        return np.zeros(6), {}

    def step(self, action):
        self.k += 1
        return np.full(6, float(self.k)), 0.0, self.k == 4, False, {}


class Named(Counting):
    """The same with a dict observation."""

    observation_space = gymnasium.spaces.Dict(
        {n: gymnasium.spaces.Box(-1e6, 1e6, (3,), np.float64) for n in ("f", "w")}
    )

    def reset(self, *, seed=None, options=None):
        both, info = super().reset(seed=seed)
        return {"f": both[:3], "w": both[3:]}, info

    def step(self, action):
        both, *rest = super().step(action)
        return {"f": both[:3], "w": both[3:]}, *rest


PLACES = {"force": slice(0, 3), "rate": [3, 4, 5]}


def test_readings_take_the_places_of_force_and_rate():
    env = tc.wrap(Counting(), bench(*BIASED), **PLACES, seed=None)
    observation, info = env.reset()
    assert observation[0] == pytest.approx(0.980665)
    np.testing.assert_array_equal(info["readings"]["accel"], observation[:3])
    observation, *_ = env.step(0)
    np.testing.assert_allclose(observation, [1.980665, 1, 1, 1, 1, 1])


def test_a_seed_of_an_episode_does_not_switch_random_effects_on():
    env = tc.wrap(Counting(), bench(*BIASED), **PLACES, seed=None)
    observation, _ = env.reset(seed=3)
    assert (observation[3:] == 0).all()
    noisy = tc.wrap(Counting(), bench(*BIASED), **PLACES)
    first, again, other = (noisy.reset(seed=seed)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first[3:] != other[3:]).all()


def test_keys_of_a_dict_observation():
    env = tc.wrap(Named(), bench(*BIASED), force="f", rate="w", seed=None)
    env.reset()
    observation, *_ = env.step(0)
    np.testing.assert_allclose(observation["f"], [1.980665, 1, 1])


def test_a_function_and_an_observer():
    env = tc.wrap(
        Counting(),
        bench(*BIASED),
        force=lambda o: o[..., :3],
        rate=lambda o: o[..., 3:],
        observe=lambda o, readings: np.concatenate([o, readings["accel"]]),
        seed=None,
    )
    observation, _ = env.reset()
    np.testing.assert_allclose(observation, [0, 0, 0, 0, 0, 0, 0.980665, 0, 0])


def test_the_checker_has_nothing_to_say():
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version")
        check_env(tc.wrap(Counting(), bench(*BIASED), **PLACES), skip_render_check=True)


@pytest.mark.parametrize("mode", ["next step", "same step"])
def test_vector_environments_read_as_single_ones(mode):
    modes = gymnasium.vector.AutoresetMode
    made = gymnasium.vector.SyncVectorEnv(
        [Counting] * 3,
        autoreset_mode=modes.SAME_STEP if mode == "same step" else modes.NEXT_STEP,
    )
    many = tc.wrap(made, bench(*BIASED), **PLACES)
    singles = [tc.wrap(Counting(), bench(*BIASED), **PLACES) for _ in range(3)]
    first, _ = many.reset(seed=4)
    alone = [env.reset(seed=4 + k)[0] for k, env in enumerate(singles)]
    np.testing.assert_array_equal(first, alone)
    for k in range(4):
        observation, _, over, _, _ = many.step(np.zeros(3, int))
        if k < 3 or mode == "next step":
            np.testing.assert_array_equal(observation, [env.step(0)[0] for env in singles])
    assert over.all()
    if mode == "next step":
        observation, *_ = many.step(np.zeros(3, int))
    # the next episode goes on in the same streams
    np.testing.assert_array_equal(observation, [env.reset()[0] for env in singles])


def test_the_sensors_of_the_environments_own_mujoco_model():
    """InvertedPendulum has none: the message names what there is."""
    env = gymnasium.make("InvertedPendulum-v5")
    with pytest.raises(TiltcalError, match="no sensor 'imu'"):
        tc.wrap(env, bench(sensors=("gyro",), rate=25.0), rate="imu")
    with pytest.raises(TiltcalError, match="without a MuJoCo model"):
        tc.wrap(Counting(), bench(sensors=("gyro",)), rate="imu")


MODEL = """<mujoco><option timestep="0.02"/><worldbody><body><freejoint/>
<geom size="0.1" mass="1"/><site name="s"/></body></worldbody><sensor>
<framepos objtype="site" objname="s"/><accelerometer name="acc" site="s"/>
<gyro name="gyr" site="s"/></sensor></mujoco>"""


def test_the_sensors_of_a_mujoco_model():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qvel[3:] = 1.0, 2.0, 3.0
    mujoco.mj_forward(model, data)
    scenario = bench(*BIASED)
    found = tc.wrap(model, scenario, force="acc", rate="gyr", seed=None).read(data)
    np.testing.assert_allclose(found["gyro"], [[1, 2, 3]])
    np.testing.assert_allclose(found["accel"], [[0.980665, 0, 0]], atol=1e-9)  # it falls
    several = np.tile(data.sensordata, (5, 1))
    found = tc.wrap(model, scenario, force="acc", rate="gyr", envs=5).read(several)
    assert found["gyro"].shape == (5, 3)
    with pytest.raises(TiltcalError, match="no sensor 'acx'"):
        tc.wrap(model, scenario, force="acx", rate="gyr")


def test_what_cannot_be_wrapped_is_refused():
    with pytest.raises(TiltcalError, match="no `rate`"):
        tc.wrap(Counting(), bench(*BIASED), force=slice(0, 3))
    with pytest.raises(TiltcalError, match="found int"):
        tc.wrap(3, bench(*BIASED))
    env = tc.wrap(Counting(), bench(*BIASED), force=slice(0, 2), rate=slice(3, 6))
    with pytest.raises(TiltcalError, match=r"`force`.*shape \(2,\)"):
        env.reset()
