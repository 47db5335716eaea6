"""Round trip with MuJoCo's system identification, on the arm of the examples."""

import mujoco
import numpy as np
import pytest
from model_oracle import forces_by_both, law, recorded
from model_rig import Mapped, PlainModel, scenario_text
from mujoco import sysid
from scipy.ndimage import binary_erosion

from tiltcal.cli import main
from tiltcal.core.assets import folder
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording
from tiltsim.sysid import Exchange

ARM = folder("scenarios") / "arm" / "arm.xml"
AXES = {
    "pan": Mapped("pan"),
    "lift": Mapped("lift", -1, 0.2),
    "elbow": Mapped("elbow", 1, -0.1),
    "wrist": Mapped("wrist", -1),
}


def written(place, effects, site="tool"):
    (place / ARM.name).write_bytes(ARM.read_bytes())
    text = scenario_text(ARM, AXES, site)
    file = place / "scenario.toml"
    file.write_text(text + effects)
    return file


LAWS = {
    "first joint of a body": law("joint_axis_tilt", "elbow", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "second joint of it": law("joint_axis_tilt", "wrist", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "first link of a body": law("link_tilt", "elbow", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "second link of it": law("link_tilt", "wrist", tilt_x_arcsec=400, tilt_y_arcsec=-300),
    "zero": law("table_encoder_zero", lift_zero_arcsec=500, wrist_zero_arcsec=-700),
    "eccentricity": law("table_encoder_eccentricity", "lift", cos_arcsec=300, sin_arcsec=200),
    "levelling": law("table_levelling", tilt_east_arcsec=500, tilt_north_arcsec=-300),
    "mounting": law("mount_misalignment", tilt_x_arcsec=500, tilt_z_arcsec=-300),
    "lever arm": law("lever_arm", lever_x_mm=20, lever_z_mm=-30),
    "gravity": law("gravity_magnitude", gravity_error_ppm=300),
    "joint bends": law(
        "joint_compliance",
        "wrist",
        bend_x_arcsec_N_m=3,
        bend_y_arcsec_N_m=2,
        bend_z_arcsec_N_m=4,
    ),
    "link bends": law("link_compliance", "wrist", bend_x_arcsec_N_m=3, bend_y_arcsec_N_m=-2),
    "base bends": law("base_load_compliance", bend_east_arcsec_N_m=0.4, bend_north_arcsec_N_m=0.6),
}


@pytest.mark.parametrize("name", LAWS)
def test_the_users_own_model_moves_as_the_closed_form_says(tmp_path, name):
    own, closed, without = by_both(tmp_path, LAWS[name])
    print(name, np.abs(own - closed).max(), np.abs(closed - without).max())
    assert np.abs(own - closed).max() < 1e-2 * np.abs(closed - without).max()


def test_a_link_bends_before_the_next_joint_of_its_body(tmp_path):
    bends = law("link_compliance", "elbow", bend_x_arcsec_N_m=30, bend_y_arcsec_N_m=-20)
    own, closed, without = by_both(tmp_path, bends)
    still = np.append(True, (np.diff(without, axis=0) == 0).all(axis=1))
    still = binary_erosion(still, iterations=10)  # a bend is still moving as a rest begins
    left, change = np.abs(own - closed)[still], np.abs(closed - without)[still]
    assert left.max() < 1e-2 * change.max()


def by_both(tmp_path, effect):
    return forces_by_both(written(tmp_path, effect), ARM, AXES)


def test_a_diagnosis_goes_to_sysid_and_comes_back(tmp_path):
    noise = law("acc_noise", white_ug_rthz=12).replace('role = "found"\n', "")
    file = written(tmp_path, law("joint_axis_tilt", "lift", tilt_x_arcsec=40.5) + noise)
    exported, found = tmp_path / "sysid.yaml", tmp_path / "found.yaml"
    assert main(["export", str(file), "-o", str(exported)]) == 0
    params = sysid.ParameterDict.load_from_disk(exported)
    assert params.keys() == ["joint_axis_tilt[lift].tilt_x"]
    tilt = params["joint_axis_tilt[lift].tilt_x"]
    assert tilt.value == pytest.approx([40.5 * ARCSEC])
    assert not tilt.frozen
    tilt.update_from_vector([-17 * ARCSEC])
    params.save_to_disk(found)
    back = tmp_path / "found.toml"
    assert main(["import", str(found), "--scenario", str(file), "-o", str(back)]) == 0
    after = {e.id: e for e in load_scenario(back).effects}
    assert after["joint_axis_tilt"].value("tilt_x") == pytest.approx(-17 * ARCSEC)
    assert after["acc_noise"].values == load_scenario(file).effects[1].values


def test_what_no_model_can_hold_is_said(tmp_path, capsys):
    noise = law("acc_noise", white_ug_rthz=12)
    file = written(tmp_path, law("joint_axis_tilt", "lift", tilt_x_arcsec=40.5) + noise)
    main(["export", str(file), "-o", str(tmp_path / "sysid.yaml")])
    assert "left out, no parameter of a model: acc_noise[accelerometer] (random)" in (
        capsys.readouterr().err
    )
    assert main(["export", str(written(tmp_path, noise))]) == 2


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a: [", "found while parsing"),
        ("- 3", "no table"),
        ("lift: {value: 3}", "no list of one value"),
        ("lift: {value: [.nan]}", "nan"),
        ('"joint_axis_tilt[lift].tilt_z": {value: [1.0e-4]}', "joint_axis_tilt[lift].tilt_x"),
    ],
)
def test_a_file_that_holds_no_result_is_refused(tmp_path, capsys, text, found):
    file = written(tmp_path, law("joint_axis_tilt", "lift", tilt_x_arcsec=40.5))
    (tmp_path / "found.yaml").write_text(text)
    assert main(["import", str(tmp_path / "found.yaml"), "--scenario", str(file)]) == 2
    assert found in capsys.readouterr().err


def test_sysid_finds_on_the_users_model_what_plain_mujoco_has(tmp_path):
    """The recording is plain MuJoCo's; the optimiser begins at a tenth of the truth."""
    _, time, jets = recorded(AXES, poses=6)
    rig = PlainModel(ARM, AXES, "tool", joint_stiffness={"lift": 1 / (10 * ARCSEC)})
    force, _ = rig.readings(time, jets)
    columns = {f"table_{a}_rad": j[0] for a, j in jets.items()}
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    start = law("joint_compliance", "lift", bend_z_arcsec_N_m=1)
    exchange = Exchange.of(written(tmp_path, start), ARM)
    residual = sysid.build_residual_fn(**exchange.problem(Recording.from_columns(time, columns)))
    found, _ = sysid.optimize(
        exchange.parameters, residual, optimizer="scipy", verbose=False, x_scale="jac"
    )
    assert found.as_vector() == pytest.approx([10 * ARCSEC], rel=1e-2)


def test_the_model_of_a_rollout_holds_springs_and_leaves_the_users_own_alone(tmp_path):
    exchange = Exchange.of(written(tmp_path, LAWS["joint bends"]), ARM)
    spec = mujoco.MjSpec.from_file(str(ARM))
    model = exchange.build_model(exchange.parameters, spec)
    names = [model.joint(k).name for k in range(model.njnt)]
    bends = [f"wrist_bearing_bend_{a}" for a in "xyz"]
    assert names == ["pan", "lift", "elbow", *bends, "wrist"]
    assert model.joint(bends[2]).stiffness[0] == pytest.approx(1 / (4 * ARCSEC))
    assert spec.compile().njnt == 4


def test_a_rig_without_a_model_of_its_own_is_refused():
    setup = load_scenario(folder("scenarios") / "catalogue_model.toml")
    bare = setup.model_copy(update={"rig": setup.rig.model_copy(update={"site": ""})})
    with pytest.raises(TiltcalError, match="links without their site"):
        Exchange(bare, mujoco.MjSpec.from_file(str(ARM)))
