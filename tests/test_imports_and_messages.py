"""The arrows of the house: who may import whom, and every message in three parts."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PRODUCT = sorted((ROOT / "tiltcal").rglob("*.py"))
SIMULATOR = sorted((ROOT / "sim").rglob("*.py"))
BLIND = sorted((ROOT / "tests" / "blind").glob("*.py"))


def name_of(path):
    return str(path.relative_to(ROOT))


def imports(tree):
    """Modules a file imports, those loaded by their name in a string included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module
        elif isinstance(node, ast.Call) and getattr(
            node.func, "attr", getattr(node.func, "id", "")
        ) in (
            "import_module",
            "__import__",
        ):
            yield from (
                a.value
                for a in node.args
                if isinstance(a, ast.Constant) and isinstance(a.value, str)
            )


def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def packages(path):
    return {module.partition(".")[0] for module in imports(tree_of(path))}


@pytest.mark.parametrize("path", PRODUCT, ids=name_of)
def test_the_metrologist_needs_no_simulator(path):
    forbidden = (
        {"mujoco"} if path.name == "cli.py" or "cli" in path.parent.parts else {"mujoco", "tiltsim"}
    )
    assert not packages(path) & forbidden


@pytest.mark.parametrize("path", BLIND, ids=name_of)
def test_blind_trials_have_their_own_physics_and_import_numpy_only(path):
    assert packages(path) <= {"numpy", "blind"} | sys.stdlib_module_names


def test_the_product_never_imports_the_blind_trials():
    assert not any("blind" in packages(path) for path in PRODUCT + SIMULATOR)
    assert len(BLIND) > 10


def test_the_scan_sees_what_the_simulator_imports():
    assert {"mujoco", "tiltcal", "tiltsim"} <= set.union(*map(packages, SIMULATOR))


@pytest.mark.parametrize("path", [p for p in PRODUCT if "effects" in p.parts], ids=name_of)
def test_effects_know_nothing_of_fits_scenarios_or_reports(path):
    later = {
        "fit",
        "calibration",
        "methods",
        "scenario",
        "laboratory",
        "diagnosis",
        "design",
        "verify",
        "report",
        "cli",
        "chain",
        "kinematics",
    }
    assert not {m.split(".")[1] for m in imports(tree_of(path)) if m.startswith("tiltcal.")} & later


def raises(path):
    """Every construction of the users' error in a file."""
    for node in ast.walk(tree_of(path)):
        if (
            isinstance(node, ast.Call)
            and getattr(node.func, "attr", getattr(node.func, "id", "")) == "TiltcalError"
        ):
            yield node


@pytest.mark.parametrize("path", [p for p in PRODUCT + SIMULATOR if any(raises(p))], ids=name_of)
def test_every_message_says_what_was_found_what_is_needed_and_what_to_do(path):
    for call in raises(path):
        where = f"{name_of(path)}:{call.lineno}"
        assert len(call.args) == 1, f"{where}: one subject"
        assert {k.arg for k in call.keywords} == {"found", "need", "do"}, where
        for keyword in call.keywords:
            empty = isinstance(keyword.value, ast.Constant) and not str(keyword.value.value).strip()
            assert not empty, f"{where}: {keyword.arg} is empty"


def test_the_scan_finds_the_messages():
    assert sum(len(list(raises(p))) for p in PRODUCT) > 50


@pytest.mark.parametrize(
    "path", [p for p in PRODUCT + SIMULATOR if "cli" not in p.parts], ids=name_of
)
def test_no_except_catches_everything(path):
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ExceptHandler):
            names = (
                {getattr(n, "id", None) for n in ast.walk(node.type)}
                if node.type
                else {"Exception"}
            )
            # said in words, cause kept; or the outcome of a task, which holds it
            named = any(
                (isinstance(n, ast.Raise) and n.cause is not None)
                or (isinstance(n, ast.Call) and ast.unparse(n) == f"Outcome.raised({node.name})")
                for n in ast.walk(node)
            )
            assert named or not names & {"Exception", "BaseException"}, (
                f"{name_of(path)}:{node.lineno}"
            )
