"""Runs by time steps: what the mechanics do must be what statics, servo theory and the closed form
say.
"""

from functools import cache
from types import MappingProxyType

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.forward.kinematics import closed_form, true_angles
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.setup.tables import BUILT_IN
from tiltcal.setup.trajectory import Jet
from tiltsim import build
from tiltsim import dynamics as module
from tiltsim.dynamics import DynamicCourse, run_dynamics
from tiltsim.laboratory import MujocoLaboratory
from tiltsim.motion import mujoco_motion

LEVER = (0.05, -0.03, 0.08)
BACKLASH = MappingProxyType({"id": "table_backlash", "width_arcsec": 40})
BENDS = MappingProxyType({"id": "mount_compliance", "bend_x_arcsec_g": 60, "bend_y_arcsec_g": 40})
ECCENTRIC = MappingProxyType(
    {"id": "table_encoder_eccentricity", "cos_arcsec": 300, "sin_arcsec": -200}
)
THERE_AND_BACK = (
    {"action": "rest", "dwell_s": 0.5},
    {"action": "move", "outer_deg": 20, "dwell_s": 2},
    {"action": "move", "outer_deg": 40, "dwell_s": 2},
    {"action": "move", "outer_deg": 20, "dwell_s": 2},
)
UP, DOWN = 3.8, 10.6  # s, late in the dwells at 20 deg that were reached from below and from above


def scenario_of(table, sequence, *effects, dynamics=MappingProxyType({}), **rig) -> Scenario:
    """A scenario at standard gravity, run by time steps unless ``dynamics`` is None."""
    text = {
        "schema": 1,
        "site": {"gravity_m_s2": G0},
        "rig": {"table": table, **rig},
        "sensor": [{"name": "accel", "kind": "accelerometer", "rate_hz": 50}],
        "effect": [dict(e) for e in effects],
        "sequence": [dict(step) for step in sequence],
    }
    if dynamics is not None:
        text["dynamics"] = dict(dynamics)
    return parse_scenario(text)


def run(
    table, sequence, *effects, seed=None, dynamics=MappingProxyType({}), **rig
) -> DynamicCourse:
    return run_dynamics(scenario_of(table, sequence, *effects, dynamics=dynamics, **rig), seed)


def at(course: DynamicCourse, *times: float):
    return course.drive(np.array(times))


def since_motion(time: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Time since the last moving sample, s, (n,); since the start where nothing moved yet."""
    moving = np.where(stop < 0, time, time[0])
    return time - np.maximum.accumulate(moving)


def servo_of(table: str, axis: str) -> tuple[float, float, float]:
    """kp, kv and joint damping, as the model's file states them."""
    model = mujoco.MjModel.from_xml_path(str(folder("models") / f"{table}.xml"))
    gain, bias = model.actuator(axis).gainprm, model.actuator(axis).biasprm
    return float(gain[0]), float(-bias[2]), float(model.joint(axis).damping[0])


def test_a_move_settles_on_the_command_and_the_droop_of_its_ballast():
    sag = {"id": "table_sag", "sag_arcsec": 10}
    (drive,) = [at(run("placing", THERE_AND_BACK, sag), UP)]
    weight, arm = 0.5 * G0, 0.1  # the ballast of table_sag
    droop = weight * arm * np.sin(20 * DEG) / servo_of("placing", "outer")[0]  # toward the fall
    # relative: the torque grows by cot(angle) times the deflections
    second_order = 10 * ARCSEC + droop
    assert drive.axes["outer"].x[0] - 20 * DEG == pytest.approx(droop, rel=3 * second_order)
    expected = 10 * ARCSEC * np.sin(20 * DEG)
    assert drive.structure["outer_sag"].x[0] == pytest.approx(expected, rel=3 * second_order)


def test_a_cruising_axis_lags_by_the_damping_over_the_stiffness_times_the_rate():
    turn = {"action": "turn", "axis": "outer", "angle_deg": 60, "rate_deg_s": 20}
    course = run("placing", [{"action": "rest", "dwell_s": 0.5}, turn])
    drive, asked = at(course, 2.5), course.scenario.schedule.drive(np.array([2.5]))
    kp, kv, damping = servo_of("placing", "outer")
    lag = asked.axes["outer"].x[0] - drive.axes["outer"].x[0]
    assert lag == pytest.approx((kv + damping) / kp * 20 * DEG, rel=1e-9)
    assert drive.axes["outer"].v[0] == pytest.approx(20 * DEG, rel=1e-10)


def test_the_scenario_may_set_the_servo():
    turn = {"action": "turn", "axis": "inner", "angle_deg": 60, "rate_deg_s": 20}
    servo = {"stiffness_N_m_rad": 5000, "damping_N_m_s_rad": 100}
    course = run("dual", [{"action": "rest", "dwell_s": 0.5}, turn], dynamics=servo)
    lag = (
        course.scenario.schedule.drive(np.array([2.5])).axes["inner"].x
        - at(course, 2.5).axes["inner"].x
    )
    assert lag[0] == pytest.approx((100 + servo_of("dual", "inner")[2]) / 5000 * 20 * DEG, rel=1e-9)


def test_dry_friction_leaves_the_axis_short_of_the_command_on_the_side_it_came_from():
    drive = at(run("dual", THERE_AND_BACK, dynamics={"friction_N_m": 2.0}), UP - 1, UP, DOWN)
    most = 2.0 / servo_of("dual", "outer")[0]
    short = 20 * DEG - drive.axes["outer"].x
    assert 0.8 * most < short[1] <= most
    assert -most <= short[2] < -0.8 * most
    creep = abs(short[1] - short[0])
    assert 0 < creep < 0.5 * ARCSEC


def test_backlash_rests_on_the_side_of_approach_as_its_closed_form_says():
    course = run("dual", THERE_AND_BACK, BACKLASH)
    (effect,) = course.scenario.effects
    time = np.linspace(*course.times, 2000)
    asked = course.scenario.schedule.drive(time)
    expected = np.interp([UP, DOWN], time, effect.deviation(asked, "outer", None).x)
    gap = at(course, UP, DOWN).structure["outer"].x
    assert expected == pytest.approx([-20 * ARCSEC, 20 * ARCSEC])
    # how far the stops give way under the servo's push
    assert gap == pytest.approx(expected, abs=0.02 * ARCSEC)


def test_the_load_does_not_rattle_between_the_stops_of_its_play():
    course = run("dual", THERE_AND_BACK, BACKLASH, dynamics={"timestep_s": 0.001})
    drive = course.drive(np.arange(UP - 1, UP, 0.003))
    assert np.abs(drive.structure["outer"].v).max() < 0.01 * ARCSEC
    assert np.ptp(drive.structure["outer"].x) < 0.01 * ARCSEC


def test_the_reader_does_not_add_backlash_a_second_time():
    course = run("dual", THERE_AND_BACK, BACKLASH)
    drive = at(course, UP, DOWN)
    load = drive.axes["outer"].x + drive.structure["outer"].x
    for mover in (mujoco_motion, closed_form):
        up = mover(course.scenario, drive, course.scenario.effects).up
        assert np.arctan2(up[:, 1], up[:, 2]) == pytest.approx(load, abs=1e-12)


@pytest.mark.parametrize("mount", ["identity", "Rz(90)", "Rx(40) Rz(-130)"])
def test_a_compliant_mount_settles_where_its_closed_form_says(mount):
    course = run("dual", THERE_AND_BACK, BENDS, mount=mount)
    drive = at(course, 0.4, UP, 6.5)
    force = closed_form(course.scenario, drive).force / G0
    bound = 3 * (60 * ARCSEC) ** 2  # second order
    assert drive.structure["bend_x"].x == pytest.approx(-60 * ARCSEC * force[:, 1], abs=bound)
    assert drive.structure["bend_y"].x == pytest.approx(40 * ARCSEC * force[:, 0], abs=bound)


def test_after_a_remount_the_bend_follows_the_body():
    steps = [*THERE_AND_BACK, {"action": "remount", "mount": "Rz(180)", "dwell_s": 2}]
    course = run("dual", steps, BENDS)
    bend = at(course, DOWN, course.times[1]).structure["bend_x"].x
    bound = 3 * (60 * ARCSEC) ** 2
    assert bend[1] == pytest.approx(-bend[0], abs=bound)
    assert bend[0] == pytest.approx(-60 * ARCSEC * np.sin(20 * DEG), abs=bound)


def test_a_counterweighted_mount_does_not_load_the_table():
    course = run("dual", THERE_AND_BACK, BENDS, {"id": "table_sag", "sag_arcsec": 10})
    sag = at(course, UP).structure["outer_sag"].x[0]
    # a bend of 60 arcsec moves 3e-4 of a load
    assert sag == pytest.approx(10 * ARCSEC * np.sin(20 * DEG), rel=1e-3)


def test_a_spring_too_stiff_for_the_time_step_is_left_to_the_reader():
    stiff = {"id": "mount_compliance", "bend_x_arcsec_g": 0.5}
    course = run("dual", THERE_AND_BACK, stiff)
    drive = at(course, UP)
    assert "bend_x" not in drive.structure
    read = mujoco_motion(course.scenario, drive, course.scenario.effects)
    told = closed_form(course.scenario, drive, course.scenario.effects)
    assert np.abs(read.force - told.force).max() < 3 * (0.5 * ARCSEC) ** 2 * G0


def mount_mode(course: DynamicCourse) -> tuple[float, float]:
    """Natural angular frequency, rad/s, and damping ratio of bend_y, from the model's own inertia.

    The integrator takes the damping torque c v half a step late, which is c dt / 2 of inertia.
    """
    scenario = course.scenario
    mechanisms = build.mechanisms_of(scenario, scenario.effects)
    rig = build.build(scenario, scenario.effects, mechanisms, "identity")
    data, inertia = mujoco.MjData(rig.model), np.empty((rig.model.nv, rig.model.nv))
    mujoco.mj_forward(rig.model, data)
    mujoco.mj_fullM(rig.model, data, inertia)
    i = rig.dof("bend_y")
    k, c = rig.springs["bend_y"], float(rig.model.dof_damping[i])
    J = inertia[i, i] + c * DT / 2
    return np.sqrt(k / J), c / (2 * np.sqrt(k * J))


DT = 0.0001  # s, short enough for the integrator's (omega dt)^2 / 24 = 3e-4


@cache
def shaken(frequency: float) -> DynamicCourse:
    """A mount that bends 30 arcsec/g about y on a base that shakes East by 20 mg."""
    bend = {"id": "mount_compliance", "bend_y_arcsec_g": 30}
    shake = {"id": "base_vibration", "ec_ug": 20000, "frequency_hz": frequency}
    return run(
        "vertical", [{"action": "rest", "dwell_s": 3}], bend, shake, dynamics={"timestep_s": DT}
    )


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0, 1.5])
def test_vibration_of_the_base_makes_the_mount_ring_by_its_transfer_function(share):
    omega, zeta = mount_mode(shaken(50.0))
    period = 2 * np.pi / (share * omega)
    time = 1.0 + period * np.arange(40 * 16) / 16
    bend = shaken(share * omega / (2 * np.pi)).drive(time).structure["bend_y"].x
    # an acceleration East bends by +y
    expected = 30 * ARCSEC * 0.02 / (1 - share**2 + 2j * zeta * share)
    amplitude = 2 * np.mean(bend * np.exp(-1j * share * omega * time))
    step = (omega * DT) ** 2  # second differences fall short by step / 12, first by step / 6
    hanging = 30 * ARCSEC  # m g l / k, the ballast as a pendulum
    assert abs(amplitude / expected - 1) < (step / 12 + hanging) / (2 * zeta) + step / 6


def test_a_slow_sequence_comes_to_the_prescribed_recording_at_rest():
    def recording(dynamics):
        scenario = scenario_of(
            "dual", THERE_AND_BACK, ECCENTRIC, dynamics=dynamics, lever_arm_m=LEVER
        )
        return MujocoLaboratory().record(scenario)

    stepped, prescribed = recording({}), recording(None)
    since = since_motion(
        stepped.time, scenario_of("dual", THERE_AND_BACK).schedule.drive(stepped.time).stop
    )
    resting = since > 1
    assert resting.sum() > 100
    for name in ("accel_x", "accel_y", "accel_z"):
        channel = stepped.channel(name)
        assert np.abs(stepped.column(channel) - prescribed.column(channel))[resting].max() < 1e-9
    assert np.abs(stepped.table("outer") - prescribed.table("outer"))[resting].max() < 1e-10


@pytest.mark.parametrize("effects", [(), (BENDS,)])
def test_readings_on_the_move_are_the_second_derivative_of_where_the_sensor_was(effects):
    turns = [
        {"action": "rest", "dwell_s": 0.5},
        {"action": "move", "outer_deg": 40, "inner_deg": 70},
    ]
    course = run("dual", turns, *effects, lever_arm_m=LEVER, dynamics={"timestep_s": 0.00025})
    log = course.log
    rows = np.flatnonzero((log.time > 0.5) & (log.time < course.times[1]))
    h = log.time[rows[1]] - log.time[rows[0]]
    rows = rows[np.isclose(log.time[rows + 2] - log.time[rows - 2], 4 * h, rtol=1e-6)]
    assert len(rows) > 1000
    q = {name: log.x[:, i] for name, i in course.columns.items()}
    R = Rotation.from_euler("XZ", np.column_stack([q["outer"], q["inner"]]))
    if effects:
        R = R * Rotation.from_euler("XY", np.column_stack([q["bend_x"], q["bend_y"]]))
    p = R.apply(LEVER)
    a = (-p[rows - 2] + 16 * p[rows - 1] - 30 * p[rows] + 16 * p[rows + 1] - p[rows + 2]) / (
        12 * h * h
    )
    expected = R[rows].inv().apply(a + np.array([0, 0, G0]))
    read = mujoco_motion(course.scenario, course.drive(log.time[rows]), course.scenario.effects)
    assert np.abs(expected - R[rows].inv().apply([0, 0, G0])).max() > 0.05  # it does move
    # rounding of 0.1 m twice differenced, 16 eps r / (12 h^2)
    assert np.abs(read.force - expected).max() < 1e-8


def test_between_two_rows_the_log_is_a_curve_with_its_own_derivatives(rng):
    poly = np.polynomial.Polynomial(rng.normal(size=6))
    start, end = (Jet(*(np.array([[poly.deriv(k)(t)]]) for k in range(3))) for t in (0.0, 0.7))
    got = module._quintic(start, end, np.array([[0.7]]), np.array([[0.3]]))
    assert [got.x[0, 0], got.v[0, 0], got.a[0, 0]] == pytest.approx(
        [poly(0.3), poly.deriv()(0.3), poly.deriv(2)(0.3)]
    )


def test_small_delays_read_a_smooth_motion():
    course = run("dual", THERE_AND_BACK)
    time = np.arange(0.5, 2.0, 1.3e-4)
    jet = course.drive(time).axes["outer"]
    h = 1e-5
    before, after = course.drive(time - h).axes["outer"], course.drive(time + h).axes["outer"]
    assert np.abs((after.x - before.x) / (2 * h) - jet.v).max() < 1e-7
    assert np.abs((after.v - before.v) / (2 * h) - jet.a).max() < 1e-3 * np.abs(jet.a).max()


def test_a_dwell_costs_few_rows():
    rest = run("dual", [{"action": "rest", "dwell_s": 20}])
    assert len(rest.log.time) < 20 / 0.05
    assert len(run("dual", THERE_AND_BACK).log.time) > 1500  # but a millisecond each on the move


def test_a_command_readout_holds_the_command_and_moves_the_same():
    effects = (BACKLASH, ECCENTRIC)
    told = run("dual", THERE_AND_BACK, *effects, dynamics={"friction_N_m": 1.0}, readout="command")
    read = run("dual", THERE_AND_BACK, *effects, dynamics={"friction_N_m": 1.0}, readout="encoder")
    time = np.linspace(*told.times, 500)
    asked, one, two = told.scenario.schedule.drive(time), told.drive(time), read.drive(time)
    assert np.array_equal(one.axes["outer"].x, asked.axes["outer"].x)
    # the encoder sees the lag
    assert np.abs(one.axes["outer"].x - two.axes["outer"].x).max() > 1e-3
    for part in ("x", "v", "a"):
        angles = [
            true_angles(c.scenario, d, c.scenario.effects)["outer"]
            for c, d in ((told, one), (read, two))
        ]
        assert np.abs(getattr(angles[0], part) - getattr(angles[1], part)).max() < 1e-9


BY_HAND = (
    {"action": "rest", "dwell_s": 2},
    {"action": "move", "up": "+x", "dwell_s": 3},
    {"action": "turn", "axis": "z", "angle_deg": 120, "rate_deg_s": 60, "dwell_s": 3},
)


@cache
def by_hand(seed: int | None) -> DynamicCourse:
    return run("handheld", BY_HAND, seed=seed)


def off_course(course: DynamicCourse, time: np.ndarray) -> np.ndarray:
    """Angle between where the body is and where it was to be, rad, (n,)."""
    asked = course.scenario.schedule.drive(time).attitude.R_wb
    return Rotation.from_matrix(
        np.swapaxes(asked, 1, 2) @ course.drive(time).attitude.R_wb
    ).magnitude()


def test_a_hand_reaches_the_wanted_attitude_and_then_lies_still():
    course = by_hand(1)
    time = np.linspace(*course.times, 4000)
    stops = course.scenario.schedule.drive(time).stop
    rest = since_motion(time, stops) > 1.5
    assert np.abs(course.drive(time).attitude.rate[rest]).max() < 1e-9
    assert off_course(course, time)[rest].max() < 1 * DEG


def test_a_hand_turns_as_irregularly_as_its_torque_makes_it():
    """rms of the rate = torque through 1 / (1 + s/c)^2 and s / (J (s + w)^2), J = 6e-3 kg m2 in
    models/.
    """
    turn = {"action": "turn", "axis": "z", "angle_deg": 900, "rate_deg_s": 20}
    course = run("handheld", [turn], seed=3, dynamics={"hand_torque_N_m": 0.05})
    time = np.linspace(1.0, 44.0, 20_000)  # at full speed
    rate = course.drive(time).attitude.rate - [0, 0, 20 * DEG]
    s, c, w = 2j * np.pi * np.linspace(0.005, 200, 40_000), 2 * np.pi * module.TREMOR, module.HAND
    shaped = 1 / abs(1 + s / c) ** 4
    share = np.sum(shaped * abs(s / (0.006 * (s + w) ** 2)) ** 2) / np.sum(shaped)
    independent = 3 * (time[-1] - time[0]) * module.TREMOR  # samples, about
    assert np.sqrt(np.mean(rate**2)) == pytest.approx(
        0.05 * np.sqrt(share), rel=4 / np.sqrt(2 * independent)
    )


def test_a_hand_repeats_by_seed_and_is_smooth_without_one():
    time = np.linspace(*by_hand(1).times, 1000)
    first = by_hand(1).drive(time).attitude.R_wb
    again = run("handheld", BY_HAND, seed=1).drive(time).attitude.R_wb
    assert np.array_equal(first, again)
    assert np.abs(first - by_hand(2).drive(time).attitude.R_wb).max() > 1e-3
    smooth = by_hand(None)
    calm, irregular = (np.abs(np.diff(off_course(c, time))).sum() for c in (smooth, by_hand(1)))
    assert irregular > 3 * calm  # the smooth one only lags behind as it speeds up, and catches up


def test_a_hands_rate_is_the_derivative_of_its_attitude():
    course, h = by_hand(1), 1e-5
    time = np.linspace(2.1, course.times[1] - 1, 1777)
    before, after = (
        Rotation.from_matrix(course.drive(time + s * h).attitude.R_wb) for s in (-1, 1)
    )
    attitude = course.drive(time).attitude
    assert np.abs((before.inv() * after).as_rotvec() / (2 * h) - attitude.rate).max() < 1e-6
    change = (course.drive(time + h).attitude.rate - course.drive(time - h).attitude.rate) / (2 * h)
    assert np.abs(change - attitude.acceleration).max() < 1e-3 * np.abs(attitude.acceleration).max()


def test_the_tremor_has_the_stated_rms(rng):
    noise = module._Tremor(0.0005).draw(rng, 400_000)
    # samples, about: correlation of some 2 / corner
    independent = 400_000 * 0.0005 * 2 * np.pi * module.TREMOR / 2
    assert noise.std(axis=0) == pytest.approx(1.0, abs=4 / np.sqrt(2 * independent))


@pytest.mark.parametrize("table", BUILT_IN)
def test_every_table_records_by_time_steps(table):
    step = {
        "action": "turn",
        "axis": "outer" if BUILT_IN[table].axes else "x",
        "angle_deg": 10,
        "dwell_s": 1,
    }
    recording = MujocoLaboratory().record(scenario_of(table, [step]), 4)
    force = np.column_stack([recording.column(recording.channel(f"accel_{a}")) for a in "xyz"])
    side = G0 * np.sin(10 * DEG)
    expected = {"z": (0, 0), "y": (-side, 0)}.get(
        "".join(BUILT_IN[table].directions[:1]), (0, side)
    )
    assert force[-1, :2] == pytest.approx(expected, abs=1e-6)
    assert np.linalg.norm(force, axis=1) == pytest.approx(G0, abs=1e-9)  # no lever arm


def test_a_run_that_diverges_says_so(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves its log there
    with pytest.raises(TiltcalError, match=r"diverges before .* lower dynamics.timestep_s"):
        run("dual", THERE_AND_BACK, dynamics={"stiffness_N_m_rad": 1e9, "timestep_s": 0.002})


def test_progress_is_told():
    heard = []
    course = run_dynamics(
        scenario_of("dual", THERE_AND_BACK), None, lambda done, total: heard.append((done, total))
    )
    assert heard[-1][0] == heard[-1][1] >= (course.times[1] - course.times[0]) / 0.0005
    assert [done for done, _ in heard] == sorted(done for done, _ in heard)


@pytest.mark.parametrize("id", ["table_backlash", "servo_friction_deadband"])
def test_lost_motion_that_is_crossed_gradually_is_added_to_the_run_by_algebra(id):
    course = run("dual", THERE_AND_BACK, {"id": id, "width_arcsec": 40, "crossing_deg": 60})
    drive = course.drive(np.linspace(*course.times, 2000))
    assert not drive.structure
    assert not drive.realised
    lag = (
        true_angles(course.scenario, drive, course.scenario.effects)["outer"].x
        - drive.axes["outer"].x
    )
    # 20 of 30 deg from the middle of the play; at 40 pushed; 20 back
    expected = [
        -40 / 3 * ARCSEC,
        -20 / 3 * ARCSEC,
    ]
    np.testing.assert_allclose(np.interp([UP, DOWN], drive.time, lag), expected, atol=0.05 * ARCSEC)
