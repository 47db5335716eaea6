"""A table with four axes: its declaration and its MJCF are all that it takes."""

import numpy as np
import pytest
from builders import ACCEL, GYRO, schedule_of, setup_of, still

from tiltcal.cli import main
from tiltcal.core.frames import rotation
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.scenario import fresh, parse_scenario
from tiltcal.setup.sequence import Step
from tiltcal.setup.sequence_files import read_sequence, sequence_text
from tiltcal.setup.tables import DUAL, FOUR, THREE
from tiltsim.laboratory import MujocoLaboratory

NOISE = {"id": "acc_noise", "white_ug_rthz": 20.0}
ORDINARY = {"id": "acc_bias", "bias_x_ug": 900.0, "bias_z_ug": -700.0}
CONCEALED = {
    "table_encoder_eccentricity": {"axis": "head", "cos_arcsec": 60.0, "sin_arcsec": -45.0},
    "axis_nonorthogonality": {"inner_head_arcsec": 80.0},
    "acc_K3": {"k3_x_ug_g3": 400.0},
}


def tumble():
    """48 poses all over the sphere; the head stands elsewhere in each."""
    poses = [(m, i + 15) for m in range(-180, 180, 45) for i in range(0, 360, 60)]
    return [
        {
            "action": "move",
            "middle_deg": m,
            "inner_deg": i,
            "head_deg": 37 * k % 360 - 180,
            "rate_deg_s": 60,
            "dwell_s": 3,
        }
        for k, (m, i) in enumerate(poses)
    ]


def scenario_with(*effects):
    return parse_scenario(
        {
            "schema": 1,
            "name": "four axes",
            "seed": 3,
            "site": {"gravity_m_s2": 9.80123, "latitude_deg": 39.9},
            "rig": {"table": "four"},
            "sensor": [
                {
                    "name": "accel",
                    "kind": "accelerometer",
                    "rate_hz": 10,
                    "adjustable": ["bias", "scale", "cross_axis"],
                }
            ],
            "effect": [NOISE, *effects],
            "sequence": tumble(),
        }
    )


def test_the_head_turns_about_the_body_s_z():
    setup = setup_of("four", ACCEL, GYRO)
    angles = {"outer": 20.0, "middle": 30.0, "inner": -50.0, "head": 70.0}
    R = np.eye(3)
    for name, about in (("outer", "z"), ("middle", "y"), ("inner", "x"), ("head", "z")):
        R = R @ rotation(about, np.radians(angles[name]))
    up = closed_form(setup, still(setup, **angles)).up[0]
    assert up == pytest.approx(R.T @ [0, 0, 1], abs=1e-15)


def test_what_follows_from_the_axes():
    assert FOUR.tilting == ("middle", "inner", "head")
    assert (FOUR.loaded, FOUR.pointing) == ("middle", THREE.pointing)
    assert FOUR.joints == (*THREE.joints, ("inner", "head", "y"))
    assert DUAL.joints == (("outer", "inner", "y"),)


def test_a_scheme_turns_every_direction_up_with_the_head_at_zero():
    setup = setup_of("four", ACCEL)
    schedule = schedule_of(setup, {"action": "scheme", "scheme": "24", "dwell_s": 1.0})
    ends = [leg for leg in schedule.legs if leg.profile == "rest"]
    drive = schedule.drive(np.array([leg.t0 + 0.5 for leg in ends]))
    up = closed_form(setup, drive).up
    faces = np.array([sign * e for e in np.eye(3) for sign in (1.0, -1.0)])
    assert up == pytest.approx(np.tile(faces, (4, 1)), abs=1e-12)
    assert not np.any(drive.axes["head"].x)
    assert set(np.round(np.degrees(drive.axes["outer"].x))) == {0, 90, 180, 270}


def test_a_sequence_file_has_a_column_for_the_further_axis(tmp_path):
    scenario = scenario_with()
    text = sequence_text(scenario.sequence, scenario.rig)
    assert text.startswith("step,action,outer_deg,middle_deg,inner_deg,head_deg,rate_deg_s")
    (tmp_path / "sequence.csv").write_text(text)
    again = fresh(scenario, sequence=read_sequence(tmp_path / "sequence.csv")).schedule
    time = np.linspace(*scenario.schedule.times, 500)
    for name in FOUR.axis_names:
        one, other = (s.drive(time).axes[name].x for s in (scenario.schedule, again))
        assert np.asarray(one) == pytest.approx(np.asarray(other), abs=1e-4)
    still_dual = sequence_text([Step(action="rest", dwell_s=1.0)], setup_of("dual").rig)
    assert still_dual.startswith("step,action,outer_deg,middle_deg,inner_deg,rate_deg_s")


@pytest.mark.parametrize("id", CONCEALED)
def test_what_is_concealed_is_found(id):
    truth = scenario_with(ORDINARY, {"id": id, **CONCEALED[id]})
    recording = MujocoLaboratory().record(truth, 3)
    assert {f"table_{axis}_deg" for axis in FOUR.axis_names} <= set(recording.column_names)
    found = diagnose(scenario_with(), [recording], laboratory=MujocoLaboratory())
    assert found.verdict in ("explained", "ambiguous")
    (finding,) = found.findings
    assert finding.effect == id
    for name, value in CONCEALED[id].items():
        if name != "axis":
            estimate, sigma = finding.parameters[name]
            assert abs(estimate - value) < 5 * sigma


def test_every_command_takes_it(here, capsys):
    import tomli_w

    table = scenario_with(ORDINARY).model_dump(
        mode="json", by_alias=True, exclude_none=True, exclude_unset=True
    )
    (here / "four.toml").write_text(tomli_w.dumps(table))
    assert main(["simulate", "four.toml", "-o", "run.csv"]) == 0
    assert main(["simulate", "four.toml", "--motion", "run.csv", "-o", "again.csv"]) == 0
    assert main(["segments", "run.csv", "-o", "segments.csv"]) == 0
    assert main(["confuse", "four.toml"]) == 0
    assert main(["design", "four.toml", "--budget-s", "60", "-o", "plan"]) == 0
    assert "head_deg" in (here / "plan" / "steps.csv").read_text().splitlines()[0]
    capsys.readouterr()
    assert main(["init", "--from", "run.csv"]) == 0
    assert 'table = "four"' in capsys.readouterr().out
