"""From a recording to a name: one thing left out is found, named, sized and modelled; nothing left
out is a match.
"""

import json

import numpy as np
import pytest
import tomli_w
from diagnosis_fixtures import bench, honest, recorded

from tiltcal.cli import main
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.saving import write_recording

LEFT_OUT = {  # what is concealed, its parameter with unit, table, sensor
    "table_levelling": (
        {"id": "table_levelling", "tilt_north_arcsec": 40.0},
        "tilt_north_arcsec",
        "vertical",
        "incl",
    ),
    "acc_K2": (
        {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 400.0},
        "k2_x_ug_g2",
        "dual",
        "accel",
    ),
    "table_axis_wobble": (
        {"id": "table_axis_wobble", "axis": "outer", "m1c_arcsec": 30.0},
        "m1c_arcsec",
        "vertical",
        "incl",
    ),
    "acc_temp_scale": (
        {"id": "acc_temp_scale", "sensor": "accel", "temp_scale_y_ppm_degC": 200.0},
        "temp_scale_y_ppm_degC",
        "dual",
        "accel",
    ),
    "mount_slip": (
        {
            "id": "mount_slip",
            "slip_x_arcsec": 40.0,
            "slip_y_arcsec": -60.0,
            "slip_z_arcsec": 50.0,
            "time_s": 80.0,
        },
        "slip_y_arcsec",
        "dual",
        "accel",
    ),
}


@pytest.fixture(scope="module", params=LEFT_OUT)
def case(request):
    """What was left out and what the diagnosis says."""
    effect, parameter, table, sensor = LEFT_OUT[request.param]
    truth = bench(effect, table=table, sensor=sensor, swing_degC=3.0, period_s=150.0)
    recording = recorded(truth, 11)
    return effect, parameter, truth, recording, diagnose(honest(truth), [recording])


def test_it_is_named_and_sized(case):
    effect, parameter, _, _, found = case
    assert found.verdict in ("explained", "ambiguous")
    (finding,) = found.findings
    assert effect["id"] in finding.names
    if finding.effect == effect["id"]:
        value, sigma = finding.parameters[parameter]
        assert abs(value - effect[parameter]) < 4 * sigma
    assert finding.p_value < 0.01
    assert finding.heldout_gain > 0
    assert found.after.chi2_per_dof < found.before.chi2_per_dof


def test_the_amended_scenario_explains_the_recording(case):
    _, _, _, recording, found = case
    assert diagnose(parse_scenario(dict(found.amended)), [recording]).verdict == "match"


def test_the_amended_scenario_predicts_another_recording(case):
    effect, _, truth, _, found = case
    other = recorded(truth, None)
    from tiltcal.laboratory.laboratory import SimulatedLaboratory

    nominal = SimulatedLaboratory().predict(
        parse_scenario(
            {
                **dict(found.amended),
                "effect": [e for e in found.amended["effect"] if e.get("role") != "found"],
            }
        ),
        other,
    )
    better = SimulatedLaboratory().predict(parse_scenario(dict(found.amended)), other)
    if effect["id"] == "mount_slip":
        return  # the other recording comes after the slip: it is not the same experiment
    errors = []
    for predicted in (nominal, better):
        sensor = truth.sensor[0]
        errors.append(
            np.sqrt(
                np.nanmean((predicted.sensor(sensor).values - other.sensor(sensor).values) ** 2)
            )
        )
    assert errors[1] < 0.5 * errors[0]


def test_a_recording_with_nothing_left_out_is_a_match():
    truth = bench()
    found = diagnose(honest(truth), [recorded(truth, 0)])
    assert (found.verdict, found.findings) == ("match", ())
    seen = {u.effect: u for u in found.undetectable}
    # one with the scale factors, whatever is recorded
    assert seen["gravity_magnitude"].absorbed > 0.999
    assert seen["gravity_magnitude"].size == {}
    assert seen["acc_K2"].size["k2_x_ug_g2"] > 0


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A recording with a concealed effect, and scenarios with and without the truth."""
    folder = tmp_path_factory.mktemp("case")
    truth = bench({"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 600.0})
    write_recording(recorded(truth, 3), folder / "run.csv")
    for name, scenario, more in (
        ("honest", honest(truth), {}),
        ("told", truth, {"role": "concealed"}),
    ):
        table = json.loads(
            scenario.model_dump_json(exclude_none=True, exclude_defaults=True, by_alias=True)
        )
        (folder / f"{name}.toml").write_text(tomli_w.dumps({"schema": 1, **table, **more}))
    return folder


def test_the_command_writes_the_answer_the_amended_scenario_and_an_offline_report(files, capsys):
    words = ["diagnose", str(files / "run.csv"), "--scenario", str(files / "honest.toml")]
    # with a finding, --check is a status of its own
    assert main([*words, "-o", str(files / "out"), "--json", "--check"]) == 1
    answer = json.loads((files / "out" / "diagnosis.json").read_text())
    assert json.loads(capsys.readouterr().out) == answer
    assert answer["schema"] == 1
    assert "acc_K2" in answer["findings"][0]["class"]
    assert set(answer["fit"]["after"]) == {
        "chi2_per_dof",
        "rms",
        "heldout_chi2_per_dof",
        "log_likelihood",
    }
    assert any("re-simulated" in note for note in answer["notes"])
    report = (files / "out" / "report.html").read_text()
    assert "acc_K2" in report
    for channel, noise in answer["noise"]["channels"].items():
        assert channel in report
        assert f"{noise['white']['value']:.3g}" in report
    assert 'src="http' not in report
    amended = [
        "diagnose",
        str(files / "run.csv"),
        "--scenario",
        str(files / "out" / "amended.toml"),
        "--check",
    ]
    assert main(amended) == 0


def test_a_scenario_that_holds_the_truth_is_refused(files, capsys):
    assert main(["diagnose", str(files / "run.csv"), "--scenario", str(files / "told.toml")]) == 2
    assert 'role = "concealed"' in capsys.readouterr().err


def test_what_is_held_out_is_predicted_where_one_dwell_alone_determines_a_term():
    """Of the outer angle only 0 and 90 deg are visited: without the first dwell nothing says what
    the third axis reads under load.
    """
    steps = [
        {"action": "move", "outer_deg": 90.0, "dwell_s": 4.0},
        {"action": "sweep", "inner_deg": 360.0, "step_deg": 30.0, "dwell_s": 4.0},
    ]
    left_out = {"id": "table_encoder_eccentricity", "axis": "inner"}
    truth = bench(left_out | {"cos_arcsec": -30.0, "sin_arcsec": 50.0})
    table = truth.model_dump(exclude_defaults=True, by_alias=True)
    truth = parse_scenario({"schema": 1, **table, "sequence": steps})
    found = diagnose(honest(truth), [recorded(truth, 1)])
    assert found.before.heldout_chi2_per_dof > found.before.chi2_per_dof
    assert found.after.heldout_chi2_per_dof == pytest.approx(found.after.chi2_per_dof, rel=0.1)
    json.dumps(found.to_json(), allow_nan=False)
