"""The scenario file: what it takes, and all that is wrong with it in one message."""

# ruff: noqa: E501  the tables of messages stand one case a line

import json
import re
import tomllib

import pytest
from builders import effect_of, setup_of

from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import earth_rate
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import load_scenario, parse_scenario, scenario_schema
from tiltcal.setup.sensor import Sensor

MINIMAL = """
schema = 1
name = "dual-axis tumble"
[site]
gravity_m_s2 = 9.80123          # local plumb-line gravity
latitude_deg = 39.9             # needed when a gyro or FOG is present
heading_deg = 0.0
[rig]
table = "dual"                  # section 2
readout = "encoder"
mount = "identity"
lever_arm_m = [0.0, 0.0, 0.0]
[[sensor]]
name = "accel"                  # prefix of its columns
kind = "accelerometer"
axes = ["x", "y", "z"]
rate_hz = 50.0
adjustable = ["bias", "scale", "cross_axis"]
"""
RAW = MINIMAL + 'input = {unit = "LSB", zero = 33000, per_m_s2 = 415}\n'
SIMULATES = (
    MINIMAL
    + """
[[effect]]
id = "acc_K2"
k2_x_ug_g2 = 120
[[effect]]
id = "table_levelling"
tilt_east_arcsec = 7
role = "concealed"
[[sequence]]
action = "move"
outer_deg = 30
dwell_s = 5
"""
)


def load(tmp_path, text):
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    return load_scenario(tmp_path / "s.toml")


def refusal(tmp_path, text):
    with pytest.raises(TiltcalError) as refused:
        load(tmp_path, text)
    return str(refused.value)


# --------------------------------------------------------------------------------------------- what
# it takes


@pytest.mark.parametrize("text", [MINIMAL, RAW], ids=["SI columns", "raw columns"])
def test_the_least_scenario_of_the_contract_parses(text, tmp_path):
    scenario = load(tmp_path, text)
    accel = scenario.named("accel")
    assert (scenario.name, scenario.rig.axis_names, accel.rate_hz) == (
        "dual-axis tumble",
        ("outer", "inner"),
        50.0,
    )
    assert scenario.site.earth_rate == pytest.approx(earth_rate(39.9 * DEG))
    assert scenario.effects == ()
    assert accel.column_unit == ("LSB" if text is RAW else "m_s2")


def test_a_fog_an_unknown_heading_and_an_effect_as_adjustable_are_taken(tmp_path):
    fog = '[[sensor]]\nname = "fog"\nkind = "fog"\naxes = ["a"]\ninput_axis = [1, 1, 1]\nadjustable = ["bias", "fog_axis_error"]\n'
    scenario = load(tmp_path, MINIMAL.replace("heading_deg = 0.0", 'heading_deg = "unknown"') + fog)
    assert scenario.named("fog").adjustable == ("bias", "fog_axis_error")
    assert [s.name for s in scenario.sensors("fog", "gyro")] == ["fog"]


def test_a_scenario_that_simulates_has_effects_and_a_schedule(tmp_path):
    scenario = load(tmp_path, SIMULATES)
    k2, level = scenario.effects
    assert (k2.address, k2.values) == ("acc_K2[accel]", {"k2_x": pytest.approx(120e-6)})
    assert k2.parameters[0].unit == "ug_g2"
    assert (level.role, level.values["tilt_east"]) == ("concealed", pytest.approx(7 * ARCSEC))
    recording = SimulatedLaboratory().record(scenario)
    assert recording.column_names[:3] == ["table_outer_deg", "table_inner_deg", "accel_x_m_s2"]


def test_a_parameter_may_be_written_in_any_unit_of_its_kind():
    setup = setup_of("placing", Sensor(name="accel", kind="accelerometer"))
    assert effect_of("acc_bias", setup, bias_x_mg=2).values == {"bias_x": pytest.approx(2e-3 * G0)}
    assert effect_of("table_levelling", setup, tilt_east_deg=1).values == {
        "tilt_east": pytest.approx(DEG)
    }


# ------------------------------------------------------------------------------------------- what
# it refuses


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (("[rig]", "[rigs]"), r"rigs: unknown key; did you mean 'rig'\?"),
        (
            ("gravity_m_s2 =", "gravity ="),
            r"site\.gravity: unknown key; did you mean 'gravity_m_s2'\?",
        ),
        (("gravity_m_s2 =", "gravity ="), r"site\.gravity_m_s2: missing; add it"),
        (("readout =", "read_out ="), r"rig\.read_out: unknown key; did you mean 'readout'\?"),
        (("rate_hz =", "rate ="), r"sensor\.1\.rate: unknown key; did you mean 'rate_hz'\?"),
        (("schema = 1", "schema = 2"), r"schema: found 2; Input should be 1"),
        (("schema = 1\n", ""), r"schema: missing; add it"),
        (("9.80123", "-9.8"), r"site\.gravity_m_s2: found -9\.8; Input should be greater than 0"),
        (
            ("39.9", "99.9"),
            r"site\.latitude_deg: found 99\.9; Input should be less than or equal to 90",
        ),
        (
            ('"dual" ', '"duel" '),
            r"rig\.table: found 'duel'; Input should be 'vertical', 'placing', 'dual'",
        ),
        (('"identity"', '"Rz[3]"'), r"rig\.mount: found 'Rz\[3\]'; mount 'Rz\[3\]'"),
        (('"accel" ', '"table" '), r"sensor\.1.*the sensor name 'table' is reserved"),
        (('"accel" ', '"my accel" '), r"sensor\.1\.name: found 'my accel'; String should match"),
        (
            ('"accelerometer"', '"inclinometer"'),
            r"axes of a inclinometer are among x, y, each once",
        ),
        (
            ('["x", "y", "z"]', '["x", "x"]'),
            r"axes of a accelerometer are among x, y, z, each once",
        ),
        (
            ('"accelerometer"\naxes = ["x", "y", "z"]', '"fog"\naxes = ["a"]'),
            r"a fog needs input_axis = \[ux, uy, uz\]",
        ),
        (
            ("rate_hz = 50.0", 'rate_hz = 50.0\nunit = "deg"'),
            r"unit 'deg' is not a unit of acceleration",
        ),
        (
            ('["bias", "scale"', '["biass", "scale"'),
            r"sensor accel: adjustable 'biass' is neither a calibration term nor an effect; did you mean 'bias'\?",
        ),
        (
            ("rate_hz = 50.0", 'rate_hz = 50.0\ninput = {unit = "LSB"}'),
            r"sensor\.1\.input: give exactly one of per_m_s2, per_g",
        ),
        (
            ("rate_hz = 50.0", 'rate_hz = 50.0\ninput = {unit = "LSB", per_g = 1, per_deg = 1}'),
            r"give exactly one of",
        ),
        (
            ("rate_hz = 50.0", 'rate_hz = 50.0\ninput = {unit = "LSB", per_g = 0.0}'),
            r"sensor\.1\.input.*per_g",
        ),
        (
            ("rate_hz = 50.0", 'rate_hz = 50.0\ninput = {unit = "LSB", zro = 1, per_g = 1}'),
            r"sensor\.1\.input\.zro: unknown key; did you mean 'zero'\?",
        ),
    ],
)
def test_a_wrong_key_or_value_is_named_with_its_path_and_the_nearest_valid_one(
    edit, message, tmp_path
):
    assert edit[0] in MINIMAL
    assert re.search(message, refusal(tmp_path, MINIMAL.replace(*edit)))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("[[sensor]]\nname = 'accel'\nkind = 'gyro'", r"two sensors are named 'accel'"),
        ("[climate]\nstart = 20", r"climate\.start: unknown key; did you mean 'start_degC'\?"),
        (
            "[dynamics]\ntimestep_s = 1",
            r"dynamics\.timestep_s: found 1; Input should be less than or equal to",
        ),
        ("[[method]]\noptions = {}", r"method\.1: give either name or command"),
        ("[[method]]\nname = 'norm'\ncommand = ['a']", r"method\.1: give either name or command"),
        (
            "[[method]]\nname = 'norm'\naccept = {tilt = 1}",
            r"method\.1\.accept\.tilt: unknown key; did you mean 'tilt_arcsec'\?",
        ),
        ("[[sequence]]\naction = 'turn'", r"sequence\.1: action turn needs axis, angle_deg"),
        (
            "[[sequence]]\naction = 'rest'\ndwell = 1",
            r"sequence\.1\.dwell: unknown key; did you mean 'dwell_s'\?",
        ),
        (
            "[[sequence]]\naction = 'move'\nmiddle_deg = 1",
            r"sequence step 1 \(move\): found axis middle, need an axis of this table: outer, inner",
        ),
        ("[[sequence]]\naction = 'remount'\nmount = 'Rz'\ndwell_s = 1", r"mount 'Rz'"),
        (
            "[[effect]]\nid = 'acc_k2'\nk2_x_ug_g2 = 1",
            r"effect 1: found unknown effect 'acc_k2', need an id of `tiltcal effects`; did you mean 'acc_K2'\?",
        ),
        ("[[effect]]\nsensor = 'accel'", r"effect\.1\.id: missing; add it"),
        (
            "[[effect]]\nid = 'acc_K2'\nk2_ug_g2 = 1",
            r"effect 1 acc_K2: found unknown key 'k2_ug_g2', need a parameter with its unit; did you mean 'k2_[xyz]_ug_g2'\?",
        ),
        (
            "[[effect]]\nid = 'acc_K2'\nk2_x_arcsec = 1",
            r"effect 1 acc_K2, key k2_x_arcsec: found unit arcsec, need a unit like ug_g2; convert the value",
        ),
        (
            "[[effect]]\nid = 'acc_K2'\nk2_x_ug_g2 = '1'",
            r"effect 1 acc_K2, key k2_x_ug_g2: found '1', need a number; write it without quotes",
        ),
        ("[[effect]]\nid = 'acc_K2'\nk2_x_ug_g2 = true", r"found True, need a number"),
        ("[[effect]]\nid = 'acc_K2'\nk2_x_ug_g2 = nan", r"found nan, need a number"),
        ("[[effect]]\nid = 'acc_K2'\nk2_x_ug_g2 = inf", r"found inf, need a number"),
        (
            "[[effect]]\nid = 'table_backlash'\nwidth_arcsec = -1",
            r"key width_arcsec: found -1, need a value >= 0; correct its sign",
        ),
        (
            "[[effect]]\nid = 'data_sign'\nflip_x_unitless = 0.7",
            r"key flip_x_unitless: found 0.7, need 0 or 1; write 1 where it applies",
        ),
        ("[[effect]]\nid = 'acc_warmup'\nwarmup_x_ug = 9\ntau_s = 0", r"key tau_s"),
        (
            "[[effect]]\nid = 'acc_K2'\nsensor = 'acel'\nk2_x_ug_g2 = 1",
            r"sensor 'acel': found no such sensor, need one of accel",
        ),
        (
            "[[effect]]\nid = 'gyr_bias'\nsensor = 'accel'",
            r"found sensor 'accel' of kind accelerometer, need gyro; choose another",
        ),
        (
            "[[effect]]\nid = 'gyr_bias'\nbias_x_deg_s = 1",
            r"found no sensor named, 0 that fit, need sensor = one of none in this scenario",
        ),
        (
            "[[sensor]]\nname = 'b'\nkind = 'accelerometer'\n[[effect]]\nid = 'acc_K2'",
            r"found no sensor named, 2 that fit, need sensor = one of accel, b; add it",
        ),
        (
            "[[effect]]\nid = 'table_sag'\nsensor = 'accel'",
            r"found sensor, need no sensor: it acts on the rig; remove that key",
        ),
        (
            "[[effect]]\nid = 'table_backlash'\naxis = 'middle'",
            r"found axis 'middle', need an axis of this table: outer, inner",
        ),
        (
            "[[effect]]\nid = 'table_levelling'\naxis = 'outer'",
            r"found axis, need no axis: it acts on the whole; remove that key",
        ),
        (
            "[[effect]]\nid = 'acc_K2'\nrole = 'lost'",
            r"effect\.1\.role: found 'lost'; Input should be 'calibration', 'found'",
        ),
        ("[[effect]]\nid = 'acc_K2'\nfit = 'maybe'", r"effect\.1\.fit: found 'maybe'"),
    ],
)
def test_a_wrong_table_is_refused_in_words(more, message, tmp_path):
    assert re.search(message, refusal(tmp_path, MINIMAL + more))


@pytest.mark.parametrize(
    "id", [id for id, cls in CATALOGUE.items() if cls.stage in ("environment", "table", "mount")]
)
def test_an_effect_that_the_hand_held_rig_cannot_have_is_refused_or_runs(id, tmp_path):
    """No traceback from the laboratory: what cannot act is refused when the scenario is read."""
    from tiltsim.laboratory import MujocoLaboratory

    key = next(f"{p.name}_{p.unit}" for p in CATALOGUE[id].parameters)
    text = (
        MINIMAL.replace('"dual" ', '"handheld" ')
        + f"[[effect]]\nid = '{id}'\n{key} = 1\n[[sequence]]\naction = 'rest'\ndwell_s = 1\n"
    )
    try:
        scenario = load(tmp_path, text)
    except TiltcalError:
        return
    assert len(MujocoLaboratory().record(scenario, seed=1)) > 0


def test_all_errors_come_at_once(tmp_path):
    message = refusal(
        tmp_path,
        MINIMAL.replace("readout", "readut").replace("9.80123", "-1") + "[[effect]]\nid = 3\n",
    )
    assert "found 3 errors:" in message
    for part in ("rig.readut", "site.gravity_m_s2", "effect.1.id"):
        assert part in message
    message = refusal(
        tmp_path,
        MINIMAL
        + "[[effect]]\nid='a'\n[[effect]]\nid='b'\n[[sequence]]\naction='move'\nmiddle_deg=1\n",
    )
    assert "found 3 errors:" in message


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"schema = \n", r"scenario s\.toml: found .*line 1.*need valid TOML"),
        (b"name = '\xff'", r"found bytes that are no text, need TOML in UTF-8"),
    ],
)
def test_a_file_that_is_no_toml_is_refused(content, message, tmp_path):
    (tmp_path / "s.toml").write_bytes(content)
    with pytest.raises(TiltcalError, match=message):
        load_scenario(tmp_path / "s.toml")


def test_asking_for_what_is_not_there_is_refused(tmp_path):
    scenario = load(tmp_path, MINIMAL)
    with pytest.raises(
        TiltcalError, match="sensor 'gyro': found no such sensor, need one of accel"
    ):
        scenario.named("gyro")
    with pytest.raises(TiltcalError, match="sequence: found no steps"):
        _ = scenario.schedule
    with pytest.raises(ValueError, match="sensor accel has no input axis"):
        _ = scenario.named("accel").input_vector
    with pytest.raises(TiltcalError, match="found no sensors, need at least one"):
        SimulatedLaboratory().record(
            parse_scenario({"schema": 1, "site": {"gravity_m_s2": 9.8}, "rig": {"table": "dual"}})
        )
    with pytest.raises(TiltcalError, match=r"found \[dynamics\], need a laboratory with mechanics"):
        SimulatedLaboratory().record(load(tmp_path, SIMULATES + "[dynamics]\n"))


def test_sigmas_of_found_effects_are_kept_and_checked_too():
    setup = setup_of("placing", Sensor(name="accel", kind="accelerometer"))
    found = make_effect("acc_bias", {"bias_x_ug": 5, "sigma_bias_x_ug": 0.5}, setup)
    assert found.sigmas == {"bias_x": pytest.approx(0.5e-6 * G0)}
    with pytest.raises(TiltcalError, match="unknown key 'bias_w_ug'"):
        make_effect("acc_bias", {"sigma_bias_w_ug": 1}, setup)


def test_the_json_schema_describes_the_file():
    schema = json.loads(json.dumps(scenario_schema()))
    assert schema["additionalProperties"] is False
    assert {"schema", "site", "rig", "sensor", "effect", "sequence", "method", "climate"} <= set(
        schema["properties"]
    )
    assert set(schema["required"]) == {"schema", "site", "rig"}
    references = set(re.findall(r'"\$ref": "#/\$defs/(\w+)"', json.dumps(schema)))
    assert references == set(schema["$defs"])
    assert schema["$defs"]["Rig"]["properties"]["table"]["enum"] == [
        "vertical",
        "placing",
        "dual",
        "three",
        "four",
        "handheld",
    ]
    for name, part in schema["$defs"].items():
        assert name in ("EffectTable", "SourceTable") or part["additionalProperties"] is False


def test_counts_of_another_quantity_are_refused():
    text = MINIMAL + 'input = {unit = "LSB", per_deg = 100}\n'
    with pytest.raises(
        TiltcalError, match=r"states counts per angle, need per acceleration: per_m"
    ):
        parse_scenario(tomllib.loads(text), "x.toml")


def test_a_number_that_counts_from_zero_may_be_zero_and_one_that_divides_not():
    """The first stop has the number 0."""
    label = "[[effect]]\nid = 'data_pose_label'\naxis = 'outer'\nerror_arcsec = 3600.0\nstop = 0\n"
    (effect,) = parse_scenario(tomllib.loads(MINIMAL + label)).effects
    assert effect.value("stop") == 0
    warming = "[[effect]]\nid = 'acc_warmup'\nwarmup_x_ug = 5\ntau_s = 0\n"
    with pytest.raises(TiltcalError, match="need a value > 0"):
        parse_scenario(tomllib.loads(MINIMAL + warming))
