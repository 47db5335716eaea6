"""A scenario from a recording: what the numbers say of table, mounting, units and rate; and a wrong
table or sense that `calibrate` and `diagnose` name.
"""

import io
import sys

import numpy as np
import pytest

import tiltcal as tc
from tiltcal.cli import main
from tiltcal.recordings.rig_fit import suspected_rig

HONEST = {
    "schema": 1,
    "name": "bench",
    "site": {"gravity_m_s2": 9.81, "latitude_deg": 50.0},
    "sensor": [
        {
            "name": "accel",
            "kind": "accelerometer",
            "rate_hz": 20,
            "adjustable": ["bias", "scale", "cross_axis"],
        }
    ],
}
SWEEP = [{"action": "sweep", "outer_deg": 330, "step_deg": 30, "dwell_s": 3}]
SCHEME = [{"action": "scheme", "scheme": "12", "dwell_s": 3}]
NOISE = [{"id": "acc_noise", "white_ug_rthz": 25}, {"id": "acc_bias", "bias_x_ug": 9000}]


def honest(table, mount="identity", **changes):
    return tc.parse_scenario(HONEST | {"rig": {"table": table, "mount": mount}} | changes)


def recorded(table, mount="identity", **changes):
    sequence = SCHEME if table == "dual" else SWEEP
    scenario = honest(table, mount, sequence=sequence, effect=NOISE, **changes)
    recording = scenario.simulate(seed=3)
    recording.metadata.pop("mount", None)
    return recording


def without_labels(recording, **turned):
    """The recording as a logger without an operator writes it, with columns multiplied."""
    factors = {name: turned.get(name, 1) for name in recording.column_names if name != "label"}
    columns = {name: factor * recording.column(name) for name, factor in factors.items()}
    return tc.Recording.from_columns(recording.time, columns)


@pytest.fixture(scope="module")
def dual():
    return recorded("dual")


def written(recording, capsys, *more):
    """What `tiltcal init --from` writes and says."""
    recording.save("run.csv")
    assert main(["init", "--from", "run.csv", "--latitude", "50", "-o", "own.toml", *more]) == 0
    return tc.load_scenario("own.toml"), capsys.readouterr().err


@pytest.mark.parametrize(("table", "mount"), [("placing", "Rz(180)"), ("vertical", "identity")])
@pytest.mark.usefixtures("here")
def test_one_angle_is_placing_or_vertical_by_gravity(table, mount, capsys):
    scenario, said = written(without_labels(recorded(table, mount)), capsys)
    assert (scenario.rig.table, scenario.rig.mount) == (table, mount)
    assert f"table {table}, mount {mount}: gravity follows the table angles within" in said
    assert scenario.named("accel").rate_hz == 20


def test_an_angle_that_counts_the_other_way_is_said(dual, here, capsys):
    _, said = written(without_labels(dual, table_inner_deg=-1), capsys)
    assert "the inner angle counts the other way" in said
    assert "the inner angle counts the other way" in (here / "own.toml").read_text()


@pytest.mark.usefixtures("here")
def test_counts_get_their_zero_and_scale_from_gravity(capsys):
    raw = {"unit": "LSB", "zero": 33000, "per_m_s2": 415}
    sensor = [HONEST["sensor"][0] | {"input": raw}]
    scenario, said = written(without_labels(recorded("dual", sensor=sensor)), capsys)
    found = scenario.named("accel").input
    assert found.per_m_s2 == pytest.approx(415, rel=1e-3)
    np.testing.assert_allclose(found.zero, [33000 + 9000e-6 * 9.80665 * 415, 33000, 33000], atol=1)
    assert "standstill means lie on a sphere" in said
    assert scenario.rig.table == "dual"


@pytest.mark.usefixtures("here")
def test_a_unit_that_gravity_contradicts_is_said(dual, capsys):
    in_g = {f"accel_{a}_g": dual.column(f"accel_{a}_m_s2") for a in "xyz"}
    _, said = written(tc.Recording.from_columns(dual.time, in_g), capsys)
    assert "the file states g, but the norm at rest" in said


@pytest.mark.usefixtures("here")
def test_it_asks_only_on_a_terminal(dual, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    recording = without_labels(dual)
    recording.save("run.csv")
    monkeypatch.setattr(sys, "stdin", Terminal("52\nno table\nthree\n\n"))
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert main(["init", "--from", "run.csv", "-o", "own.toml"]) == 0
    scenario = tc.load_scenario("own.toml")
    assert (scenario.site.latitude_deg, scenario.rig.table) == (52, "three")
    assert sys.stderr.getvalue().count("table (vertical, placing, dual") == 2
    monkeypatch.setattr(sys, "stdin", io.StringIO("1\n"))
    assert main(["init", "--from", "run.csv", "-o", "own.toml"]) == 0
    assert tc.load_scenario("own.toml").site.latitude_deg == 48


@pytest.mark.parametrize(
    ("stated", "mount", "turned", "words"),
    [
        ("vertical", "identity", {}, 'set table = "dual"'),
        ("dual", "Rx(90)", {}, 'set mount = "identity"'),
        ("dual", "identity", {"table_inner_deg": -1}, "change the sign of the inner angle"),
        ("dual", "identity", {"table_outer_deg": -1}, "change the sign of the outer angle; or"),
    ],
)
def test_calibrate_names_a_wrong_table_mounting_or_sense(dual, stated, mount, turned, words):
    recording, scenario = without_labels(dual, **turned), honest(stated, mount)
    calibration = scenario.calibrate(recording, "six_position")
    assert calibration.verdict != "good"
    (warning,) = [w for w in calibration.warnings if w.startswith("gravity does not follow")]
    assert words in warning


@pytest.mark.parametrize("do", ["calibrate", "diagnose"])
def test_a_table_whose_columns_are_missing_is_refused_with_the_one_that_fits(dual, do):
    more = ["six_position"] if do == "calibrate" else []
    with pytest.raises(tc.TiltcalError, match='set table = "dual", which its columns fit'):
        getattr(honest("three"), do)(without_labels(dual), *more)


def test_a_right_table_is_not_suspected(dual):
    assert suspected_rig(dual, honest("dual")) is None
    assert suspected_rig(without_labels(dual), honest("handheld")) is None


def test_diagnose_names_a_wrong_table():
    found = honest("vertical").diagnose(without_labels(recorded("placing")))
    assert found.verdict != "match"
    assert 'it would if you set table = "placing"' in found.statement
