"""Designs on a user's own model: where up is, effects of links, and more axes than a grid holds."""

from functools import cache

import numpy as np
import pytest
from model_rig import Mapped, PlainModel, scenario_text
from statistics_helpers import rng_of

from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.design.pose_grids import spread
from tiltcal.design.recording_blocks import candidates
from tiltcal.design.scenario_problem import clock_of
from tiltcal.design.static_instrument import Still, pointwise, still_sense
from tiltcal.design.tabulated import changes_of, tabulate
from tiltcal.design.terms import Wanted, scenario_model
from tiltcal.diagnosis.investigation.next_block import Limits, table_of
from tiltcal.effects import make_effect
from tiltcal.laboratory.scenario import load_scenario

ARM = folder("scenarios") / "arm" / "arm.xml"
AXES = {
    "pan": Mapped("pan"),
    "lift": Mapped("lift", -1, np.radians(10)),
    "elbow": Mapped("elbow"),
    "wrist": Mapped("wrist", 1, -0.3),
}


@cache
def tilted_arm():
    """The arm on a base that leans, so that all four axes tilt the instrument."""
    text = ARM.read_text()
    assert 'euler="0 0 30"' in text
    return text.replace('euler="0 0 30"', 'euler="20 0 30"')


@pytest.fixture
def arm(tmp_path):
    """(scenario file, model file)."""
    (tmp_path / "arm.xml").write_text(tilted_arm())
    (tmp_path / "s.toml").write_text(scenario_text("arm.xml", AXES, "tool"))
    return tmp_path / "s.toml", tmp_path / "arm.xml"


def test_force_at_rest_is_that_of_plain_mujoco(arm):
    scenario_file, model = arm
    scenario = load_scenario(scenario_file)
    still, n = Still(scenario, 100.0), 20
    assert still.axes == tuple(AXES)
    angles = rng_of("rest of an arm").uniform(-3, 3, (n, 4))
    jets = {axis: np.array([angles[:, k], np.zeros(n), np.zeros(n)]) for k, axis in enumerate(AXES)}
    force, _ = PlainModel(model, AXES, "tool").readings(np.arange(float(n)), jets)
    sense = still_sense(still, scenario.sensor[0], angles, np.zeros(n))
    np.testing.assert_allclose(sense.force[:n], force, atol=1e-9)


def test_a_sensor_that_sits_elsewhere_is_designed_for_where_it_sits(tmp_path):
    (tmp_path / "arm.xml").write_text(tilted_arm())
    text = scenario_text("arm.xml", AXES, "base_imu") + 'site = "tool"\n'
    (tmp_path / "s.toml").write_text(text)
    scenario = load_scenario(tmp_path / "s.toml")
    out = tmp_path / "out"
    words = ("design", tmp_path / "s.toml", "--budget-s", 70, "-o", out, "--terms", "bias")
    assert main([str(word) for word in words]) == 0
    designed = load_scenario(out / "design.toml")
    assert designed.rig == scenario.rig
    assert designed.sensor == scenario.sensor
    assert any(step.angles_deg.get("wrist") for step in designed.sequence)


def test_bends_of_links_show_in_poses_in_any_order(arm):
    scenario = load_scenario(arm[0])
    bend = make_effect("joint_compliance", {"bend_z_arcsec_N_m": 2.0}, scenario, axis="lift")
    assert pointwise(Still(scenario, 100.0), scenario.sensor[0], bend)


def test_columns_of_four_axes_are_their_differences_and_lines_are_left_out(arm):
    scenario = load_scenario(arm[0])
    still, sensor = Still(scenario, 100.0), scenario.sensor[0]
    effects = [
        make_effect("joint_axis_tilt", {"tilt_x_arcsec": 60.0}, scenario, axis="lift"),
        make_effect(
            "table_encoder_sde",
            {"lines": 3600, "cos_arcsec": 2.0},
            scenario,
            axis="elbow",
        ),
    ]
    columns, held = tabulate(still, sensor, effects)
    assert held == [True, False]
    angles = rng_of("poses of four axes").uniform(-3, 3, (15, 4))
    np.testing.assert_array_equal(
        columns.only([0]).at(angles), changes_of(still, sensor, effects[:1], angles)
    )


def test_spread_poses_are_allowed_and_fill_every_pair_of_axes():
    limits = (None, (-40 * DEG, 80 * DEG), None, (0.0, 1.0))
    poses = spread(limits, 4096)
    low, high = np.array([pair or (-np.pi, np.pi) for pair in limits]).T
    assert (poses >= low).all()
    assert (poses <= high).all()
    cells = np.floor((poses - low) / (high - low) * 8).astype(int)
    for i in range(4):
        for j in range(i):
            counts = np.bincount(8 * cells[:, i] + cells[:, j], minlength=64)
            assert 40 <= counts.min() <= counts.max() <= 90  # 64 on average


def test_joints_keep_to_their_range_unless_told_otherwise(tmp_path):
    text = tilted_arm()
    assert '<joint name="lift"' in text
    text = text.replace('<joint name="lift"', '<joint name="lift" range="-80 30"')
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "s.toml").write_text(scenario_text("arm.xml", AXES, "tool"))
    scenario = load_scenario(tmp_path / "s.toml")
    # the readout counts the other way, and says zero where the joint stands at 10 deg
    assert scenario.rig.ranges == {"lift": pytest.approx((-20.0, 90.0))}
    lift = list(AXES).index("lift")
    low, high = clock_of(scenario, 100.0).limits[lift]
    assert (low / DEG, high / DEG) == pytest.approx((-20.0, 90.0))
    told = clock_of(scenario, 100.0, angles_deg={"lift": (-5.0, 5.0)}).limits[lift]
    assert told == pytest.approx((-5 * DEG, 5 * DEG))
    reach = table_of(scenario, [], Limits()).reach
    assert reach["lift"] == pytest.approx((-20.0, 90.0))
    assert reach["pan"] == (0.0, 360.0)


def test_no_block_turns_two_joints_over_as_a_table_does(tmp_path):
    """Up at (a, b) is that at (360 - a, b + 180) where two axes meet at right angles only."""
    (tmp_path / "arm.xml").write_text(tilted_arm())
    two = {name: AXES[name] for name in ("pan", "lift")}
    (tmp_path / "s.toml").write_text(scenario_text("arm.xml", two, "tool"))
    scenario = load_scenario(tmp_path / "s.toml")
    names = {block.name for block in candidates(table_of(scenario, [], Limits()))}
    assert "tumble" in names
    assert "flip" not in names


def test_an_instrument_that_no_axis_tilts_is_refused(tmp_path):
    (tmp_path / "arm.xml").write_text(tilted_arm())
    (tmp_path / "s.toml").write_text(scenario_text("arm.xml", AXES, "base_imu"))
    with pytest.raises(TiltcalError, match=r"arm\.xml: found no axis that tilts the instrument"):
        clock_of(load_scenario(tmp_path / "s.toml"), 100.0)


def test_a_joint_about_the_vertical_is_named_as_not_visible(tmp_path):
    """Its axis tilts nothing, so that a design does not move it: the others' errors show."""
    (tmp_path / "arm.xml").write_text(ARM.read_text().replace('euler="0 0 30"', 'euler="0 0 0"'))
    (tmp_path / "s.toml").write_text(scenario_text("arm.xml", AXES, "tool"))
    scenario = load_scenario(tmp_path / "s.toml")
    wanted = Wanted(("bias", "joint_axis_tilt"))
    model, unseen = scenario_model(scenario, scenario.sensor[0], wanted, 100.0)
    assert "pan" not in Still(scenario, 100.0).axes
    assert unseen == ("joint_axis_tilt[pan]",)
    for axis in ("lift", "elbow", "wrist"):
        assert f"joint_axis_tilt[{axis}].tilt_x" in model.names
