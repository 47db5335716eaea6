"""The Gymnasium environments: the checker, the telescoping reward, the traps, one against many,
baselines and training.
"""

import importlib.metadata
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from statistics_helpers import rng_of

import tiltcal.design.gym
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.design.criteria import gain
from tiltcal.design.gradient_search import Problem
from tiltcal.design.gym.calibrations import Bench, Task
from tiltcal.design.gym.policies import BASELINES, following, greedy, named, rollout
from tiltcal.design.gym.spaces import DWELLS, action_of, menu, pose_of
from tiltcal.design.gym.training import START, linear_policy, train
from tiltcal.design.gym.wrappers import StepAngles
from tiltcal.design.polynomial import KINDS, textbook_model

CONTINUOUS, DISCRETE = tiltcal.design.gym.IDS


@pytest.mark.parametrize("id", tiltcal.design.gym.IDS)
@pytest.mark.parametrize("model", KINDS)
def test_the_checker_has_nothing_to_say(id, model):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment = gymnasium.make(id, model=model)
        check_env(environment.unwrapped)
        environment.close()


def test_the_installed_entry_point_registers_the_environments():
    (point,) = [
        p
        for p in importlib.metadata.entry_points(group="gymnasium.envs")
        if p.value.startswith("tiltcal")
    ]
    point.load()()
    assert set(tiltcal.design.gym.IDS) <= set(gymnasium.registry)
    assert gymnasium.make(f"tiltcal.design.gym:{CONTINUOUS}").spec.id == CONTINUOUS


@pytest.mark.parametrize("model", KINDS)
@pytest.mark.parametrize("drift", [False, True])
def test_the_return_is_the_information_of_the_whole_sequence(model, drift):
    """Rank-one updates against the information matrix that a design inverts."""
    task = Task(model, drift)
    rng = rng_of(f"return {model} {drift}")
    environment = gymnasium.make(CONTINUOUS, model=model, drift=drift)
    environment.reset(seed=0)
    total, angles, dwells, over = 0.0, [], [], False
    while not over:
        action = rng.uniform(-1, 1, 3).astype(np.float32)
        action[2] = -0.8
        observation, reward, over, _, info = environment.step(action)
        assert environment.observation_space.contains(observation)
        total += reward
        if not info["refused"]:
            angle, dwell = pose_of(action[None], task)
            angles.append(angle[0])
            dwells.append(dwell[0])
    from tiltcal.design.time_budget import unwound

    problem = Problem(textbook_model(model, drift, task.budget_s), task.clock)
    route = unwound(np.array(angles), problem.clock.limits)
    assert total == pytest.approx(
        gain(problem.information(route, np.array(dwells)), problem.model.interest), rel=1e-6
    )
    assert environment.unwrapped.bench.nats()[0] == pytest.approx(total, rel=1e-6)
    assert environment.unwrapped.bench.elapsed[0] == pytest.approx(
        problem.clock.total(route, np.array(dwells)), rel=1e-9
    )


@pytest.mark.parametrize("id", tiltcal.design.gym.IDS)
def test_many_environments_are_as_many_single_ones(id):
    rng = rng_of(f"many {id}")
    many = gymnasium.make_vec(id, num_envs=3, model="K2K3")
    ones = [gymnasium.make(id, model="K2K3") for _ in range(3)]
    together, _ = many.reset(seed=1)
    apart = [e.reset(seed=1)[0] for e in ones]
    assert np.array_equal(together, apart)
    over = [False] * 3
    for _ in range(60):
        actions = np.array(
            [e.action_space.sample() if id == DISCRETE else rng.uniform(-1, 1, 3) for e in ones]
        )
        together, rewards, terminated, truncated, _ = many.step(actions)
        assert not truncated.any()
        for k, e in enumerate(ones):
            if over[k]:  # NEXT_STEP: the step after the end begins again and pays nothing
                observation, reward, over[k] = e.reset()[0], 0.0, False
            else:
                observation, reward, over[k], _, _ = e.step(actions[k])
            assert together[k] == pytest.approx(observation, abs=1e-6)
            assert rewards[k] == pytest.approx(reward, abs=1e-9)
            assert terminated[k] == over[k]


def test_angles_wrap_and_are_not_clipped():
    task = Task()
    there, back = np.array([[315 / 180, 0, -1]]), np.array([[-45 / 180, 0, -1]])
    benches = [Bench(task, 1) for _ in range(2)]
    worth = [
        b.step(*pose_of(a, task), np.ones(1, bool))
        for b, a in zip(benches, (there, back), strict=True)
    ]
    assert worth[0][0] == pytest.approx(worth[1][0], rel=1e-9)
    assert worth[0][2] == pytest.approx(45 / 20 + 5 + 5)  # the short way round
    assert action_of(np.array([[315.0, 0.0]]) * np.pi / 180, np.array([5.0]), task)[
        0
    ] == pytest.approx([-0.25, 0.0, -1.0])


def test_a_pose_that_would_overrun_is_refused_and_ends_the_episode():
    environment = gymnasium.make(CONTINUOUS)
    environment.reset(options={"budget_s": 90})
    longest = np.array([0.0, 0.0, 1.0], dtype=np.float32)
    before, reward, over, _, info = environment.step(longest)
    assert (over, info["refused"]) == (False, False)
    assert info["spent_s"] == pytest.approx(65.0)
    assert info["nats_per_s"] == pytest.approx(reward / 65.0)
    after, reward, over, _, info = environment.step(longest)
    assert (reward, over, info["refused"], info["nats_per_s"]) == (0.0, True, True, 0.0)
    assert np.array_equal(before, after)


def test_no_episode_ends_on_its_first_step():
    task = Task(budget_s=84.0)
    bench = Bench(task, 1)
    _, over, _ = bench.step(np.array([[np.pi, 0.0]]), np.array([60.0]), np.ones(1, bool))
    assert not over[0]
    with pytest.raises(TiltcalError, match="more than one step"):
        Task(budget_s=80.0)


def test_options_that_are_none_and_unknown_models_are_refused():
    environment = gymnasium.make(CONTINUOUS)
    with pytest.raises(TiltcalError, match="reset options"):
        environment.reset(options={"seconds": 3})
    with pytest.raises(TiltcalError, match="textbook model"):
        Task("tertiary")


def test_the_menu_holds_faces_edges_and_corners():
    environment = gymnasium.make(DISCRETE)
    assert environment.action_space.n == 26 * len(DWELLS)
    assert len(np.unique(np.round(menu(), 9), axis=0)) == 26


def test_every_baseline_has_the_signature_of_a_policy_and_the_design_is_worth_most():
    task = Task("K2K3")
    worth = {name: float(np.median(rollout(named(name, task), task, 20))) for name in BASELINES}
    assert max(worth, key=worth.__getitem__) == "design"
    assert worth["design"] >= 130.47
    assert worth["24"] > worth["six"]
    assert named("24", task)(np.zeros((7, 23), np.float32), 0).shape == (7, 3)


def test_greedy_takes_the_most_nats_a_second_from_the_menu():
    angles, dwell = greedy(Task())
    assert set(dwell) <= set(DWELLS)
    assert len(angles) == len(dwell) > 8
    assert rollout(following(angles, dwell, Task()), Task())[0] > 85


def test_training_without_deep_learning_improves_on_where_it_began():
    task = Task()
    trained = train(task, generations=12, population=64, elite=8, seed=3)
    began = rollout(linear_policy(START[None]), task)[0]
    assert rollout(trained, task)[0] == pytest.approx(max(trained.history), abs=1e-6)
    assert max(trained.history) > began + 0.5


def test_wrappers_keep_a_table_to_its_steps_and_limits():
    stepped = StepAngles(gymnasium.make(CONTINUOUS), 15.0)
    assert np.abs(
        stepped.action(np.array([0.31, -0.99, 0.2], np.float32))[:2]
    ) * 12 == pytest.approx([4.0, 12.0])
    with pytest.raises(TiltcalError, match="divides a turn"):
        StepAngles(gymnasium.make(CONTINUOUS), 7.0)


def test_a_table_keeps_to_its_limits_and_never_goes_the_short_way_through_what_is_forbidden():
    limits = {"outer": (20.0, 340.0), "inner": (-90.0, 45.0)}
    env = gymnasium.make(CONTINUOUS, limits_deg=limits, budget_s=600.0).unwrapped
    env.reset()
    assert env.bench.angles[0] == pytest.approx([20 * DEG, 0.0])
    *_, info = env.step(np.array([1.0, 1.0, -1.0], np.float32))  # 320 deg on, not 40 deg back
    assert env.bench.angles[0] == pytest.approx([340 * DEG, 45 * DEG])
    assert info["spent_s"] == pytest.approx(320 / 20 + 5 + 5)
    env.step(np.array([-3.0, -3.0, -1.0], np.float32))
    assert env.bench.angles[0] == pytest.approx([20 * DEG, -90 * DEG])
    choices = gymnasium.make(DISCRETE, limits_deg=limits, budget_s=600.0).unwrapped.menu / DEG
    assert 0 < len(choices) < 26
    assert ((choices >= [20, -90]) & (choices <= [340, 45])).all()
    with pytest.raises(TiltcalError, match="axis inner: found limits 20 to 10 deg"):
        gymnasium.make(CONTINUOUS, limits_deg={"inner": (20, 10)})
    with pytest.raises(TiltcalError, match="no face, edge or corner"):
        gymnasium.make(DISCRETE, limits_deg={"outer": (1, 2), "inner": (1, 2)})
