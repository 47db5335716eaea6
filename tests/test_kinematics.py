"""The closed form against MuJoCo, and both against differentiation: two derivations of the same
motion.
"""

import mujoco
import numpy as np
import pytest
from builders import AXLED, FOG, GYRO, LATITUDE, TABLES, schedule_of, setup_of, still, tossed

from tiltcal.core.assets import folder
from tiltcal.core.frames import earth_rate, rotation, skew
from tiltcal.core.units import DEG, EARTH_RATE
from tiltcal.effects.mechanisms import World
from tiltcal.forward.kinematics import closed_form
from tiltcal.setup.schedule import RAMP, Leg
from tiltcal.setup.trajectory import Jet, sampled_jet
from tiltsim.motion import _Runner, mujoco_motion
from tiltsim.rig import RigBuilder

LEVER = (0.05, -0.03, 0.08)
STATES = 1000
TURNED = rotation("x", 0.3) @ rotation("z", 2.0)


def mounted(drive, *mounts):
    """The drive with mountings, (row, matrix) each."""
    return type(drive)(**{**vars(drive), "mounts": mounts})


def by_parts(motion):
    return {
        "force": motion.force,
        "rate": motion.rate,
        "up": motion.up,
        "spin": motion.angular_acceleration,
    }


def assert_same_motion(one, two, **limits):
    for name, limit in limits.items():
        assert np.abs(by_parts(one)[name] - by_parts(two)[name]).max() <= limit, name


@pytest.mark.parametrize("table", TABLES)
def test_mujoco_and_the_closed_form_agree_at_rest(table, rng):
    setup = setup_of(table, heading=25.0, lever_arm_m=LEVER)
    drive = mounted(tossed(setup, rng, STATES, moving=False), (0, np.eye(3)), (STATES // 2, TURNED))
    assert_same_motion(
        mujoco_motion(setup, drive),
        closed_form(setup, drive),
        force=1e-13,
        rate=1e-13,
        up=1e-13,
        spin=1e-13,
    )


@pytest.mark.parametrize("table", TABLES)
def test_mujoco_and_the_closed_form_agree_in_motion_with_a_lever_arm(table, rng):
    setup = setup_of(table, heading=25.0, lever_arm_m=LEVER)
    drive = mounted(tossed(setup, rng, STATES, moving=True), (0, TURNED))
    assert_same_motion(
        mujoco_motion(setup, drive),
        closed_form(setup, drive),
        force=1e-12,
        rate=1e-13,
        up=1e-13,
        spin=1e-12,
    )


@pytest.mark.parametrize("table", AXLED)
def test_earths_rotation_as_a_root_hinge_gives_the_products_correction(table, rng):
    """docs/physics.md, "Conventions": the laboratory itself turns on a hinge along the Earth's
    axis, read by mj_inverse.
    """
    heading = 25.0
    setup = setup_of(table, heading=heading, lever_arm_m=LEVER)
    drive = tossed(setup, rng, 100, moving=True)
    spec = mujoco.MjSpec.from_file(str(folder("models") / f"{table}.xml"))
    spec.option.gravity = [0, 0, -setup.site.gravity]
    axis = earth_rate(LATITUDE * DEG, heading * DEG) / EARTH_RATE
    spec.body("base").add_joint(name="earth", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    for site in ("accel", "gyro"):
        spec.site(site).pos = LEVER
    model = spec.compile()
    data = mujoco.MjData(model)
    earth = model.joint("earth").dofadr[0]
    product = closed_form(setup, drive)
    for k in range(len(drive.time)):
        data.qpos[:], data.qvel[:], data.qacc[:] = 0, 0, 0
        data.qvel[earth] = EARTH_RATE
        for name, jet in drive.axes.items():
            i = model.joint(name).dofadr[0]
            data.qpos[i], data.qvel[i], data.qacc[i] = jet.x[k], jet.v[k], jet.a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(data.sensor("accel").data, product.force[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.sensor("gyro").data, product.rate[k], rtol=0, atol=1e-13)


def test_leaving_the_earth_out_would_be_seen(rng):
    setup = setup_of("three", lever_arm_m=LEVER)
    blind = setup.model_copy(update={"site": setup.site.model_copy(update={"latitude_deg": None})})
    drive = tossed(setup, rng, 100, moving=True)
    with_earth, without = closed_form(setup, drive), closed_form(blind, drive)
    np.testing.assert_allclose(np.linalg.norm(with_earth.rate - without.rate, axis=1), EARTH_RATE)
    assert np.abs(with_earth.force - without.force).max() > 1e-6


@pytest.mark.parametrize(
    "direction", [(1, 1, 1), (0, 0, 1), (0, 1, 0), (0.1, -0.9, -0.3), (0, 0, -1)]
)
def test_the_models_fog_site_looks_along_the_input_axis(direction, rng):
    fog = FOG.model_copy(update={"input_axis": direction})
    setup = setup_of("three", GYRO, fog)
    builder = RigBuilder(setup, World.of(setup), np.eye(3))
    builder.spec.add_sensor(
        name="along",
        type=mujoco.mjtSensor.mjSENS_GYRO,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="fog",
    )
    rig = builder.compile()
    data = mujoco.MjData(rig.model)
    data.qpos[:], data.qvel[:] = rng.normal(size=(2, rig.model.nq))
    mujoco.mj_forward(rig.model, data)
    assert data.sensor("along").data[2] == pytest.approx(
        data.sensor("gyro").data @ fog.input_vector, abs=1e-14
    )


def derivative(f, time, h):
    """Five-point first derivative of a function of time."""
    return (f(time - 2 * h) - 8 * f(time - h) + 8 * f(time + h) - f(time + 2 * h)) / (12 * h)


LEGS = {
    "a long move": Leg(1.0, 6.0, np.zeros(1), np.ones(1), "ramp"),
    "a move too short to cruise": Leg(1.0, 1.0 + 2 * RAMP, np.zeros(1), np.ones(1), "ramp"),
    "a swing": Leg(1.0, 6.0, np.zeros(1), np.ones(1), "swing", frequency=0.8),
    "a rest": Leg(1.0, 6.0, np.zeros(1), np.ones(1), "rest"),
}


@pytest.mark.parametrize("leg", LEGS.values(), ids=LEGS.keys())
def test_rates_and_accelerations_of_a_leg_are_the_derivatives_of_its_angle(leg):
    h = 1e-3
    time = np.linspace(leg.t0 + 2 * h, leg.t1 - 2 * h, 3001)
    jet = leg.progress(time)
    np.testing.assert_allclose(derivative(lambda t: leg.progress(t).x, time, h), jet.v, atol=1e-7)
    np.testing.assert_allclose(
        derivative(lambda t: leg.progress(t).v, time, h),
        jet.a,
        atol=2e-5 * max(1, np.abs(jet.a).max()),
    )


@pytest.mark.parametrize("leg", LEGS.values(), ids=LEGS.keys())
def test_a_leg_starts_and_ends_at_rest_and_covers_its_whole_way(leg):
    ends = leg.progress(np.array([leg.t0, leg.t1]))
    np.testing.assert_allclose(ends.x, [0, 1 if leg.profile == "ramp" else 0], atol=1e-15)
    np.testing.assert_allclose(ends.v, 0, atol=1e-14)
    np.testing.assert_allclose(ends.a, 0, atol=1e-12)


def test_a_schedule_is_continuous_over_all_its_legs():
    setup = setup_of("three")
    schedule = schedule_of(
        setup,
        {"action": "rest", "dwell_s": 1.0},
        {"action": "move", "outer_deg": 90, "middle_deg": -30, "dwell_s": 0.5},
        {"action": "turn", "axis": "inner", "angle_deg": -2, "rate_deg_s": 30},
        {
            "action": "oscillate",
            "axis": "middle",
            "amplitude_deg": 10,
            "frequency_hz": 1.0,
            "cycles": 3,
        },
        {"action": "sweep", "outer_deg": 0, "step_deg": 45, "dwell_s": 0.5},
    )
    h = 1e-4
    time = np.arange(schedule.times[0] + 2 * h, schedule.times[1] - 2 * h, 0.0031)
    for name in setup.rig.axis_names:
        jet = schedule.drive(time).axes[name]
        np.testing.assert_allclose(
            derivative(lambda t, n=name: schedule.drive(t).axes[n].x, time, h), jet.v, atol=1e-7
        )
        np.testing.assert_allclose(
            derivative(lambda t, n=name: schedule.drive(t).axes[n].v, time, h), jet.a, atol=1e-4
        )


def by_hand():
    setup = setup_of("handheld", lever_arm_m=LEVER)
    steps = [
        {"action": "rest", "dwell_s": 0.5},
        {
            "action": "turn",
            "axis": [1.0, 2.0, -1.0],
            "angle_deg": 170,
            "rate_deg_s": 90,
            "dwell_s": 0.5,
        },
        {"action": "move", "up": "-z", "rate_deg_s": 60},
        {"action": "turn", "axis": "y", "angle_deg": -100, "rate_deg_s": 120},
    ]
    return setup, schedule_of(setup, *steps)


def test_the_rate_of_a_hand_held_body_is_the_derivative_of_its_attitude():
    _, schedule = by_hand()
    h = 1e-4
    time = np.arange(schedule.times[0] + 2 * h, schedule.times[1] - 2 * h, 0.0071)
    attitude = schedule.drive(time).attitude
    slope = derivative(lambda t: schedule.drive(t).attitude.R_wb, time, h)
    for R, dR, rate in zip(attitude.R_wb, slope, attitude.rate, strict=True):
        np.testing.assert_allclose(R.T @ dR, skew(rate), atol=1e-6)
    np.testing.assert_allclose(
        derivative(lambda t: schedule.drive(t).attitude.rate, time, h),
        attitude.acceleration,
        atol=1e-3,
    )


def test_the_force_of_a_hand_held_lever_arm_is_the_second_derivative_of_its_path():
    setup, schedule = by_hand()
    setup = setup.model_copy(update={"site": setup.site.model_copy(update={"latitude_deg": None})})
    h = 1e-3
    time = np.arange(schedule.times[0] + 3 * h, schedule.times[1] - 3 * h, 0.0071)

    def path(t):
        return schedule.drive(t).attitude.R_wb @ np.array(LEVER)

    acceleration = (
        -path(time - 2 * h)
        + 16 * path(time - h)
        - 30 * path(time)
        + 16 * path(time + h)
        - path(time + 2 * h)
    ) / (12 * h * h)
    drive = schedule.drive(time)
    force = np.einsum(
        "nji,nj->ni", drive.attitude.R_wb, acceleration + np.array([0, 0, setup.site.gravity])
    )
    product = closed_form(setup, drive).force
    assert np.abs(product).max() > setup.site.gravity + 0.1  # the arm is felt
    np.testing.assert_allclose(product, force, atol=1e-3)


def test_moving_to_an_up_direction_brings_it_up():
    setup, schedule = by_hand()
    (move,) = [leg for leg in schedule.legs if leg.label == "-z" and leg.profile == "ramp"]
    np.testing.assert_allclose(
        closed_form(setup, schedule.drive(np.array([0.0, move.t1 - 1e-9]))).up,
        [[0, 0, 1], [0, 0, -1]],
        atol=1e-7,
    )


def test_a_harmonic_jet_obeys_the_chain_rule(rng):
    x, v, a = rng.normal(size=(3, 50))
    jet = Jet(x, v, a).harmonic(3, 0.2, -0.7)

    def value(t):
        q = 3 * (x + v * t + a * t * t / 2)
        return 0.2 * np.cos(q) - 0.7 * np.sin(q)

    h = 1e-4
    np.testing.assert_allclose(
        jet.v, (value(h) - value(-h)) / (2 * h), atol=1e-6 * (1 + np.abs(v).max() ** 3) * 27
    )
    np.testing.assert_allclose(
        jet.a,
        (value(h) - 2 * value(0.0) + value(-h)) / h**2,
        atol=1e-5 * (1 + np.abs(v).max() ** 4),
    )
    np.testing.assert_allclose((jet + jet - jet.scaled(2)).x, 0)


def test_sampled_jets_differentiate_and_constants_stay_still():
    time = np.linspace(0, 10, 501)
    jet = sampled_jet(time, np.sin(time))
    np.testing.assert_allclose(jet.v[2:-2], np.cos(time)[2:-2], atol=1e-4)
    np.testing.assert_allclose(jet.a[2:-2], -np.sin(time)[2:-2], atol=2e-2)
    assert not np.any(sampled_jet(time, np.ones(501)).v)
    assert Jet(1.0).constant
    assert not Jet(1.0, 1.0).constant


def test_mujoco_computes_a_dwell_once(monkeypatch):
    setup, states = setup_of("dual"), []
    monkeypatch.setattr(
        "tiltsim.motion._Runner", lambda rig, n: states.append(n) or _Runner(rig, n)
    )
    motion = mujoco_motion(setup, still(setup, outer=np.repeat([20.0, -5.0], 250)))
    assert states == [2]
    assert motion.force.shape == (500, 3)
