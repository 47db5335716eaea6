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


without_noise = pytest.mark.filterwarnings("ignore:seed=None leaves out gyr_noise")
PLACES = {"force": slice(0, 3), "rate": [3, 4, 5]}


@without_noise
def test_readings_take_the_places_of_force_and_rate():
    env = tc.wrap(Counting(), bench(*BIASED), **PLACES, seed=None)
    observation, info = env.reset()
    assert observation[0] == pytest.approx(0.980665)
    np.testing.assert_array_equal(info["readings"]["accel"], observation[:3])
    observation, *_ = env.step(0)
    np.testing.assert_allclose(observation, [1.980665, 1, 1, 1, 1, 1])


@without_noise
def test_a_seed_of_an_episode_does_not_switch_random_effects_on():
    env = tc.wrap(Counting(), bench(*BIASED), **PLACES, seed=None)
    observation, _ = env.reset(seed=3)
    assert (observation[3:] == 0).all()
    noisy = tc.wrap(Counting(), bench(*BIASED), **PLACES)
    first, again, other = (noisy.reset(seed=seed)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first[3:] != other[3:]).all()


@without_noise
def test_keys_of_a_dict_observation():
    env = tc.wrap(Named(), bench(*BIASED), force="f", rate="w", seed=None)
    env.reset()
    observation, *_ = env.step(0)
    np.testing.assert_allclose(observation["f"], [1.980665, 1, 1])


@without_noise
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


@without_noise
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


def test_a_word_says_what_no_seed_leaves_out():
    model = mujoco.MjModel.from_xml_string(MODEL)
    with pytest.warns(UserWarning, match=r"seed=None leaves out gyr_noise\[gyro\]$"):
        tc.wrap(model, bench(*BIASED), force="acc", rate="gyr", seed=None)
    with pytest.warns(UserWarning, match="gyr_noise"):
        tc.Instrument(bench(*BIASED), 0.02, seed=None)
    tc.Instrument(bench(BIASED[0]), 0.02, seed=None)  # nothing random is left out
    noisy, *_ = tc.Instrument(bench(*BIASED), 0.02).step(np.zeros(3), np.zeros(3))["gyro"]
    again, *_ = tc.Instrument(bench(*BIASED), 0.02, seed=0).step(np.zeros(3), np.zeros(3))["gyro"]
    assert noisy.all()
    np.testing.assert_array_equal(noisy, again)


OTHERS = MODEL.replace(
    "<sensor>",
    """<sensor><framelinacc name="lin" objtype="site" objname="s"/>
    <velocimeter name="vel" site="s"/>
    <frameangvel name="spin" objtype="site" objname="s"/>""",
)


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ({"force": "lin", "rate": "gyr"}, "'lin', a framelinacc.*specific force.*give acc"),
        ({"force": "vel", "rate": "gyr"}, "'vel', a velocimeter.*specific force.*give acc"),
        ({"force": "gyr", "rate": "gyr"}, "'gyr', a gyro.*specific force"),
        ({"force": "acc", "rate": "spin"}, "'spin', a frameangvel.*angular rate.*give gyr"),
    ],
)
def test_sensors_of_another_kind_are_refused_by_the_name_of_what_they_are(places, words):
    with pytest.raises(TiltcalError, match=words):
        tc.wrap(mujoco.MjModel.from_xml_string(OTHERS), bench(*BIASED), **places)


def test_the_time_of_the_simulation_goes_by_steps():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    instrument = tc.wrap(model, bench(*BIASED), force="acc", rate="gyr")
    for _ in range(50):
        mujoco.mj_step(model, data)
        instrument.read(data)
    with pytest.raises(TiltcalError, match=r"found 0 s since the last reading, need 0.02 s"):
        instrument.read(data)
    mujoco.mj_step(model, data, 2)
    with pytest.raises(TiltcalError, match=r"found 0.04 s since the last reading"):
        instrument.read(data)
    mujoco.mj_resetData(model, data)
    with pytest.raises(TiltcalError, match=r"call reset\(\)"):
        instrument.read(data)
    instrument.reset()
    instrument.read(data)


class Twice(gymnasium.Wrapper):
    """Repeats each action, and says nothing of it."""

    def step(self, action):
        self.env.step(action)
        return self.env.step(action)


def test_an_environment_that_repeats_actions_needs_its_step_stated():
    def made():
        return Twice(gymnasium.make("InvertedPendulum-v5"))

    how = {"rate": lambda o: o[..., 3:4] * np.array([0.0, 1.0, 0.0])}
    env = tc.wrap(made(), bench(sensors=("gyro",), rate=25.0), **how)
    env.reset(seed=1)
    with pytest.raises(TiltcalError, match=r"found 0.08 s.*give step_s"):
        env.step(np.zeros(1, np.float32))
    env = tc.wrap(made(), bench(sensors=("gyro",), rate=12.5), **how, step_s=0.08)
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.zeros(1, np.float32))


@pytest.mark.parametrize("mode", list(gymnasium.vector.AutoresetMode)[:2])
def test_environments_in_processes_of_their_own_read_as_those_in_this_one(mode):
    makers = {"autoreset_mode": mode}
    apart = gymnasium.vector.AsyncVectorEnv([Counting] * 2, **makers)
    here = gymnasium.vector.SyncVectorEnv([Counting] * 2, **makers)
    try:
        with pytest.raises(TiltcalError, match="processes of their own"):
            tc.wrap(apart, bench(*BIASED), force="acc", rate="gyr")
        both = [tc.wrap(env, bench(*BIASED), **PLACES) for env in (apart, here)]
        np.testing.assert_array_equal(*(env.reset(seed=4)[0] for env in both))
        for _ in range(7):
            one, other = (env.step(np.zeros(2, int)) for env in both)
            np.testing.assert_array_equal(one[0], other[0])
    finally:
        apart.close()
