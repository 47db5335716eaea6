"""A run by time steps on a user's own model: against plain MuJoCo on the user's file, and against
the prescribed run where the servos are stiff.
"""

import re

import mujoco
import numpy as np
import pytest

from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltsim.dynamics import run_dynamics
from tiltsim.laboratory import MujocoLaboratory
from tiltsim.model_reader import NATURAL

GRAVITY = 9.80123
SIGN, OFFSET = {"lift": -1}, {"lift": 10 * DEG}
AXES = ("pan", "lift", "elbow", "wrist")
# another gear, a servo whose force is filtered, and a motor: the last two are no position servos
SERVOS = """<actuator>
  <position joint="pan" kp="9000" kv="800"/><position joint="lift" kp="1000" kv="40" gear="5"/>
  <position joint="elbow" kp="100" kv="5" timeconst="0.1"/><motor joint="wrist"/>
</actuator>"""
SCENARIO = """
schema = 1
name = "arm by time steps"
[site]
gravity_m_s2 = 9.80123
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
[[sensor]]
name = "level"
kind = "inclinometer"
axes = ["x", "y"]
site = "base_imu"
rate_hz = 100
[[sequence]]
action = "rest"
dwell_s = 0.5
[[sequence]]
action = "move"
pan_deg = 40
lift_deg = -50
wrist_deg = -70
dwell_s = 1.5
rate_deg_s = 60
[[sequence]]
action = "move"
elbow_deg = 30
lift_deg = -20
dwell_s = 1.5
rate_deg_s = 60
[[effect]]
id = "base_load_compliance"
bend_east_arcsec_N_m = 4
bend_north_arcsec_N_m = 6
"""


def arm(place, servos="", joints="", dynamics="", more=""):
    """The scenario of an arm with these actuators, and attributes of every joint."""
    text = (folder("scenarios") / "arm" / "arm.xml").read_text()
    text = text.replace("<sensor>", f"{servos}<sensor>")
    (place / "arm.xml").write_text(re.sub(r"(<joint )", rf"\1{joints} ", text))
    (place / "s.toml").write_text(f"{SCENARIO}{more}[dynamics]\n{dynamics}")
    return load_scenario(place / "s.toml")


def plainly_stepped(path, scenario, until):
    """Readouts of the user's own file, stepped by plain MuJoCo, (steps, axes), and the times."""
    spec = mujoco.MjSpec.from_file(str(path))
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name, link in scenario.rig.kind.chain.links.items():
        servo = spec.add_actuator(name=f"{name}_servo", target=name)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.set_to_position(link.servo_N_m_rad, kv=link.servo_N_m_s_rad)
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.timestep = 0.0005
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name).qposadr[0] for name in AXES]
    sign = np.array([SIGN.get(name, 1) for name in AXES])
    offset = np.array([OFFSET.get(name, 0.0) for name in AXES])

    def asked(time):
        axes = scenario.schedule.drive(time).axes
        return np.column_stack([np.asarray(axes[n].x) for n in AXES]) * sign + offset

    goals = asked(np.arange(round(until / 0.0005)) * 0.0005)
    data.qpos[joints] = goals[0]
    data.ctrl[:] = goals[0]
    for _ in range(6000):  # until it hangs in its servos
        mujoco.mj_step(model, data)
    found = []
    for goal in goals:
        data.ctrl[:] = goal
        found.append((data.qpos[joints] - offset) * sign)
        mujoco.mj_step(model, data)
    return np.arange(len(goals)) * 0.0005, np.array(found)


@pytest.mark.parametrize(
    ("servos", "joints"),
    [("", ""), (SERVOS, 'damping="3" armature="0.2"')],
    ids=["without servos", "its own servos"],
)
def test_it_moves_as_plain_mujoco_moves_the_users_file(tmp_path, servos, joints):
    scenario = arm(tmp_path, servos, joints)
    course = run_dynamics(scenario, None)
    time, plain = plainly_stepped(tmp_path / "arm.xml", scenario, 4.0)
    drive = course.drive(time)
    ours = np.column_stack([np.asarray(drive.axes[name].x) for name in AXES])
    asked = scenario.schedule.drive(time).axes
    away = plain - np.column_stack([np.asarray(asked[name].x) for name in AXES])
    # the user's file lacks the frames of our instrument, half a gram
    scale = np.abs(away).max(axis=0)
    assert (scale > 20 * ARCSEC).all()
    assert (np.abs(ours - plain).max(axis=0) < 2e-3 * scale).all()


def test_servos_of_the_model_are_taken_where_they_hold_a_position(tmp_path):
    links = arm(tmp_path, SERVOS, 'frictionloss="0.3"').rig.kind.chain.links
    found = {n: (k.servo_N_m_rad, k.servo_N_m_s_rad) for n, k in links.items()}
    assert found["pan"] == (9000, 800)
    assert found["lift"] == pytest.approx((25 * 1000, 25 * 40))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    for name in ("elbow", "wrist"):
        inertia = model.dof_M0[model.joint(name).dofadr[0]]
        assert found[name] == pytest.approx((inertia * NATURAL**2, 2 * inertia * NATURAL))
    assert {link.friction_N_m for link in links.values()} == {0.3}


def stiff(frequency):
    """Servos of all joints at a natural frequency, Hz, critically damped."""
    inertia = {"pan": 2.2, "lift": 1.6, "elbow": 0.4, "wrist": 0.02}
    w = 2 * np.pi * frequency
    servos = (
        f'<position joint="{n}" kp="{i * w * w}" kv="{2 * i * w}"/>' for n, i in inertia.items()
    )
    return f"<actuator>{''.join(servos)}</actuator>"


def test_stiff_servos_end_in_the_prescribed_run(tmp_path):
    """Lag 2 / w and droop M / (J w^2) of a servo: both vanish with its frequency w."""
    lags, droops, readings = [], [], []
    for frequency in (20, 80):
        scenario = arm(tmp_path, stiff(frequency), dynamics="timestep_s = 0.0001\n")
        prescribed = scenario.model_copy(update={"dynamics": None})
        times = {"moving": np.arange(0.9, 1.1, 0.01), "resting": np.arange(2.9, 3.0, 0.01)}
        course = run_dynamics(scenario, None)
        away = {}
        for name, time in times.items():
            stepped, asked = course.drive(time).axes, scenario.schedule.drive(time).axes
            away[name] = max(np.abs(stepped[n].x - asked[n].x).max() for n in AXES)
        lags.append(away["moving"])
        droops.append(away["resting"])
        laboratory = MujocoLaboratory()
        by_steps, exact = (laboratory.record(s, None) for s in (scenario, prescribed))
        readings.append(
            max(
                np.abs(by_steps.column(c) - exact.column(c)).max()
                for c in exact.column_names
                if c.startswith("level")
            )
        )
    assert lags[0] / lags[1] == pytest.approx(4, rel=0.15)
    assert droops[0] / droops[1] == pytest.approx(16, rel=0.02)
    assert readings[0] > 3 * readings[1]
    assert lags[1] < 0.3 * DEG
    assert droops[1] < 20 * ARCSEC


def test_the_readings_belong_to_the_readout(tmp_path):
    """The prescribed run of what the encoders said reads the same."""
    scenario = arm(tmp_path, SERVOS)
    laboratory = MujocoLaboratory()
    course = laboratory.course(scenario, None)
    recording = laboratory.record(scenario, None)
    time = recording.time
    drive = course.drive(time)
    motion = closed_form(scenario, drive, scenario.effects)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(
            recording.column(f"accel_{axis}_m_s2"), motion.force[:, k], rtol=0, atol=1e-8
        )
    lift = recording.column("table_lift_deg")
    np.testing.assert_allclose(lift, np.asarray(drive.axes["lift"].x) / DEG, rtol=0, atol=1e-10)
    assert np.abs(lift - np.asarray(scenario.schedule.drive(time).axes["lift"].x) / DEG).max() > 0.1


def test_a_run_that_diverges_is_refused_in_one_message(tmp_path, capfd):
    scenario = arm(tmp_path, dynamics="stiffness_N_m_rad = 1e9\n")
    with pytest.raises(TiltcalError, match=r"diverges.*lower dynamics.timestep_s"):
        run_dynamics(scenario, None)
    assert capfd.readouterr() == ("", "")


def test_links_without_a_servo_are_refused(tmp_path):
    """An amended scenario holds the links as numbers; older ones state no servos."""
    table = arm(tmp_path).model_dump(by_alias=True, exclude_unset=True)
    table["rig"].pop("table")
    assert parse_scenario(table).rig.link[0].servo_N_m_rad > 0
    del table["rig"]["link"][1]["servo_N_m_rad"]
    with pytest.raises(TiltcalError, match="link 'lift' has no servo"):
        parse_scenario(table)
