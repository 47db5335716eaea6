"""``tiltcal/Rig-v0``: the checker, the laboratory's readings for the same motion, one against many,
the reward, limits and refusals.
"""

import shutil
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gym_course import Course, driven
from gymnasium.utils.env_checker import check_env
from statistics_helpers import rng_of

import tiltcal.design.gym
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG, G0
from tiltcal.design.gym.rig_environment import RigEnvironmentVector
from tiltcal.design.gym.rigs import AxisLimits, AxisMotion
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.setup.setup import Rig
from tiltsim.motion import mujoco_motion

RIG = tiltcal.design.gym.RIG
ARM = """
schema = 1
name = "arm"
seed = 4
[site]
gravity_m_s2 = 9.80123
latitude_deg = 40.0
[rig]
mjcf = "arm.xml"
site = "tool"
[rig.axes]
pan = "pan"
lift = {joint = "lift", sign = -1, offset_deg = 10}
elbow = "elbow"
wrist = "wrist"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = 100
adjustable = ["bias", "scale", "cross_axis"]
[[sensor]]
name = "gyro"
kind = "gyro"
rate_hz = 50
adjustable = ["bias"]
[[sensor]]
name = "level"
kind = "inclinometer"
axes = ["x", "y"]
site = "base_imu"
rate_hz = 100
adjustable = ["bias", "table_encoder_zero"]
[[effect]]
id = "acc_noise"
sensor = "accel"
white_ug_rthz = 30
[[effect]]
id = "acc_K2"
sensor = "accel"
k2_x_ug_g2 = 300
[[effect]]
id = "data_latency"
sensor = "accel"
latency_ms = 20
[[effect]]
id = "base_load_compliance"
bend_east_arcsec_N_m = 4
bend_north_arcsec_N_m = 6
[[effect]]
id = "joint_compliance"
axis = "lift"
bend_x_arcsec_N_m = 5
bend_z_arcsec_N_m = 3
"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    place = tmp_path_factory.mktemp("arm")
    shutil.copy(folder("scenarios") / "arm" / "arm.xml", place)
    (place / "arm.toml").write_text(ARM)
    return str(place / "arm.toml")


@pytest.fixture(scope="module", params=["arm", "six_faces_dual"])
def path(request, arm):
    return arm if request.param == "arm" else str(folder("scenarios") / f"{request.param}.toml")


def test_the_checker_has_nothing_to_say(path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment = gymnasium.make(RIG, scenario=path)
        check_env(environment.unwrapped)
        environment.close()


@pytest.mark.parametrize(
    ("mover", "tolerance"), [(closed_form, 1e-12), (mujoco_motion, 1e-8)], ids=["closed", "mujoco"]
)
def test_the_readings_are_the_laboratorys_for_the_same_motion(arm, mover, tolerance):
    scenario = load_scenario(arm)
    environment = gymnasium.make(RIG, scenario=arm, rate_deg_s=60)
    states, live = driven(environment, rng_of("rig readings"), 300, seed=7)
    assert np.abs(states[:, 1]).max() > 30 * DEG
    assert np.abs(states[:, 2]).max() > 30 * DEG
    course = Course(scenario.rig.axis_names, 0.01, states)
    times = {s.name: np.arange(len(states)) * 0.01 for s in scenario.sensor}
    times["gyro"] = times["gyro"][::2]
    lab = readings(scenario, course, times, scenario.effects, seed=7, mover=mover)
    for name, values in lab.items():
        mine = live[name][::2] if name == "gyro" else live[name]
        np.testing.assert_allclose(mine, values, rtol=0, atol=tolerance, err_msg=name)


def test_a_bend_turns_the_instrument_at_the_rate_at_which_it_grows(arm):
    """The gyro's reading against the differences of the attitude, in a course; rows apart lack what
    a change of acceleration adds.
    """
    scenario = load_scenario(arm)
    time = np.arange(5000) * 2e-4
    x = {n: np.sin(k * time + k) for k, n in enumerate(scenario.rig.axis_names, start=1)}
    v = {n: k * np.cos(k * time + k) for k, n in enumerate(scenario.rig.axis_names, start=1)}
    a = {n: -(k**2) * x[n] for k, n in enumerate(x, start=1)}
    states = np.array([[*p.values()] for p in (x, v, a)]).transpose(2, 0, 1)
    course = Course(tuple(x), 2e-4, states, rows_apart=False)
    effects = [e for e in scenario.effects if "compliance" in e.id]
    motion = closed_form(scenario, course.drive(time), effects)
    change = np.gradient(motion.up, time, axis=0)  # up' = up x w, without the Earth's rate
    earth = closed_form(scenario, course.drive(time)).rate - rate_without_earth(
        scenario, course, time
    )
    across = np.cross(motion.up, motion.rate - earth)
    amid = slice(500, -500)  # at its ends the motion begins and stops at once
    np.testing.assert_allclose(across[amid], change[amid], rtol=0, atol=1e-5)
    bare = closed_form(scenario, course.drive(time))
    assert np.abs(np.cross(bare.up, bare.rate) - across).max() > 1e-4
    apart = closed_form(scenario, replace(course, rows_apart=True).drive(time), effects)
    short = np.cross(apart.up, apart.rate - earth) - change
    assert 1e-4 < np.abs(short[amid]).max() < 1e-3


def rate_without_earth(scenario, course, time):
    site = scenario.site.model_copy(update={"latitude_deg": None})
    return closed_form(scenario.model_copy(update={"site": site}), course.drive(time)).rate


def test_many_environments_are_as_many_single_ones(path):
    how = {"scenario": path, "duration_s": 0.5}
    many = gymnasium.make_vec(RIG, num_envs=3, **how)
    assert isinstance(many.unwrapped, RigEnvironmentVector)
    ones = [gymnasium.make(RIG, **how) for _ in range(3)]
    rng = rng_of("many rigs")
    together, _ = many.reset(seed=5)
    apart = [e.reset(seed=5 + k)[0] for k, e in enumerate(ones)]
    over = [False] * 3
    ends = 0
    for _ in range(120):
        for name, values in together.items():
            np.testing.assert_allclose(values, [a[name] for a in apart], rtol=1e-12, atol=1e-12)
        actions = rng.uniform(-1, 1, many.action_space.shape).astype(np.float32)
        together, rewards, terminated, truncated, _ = many.step(actions)
        assert not terminated.any()
        for k, e in enumerate(ones):
            if over[k]:  # NEXT_STEP: the step after the end begins again and pays nothing
                apart[k], reward, over[k] = e.reset()[0], 0.0, False
            else:
                apart[k], reward, _, over[k], _ = e.step(actions[k])
            assert rewards[k] == pytest.approx(reward, abs=1e-9)
            assert truncated[k] == over[k]
        ends += sum(over)
    assert ends > 3


def test_the_reward_is_the_information_on_the_adjustable_terms(arm):
    scenario = load_scenario(arm)
    environment = gymnasium.make(RIG, scenario=arm, noise=False)
    environment.reset()
    rng, total, forces = rng_of("reward"), 0.0, []
    for _ in range(100):
        total += environment.step(rng.uniform(-1, 1, 4).astype(np.float32))[1]
        rigs = environment.unwrapped.rigs
        drive = rigs.drive()
        geometry = rigs.instrument.geometry
        forces.append([closed_form(s, drive, geometry).force[0] for s in rigs.instrument.setups])
    at_tool, at_base = np.array(forces).transpose(1, 0, 2)
    ug, white, usual = G0 * 1e-6, 30e-6 * G0 * 10, 25e-6 * 10
    bias, scale, cross = prior("acc_bias") * ug, prior("acc_scale"), prior("acc_cross_axis")
    expected = 0.0
    for i in range(3):  # accel: bias, scale and two terms of cross-axis a channel
        sizes = np.full(3, cross)
        sizes[i] = scale
        rows = np.column_stack([np.full(100, bias), at_tool * sizes]) / white
        expected += np.linalg.slogdet(np.eye(4) + rows.T @ rows)[1] / 2
    across = np.sqrt(1 - (at_base[:, :2] / 9.80123) ** 2)
    slope = bias / (9.80123 * across * usual)
    expected += np.log(1 + (slope**2).sum(0)).sum() / 2
    gyro = prior("gyr_bias") / (1e-4 * np.sqrt(50))
    expected += 3 * np.log(1 + 50 * gyro**2) / 2
    assert scenario.named("gyro").adjustable == ("bias",)
    assert total == pytest.approx(expected, rel=1e-6)


def prior(id):
    """Plausible size of an effect's first parameter, in the factor of its unit."""
    from tiltcal.core.units import PARAMETER_UNITS
    from tiltcal.effects import CATALOGUE

    (parameter, *_) = CATALOGUE[id].parameters
    factor = 1.0 if parameter.unit == "ug" else PARAMETER_UNITS[parameter.unit].factor
    return parameter.plausible[1] * factor


def test_axes_reach_their_rate_in_two_steps_and_stop_before_their_limits():
    reach = Rig(table="dual").narrowed({"outer": (-20, 30)}, {}).reach
    limits = AxisLimits.of(reach, {"deg": 100, "mm": 1}, {"deg": 100, "mm": 1})
    motion = AxisMotion.at_rest(limits, 0.02, 64)
    everyone, rng = np.ones(64, bool), rng_of("limits")
    motion.move(np.full((64, 2), 0.5 * DEG), everyone)
    motion.move(np.full((64, 2), 0.5 * DEG), everyone)
    np.testing.assert_allclose(motion.rate, 0.5 * DEG, rtol=1e-12)
    np.testing.assert_allclose(motion.acceleration, 0.0, atol=1e-12)
    demand = np.zeros((64, 2))
    for step in range(3000):
        if step % 30 == 0:
            demand = rng.uniform(-2, 2, (64, 2))
        motion.move(demand, everyone)
        assert (motion.position[:, 0] <= 30 * DEG).all()
        assert (motion.position[:, 0] >= -20 * DEG).all()
        assert np.abs(motion.rate).max() <= 100 * DEG * (1 + 1e-12)
        assert np.abs(motion.acceleration).max() <= 100 * DEG * (1 + 1e-12)
    assert np.ptp(motion.position[:, 0]) > 40 * DEG


@pytest.mark.parametrize(
    ("change", "how", "words"),
    [
        ({"rig": {"table": "handheld"}}, {}, "table handheld"),
        ({"sensor": []}, {}, "no sensors"),
        ({"dynamics": {}}, {}, r"\[dynamics\]"),
        ({"effect": [{"id": "table_backlash", "width_arcsec": 9}]}, {}, "motion as a whole"),
        ({}, {"duration_s": 0.0}, "positive duration"),
        ({}, {"rate_deg_s": -1.0}, "rate_deg_s"),
        ({}, {"limits_deg": {"lift": (-1, 1)}}, "limits_deg"),
        ({}, {"limits_deg": {"outer": (5, 5)}}, "room to move"),
        ({}, {"limits_deg": {"outer": (9, 5)}}, "axis outer: found limits 9 to 5 deg"),
    ],
)
def test_what_cannot_be_an_environment_is_refused(change, how, words):
    table = {
        "schema": 1,
        "site": {"gravity_m_s2": 9.8},
        "rig": {"table": "dual"},
        "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": 50}],
    }
    with pytest.raises(TiltcalError, match=words):
        gymnasium.make(RIG, scenario=parse_scenario(table | change), **how)
