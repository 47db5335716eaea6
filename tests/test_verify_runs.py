"""`verify` over many runs: a row a run, files, worker processes, units, and methods that cheat."""

import json
import pickle
import sys

import numpy as np
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
import pytest
from scenario_files import EFFECTS, HEAD, SEQUENCE

from tiltcal.calibration.parameter_units import in_our_units
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0
from tiltcal.laboratory.scenario import parse_scenario

MODULE = '''
"""Methods that look at nothing but the number of the run."""
import os

import numpy as np

from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.calibration.validity import Test
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0

TRUTH = {f"accel.bias_{a}": b * 1e-6 * G0 for a, b in zip("xyz", (3000, -1500, 0))}
TRUTH |= {f"accel.scale_{a}": s for a, s in zip("xyz", (0, 0, 1200e-6))}
TRUTH |= {f"accel.cross_{a}{b}": 0.0 for a in "xyz" for b in "xyz" if a != b}
PASSED = [Test("none", 0.0, 0, 1.0, True, "")]


def fake(
    recording, setup, *, seed=-1, size=1.0, mean="", drop="", unit="m_s2", tests=1, fails=-1,
    dies=-1,
):
    run = int(recording.metadata["seed"])
    if run == fails:
        raise ValueError("no light")
    if run == dies:
        os._exit(3)
    draw = np.random.default_rng(run)
    estimates = {}
    for name, true in TRUTH.items():
        sigma, own = (3e-5, unit) if "bias" in name else (4e-6, "1")
        error = draw.normal() * (size if run == seed or seed < 0 else 1.0)
        error += 2.0 if name == mean else 0.0
        if name != drop:
            factor = {"ug": 1e6 / G0, "mg": 1e3 / G0}.get(own, 1.0)
            estimates[name] = Estimate((true + sigma * error) * factor, sigma * factor, own)
    C = np.diag([e.sigma**2 for e in estimates.values()])
    return Calibration("fake", "good", estimates, C, tests=PASSED * tests)
'''
ROW = ["scenario", "method", "seed", "verdict", "nees", "nees_dof", "tilt_before_arcsec"]


@pytest.fixture
def module(here, monkeypatch):
    """A module of the user's, in the folder they stand in."""
    (here / "lab.py").write_text(MODULE)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield here
    sys.modules.pop("lab", None)


# the methods look at no reading
SMALL = (HEAD + EFFECTS + SEQUENCE).replace("rate_hz = 50", "rate_hz = 5")


def verified(folder, capsys, options, accept, *words, status=0):
    """The one method of a claim with twenty runs, judged by `verify`."""
    text = f"[[method]]\nname = 'lab:fake'\nruns = 20\noptions = {{ {options} }}\n"
    text = SMALL + text + f"[method.accept]\n{accept}\n"
    (folder / "claim.toml").write_text(text)
    capsys.readouterr()
    assert main(["verify", "claim.toml", "--json", *words]) == status
    return json.loads(capsys.readouterr().out)["scenarios"][0]["methods"][0]


def names(method):
    """Limits that are not kept."""
    return [limit["name"] for limit in method["limits"] if not limit["passed"]]


def test_all_runs_are_shown_and_written(module, capsys):
    found = verified(module, capsys, "", "better_by = 20", "-o", "out")
    assert (found["accepted"], found["runs"], found["verdicts"]) == (True, 20, "good")
    table = pq.read_table("out/runs.parquet")
    assert table.column_names[:7] == ROW
    assert table["seed"].to_pylist() == list(range(5, 25))
    for words in ("", "sigma_", "truth_"):
        assert f"accel.bias_x_{words}m_s2" in table.column_names
        assert f"accel.scale_z_{words}unitless" in table.column_names
    again = pacsv.read_csv("out/runs.csv")
    assert again.column_names == table.column_names
    np.testing.assert_array_equal(again["accel.bias_x_m_s2"], table["accel.bias_x_m_s2"])
    assert [r["seed"] for r in found["rows"]] == list(range(5, 25))
    assert table["accel.bias_x_truth_m_s2"][0].as_py() == pytest.approx(3000e-6 * G0)
    assert main(["verify", "claim.toml"]) == 0
    said = capsys.readouterr().out.splitlines()
    rows = [line.split() for line in said if line.split()[1:2] == ["good"]]
    assert [int(row[0]) for row in rows] == list(range(5, 25))


def test_json_has_statistics_with_intervals(module, capsys):
    found = verified(module, capsys, "", "better_by = 20\nquantile = 0.8")
    after = np.array([r["tilt_after_arcsec"] for r in found["rows"]])
    statistics = found["statistics"]
    tilt = statistics["tilt_arcsec"]
    assert tilt["after_rms"] == pytest.approx(np.sqrt(np.mean(after**2)))
    assert found["tilt_arcsec"]["after"] == pytest.approx(tilt["after_rms"])
    assert tilt["after_quantile"] == pytest.approx(np.quantile(after, 0.8))
    for name, value in (("after_rms", "after_rms"), ("after_quantile", "after_quantile")):
        low, high = tilt[f"{name}_interval_95"]
        assert low < tilt[value] < high
    low, high = statistics["nees_per_dof"]["interval_95"]
    assert low < statistics["nees_per_dof"]["value"] < high
    x = statistics["parameters"]["accel.bias_x"]
    assert (x["unit"], x["runs"]) == ("m_s2", 20)
    assert x["mean_error_interval_95"][0] < x["mean_error"] < x["mean_error_interval_95"][1]
    interval = next(n["interval"] for n in found["limits"] if "before over after" in n["name"])
    assert interval[0] < interval[1]


def test_any_number_of_processes_gives_the_same_rows(module, capsys):
    verified(module, capsys, "", "better_by = 20", "-o", "one")
    verified(module, capsys, "", "better_by = 20", "-o", "two", "-j", "2")
    one, two = (pq.read_table(f"{f}/runs.parquet").drop(["seconds"]) for f in ("one", "two"))
    assert one.equals(two)
    assert main(["verify", "claim.toml", "-j", "0"]) == 2
    assert "option -j: found 0, need 1 or more" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "limit", "where"),
    [
        ("seed = 17, size = 6", "NEES per degree of freedom, worst run", "seed 17"),
        ("mean = 'accel.cross_yz'", "mean error over its sigma, worst parameter", "accel.cross_yz"),
        ("size = 1.6", "NEES per degree of freedom", ""),
        ("drop = 'accel.scale_y'", "required parameters that are missing", "accel.scale_y"),
    ],
)
def test_a_method_that_is_wrong_somewhere_is_rejected(options, limit, where, module, capsys):
    found = verified(module, capsys, options, "better_by = 20", status=1)
    wrong = {n["name"].removeprefix("parameters, "): n for n in found["limits"] if not n["passed"]}
    assert wrong[limit]["where"] == where
    assert main(["verify", "claim.toml"]) == 1
    assert where in capsys.readouterr().out


def test_one_seed_beyond_the_tilt_limit_is_rejected_and_not_the_first(module, capsys):
    accept = "parameters = false\ntilt_arcsec = 2"
    assert verified(module, capsys, "", accept)["accepted"]
    found = verified(module, capsys, "seed = 17, size = 9", accept, status=1)
    assert "tilt error, arcsec, worst run" in names(found)
    assert found["rows"][0]["tilt_after_arcsec"] < 2


def test_one_failed_run_is_named_and_the_others_are_kept(module, capsys):
    found = verified(module, capsys, "fails = 9", "", "-o", "out", status=1)
    assert "no light" in found["error"]
    assert "1 of 20 runs, first seed 9" in found["error"]
    assert found["statistics"]["failed"] == 1
    table = pq.read_table("out/runs.parquet")
    assert table["verdict"].to_pylist() == ["good"] * 4 + ["error"] + ["good"] * 15
    assert table["accel.bias_x_m_s2"].null_count == 1


def test_a_worker_that_ends_is_one_message(module, capsys):
    text = SMALL + "[[method]]\nname = 'lab:fake'\nruns = 4\n"
    (module / "claim.toml").write_text(text + "options = { dies = 7 }\n")
    assert main(["verify", "claim.toml", "-j", "2", "-o", "out"]) == 2
    assert "run 3: found no result: its process ended by exit status 3" in capsys.readouterr().err
    assert not (module / "out").exists()


def test_a_verdict_without_a_test_is_shown_as_such(module, capsys):
    found = verified(module, capsys, "tests = 0", "")
    assert (found["accepted"], found["verdict"], found["verdicts"]) == (True, "good", "untested")
    assert {r["verdict"] for r in found["rows"]} == {"untested"}
    assert main(["verify", "claim.toml"]) == 0
    assert "untested" in capsys.readouterr().out


# --------------------------------------------------------------------------------------------------
# ------ units


@pytest.mark.parametrize("unit", ["m_s2", "ug", "mg", ""])
def test_a_unit_of_the_same_dimension_is_converted(unit, module, capsys):
    found = verified(module, capsys, f"unit = '{unit}'", "better_by = 20")
    assert found["parameters"]["accel.bias_x"]["unit"] == "m_s2"
    assert found["parameters"]["accel.bias_x"]["value"] == pytest.approx(0.0294, abs=2e-4)


@pytest.mark.parametrize("unit", ["arcsec", "furlong"])
def test_a_unit_of_another_dimension_is_refused(unit, module, capsys):
    error = verified(module, capsys, f"unit = '{unit}'", "", status=1)["error"]
    assert f"accel.bias_x: found the unit '{unit}', need one of m_s2, g, mg, ug;" in error
    assert "return it in m_s2" in error
    main(["simulate", "claim.toml", "-o", "run.csv"])
    words = ["run.csv", "--scenario", "claim.toml", "--method", "lab:fake"]
    assert main(["calibrate", *words, "--option", f"unit={unit}"]) == 2
    assert f"found the unit '{unit}'" in capsys.readouterr().err


def test_values_sigmas_and_covariance_are_converted_together():
    setup = parse_scenario({"schema": 1, "site": {"gravity_m_s2": 9.8, "latitude_deg": 40}} | BENCH)
    estimates = {
        "accel.bias_x": Estimate(3.0, 1.0, "mg"),
        "accel.scale_x": Estimate(1200.0, 5.0, "ppm"),
        "gyro.bias_x": Estimate(36.0, 3.6, "deg_h"),
        "base.roll": Estimate(10.0, 1.0, "arcsec"),
        "accel.mine": Estimate(7.0, 1.0, "furlong"),
    }
    C = np.diag([e.sigma**2 for e in estimates.values()])
    C[0, 1] = C[1, 0] = 0.5
    found = in_our_units(Calibration("own", "good", estimates, C), setup)
    units = {n: e.unit for n, e in found.parameters.items()}
    assert list(units.values()) == ["m_s2", "1", "rad_s", "rad", "furlong"]
    assert found.value("accel.bias_x") == pytest.approx(3e-3 * G0)
    assert found.value("gyro.bias_x") == pytest.approx(np.radians(0.01))
    sigmas = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(sigmas, [e.sigma for e in found.parameters.values()])
    assert found.covariance[0, 1] == pytest.approx(0.5 * 1e-3 * G0 * 1e-6)
    assert found.value("accel.mine") == 7.0


BENCH = {
    "rig": {"table": "dual"},
    "sensor": [
        {"name": "accel", "kind": "accelerometer", "rate_hz": 50},
        {"name": "gyro", "kind": "gyro", "rate_hz": 50},
    ],
}


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_no_number_is_refused(value):
    setup = parse_scenario({"schema": 1, "site": {"gravity_m_s2": 9.8, "latitude_deg": 40}} | BENCH)
    for estimate in (Estimate(value, 1.0, "1"), Estimate(0.0, value, "1")):
        wrong = Calibration("own", "good", {"accel.scale_x": estimate}, np.eye(1))
        with pytest.raises(TiltcalError, match=r"accel\.scale_x: found the value"):
            in_our_units(wrong, setup)


def test_an_error_of_another_process_arrives_whole():
    error = TiltcalError("a", found="b", need="c", do="d")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.found) == (str(error), "b")
