"""Effects of the drive and of what rings, as mechanics in a run by time steps: each must be what
its closed form says.
"""

from functools import cache

import mujoco
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from test_dynamics import DOWN, THERE_AND_BACK, UP, at, run, scenario_of, servo_of

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.forward.kinematics import closed_form, true_angles
from tiltsim import build
from tiltsim.motion import mujoco_motion

STEP = 0.0005  # s, of the default run
RINGS = ((20.0, 0.2), (10.0, 0.5), (5.0, 2.0))  # Hz and s, as plausible as they come


def error_of(course, time):
    """True angle of the outer axis minus its command, by the log and by the closed form of the
    course's one effect, rad.
    """
    (effect,) = course.scenario.effects
    span = np.linspace(*course.times, 4000)
    told = effect.deviation(course.scenario.schedule.drive(span), "outer", None).x
    drive = at(course, *time)
    asked = course.scenario.schedule.drive(np.array(time)).axes["outer"].x
    return true_angles(course.scenario, drive, [effect])["outer"].x - asked, np.interp(
        time, span, told
    )


def inertia_of(table, joint, *effects):
    """Inertia that a joint moves, kg m2, at the start."""
    scenario = scenario_of(table, THERE_AND_BACK, *effects)
    rig = build.build(
        scenario, scenario.effects, build.mechanisms_of(scenario, scenario.effects), "identity"
    )
    data, inertia = mujoco.MjData(rig.model), np.empty((rig.model.nv, rig.model.nv))
    mujoco.mj_forward(rig.model, data)
    mujoco.mj_fullM(rig.model, data, inertia)
    return inertia[rig.dof(joint), rig.dof(joint)]


@pytest.mark.parametrize("readout", ["command", "encoder"])
@pytest.mark.parametrize(("table", "width"), [("placing", 2), ("dual", 20), ("vertical", 60)])
def test_dry_friction_rests_half_the_dead_band_short_but_for_its_creep(table, width, readout):
    """Regularised friction creeps by R force / b: impedance 0.9999 and b = 2 / 1 ms, see harden()
    in rig.py.
    """
    course = run(
        table,
        THERE_AND_BACK,
        {"id": "servo_friction_deadband", "width_arcsec": width},
        readout=readout,
    )
    found, told = error_of(course, (UP, DOWN))
    assert told == pytest.approx(np.array([-width, width]) / 2 * ARCSEC)
    lasts = 2000 * 0.9999 / 0.0001 * inertia_of(table, "outer") / servo_of(table, "outer")[0]
    creep = 1 - np.exp(-2.0 / lasts)  # of a dwell of two seconds
    assert np.all(found / told <= 1 + 1e-9)
    assert np.all(found / told > 1 - 1.1 * creep)
    assert creep < 0.02


def test_friction_of_the_scenario_and_of_the_effect_add_up():
    own = {"id": "servo_friction_deadband", "width_arcsec": 20}
    course = run("dual", THERE_AND_BACK, own, dynamics={"friction_N_m": 2.0}, readout="command")
    found, told = error_of(course, (UP,))
    # creep of both
    assert found[0] - told[0] == pytest.approx(-2.0 / servo_of("dual", "outer")[0], rel=0.05)


@pytest.mark.parametrize(
    ("tau", "rings_on"), [(0.01, 1e-3), (0.2, 1e-9), (1, 1e-9), (10, 1e-9), (50, 1e-9)]
)
def test_a_servo_follows_a_ramp_by_its_lag_behind(tau, rings_on):
    turn = {"action": "turn", "axis": "outer", "angle_deg": 60, "rate_deg_s": 20}
    effect = {"id": "servo_lag", "tau_ms": tau}
    course = run("placing", [{"action": "rest", "dwell_s": 0.5}, turn], effect, readout="command")
    found, told = error_of(course, (2.5,))
    assert told[0] == pytest.approx(-tau * 1e-3 * 20 * DEG)
    assert found[0] == pytest.approx(told[0], rel=rings_on)


def test_lag_is_gone_at_rest_and_only_its_own_axis_has_it():
    moves = [
        {"action": "rest", "dwell_s": 0.5},
        {"action": "move", "outer_deg": 40, "inner_deg": 40, "dwell_s": 2},
    ]
    course, plain = (
        run("dual", moves, *e, readout="command")
        for e in ([{"id": "servo_lag", "tau_ms": 5, "axis": "inner"}], [])
    )
    end = course.times[1]
    assert abs(at(course, end).structure["inner"].x[0]) < 1e-12
    lag = [at(c, 1.5).structure for c in (course, plain)]
    assert lag[0]["inner"].x[0] == pytest.approx(
        -0.005 * at(course, 1.5).axes["inner"].v[0], rel=1e-6
    )
    assert lag[0]["outer"].x[0] == pytest.approx(lag[1]["outer"].x[0], rel=1e-9)


@pytest.mark.parametrize("readout", ["command", "encoder"])
@pytest.mark.parametrize("droop", [0.05, -20, 60])
def test_a_servo_gives_way_to_a_ballast_by_its_droop(droop, readout):
    course = run(
        "placing", THERE_AND_BACK, {"id": "servo_droop", "droop_arcsec": droop}, readout=readout
    )
    found, told = error_of(course, (UP, 6.5))
    assert told == pytest.approx(droop * ARCSEC * np.sin([20 * DEG, 40 * DEG]))
    # relative: the torque grows with the deflection
    second_order = abs(droop) * ARCSEC / np.tan(20 * DEG)
    assert found == pytest.approx(told, rel=1.01 * second_order + 1e-7)
    assert "outer_sag" not in at(course, UP).structure  # the encoder sees it: no structure bends


@pytest.mark.parametrize("pull", [20, -3])
def test_a_cable_holds_the_axis_off_in_proportion_to_its_turns(pull):
    turn = {"action": "turn", "axis": "outer", "angle_deg": 400, "rate_deg_s": 90, "dwell_s": 2}
    course = run(
        "vertical", [turn], {"id": "cable_torque", "pull_arcsec_rad": pull}, readout="command"
    )
    found, told = error_of(course, (course.times[1],))
    assert told[0] == pytest.approx(pull * ARCSEC * 400 * DEG)
    assert found[0] == pytest.approx(told[0], rel=1e-9)


def test_a_rate_error_is_no_cable():
    course = run("vertical", THERE_AND_BACK, {"id": "rate_error", "rate_ppm": 100})
    assert at(course, UP).realised == ()


@pytest.mark.parametrize("rate", [1, 20, 60])
def test_cogging_ripples_the_angle_as_the_servo_lets_it_through(rate):
    size, n = 1e-3 / 12, 12
    turn = {"action": "turn", "axis": "outer", "angle_deg": 95 + 2 * rate, "rate_deg_s": rate}
    course = run("vertical", [turn], {"id": "servo_ripple", "ripple_ppm": 1000}, readout="command")
    time = 1.5 + np.linspace(0, 30 * 3 / rate, 3000, endpoint=False)  # three periods at full speed
    drive = course.drive(time)
    off, angle = drive.structure["outer"].x, drive.axes["outer"].x + drive.structure["outer"].x
    columns = np.column_stack([np.sin(n * angle), np.cos(n * angle), np.ones_like(angle)])
    sine, cosine, _ = np.linalg.lstsq(columns, off, rcond=None)[0] / size
    kp, kv, damping = servo_of("vertical", "outer")
    omega = n * rate * DEG
    through = 1 / (
        1 + 1j * omega * (kv + damping) / kp - inertia_of("vertical", "outer") * omega**2 / kp
    )
    second_order = 1e-3 + omega * STEP  # of the ripple; the damping acts half a step late
    assert abs(sine + 1j * cosine - through) < second_order
    # the closed form is the slow limit
    assert abs(sine + 1j * cosine - 1) < abs(through - 1) + second_order
    if rate == 1:
        assert abs(through - 1) < 0.01


@cache
def rung(table, effect, frequency, tau, size, rate=5.0):
    """A turn at a rate and a dwell of 3 s, with what rings afterwards at some size."""
    parts = ("amplitude",) if effect == "settling_transient" else ("ring_x", "ring_y")
    made = {
        "id": effect,
        "frequency_hz": frequency,
        "tau_s": tau,
        **{f"{p}_arcsec": size for p in parts},
    }
    turn = {"action": "turn", "axis": "outer", "angle_deg": 20, "rate_deg_s": rate, "dwell_s": 3}
    return run(table, [{"action": "rest", "dwell_s": 0.5}, turn], made)


def dwell(course):
    """Times of its dwell."""
    return np.arange(course.times[1] - 3 + 1e-9, course.times[1], 0.001)


def ring_of(time, x, frequency, tau):
    """Amplitudes of cosine and sine, decay rate and angular frequency of a decaying tone, and the
    largest residual.
    """

    def wave(p):
        return np.exp(-time * p[2]) * (p[0] * np.cos(p[3] * time) + p[1] * np.sin(p[3] * time))

    scale = np.abs(x).max()
    start = [scale, 0, 1.1 / tau, 2 * np.pi * frequency * 1.01]
    found = least_squares(
        lambda p: (wave(p) - x) / scale,
        start,
        x_scale=[scale, scale, 1, 1],
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return found.x, np.abs(found.fun).max()


@pytest.mark.parametrize("table", ["placing", "vertical", "dual", "three"])
@pytest.mark.parametrize(("frequency", "tau"), RINGS)
def test_the_structure_rings_after_a_move_with_its_own_frequency_and_decay(table, frequency, tau):
    course = rung(table, "settling_transient", frequency, tau, 20)
    time = dwell(course)
    late = time > time[0] + 0.4  # the servo's own modes have died, exp(-16)
    x = course.drive(time).structure["outer"].x
    (_, _, decay, omega), residual = ring_of(time[late] - time[0], x[late], frequency, tau)
    assert decay == pytest.approx(1 / tau, rel=1e-5)
    assert omega == pytest.approx(2 * np.pi * frequency, rel=1e-6)
    assert residual < 1e-5


@pytest.mark.parametrize(("frequency", "tau"), RINGS)
def test_a_move_lets_the_structure_go_at_its_amplitude(frequency, tau):
    """By the difference of two sizes, which leaves out how the move itself shook it; released from
    rest, 1 / (w tau) off.
    """
    courses = [rung("placing", "settling_transient", frequency, tau, size) for size in (40, 20)]
    time, (effect,) = dwell(courses[1]), courses[1].scenario.effects
    x, y = (c.drive(time).structure["outer"].x for c in courses)
    span = np.linspace(*courses[1].times, 20000)
    told = np.interp(
        time, span, effect.deviation(courses[1].scenario.schedule.drive(span), "outer", None).x
    )
    omega = 2 * np.pi * frequency
    kp, kv, damping = servo_of("placing", "outer")
    behind = inertia_of(
        "placing", "outer_ring_y", {"id": "settling_transient", "amplitude_arcsec": 1}
    )
    # how far the servo goes along
    gives = behind * omega**2 / abs(kp + 1j * omega * (kv + damping))
    started = time > time[0] + 0.02
    assert np.abs(told).max() > 19 * ARCSEC
    within = 1 / (omega * tau) + gives + omega * (span[1] - span[0])
    assert within < 0.25
    assert np.abs(x - y - told)[started].max() < within * 20 * ARCSEC


def test_the_structure_bends_back_while_the_table_speeds_up():
    course = rung("vertical", "settling_transient", 20.0, 0.2, 0.01, rate=30.0)
    asked = course.drive(np.linspace(0.55, 0.85, 200))
    bent = asked.structure["outer"].x
    slow = -np.asarray(asked.axes["outer"].a) / (2 * np.pi * 20) ** 2
    assert np.abs(slow).max() > 20 * ARCSEC
    # of the start against the swing
    transient = (2 * np.pi / 0.4 / (2 * np.pi * 20)) + 1 / (2 * np.pi * 20 * 0.2)
    assert np.abs(bent - slow).max() < transient * np.abs(slow).max()


@pytest.mark.parametrize(("frequency", "tau"), [(100.0, 0.1), (40.0, 0.3), (20.0, 1.0)])
def test_the_mount_rings_in_its_own_axes(frequency, tau):
    course = rung("dual", "mount_resonance", frequency, tau, 10)
    time = dwell(course)
    drive = course.drive(time)
    omega = 2 * np.pi * frequency
    for name in ("mount_ring_x", "mount_ring_y"):
        (c, s, decay, w), _ = ring_of(time - time[0], drive.structure[name].x, frequency, tau)
        assert decay == pytest.approx(1 / tau, rel=5e-3)
        assert w == pytest.approx(omega, rel=5e-4)
        # about the other axis than the table turned: nothing else shook it
        if name == "mount_ring_y":
            assert np.hypot(c - 10 * ARCSEC, s) < 10 * ARCSEC * (
                1 / (omega * tau) + omega * 2 * STEP
            )


def test_what_rang_is_read_once_by_both_readers():
    course = rung("dual", "mount_resonance", 40.0, 0.3, 10)
    time = dwell(course)[:400]
    drive = course.drive(time)
    assert drive.realised == ("mount_resonance",)
    q, ring = drive.axes, drive.structure
    R = Rotation.from_euler("XZ", np.column_stack([q["outer"].x, q["inner"].x]))
    R = R * Rotation.from_euler(
        "XY", np.column_stack([ring["mount_ring_x"].x, ring["mount_ring_y"].x])
    )
    for mover in (mujoco_motion, closed_form):
        up = mover(course.scenario, drive, course.scenario.effects).up
        assert np.abs(up - R.inv().apply([0, 0, 1])).max() < 1e-12
    assert np.abs(ring["mount_ring_x"].x).max() > 5 * ARCSEC


FACES = (
    {"id": "servo_friction_deadband", "width_arcsec": 20},
    {"id": "servo_lag", "tau_ms": 20},
    {"id": "servo_droop", "droop_arcsec": 30},
    {"id": "cable_torque", "pull_arcsec_rad": 20},
    {"id": "servo_ripple", "ripple_ppm": 1000},
    {"id": "settling_transient", "amplitude_arcsec": 40},
)


@pytest.mark.parametrize("face", FACES, ids=lambda f: f["id"])
def test_a_face_moves_the_table_the_same_whatever_is_read_and_is_read_once(face):
    courses = [
        run("dual", THERE_AND_BACK, face, readout=readout) for readout in ("command", "encoder")
    ]
    time = np.linspace(0.6, UP, 300)
    angles = []
    for course in courses:
        drive = course.drive(time)
        assert drive.realised == (face["id"],)
        for mover in (mujoco_motion, closed_form):
            up = mover(course.scenario, drive, course.scenario.effects).up
            angles.append(np.arctan2(up[:, 1], up[:, 2]))
        of_log = drive.axes["outer"].x + (
            drive.structure["outer"].x if "outer" in drive.structure else 0
        )
        assert np.abs(angles[-1] - of_log).max() < 1e-12
    assert np.ptp(angles, axis=0).max() < 1e-12
    plain = at(run("dual", THERE_AND_BACK), *time).axes["outer"].x
    assert np.abs(plain - angles[0]).max() > 2 * ARCSEC  # and it does something


def test_all_of_them_together_settle_on_the_sum_of_their_closed_forms():
    """All but friction, which stops the axis anywhere in its dead band once something rings against
    it.
    """

    def rest(*faces):
        course = run("dual", THERE_AND_BACK, *faces, readout="command")
        drive, asked = at(course, UP), course.scenario.schedule.drive(np.linspace(0, UP, 4000))
        assert set(drive.realised) == {face["id"] for face in faces}
        told = sum(
            e.deviation(asked, "outer", None).x[-1]
            for e in course.scenario.effects
            if e.id != FACES[0]["id"]
        )
        return drive.structure["outer"].x[0], told

    quick = FACES[5] | {"tau_s": 0.1}
    found, told = rest(*FACES[1:5], quick)
    assert abs(told) > 1 * ARCSEC
    # the slope of the cogging against its kp, over what the others displace it
    second_order = 1e-3 * 60 * ARCSEC
    assert found == pytest.approx(told, abs=second_order + 40 * ARCSEC * np.exp(-1.5 / 0.1))
    with_friction, _ = rest(FACES[0], *FACES[1:5], quick)
    assert 0.01 * ARCSEC < abs(with_friction - told) < 10 * ARCSEC


def test_a_structure_that_rings_does_not_sag_on_that_hinge_too():
    effects = (
        {"id": "table_sag", "sag_arcsec": 30},
        {"id": "settling_transient", "amplitude_arcsec": 20, "tau_s": 0.1},
    )
    course = run("placing", THERE_AND_BACK, *effects)
    drive = at(course, UP)
    assert abs(drive.structure["outer"].x[0]) < 0.01 * ARCSEC
    assert drive.structure["outer_sag"].x[0] == pytest.approx(
        30 * ARCSEC * np.sin(20 * DEG), rel=1e-3
    )


def test_a_ring_too_fast_for_the_time_step_is_left_to_the_reader():
    course = rung("dual", "mount_resonance", 300.0, 0.1, 10)
    time = dwell(course)[:50]
    drive = course.drive(np.concatenate([time[:1] - 0.1, time]))
    assert drive.realised == ()
    assert "mount_ring_x" not in drive.structure
    read, still = (
        mujoco_motion(course.scenario, drive, effects) for effects in (course.scenario.effects, ())
    )
    assert np.abs(read.force - still.force).max() > 5 * ARCSEC * G0


def test_two_rings_about_one_axis_are_refused():
    ring = {"id": "settling_transient", "amplitude_arcsec": 20}
    with pytest.raises(TiltcalError, match="two effects that ring about the same axis"):
        run("dual", THERE_AND_BACK, ring, ring | {"frequency_hz": 7})


def test_a_servo_too_soft_for_the_ring_is_refused():
    soft = {"stiffness_N_m_rad": 1000, "damping_N_m_s_rad": 1}
    with pytest.raises(TiltcalError, match="servo too soft"):
        run(
            "dual",
            THERE_AND_BACK,
            {"id": "settling_transient", "amplitude_arcsec": 20},
            dynamics=soft,
        )
