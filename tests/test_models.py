"""A user's own MJCF or URDF as the rig: against plain MuJoCo on the user's file."""

import shutil
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
import tomli_w
from model_rig import GRAVITY, LIFT, Mapped, PlainModel, poses_and_moves, scenario_text, stated
from scipy.spatial.transform import Rotation
from statistics_helpers import rng_of

import tiltcal as tc
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.chain import BASE
from tiltcal.setup.loads import moments
from tiltcal.setup.trajectory import Drive, Jet
from tiltsim.laboratory import MujocoLaboratory
from tiltsim.motion import mujoco_motion

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
ARM = {
    "pan": Mapped("pan"),
    "lift": Mapped("lift", -1, np.radians(10)),
    "elbow": Mapped("elbow"),
    "wrist": Mapped("wrist", 1, -0.3),
}
PUSHER = {
    f"j{k}": Mapped(name)
    for k, name in enumerate(
        (
            "r_shoulder_pan_joint",
            "r_shoulder_lift_joint",
            "r_upper_arm_roll_joint",
            "r_elbow_flex_joint",
            "r_forearm_roll_joint",
            "r_wrist_flex_joint",
            "r_wrist_roll_joint",
        )
    )
}
HOIST = {
    "lift": Mapped("lift", -1, 0.03, slides=True),
    "pan": Mapped("pan", 1, 0.2),
    "tilt": Mapped("tilt", -1),
    "boom": Mapped("boom", 1, -0.1, slides=True),
}
URDF = """<robot name="head">
  <link name="mast"><inertial><origin xyz="0 0 .5"/><mass value="3"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fork"><inertial><mass value="2"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="head"><inertial><origin xyz=".1 0 0"/><mass value="1"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pan" type="revolute"><parent link="mast"/><child link="fork"/>
    <origin xyz="0 0 1" rpy="0 0 .4"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="tilt" type="revolute"><parent link="fork"/><child link="head"/>
    <origin xyz=".1 .02 .2" rpy=".2 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
</robot>"""
HEAD = {"pan": Mapped("pan"), "tilt": Mapped("tilt", -1)}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """(model, axes, site) by name, each in the folder of its scenario."""
    place = tmp_path_factory.mktemp("models")
    shutil.copy(folder("scenarios") / "arm" / "arm.xml", place / "arm.xml")
    text = (ASSETS / "pusher_v5.xml").read_text()
    site = '<body name="r_wrist_roll_link" pos="0 0 0">'
    assert site in text
    (place / "pusher.xml").write_text(
        text.replace(site, f'{site}<site name="imu" pos=".02 0 .1"/>')
    )
    for name in ("lift", "floor"):
        (place / f"{name}.xml").write_text(LIFT)
    found = {"arm": (ARM, "tool"), "base": (ARM, "base_imu"), "pusher": (PUSHER, "imu")}
    found |= {"lift": (HOIST, "imu"), "floor": (HOIST, "floor_imu")}
    (place / "base.xml").write_text((place / "arm.xml").read_text())
    for name, (axes, site) in found.items():
        (place / f"{name}.toml").write_text(scenario_text(f"{name}.xml", axes, site))
    return {n: (place / f"{n}.xml", axes, site) for n, (axes, site) in found.items()}


def drive_of(time, jets):
    n = len(time)
    still = np.full(n, -1)
    return Drive(time, jets, 0.0, np.zeros(n), 0.0, still, ((0, np.eye(3)),))


@pytest.mark.parametrize("name", ["arm", "base", "pusher", "lift"])
def test_closed_form_and_both_models_of_mujoco_agree(models, name):
    path, axes, site = models[name]
    scenario = load_scenario(path.with_suffix(".toml"))
    rng = rng_of(f"motion {name}")
    time, angles = poses_and_moves(rng, list(axes), 4, dwell=0.2, move=1.0)
    force, rate = PlainModel(path, axes, site).readings(time, angles)
    jets = {axis: Jet(*jet) for axis, jet in angles.items()}
    ours = closed_form(scenario, drive_of(time, jets))
    theirs = mujoco_motion(scenario, drive_of(time, jets))
    for mine in (ours, theirs):
        np.testing.assert_allclose(mine.force, force, atol=1e-9)
        np.testing.assert_allclose(mine.rate, rate, atol=1e-9)


def test_sensors_at_several_places_of_one_model(models, tmp_path):
    path, axes, _ = models["arm"]
    shutil.copy(path, tmp_path / "arm.xml")
    sensors = ("accelerometer", "gyro")
    text = scenario_text("arm.xml", axes, "tool", sensors)
    (tmp_path / "s.toml").write_text(text + 'site = "base_imu"\n')
    scenario = load_scenario(tmp_path / "s.toml")
    rng = rng_of("several places")
    time, angles = poses_and_moves(rng, list(axes), 8)
    jets = {axis: Jet(*jet) for axis, jet in angles.items()}
    force, _ = PlainModel(path, axes, "tool").readings(time, angles)
    _, rate = PlainModel(path, axes, "base_imu").readings(time, angles)
    found = readings(scenario, _Course(drive_of(time, jets)), dict.fromkeys(sensors, time), ())
    np.testing.assert_allclose(found["accelerometer"], force, atol=1e-9)
    np.testing.assert_allclose(found["gyro"], rate, atol=1e-9)
    columns = {f"table_{a}_deg": np.degrees(jet[0]) for a, jet in angles.items()}
    white = 60e-6 * 9.8 * np.sqrt(50)
    for name, values, unit in (("accelerometer", force, "m_s2"), ("gyro", rate, "rad_s")):
        noisy = values + rng.normal(0, white, values.shape)
        columns |= {f"{name}_{a}_{unit}": noisy[:, i] for i, a in enumerate("xyz")}
    recording = Recording.from_columns(time, columns)
    assert diagnose(scenario, [recording]).verdict == "match"


class _Course:
    """A course that is asked at its own stamps only."""

    def __init__(self, drive):
        self._drive, self.times = drive, (drive.time[0], drive.time[-1])

    def drive(self, time):
        assert np.array_equal(time, self._drive.time)
        return self._drive


@pytest.mark.parametrize(("name", "taken"), [("model-00000000", True), ("dual", False)])
def test_links_that_an_earlier_version_wrote_are_read(models, name, taken):
    """Their table has a name made from them, and what they hold may grow."""
    scenario = load_scenario(models["arm"][0].with_suffix(".toml"))
    table = scenario.model_dump(exclude_defaults=True, by_alias=True)
    table |= {"schema": 1, "rig": {**table["rig"], "table": name}}
    if taken:
        assert parse_scenario(table).rig.table == scenario.rig.table
    else:
        with pytest.raises(TiltcalError, match="table 'dual' with links; leave it out"):
            parse_scenario(table)


def test_effects_of_links_are_refused_on_a_table(tmp_path):
    text = (folder("scenarios") / "six_faces_dual.toml").read_text()
    effect = '\n[[effect]]\nid = "joint_compliance"\nbend_z_arcsec_N_m = 1\n'
    (tmp_path / "s.toml").write_text(text + effect)
    with pytest.raises(TiltcalError, match=r"joint_compliance: needs the links of a model"):
        load_scenario(tmp_path / "s.toml")


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("name", ["arm", "pusher", "lift"])
def test_loads_are_those_of_inverse_dynamics_in_mujoco(models, name, moving):
    path, axes, site = models[name]
    chain = load_scenario(path.with_suffix(".toml")).rig.kind.chain
    rng = rng_of(f"loads {name}")
    jets = {a: rng.uniform(-2, 2, (3, 20)) * [[1], [moving], [5 * moving]] for a in axes}
    plain = PlainModel(path, axes, site)
    found = moments(chain, {a: Jet(*jet) for a, jet in jets.items()}, GRAVITY)
    base = np.zeros((20, 3))
    for axis, mapped in axes.items():
        torque, vector = plain.moments(jets, mapped.joint)
        size = np.linalg.norm(vector, axis=1)
        within = {"rtol": 0, "atol": 1e-9 * size.max()}
        if not mapped.slides:
            np.testing.assert_allclose(found[axis][:, 2], mapped.sign * torque, **within)
        np.testing.assert_allclose(np.linalg.norm(found[axis], axis=1), size, **within)
        if chain.links[axis].on == BASE:
            base += plain.moments(jets, mapped.joint, np.zeros(3))[1]
    np.testing.assert_allclose(found[BASE], base, rtol=0, atol=1e-9 * np.abs(base).max())


def test_urdf_is_read_like_mjcf(tmp_path):
    (tmp_path / "head.urdf").write_text(URDF)
    (tmp_path / "s.toml").write_text(scenario_text("head.urdf", HEAD, "head"))
    scenario = load_scenario(tmp_path / "s.toml")
    angles = {"pan": np.array([0.3]), "tilt": np.array([-0.5])}
    zero = np.zeros(1)
    motion = closed_form(
        scenario, drive_of(zero, {a: Jet(x, zero, zero) for a, x in angles.items()})
    )
    # up in the head, by hand: Ry(0.5) Rx(-0.2) of the mast's up, its pan about up
    c, s, ct, st = np.cos(0.2), np.sin(0.2), np.cos(0.5), np.sin(0.5)
    np.testing.assert_allclose(motion.up[0], [-st * c, s, ct * c], atol=1e-12)


WRONG = {
    "../out.xml": ({}, "outside the scenario's folder"),
    "absent.xml": ({}, "no such file"),
    "ball.xml": (
        {
            "ball.xml": "<mujoco><worldbody><body name='b'><joint name='pan' type='ball'/>"
            "<geom size='.1'/></body></worldbody></mujoco>"
        },
        "for axis pan, a ball joint.*leave it out",
    ),
    "broken.xml": ({"broken.xml": "<mujoco><worldbody>"}, "no XML"),
    "unknown.xml": ({"unknown.xml": "<mujoco><nothing/></mujoco>"}, "a model that MuJoCo loads"),
    "include.xml": (
        {"include.xml": "<mujoco><include file='../../secret.xml'/></mujoco>"},
        "outside the scenario's folder",
    ),
    "around.xml": (
        {
            "around.xml": "<mujoco><compiler meshdir='..'/><include file='part.xml'/></mujoco>",
            "part.xml": "<mujoco><asset><mesh file='secret.stl'/></asset></mujoco>",
        },
        "outside the scenario's folder",
    ),
    "cube.xml": (
        {"cube.xml": "<mujoco><asset><texture fileright='../secret.png'/></asset></mujoco>"},
        "outside the scenario's folder",
    ),
    "circle.xml": (
        {"circle.xml": "<mujoco><include file='circle.xml'/></mujoco>"},
        "a model that MuJoCo loads",
    ),
    "mesh.xml": (
        {"mesh.xml": "<mujoco><asset><mesh file='/etc/hostname'/></asset></mujoco>"},
        "outside the scenario's folder",
    ),
}


@pytest.mark.parametrize("name", list(WRONG))
def test_models_that_cannot_be_used_are_refused_with_one_message(tmp_path, name):
    files, words = WRONG[name]
    place = tmp_path / "inner"
    place.mkdir()
    for file, text in files.items():
        (place / file).write_text(text)
    text = scenario_text("x.xml", {"pan": Mapped("pan")}, "b").replace("x.xml", name)
    (place / "s.toml").write_text(text)
    with pytest.raises(TiltcalError, match=words):
        load_scenario(place / "s.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"tool"', '"toll"', "no site or body 'toll'"),
        ('joint = "lift"', 'joint = "lifd"', "no joint 'lifd'"),
        ('joint = "lift"', 'joint = "pan"', "one joint mapped to two axes"),
        ("sign = -1", "sign = 2", "sign"),
    ],
)
def test_words_that_do_not_fit_the_model_are_refused(models, tmp_path, old, new, words):
    path, *_ = models["arm"]
    shutil.copy(path, tmp_path / "arm.xml")
    text = path.with_suffix(".toml").read_text()
    assert old in text
    (tmp_path / "s.toml").write_text(text.replace(old, new))
    with pytest.raises(TiltcalError, match=words):
        load_scenario(tmp_path / "s.toml")


def recorded(models, name, seed, poses=14, **springs):
    """A recording of a triad by plain MuJoCo, with 60 ug/rtHz of noise."""
    path, axes, site = models[name]
    rng = rng_of(f"recording {name} {seed}")
    time, angles = poses_and_moves(rng, list(axes), poses)
    force, _ = PlainModel(path, axes, site, **springs).readings(time, angles)
    force = force + rng.normal(0, 60e-6 * 9.8 * np.sqrt(50), force.shape)
    columns = {}
    for axis, jet in angles.items():
        columns |= axes[axis].column(axis, jet[0])
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    return load_scenario(path.with_suffix(".toml")), Recording.from_columns(time, columns)


@pytest.mark.parametrize("name", ["pusher", "lift", "floor"])  # the arm: sensors at several places
def test_a_sound_model_matches(models, name):
    scenario, recording = recorded(models, name, "null")
    assert diagnose(scenario, [recording]).verdict == "match"


def test_a_base_that_gives_way_is_named_and_its_amended_scenario_stands_alone(models, tmp_path):
    stiffness = (3e5, 2e5)  # N m/rad
    scenario, recording = recorded(models, "base", "base", 24, base_stiffness=stiffness)
    answer = diagnose(scenario, [recording], laboratory=MujocoLaboratory())
    (finding,) = answer.findings
    assert (answer.verdict, finding.effect) == ("explained", "base_load_compliance")
    assert finding.where.coordinate == "load moment"
    for name, k in zip(("east", "north"), stiffness, strict=True):
        value, sigma = finding.parameters[f"bend_{name}_arcsec_N_m"]
        assert abs(value - 1 / k / ARCSEC) < 4 * sigma
        assert sigma < 0.15 / k / ARCSEC
    (tmp_path / "amended.toml").write_text(tomli_w.dumps(answer.amended))
    assert diagnose(load_scenario(tmp_path / "amended.toml"), [recording]).verdict == "match"


def test_a_joint_that_gives_way_is_named(models):
    scenario, recording = recorded(models, "arm", "lift", joint_stiffness={"lift": 5e4})
    (finding,) = diagnose(scenario, [recording]).findings
    assert "joint_compliance" in finding.names


SPRING = {"lift": 5e4}  # N m/rad


def test_a_payload_behind_a_known_spring_is_named(models, tmp_path):
    """2 kg on the last link, which has 1 kg: nothing but the spring shows it."""
    payload = {"wrist": (2.0, (0.1, 0.05, 0.0))}
    _, recording = recorded(models, "arm", "payload", joint_stiffness=SPRING, payload=payload)
    path = models["arm"][0]
    shutil.copy(path, tmp_path / path.name)
    known = stated("joint_compliance", axis="lift", bend_z=1 / SPRING["lift"])
    file = tmp_path / "s.toml"
    file.write_text(path.with_suffix(".toml").read_text() + known)
    (finding,) = diagnose(load_scenario(file), [recording]).findings
    assert "payload" in finding.names
    if finding.effect == "payload":
        value, sigma = finding.parameters["mass_kg"]
        print(value, sigma)
        assert abs(value - 2.0) < 4 * sigma


@pytest.mark.parametrize(
    ("id", "where", "sizes", "beside"),
    [
        ("joint_compliance", "lift", {"bend_x": 2, "bend_y": -1, "bend_z": 3}, ()),
        ("link_compliance", "elbow", {"bend_x": 2, "bend_y": -3}, ()),
        ("base_load_compliance", None, {"bend_east": 0.4, "bend_north": 0.6}, ()),
        ("payload", "wrist", {"mass": 0.5}, ("joint_compliance", "base_load_compliance")),
        ("payload", "wrist", {"com_x": 20, "com_z": -10}, ("joint_compliance",)),
        ("payload", "wrist", {"mass": 0.5}, ("link_compliance",)),
        ("joint_compliance", "lift", {"bend_z": 3}, ("payload",)),
    ],
)
def test_columns_of_loads_are_differences_of_the_closed_form(models, id, where, sizes, beside):
    path, axes, _ = models["arm"]
    scenario = load_scenario(path.with_suffix(".toml"))
    rng = rng_of(f"columns {id}")
    time, angles = poses_and_moves(rng, list(axes), 4)
    drive = drive_of(time, {axis: Jet(*jet) for axis, jet in angles.items()})
    others = {
        "joint_compliance": ("elbow", {"bend_y_arcsec_N_m": 5, "bend_z_arcsec_N_m": 20}),
        "link_compliance": ("lift", {"bend_x_arcsec_N_m": 5, "bend_y_arcsec_N_m": 20}),
        "base_load_compliance": (None, {"bend_east_arcsec_N_m": 2}),
        "payload": ("wrist", {"mass_kg": 3.0, "com_x_mm": 40}),
    }
    there = [make_effect(b, others[b][1], scenario, axis=others[b][0]) for b in beside]
    suffixes = {p.name: p.suffix for p in CATALOGUE[id].parameters}
    small = {f"{n}{suffixes[n]}": 1e-3 * v for n, v in sizes.items()}
    effect = make_effect(id, small, scenario, axis=where)
    column = NominalMotion(scenario, _Course(drive), time).changes(effect, there)["accelerometer"]
    changed = closed_form(scenario, drive, [*there, effect]).force
    expected = changed - closed_form(scenario, drive, there).force
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(column, expected, rtol=0, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize(("name", "axis"), [("arm", "wrist"), ("pusher", "j1"), ("lift", "tilt")])
def test_a_link_that_bends_is_two_springs_behind_its_joint_in_plain_mujoco(models, name, axis):
    path, axes, site = models[name]
    scenario = load_scenario(path.with_suffix(".toml"))
    rng, time = rng_of(f"link bends {name}"), np.arange(0, 12, 0.02)
    swings = {a: (*rng.uniform(0.5, 1.5, 2), rng.uniform(0, 6)) for a in axes}
    angles = {a: swing(time, *how) for a, how in swings.items()}
    drive = drive_of(time, {a: Jet(*jet) for a, jet in angles.items()})
    honest, joint = closed_form(scenario, drive).force, axes[axis].joint
    _, moment = PlainModel(path, axes, site).moments(angles, joint)
    bend = 100 * ARCSEC / np.abs(moment).max()  # alike in both directions, whatever they are called
    plain = PlainModel(path, axes, site, link_stiffness={joint: (1 / bend, 1 / bend)})
    sizes = {f"bend_{a}_arcsec_N_m": bend / ARCSEC for a in "xy"}
    ours = closed_form(
        scenario, drive, [make_effect("link_compliance", sizes, scenario, axis=axis)]
    )
    expected = plain.readings(time, angles)[0] - honest
    inside = slice(120, -120)  # towards its ends a recording says less of rates of loads
    left = np.abs(ours.force - honest - expected)[inside]
    assert left.max() < 5e-3 * np.abs(expected).max()


def swing(time, size, frequency, phase):
    """A sine with its derivatives, rad, rad/s, rad/s2, (3, n)."""
    at = frequency * time + phase
    rates = (np.sin(at), frequency * np.cos(at), -(frequency**2) * np.sin(at))
    return size * np.array(rates)


@pytest.mark.parametrize("name", ["arm", "pusher", "lift"])
def test_a_tilted_axis_is_one_effect_whatever_its_readout_says_at_the_reference(models, name):
    path, axes, site = models[name]
    scenario = load_scenario(path.with_suffix(".toml"))
    rng = rng_of(f"tilted axis {name}")
    time, angles = poses_and_moves(rng, list(axes), 4)
    drive = drive_of(time, {axis: Jet(*jet) for axis, jet in angles.items()})
    for axis, mapped in list(axes.items())[1:]:
        tilt = rng.uniform(100, 400, 2) * ARCSEC
        plain = PlainModel(path, axes, site, axis_tilt={mapped.joint: tilt})
        changed = plain.readings(time, angles)[0] - closed_form(scenario, drive).force
        columns = [
            closed_form(
                scenario,
                drive,
                [make_effect("joint_axis_tilt", {f"tilt_{a}_arcsec": 100}, scenario, axis=axis)],
            ).force
            - closed_form(scenario, drive).force
            for a in "xy"
        ]
        design = np.column_stack([c.ravel() for c in columns])
        left = changed.ravel() - design @ np.linalg.lstsq(design, changed.ravel())[0]
        assert np.abs(left).max() < 5e-3 * np.abs(changed).max()


FINGERS = URDF.replace(
    "</robot>",
    """
  <link name="imu_link"/>
  <joint name="imu_joint" type="fixed"><parent link="fork"/><child link="imu_link"/>
    <origin xyz=".1 0 1" rpy="0 .2 .4"/></joint>
  <link name="finger"><inertial><mass value="1"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="grip" type="revolute"><parent link="head"/><child link="finger"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
    <mimic joint="tilt" multiplier="2"/></joint>
</robot>""",
)


def parsed(folder, name, axes, site):
    """A scenario of a table, with a model in a folder."""
    return tc.parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": GRAVITY},
            "rig": {"mjcf": name, "site": site, "axes": axes},
            "sensor": [{"name": "accelerometer", "kind": "accelerometer", "rate_hz": 50}],
        },
        folder=folder,
    )


def test_fixed_links_of_a_urdf_are_places_of_instruments(tmp_path):
    (tmp_path / "hand.urdf").write_text(FINGERS)
    axes = {"pan": "pan", "tilt": "tilt", "grip": "grip"}
    scenario = parsed(tmp_path, "hand.urdf", axes, "imu_link")
    place = scenario.rig.instrument
    assert (place.on, place.offset_m) == ("pan", pytest.approx((0.1, 0, 1)))
    rpy = Rotation.from_euler("xyz", [0, 0.2, 0.4]).as_matrix()
    np.testing.assert_allclose(place.R, rpy, atol=1e-12)


def test_joints_that_a_constraint_moves_have_to_be_read(tmp_path):
    (tmp_path / "hand.urdf").write_text(FINGERS)
    with pytest.raises(TiltcalError, match="'grip', which has no axis, moves with joint 'tilt'"):
        parsed(tmp_path, "hand.urdf", {"pan": "pan", "tilt": "tilt"}, "imu_link")
    assert parsed(tmp_path, "hand.urdf", {"pan": "pan"}, "imu_link").rig.axis_names == ("pan",)


LOOP = """<mujoco><worldbody>
  <body name="left"><joint name="a" axis="0 1 0"/><geom size=".1" mass="1"/>
    <body name="bar" pos="0 0 1"><joint name="b" axis="0 1 0"/><geom size=".1" mass="1"/></body>
  </body>
  <body name="right" pos="1 0 0"><joint name="c" axis="0 1 0"/><geom size=".1" mass="1"/>
    <site name="tip" pos="0 0 1"/></body>
</worldbody>
<tendon><fixed name="belt"><joint joint="a" coef="1"/><joint joint="c" coef="-1"/></fixed></tendon>
<equality>CONSTRAINT</equality></mujoco>"""


@pytest.mark.parametrize(
    ("constraint", "axes", "unread"),
    [
        ('<connect body1="bar" body2="right" anchor="1 0 0"/>', "ab", "c"),
        ('<weld body1="bar" body2="right"/>', "ac", "b"),
        ('<tendon tendon1="belt"/>', "a", "c"),
        ('<joint joint1="b" joint2="c" polycoef="0 2 0 0 0"/>', "ac", "b"),
        ('<connect body1="bar" body2="right" anchor="1 0 0"/>', "abc", None),
        ('<connect body1="bar" body2="right" anchor="1 0 0" active="false"/>', "a", None),
        ('<joint joint1="b" polycoef="0.3 0 0 0 0"/>', "ac", None),
        ('<tendon tendon1="belt"/>', "b", None),
    ],
)
def test_a_loop_is_taken_where_all_or_none_of_its_joints_are_read(
    tmp_path, constraint, axes, unread
):
    (tmp_path / "loop.xml").write_text(LOOP.replace("CONSTRAINT", constraint))
    mapped = {name: name for name in axes}
    if unread is None:
        assert parsed(tmp_path, "loop.xml", mapped, "left").rig.axis_names == tuple(axes)
    else:
        with pytest.raises(TiltcalError, match=f"'{unread}', which has no axis"):
            parsed(tmp_path, "loop.xml", mapped, "left")


PAYLOAD = (2.5, np.array([0.02, 0.15, -0.04]))  # kg, and m in the body's frame from the joint
ACROSS = {"0 0 1": "x y z", "0 1 0": "x -z y", "1 0 0": "y z x"}
"""Axes of the link in the body's, as docs/own_model.md states them, by the joint's axis."""


@pytest.mark.parametrize("axis", ACROSS)
def test_a_payload_stands_in_the_frame_that_the_page_defines(tmp_path, axis):
    text = f"""<mujoco><worldbody><body pos="0 0 1" euler="20 30 40">
    <joint name="lift" axis="1 1 0"/><geom size=".1" mass="2"/>
    <body name="tool" pos=".3 0 .2" euler="50 10 -30">
    <joint name="turn" axis="{axis}" pos=".01 .02 .03"/><inertial pos=".05 .06 -.02" mass=".7"
    diaginertia="1e-3 1e-3 1e-3"/></body></body></worldbody></mujoco>"""
    (tmp_path / "tool.xml").write_text(text)
    axes = {"lift": Mapped("lift"), "turn": Mapped("turn", -1 if axis == "1 0 0" else 1)}
    (tmp_path / "s.toml").write_text(scenario_text("tool.xml", axes, "tool"))
    scenario = load_scenario(tmp_path / "s.toml")
    (mass, r), own = PAYLOAD, 0.7
    shift = mass * (r - np.array([0.05, 0.06, -0.02])) / (mass + own)
    link = axes["turn"].sign * np.array([_along(word, shift) for word in ACROSS[axis].split()])
    link = link * [axes["turn"].sign, 1, 1]  # a frame stays right-handed: x is the body's
    sizes = {"mass_kg": mass} | {f"com_{a}_mm": 1e3 * link[k] for k, a in enumerate("xyz")}
    effect = make_effect("payload", sizes, scenario, axis="turn")
    rng = rng_of(f"payload {axis}")
    jets = {a: rng.uniform(-2, 2, (3, 20)) * [[1], [0], [0]] for a in axes}
    plain = PlainModel(tmp_path / "tool.xml", axes, "tool", payload={"turn": (mass, r)})
    chain, rig = scenario.rig.kind.chain, scenario.rig
    found = moments(chain, {a: Jet(*j) for a, j in jets.items()}, GRAVITY, effect.masses(rig))
    for name, mapped in axes.items():
        torque, vector = plain.moments(jets, mapped.joint)
        within = {"rtol": 0, "atol": 1e-8 * np.abs(vector).max()}
        np.testing.assert_allclose(found[name][:, 2], mapped.sign * torque, **within)


def _along(word, vector):
    return (-1 if word.startswith("-") else 1) * vector["xyz".index(word[-1])]


def bent_base(models, time, angles, matrix):
    """What a triad reads on a base that tilts by a matrix of compliances, rad/(N m), (2, 2): two
    springs about its principal directions in plain MuJoCo.
    """
    path, axes, site = models["base"]
    softness, along = np.linalg.eigh(matrix)
    spec = mujoco.MjSpec.from_file(str(path))
    root, turned = spec.worldbody.first_body(), path.with_name("turned.xml")
    R = Rotation.from_quat(np.roll(spec.compile().body(root.name).quat, -1)).as_matrix()
    springs = {}
    for k in range(2):
        axis = R.T @ [*along[:, k], 0.0]
        root.add_joint(name=f"base_{k}", type=HINGE, axis=axis, pos=R.T @ -np.array(root.pos))
        springs[f"base_{k}"] = 1 / softness[k]
    turned.write_text(spec.to_xml())
    plain = PlainModel(turned, axes, site)
    plain.springs.update(springs)
    return plain.readings(time, angles)[0]


HINGE = mujoco.mjtJoint.mjJNT_HINGE
SOFT = np.array([[0.4, 0.15], [0.15, 0.6]]) * ARCSEC  # rad/(N m)
CROSSED = {"bend_east": 0.4, "bend_north": 0.6, "cross_east": 0.15, "cross_north": 0.15}


def test_a_base_that_is_soft_between_east_and_north_is_two_springs_in_plain_mujoco(models):
    path, axes, _ = models["base"]
    scenario = load_scenario(path.with_suffix(".toml"))
    rng, time = rng_of("soft between"), np.arange(0, 12, 0.02)
    angles = {a: swing(time, *rng.uniform(0.5, 1.5, 2), rng.uniform(0, 6)) for a in axes}
    drive = drive_of(time, {a: Jet(*jet) for a, jet in angles.items()})
    honest = closed_form(scenario, drive).force
    expected = bent_base(models, time, angles, SOFT) - honest
    sizes = {f"{n}_arcsec_N_m": v for n, v in CROSSED.items()}
    effect = make_effect("base_load_compliance", sizes, scenario)
    ours = closed_form(scenario, drive, [effect]).force - honest
    left = (ours - expected)[120:-120]
    left -= left.mean(axis=0)  # the weight of the base itself tilts it by as much always
    assert np.abs(left).max() < 5e-3 * np.ptp(expected, axis=0).max()
    theirs = mujoco_motion(scenario, drive, [effect]).force - honest
    assert np.abs((theirs - ours)[120:-120]).max() < 5e-3 * np.abs(ours).max()


def test_a_base_that_is_soft_between_east_and_north_is_named_with_its_matrix(models):
    path, axes, _ = models["base"]
    rng = rng_of("soft between, read")
    time, angles = poses_and_moves(rng, list(axes), 24)
    force = bent_base(models, time, angles, 4 * SOFT)
    force = force + rng.normal(0, 60e-6 * 9.8 * np.sqrt(50), force.shape)
    columns = {k: v for a, jet in angles.items() for k, v in axes[a].column(a, jet[0]).items()}
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    scenario = load_scenario(path.with_suffix(".toml"))
    (finding,) = diagnose(scenario, [Recording.from_columns(time, columns)]).findings
    assert finding.effect == "base_load_compliance"
    for name, size in CROSSED.items():
        value, sigma = finding.parameters[f"{name}_arcsec_N_m"]
        assert abs(value - 4 * size) < 4 * sigma


@pytest.mark.parametrize(
    ("id", "sizes", "error"),
    [
        ("rate_error", {"rate_ppm": 3000}, lambda q: q / 1.003 - q),
        (
            "joint_harmonic_drive",
            {"cos_arcsec": 50, "sin_arcsec": -80, "ratio": 50},
            lambda q: ARCSEC * (50 * np.cos(100 * q) - 80 * np.sin(100 * q)),
        ),
    ],
)
@pytest.mark.parametrize(("name", "axis"), [("arm", "elbow"), ("lift", "boom")])
def test_errors_of_the_readout_of_a_joint_are_those_of_plain_mujoco(
    models, id, sizes, error, name, axis
):
    path, axes, site = models[name]
    scenario = load_scenario(path.with_suffix(".toml"))
    if axis not in CATALOGUE[id].axes_on(scenario.rig):
        pytest.skip("of a joint that turns")
    rng = rng_of(f"{id} {name}")
    true = {a: rng.uniform(-1, 1, (3, 40)) * [[1], [0], [0]] for a in axes}
    force, _ = PlainModel(path, axes, site).readings(np.arange(40.0), true)
    read = {a: jet.copy() for a, jet in true.items()}
    read[axis][0] += error(true[axis][0])
    drive = drive_of(np.arange(40.0), {a: Jet(*jet) for a, jet in read.items()})
    effect = make_effect(id, sizes, scenario, axis=axis)
    honest = closed_form(scenario, drive).force
    ours = closed_form(scenario, drive, [effect]).force
    np.testing.assert_allclose(ours, force, rtol=0, atol=1e-7)
    assert name == "lift" or np.abs(honest - force).max() > 1e-3


def test_a_joint_that_counts_too_much_is_named(models):
    path, axes, site = models["arm"]
    rng = rng_of("scale of a joint")
    time, angles = poses_and_moves(rng, list(axes), 14)
    force, _ = PlainModel(path, axes, site).readings(time, angles)
    force = force + rng.normal(0, 60e-6 * 9.8 * np.sqrt(50), force.shape)
    columns = {k: v for a, jet in angles.items() for k, v in axes[a].column(a, jet[0]).items()}
    columns["table_elbow_deg"] *= 1 + 1.5e-3
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    scenario = load_scenario(path.with_suffix(".toml"))
    answer = diagnose(scenario, [Recording.from_columns(time, columns)])
    (finding,) = answer.findings
    (found,) = (e for e in answer.amended["effect"] if e.get("role") == "found")
    assert (finding.effect, found["axis"]) == ("rate_error", "elbow")
    value, sigma = finding.parameters["rate_ppm"]
    assert abs(value + 1500) < 4 * sigma
    assert "cable_torque" in finding.names  # of the same form


def test_the_wave_of_a_harmonic_drive_is_named_where_its_gear_is_stated(models, tmp_path):
    path, axes, site = models["arm"]
    rng = rng_of("harmonic drive")
    time, angles = poses_and_moves(rng, list(axes), 10, move=4.0, reach=1.0)
    force, _ = PlainModel(path, axes, site).readings(time, angles)
    force = force + rng.normal(0, 60e-6 * 9.8 * np.sqrt(50), force.shape)
    columns = {k: v for a, jet in angles.items() for k, v in axes[a].column(a, jet[0]).items()}
    wave = 70 * np.cos(160 * angles["elbow"][0]) - 40 * np.sin(160 * angles["elbow"][0])
    columns["table_elbow_deg"] += wave / 3600
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    shutil.copy(path, tmp_path / path.name)
    text = path.with_suffix(".toml").read_text()
    plain = 'joint = "elbow"'
    assert text.count(plain) == 1
    file = tmp_path / "s.toml"
    file.write_text(text.replace(plain, f"{plain}, gear_ratio = 80"))
    (finding,) = diagnose(load_scenario(file), [Recording.from_columns(time, columns)]).findings
    assert "joint_harmonic_drive" in finding.names


def test_how_heavy_a_payload_may_be_follows_from_the_rated_one(models, tmp_path):
    path, *_ = models["arm"]
    shutil.copy(path, tmp_path / path.name)
    text, file = path.with_suffix(".toml").read_text(), tmp_path / "s.toml"
    sizes = []
    for stated_key in ("", "rated_payload_kg = 5\n"):
        file.write_text(text.replace("[rig]\n", f"[rig]\n{stated_key}"))
        rig = load_scenario(file).rig
        found = CATALOGUE["payload"].sizes_on((), rig)
        assert list(found) == ["mass", "moment_x", "moment_y", "moment_z"]  # com restates these
        sizes.append([p.plausible[1] * p.factor for p in found.values()])
    np.testing.assert_allclose(sizes, [[0.5, 0.05, 0.05, 0.05], [2.5, 0.25, 0.25, 0.25]])


def test_a_heavy_payload_far_from_a_light_link_is_named(models, tmp_path):
    """Three times the mass of the link, beyond twice the distance of its centre."""
    payload = {"wrist": (3.0, (0.3, 0.1, 0.0))}
    _, recording = recorded(models, "arm", "far", joint_stiffness=SPRING, payload=payload)
    path = models["arm"][0]
    shutil.copy(path, tmp_path / path.name)
    file = tmp_path / "s.toml"
    known = stated("joint_compliance", axis="lift", bend_z=1 / SPRING["lift"])
    file.write_text(path.with_suffix(".toml").read_text() + known)
    (finding,) = diagnose(load_scenario(file), [recording]).findings
    assert finding.effect == "payload"
