"""The names at the top of the package, and that they do what the commands do."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenario_files import BENCH_SCENARIO

import tiltcal as tc
from tiltcal.cli import main

NAMES = {
    "Calibration",
    "Certificate",
    "Check",
    "DesignedSequence",
    "Diagnosis",
    "Estimate",
    "Guide",
    "GuideState",
    "Instrument",
    "Recording",
    "Scenario",
    "Segment",
    "Stated",
    "TiltcalError",
    "combine",
    "compare",
    "correct",
    "find_segments",
    "load_calibration",
    "load_instrument",
    "load_scenario",
    "parse_scenario",
    "read",
    "wrap",
}
README = Path(__file__).parents[1] / "README.md"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    path = tmp_path_factory.mktemp("api") / "bench.toml"
    path.write_text(BENCH_SCENARIO)
    return tc.load_scenario(path)


@pytest.fixture(scope="module")
def recording(bench):
    return bench.simulate(seed=3)


@pytest.fixture(scope="module")
def calibration(bench, recording):
    return bench.calibrate(recording, "six_position")


def test_the_names_at_the_top_are_exactly_these():
    assert set(tc.__all__) == NAMES
    assert set(dir(tc)) >= NAMES
    assert all(callable(getattr(tc, name)) for name in NAMES)
    with pytest.raises(AttributeError, match="no attribute 'reed'"):
        tc.reed  # noqa: B018


def test_type_checkers_see_the_objects_that_are_loaded():
    tree = ast.parse(Path(tc.__file__).read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert set(seen) == NAMES
    for name, module in seen.items():
        assert getattr(tc, name) is getattr(sys.modules[module], name)


def test_importing_the_package_loads_nothing_heavy():
    program = "import sys, tiltcal; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert not loaded & {"numpy", "scipy", "mujoco", "pydantic", "pyarrow", "pandas"}


def test_python_and_the_commands_give_the_same_files(bench, recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(BENCH_SCENARIO)
    assert main(["simulate", "bench.toml", "--seed", "3", "-o", "run.csv"]) == 0
    read = tc.read("run.csv")
    read.save("again.csv")
    recording.save("python.csv")
    text = Path("run.csv").read_text()
    assert Path("again.csv").read_text() == text == Path("python.csv").read_text()
    words = ["--scenario", "bench.toml", "--method", "six_position", "-o", "CAL.json"]
    assert main(["calibrate", "run.csv", *words]) == 0
    bench.calibrate(read, "six_position").save("python.json")
    assert Path("python.json").read_text() == Path("CAL.json").read_text()
    assert main(["correct", "CAL.json", "run.csv", "-o", "corrected.csv"]) == 0
    tc.correct(tc.load_calibration("CAL.json"), read).save("python.csv")
    assert Path("python.csv").read_text() == Path("corrected.csv").read_text()


def mean_of_x(given, setup):
    (sensor,) = setup.sensor
    mean = float(given.sensor(sensor).values[:, 0].mean())
    return tc.Calibration(
        "mine", "good", {"accel.bias_x": tc.Estimate(mean, 0.001, "m_s2")}, np.eye(1) * 1e-6
    )


def test_a_function_is_a_method_too(bench, recording):
    found = bench.calibrate(recording, mean_of_x)
    assert found.value("accel.bias_x") == np.mean(recording.column("accel_x_m_s2"))
    assert "setup" in found.provenance
    with pytest.raises(tc.TiltcalError, match="need a function"):
        bench.calibrate(recording, 3)
    with pytest.raises(tc.TiltcalError, match=r"method six_position.*'term'"):
        bench.calibrate(recording, "six_position", term=9)


def test_dwells_are_given_as_a_file_or_as_a_list(bench, recording, calibration, tmp_path):
    rows = [f"{s.start},{s.end},{s.kind}" for s in tc.find_segments(recording)]
    (tmp_path / "seg.csv").write_text("\n".join(["start_s,end_s,kind", *rows]) + "\n")
    of_file = bench.calibrate(recording, "six_position", segments=tmp_path / "seg.csv")
    of_list = bench.calibrate(recording, "six_position", segments=tc.find_segments(recording))
    assert of_file.parameters == of_list.parameters == calibration.parameters


def test_results_are_tables_for_arrow_pandas_and_notebooks(bench, recording, calibration):
    table = recording.to_arrow()
    assert table.column_names == recording.written_names
    assert len(recording.to_pandas()) == len(recording)
    frame = calibration.to_pandas().set_index("parameter")
    assert frame.loc["accel.bias_x", "value"] == calibration.value("accel.bias_x")
    html = calibration._repr_html_()
    assert "calibration by six_position: good" in html
    assert "first 8 of 12 rows" in html
    check = bench.check(calibration, bench.simulate(seed=4))
    assert check.accepted
    assert len(check.to_arrow()) == len(check.poses)
    assert not bench.check(calibration, bench.simulate(seed=4), limit_arcsec=1e-6).accepted


def test_without_pandas_the_message_says_what_to_install(calibration, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(tc.TiltcalError, match=r'pip install "tiltcal\[pandas\]"'):
        calibration.to_pandas()


def test_names_in_tables_are_escaped_for_html(recording):
    odd = tc.Recording.from_columns(recording.time, {}, source="<script>")
    assert "<script>" not in odd._repr_html_()


def test_several_recordings_are_read_and_calibrated_together(bench, recording, tmp_path):
    recording.save(tmp_path / "a.parquet")
    bench.simulate(seed=8).save(tmp_path / "b.npz")
    two = tc.read(tmp_path / "a.parquet", tmp_path / "b.npz")
    assert len(two) == 2
    assert len(bench.calibrate(two, "six_position").poses) == 12


def test_a_foreign_file_is_read_with_its_mapping(tmp_path):
    (tmp_path / "log.txt").write_text("0,10\n0.1,11\n0.2,12\n")
    words = '[file]\nheader = false\n[time]\ncolumn = 1\nunit = "s"\n'
    words += '[[column]]\nfrom = 2\nto = "accel_x_LSB"\n'
    (tmp_path / "map.toml").write_text(words)
    found = tc.read(tmp_path / "log.txt", mapping=tmp_path / "map.toml")
    assert found.column("accel_x_LSB").tolist() == [10, 11, 12]
    with pytest.raises(tc.TiltcalError, match="bring a foreign format in"):
        tc.read(tmp_path / "log.txt")


def test_a_prediction_replays_the_motion_without_noise(bench, recording):
    clean = bench.simulate(noise=False)
    predicted = bench.predict(recording)
    difference = predicted.column("accel_x_m_s2") - recording.column("accel_x_m_s2")
    assert np.nanstd(difference) < 0.01
    assert clean.column("accel_x_m_s2") == pytest.approx(predicted.column("accel_x_m_s2"), abs=1e-6)
    assert bench.truth()["effects"]


def test_a_design_is_saved_and_simulated(bench, tmp_path):
    design = bench.design(60.0, terms=("bias",), nuisance=())
    assert design.plan.forecast.total_s <= 60.0
    assert len(design.to_arrow()) == design.plan.forecast.poses
    design.save(tmp_path)
    saved = tc.load_scenario(tmp_path / "design.toml")
    assert tc.parse_scenario(design.table()) == saved
    assert len(saved.sequence) == design.plan.forecast.poses
    with pytest.raises(
        tc.TiltcalError, match="axis uter, need an axis of this table: outer, inner"
    ):
        bench.design(60.0, angles_deg={"uter": (-10, 10)})


def test_a_diagnosis_is_saved_without_files_that_nobody_named(bench, recording, tmp_path):
    found = tc.Diagnosis("match", "Nothing differs.", scenario=bench, recordings=(recording,))
    found.save(tmp_path / "out")
    table = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert (table["verdict"], table["recordings"]) == ("match", [])
    assert "recording of bench" in (tmp_path / "out" / "report.html").read_text()
    assert (tmp_path / "out" / "amended.toml").exists()
    assert found.headline() == "match: Nothing differs."
    assert len(found.to_arrow()) == 0


def test_the_certificate_of_the_readme_in_a_dozen_lines(tmp_path, monkeypatch):
    text = README.read_text()
    (program,) = [b.partition("```")[0] for b in text.split("```python\n") if "certify" in b]
    assert len([line for line in program.splitlines() if line.strip()]) <= 12
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").symlink_to(README.parent / "scenarios")
    names: dict = {}
    exec(compile(program, "README.md", "exec"), names)
    certificate = names["certificate"]
    assert (tmp_path / "certificate.html").read_text() == certificate.page()
    assert "<iframe" in certificate._repr_html_()
    assert certificate.budget is not None
    frame = certificate.to_pandas()
    calibration = certificate.calibration
    noise = np.array([2 * e.sigma for e in calibration.parameters.values()])
    assert frame.U.to_numpy() == pytest.approx(noise)  # stated sources are part of the fit
    with pytest.raises(tc.TiltcalError, match=r"one of \.html, \.xml"):
        certificate.save(tmp_path / "certificate.pdf")
