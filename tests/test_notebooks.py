"""The worked notebooks run as scripts, and the page of the design explorer follows its settings."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[1] / "docs" / "notebooks"


@pytest.mark.parametrize("name", ["calibration", "diagnosis"])
def test_a_notebook_runs_as_a_script(name, tmp_path):
    text = (NOTEBOOKS / f"{name}.py").read_text()
    assert text.count("\n# %%") > 5
    words = [sys.executable, str(NOTEBOOKS / f"{name}.py")]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def explorer():
    path = NOTEBOOKS / "design_explorer.py"
    spec = importlib.util.spec_from_file_location("design_explorer", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.app


def test_the_explorer_designs_for_its_settings(explorer):
    _, found = explorer.run()
    assert found["refusal"] == ""
    assert found["settings"]["budget_s"] == 120
    assert found["design"].plan.forecast.total_s <= 120
    assert {row["parameter"] for row in found["expected"]} >= {"accel.bias_x", "accel.scale_z"}


def test_the_explorer_says_what_cannot_be_had(explorer):
    settings = {"budget_s": 8.0, "settle_s": 5.0, "criterion": "both"}
    _, found = explorer.run(defs={"settings": settings})
    assert found["design"] is None
    assert "need 10 s for one pose" in found["refusal"]
