"""A user's own model with joints that slide: scenario, recording, diagnosis, mujoco.sysid, and what
is refused.
"""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gym_course import Course, driven
from gymnasium.utils.env_checker import check_env
from model_oracle import forces_by_both, law
from model_rig import LIFT, Mapped, scenario_text
from serving import Wire, served
from statistics_helpers import rng_of

from tiltcal.api.simulating import simulator
from tiltcal.core.errors import TiltcalError
from tiltcal.core.progress import silent
from tiltcal.design.gym import RIG
from tiltcal.design.recording_blocks import candidates, within
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.investigation.next_block import Limits, next_block, poses_of, table_of
from tiltcal.effects import CATALOGUE
from tiltcal.forward.signal_chain import readings
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.laboratory.serve.commands import TableCommands
from tiltcal.laboratory.serve.rate_table import RateTable
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.replay import replay
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence_files import read_sequence, sequence_text
from tiltsim.laboratory import MujocoLaboratory
from tiltsim.motion import mujoco_motion

# the servo swings at 20 Hz with what it carries: its weight pulls it down by g / w^2, mm
DROOP = 1e3 * 9.80123 / (2 * np.pi * 20) ** 2
AXES = {
    "lift": Mapped("lift", -1, 0.03, slides=True),
    "pan": Mapped("pan", 1, 0.2),
    "tilt": Mapped("tilt", -1),
    "boom": Mapped("boom", 1, -0.1, slides=True),
}
STEPS = """
[[sequence]]
action = "move"
pan_deg = 60
boom_mm = 300
dwell_s = 3
[[sequence]]
action = "move"
pan_deg = 120
tilt_deg = 40
boom_mm = 500
rate_mm_s = 100
dwell_s = 3
[[sequence]]
action = "sweep"
boom_mm = -100
step_mm = 200
dwell_s = 2
[[sequence]]
action = "move"
pan_deg = -90
lift_mm = 200
dwell_s = 3
[[sequence]]
action = "sweep"
boom_mm = 500
step_mm = 200
dwell_s = 2
"""
SOFT_FLOOR = """
[[effect]]
id = "base_load_compliance"
bend_east_arcsec_N_m = 2
bend_north_arcsec_N_m = 3
"""
STATED = {"bend_east_arcsec_N_m": 2.0, "bend_north_arcsec_N_m": 3.0}


def scenario_of(place, more="", site="floor_imu", name="s.toml"):
    """The scenario of a head on a lift, with more tables."""
    (place / "lift.xml").write_text(LIFT)
    text = scenario_text("lift.xml", AXES, site)
    noise = '[[effect]]\nid = "acc_noise"\nwhite_ug_rthz = 30\n'
    (place / name).write_text(text.replace('name = "own', 'seed = 3\nname = "own') + more + noise)
    return load_scenario(place / name)


def test_a_floor_that_gives_way_to_a_boom_is_named(tmp_path):
    true = scenario_of(tmp_path, STEPS + SOFT_FLOOR)
    honest = scenario_of(tmp_path, name="honest.toml")
    recording = simulator().record(true, true.seed)
    assert {"table_boom_mm", "table_lift_mm", "table_pan_deg"} <= set(recording.column_names)
    boom = recording.column("table_boom_mm")
    assert (boom.min(), boom.max()) == pytest.approx((-100, 500))
    answer = diagnose(honest, [recording])
    (finding,) = answer.findings
    assert (answer.verdict, finding.effect) == ("explained", "base_load_compliance")
    for name, size in STATED.items():
        value, sigma = finding.parameters[name]
        assert abs(value - size) < 4 * sigma
        assert sigma < 0.1 * size


def test_a_table_that_tilts_along_its_rail_is_a_curve_over_the_slide(tmp_path):
    """A carriage that pitches by 200 arcsec in an S along the rail: no listed effect."""
    honest = scenario_of(tmp_path, STEPS, "imu")
    clean = simulator().record(honest, None)
    rng, rows = rng_of("rail"), len(clean)
    boom = clean.table("boom") / 0.3
    tilt = 1e-3 * np.sin(3 * boom)
    force = np.column_stack([clean.column(f"accelerometer_{a}_m_s2") for a in "xyz"])
    turned = force + np.cross(force, [0.0, 1.0, 0.0]) * tilt[:, None]
    turned += rng.normal(0, 30e-6 * 9.8 * np.sqrt(50), (rows, 3))
    columns = {n: clean.column(n) for n in clean.column_names if n.startswith("table")}
    columns |= {f"accelerometer_{a}_m_s2": turned[:, k] for k, a in enumerate("xyz")}
    answer = diagnose(honest, [Recording.from_columns(clean.time, columns)])
    assert answer.verdict == "unlisted"
    assert answer.findings[0].where.coordinate == "table_boom"


def test_by_time_steps_it_hangs_in_its_servos(tmp_path):
    stepped = scenario_of(tmp_path, STEPS + "[dynamics]\n")
    asked = scenario_of(tmp_path, STEPS, name="asked.toml")
    lift, still = (simulator().record(s, None).column("table_lift_mm") for s in (stepped, asked))
    assert (lift - still)[-1] == pytest.approx(DROOP, rel=0.02)


def test_served_by_time_steps_it_hangs_in_its_servos_and_settles(tmp_path):
    scenario = scenario_of(tmp_path, "[dynamics]\n", "imu")
    table = RateTable(scenario, None, mechanics=MujocoLaboratory().mechanics(scenario))
    TableCommands(table).line(":MODE:POS 4;:DEM:POS 4,300")
    *_, last = table.advance(8.0)
    told = dict(zip(table.format.columns, last.values, strict=True))
    assert told["table_lift_mm"] == pytest.approx(DROOP, rel=0.02)
    assert told["table_boom_mm"] == pytest.approx(300.0, abs=0.05)
    assert not table.moving()


LAWS = {
    "axis tilt": law("joint_axis_tilt", "boom", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "link tilt": law("link_tilt", "boom", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "tilted lift": law("link_tilt", "lift", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "rail bends": law("joint_compliance", "boom", bend_x_arcsec_N_m=3, bend_y_arcsec_N_m=9),
    "carriage bends": law("link_compliance", "lift", bend_x_arcsec_N_m=3, bend_y_arcsec_N_m=-2),
}
of_each_law = pytest.mark.parametrize("law", LAWS.values(), ids=list(LAWS))


@of_each_law
def test_the_users_own_model_moves_as_the_closed_form_says(tmp_path, law):
    scenario_of(tmp_path, law, "imu")
    own, closed, without = forces_by_both(tmp_path / "s.toml", tmp_path / "lift.xml", AXES)
    assert np.abs(own - closed).max() < 1e-2 * np.abs(closed - without).max()


def test_a_sequence_goes_through_its_file(tmp_path):
    scenario = scenario_of(tmp_path, STEPS)
    (tmp_path / "s.csv").write_text(sequence_text(scenario.sequence, scenario.rig))
    back = build_schedule(read_sequence(tmp_path / "s.csv"), scenario.rig)
    time = np.linspace(*scenario.schedule.times, 400)
    there, again = (s.drive(time).axes for s in (scenario.schedule, back))
    for axis in AXES:
        # rates are written in six digits: a move ends some 1e-5 s elsewhere
        np.testing.assert_allclose(again[axis].x, there[axis].x, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("boom_mm = 300", "boom_deg = 300", "found boom_deg, need boom_mm"),
        ("pan_deg = 60", "pan_mm = 60", "pan_mm: unknown key"),
        ("offset_mm = 30", "offset_deg = 30", "offset_deg of axis lift, whose joint is a slide"),
        ('action = "sweep"', 'action = "turn"\naxis = "boom"\nangle_deg = 3', "axis boom, which"),
    ],
)
def test_angles_of_a_slide_are_refused(tmp_path, old, new, words):
    scenario_of(tmp_path, STEPS)
    text = (tmp_path / "s.toml").read_text()
    assert old in text
    (tmp_path / "s.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(TiltcalError, match=words):
        load_scenario(tmp_path / "s.toml")


@of_each_law
def test_an_environment_moves_a_slide_as_the_laboratory_does(tmp_path, law):
    scenario_of(tmp_path, law, "imu")
    with pytest.raises(TiltcalError, match="no axis lift, which slides"):
        gymnasium.make(RIG, scenario=tmp_path / "s.toml", noise=False)
    environment = gymnasium.make(
        RIG, scenario=tmp_path / "s.toml", noise=False, limits_mm={"lift": (-50, 200)}
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment.unwrapped, skip_render_check=True)
    readout = environment.observation_space["readout"]
    np.testing.assert_allclose(readout.low, (-0.05, -np.pi, -np.pi, -0.1))
    np.testing.assert_allclose(readout.high, (0.2, np.pi, np.pi, 0.7))
    scenario = load_scenario(tmp_path / "s.toml")
    states, live = driven(environment, rng_of("slides"), 400, seed=7)
    places, rates = states[:, 0], states[:, 1]
    assert 0.2 < np.ptp(places[:, 3]) <= 0.8
    assert 0.1 < np.abs(rates[:, 3]).max() <= 0.2 + 1e-12
    course = Course(scenario.rig.axis_names, 1 / 50, states)
    times = {s.name: np.arange(len(states)) / 50 for s in scenario.sensor}
    lab = readings(scenario, course, times, scenario.effects, mover=mujoco_motion)
    for name, values in lab.items():
        np.testing.assert_allclose(live[name], values, rtol=0, atol=1e-8, err_msg=name)


def test_what_turns_is_no_effect_of_a_slide(tmp_path):
    with pytest.raises(TiltcalError, match=r"which slides, need an axis .* that turns"):
        scenario_of(tmp_path, law("table_backlash", "boom", width_arcsec=4))
    with pytest.raises(TiltcalError, match="axis 'lift', which slides"):
        scenario_of(tmp_path, law("table_backlash", width_arcsec=4))


def test_what_gravity_loads_is_found_behind_a_slide(tmp_path):
    scenario = scenario_of(tmp_path, law("table_sag", sag_arcsec=20), "imu")
    sag = next(e for e in scenario.effects if e.id == "table_sag")
    assert [a for a in AXES if sag.acts_on(a, scenario.rig)] == ["tilt"]


def test_the_zero_of_a_readout_is_a_parameter_of_axes_that_turn_alone(tmp_path):
    rig = scenario_of(tmp_path, STEPS).rig
    parameters = CATALOGUE["table_encoder_zero"].parameters
    assert {p.name for p in parameters if p.stands_on(rig)} == {"pan_zero", "tilt_zero"}


def test_a_readout_in_a_unit_of_angle_is_refused(tmp_path):
    scenario = scenario_of(tmp_path, STEPS)
    recording = simulator().record(scenario, None)
    columns = {
        n.replace("boom_mm", "boom_deg"): recording.column(n) for n in recording.column_names
    }
    with pytest.raises(TiltcalError, match="unit deg, need a unit of length: axis boom slides"):
        replay(Recording.from_columns(recording.time, columns), scenario)


ALONG = "along boom at lift 0 at pan 0 at tilt -20"


def test_blocks_move_slides_within_the_range_of_the_joint_or_as_far_as_they_went(tmp_path):
    scenario = scenario_of(tmp_path, STEPS, "imu")
    recording = simulator().record(scenario, None)
    table = table_of(scenario, [recording], Limits(angles={"tilt": (-20.0, 40.0)}))
    # the joint goes from -200 to 600 mm, and stands at -100 mm where the readout says zero
    assert table.reach["boom"] == pytest.approx((-100.0, 700.0))
    assert table.reach["lift"] == pytest.approx((0.0, 200.0))  # no range: as far as it went
    blocks = {block.name: block for block in candidates(table)}
    # the recording turned the pan to -90 deg
    assert {name for name, block in blocks.items() if not within(block, table)} == {"repeat"}
    start, *rest = (step.lengths_mm["boom"] for step in blocks[ALONG].steps)
    assert (start, rest[-1]) == pytest.approx((-100.0, 700.0))
    *_, slow = blocks[ALONG.replace("along", "slow")].steps
    assert slow.rate_mm_s == pytest.approx(800 / 60)
    last = build_schedule(blocks[ALONG].steps, scenario.rig).legs[-1]
    assert (last.q0 + last.dq)[list(AXES).index("boom")] == pytest.approx(0.7)
    assert {"circle tilt at lift 0 at pan 0 at boom -100", "reverse lift at pan 0"} <= {
        name.removesuffix(" at tilt -20 at boom -100") for name in blocks
    }
    assert not [name for name in blocks if name.startswith(("spin boom", "circle boom"))]


def test_a_slide_without_a_range_stands_still_unless_told(tmp_path):
    still = STEPS.replace("lift_mm", "tilt_deg")
    scenario = scenario_of(tmp_path, still, "imu")
    recording = simulator().record(scenario, None)
    assert "lift" not in table_of(scenario, [recording], Limits()).reach
    told = table_of(scenario, [recording], Limits(angles={"lift": (0.0, 50.0)}))
    assert told.reach["lift"] == (0.0, 50.0)
    assert poses_of(recording, scenario)[-1] == pytest.approx((0.0, -90.0, 200.0, 500.0), abs=0.1)


def test_where_one_axis_turns_more_poses_are_those_from_both_sides(tmp_path):
    (tmp_path / "lift.xml").write_text(LIFT)
    two = {name: AXES[name] for name in ("tilt", "boom")}
    (tmp_path / "s.toml").write_text(scenario_text("lift.xml", two, "imu"))
    scenario = load_scenario(tmp_path / "s.toml")
    found = {"verdict": "cannot_tell", "findings": []}
    plan = next_block(scenario, [], found, {}, Limits(), silent)
    assert plan.proposal.block.name.startswith("reverse tilt")


def test_a_served_slide_obeys_in_mm_and_its_recording_is_explained(tmp_path):
    scenario = scenario_of(tmp_path, STEPS, "imu")
    (tmp_path / "steps.csv").write_text(sequence_text(scenario.sequence, scenario.rig))
    with served(scenario) as server:
        wire = Wire(server.ports["command"])
        assert wire.ask(":LIM:POS? 4;:LIM:RATE? 4;:LIM:ACC? 4") == "-100,700;200;500"
        wire.send(":MODE:POS 4;:DEM:POS 4,800")
        assert wire.ask(":SYST:ERR?").startswith("-222")
        wire.close()
        # a process that knows nothing of the model but what the table says
        words = ["record", f"127.0.0.1:{server.ports['command']}", "steps.csv", "run.csv"]
        subprocess.run([sys.executable, "-m", "tiltcal", *words], cwd=tmp_path, check=True)
    recording = read_recording(tmp_path / "run.csv")
    boom, lift = recording.column("table_boom_mm"), recording.column("table_lift_mm")
    assert (boom.min(), boom.max(), lift[-1]) == pytest.approx((-100, 500, 200), abs=1e-6)
    assert diagnose(scenario, [recording]).verdict == "match"
