"""What is published works where nobody has a checkout."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from tiltcal import __version__
from tiltcal.cli.commands import COMMANDS

ROOT = Path(__file__).resolve().parent.parent
PARTS = (
    "tiltcal/cli/__init__.py",
    "tiltsim/laboratory.py",
    "tiltcal/scenarios/two_position_level.toml",
    "tiltcal/scenarios/real/mpu9150_map.toml",
    "tiltcal/recordings/datasets.toml",
    "tiltcal/report/templates/verification.html.jinja",
    "tiltcal/report/templates/certificate.html.jinja",
)


def run(*words, cwd, status=0, **environment):
    done = subprocess.run(
        list(map(str, words)),
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stderr if status else done.stdout


def built(source, out, *kinds):
    run(sys.executable, "-m", "build", "--no-isolation", *kinds, "--outdir", out, source, cwd=out)
    return {p.suffix: p for p in out.iterdir() if p.suffix in (".whl", ".gz")}


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """The wheel and the source distribution, built from what git would publish: no build product
    lies around.
    """
    out = tmp_path_factory.mktemp("dist")
    return built(ROOT, out, "--wheel", "--sdist")


@pytest.fixture(scope="module")
def installed(published, tmp_path_factory):
    """The wheel in a folder of its own."""
    target = tmp_path_factory.mktemp("target")
    run(
        sys.executable,
        "-m",
        "pip",
        "install",
        "--no-deps",
        "--no-index",
        "--target",
        target,
        published[".whl"],
        cwd=target,
    )
    return target


def test_the_wheel_holds_the_laboratory_its_models_and_the_scenarios(published):
    wheel = zipfile.ZipFile(published[".whl"])
    names = wheel.namelist()
    stated = wheel.read(f"tiltcal-{__version__}.dist-info/METADATA").decode()
    assert f"\nVersion: {__version__}\n" in stated
    for part in PARTS:
        assert part in names
    for folder, ending in (("models", ".xml"), ("scenarios", ".toml")):
        ours = {f"tiltcal/{folder}/{p.name}" for p in (ROOT / folder).glob(f"*{ending}")}
        assert ours
        assert ours <= set(names)
    sources = {str(p.relative_to(ROOT)) for p in (ROOT / "tiltcal").rglob("*.py")}
    sources |= {str(p.relative_to(ROOT / "sim")) for p in (ROOT / "sim").rglob("*.py")}
    assert sources <= set(names)
    assert not any(name.startswith(("tests/", "sim/", "docs/")) for name in names)


@pytest.fixture
def far(installed, tmp_path):
    """Python far from the checkout, where the packages are those of the wheel."""
    path = os.pathsep.join([str(installed), sysconfig.get_paths()["purelib"]])

    def python(*words, status=0):
        words = (sys.executable, "-P", *words)
        return run(*words, cwd=tmp_path, status=status, PYTHONPATH=path, COLUMNS="160")

    code = "import tiltcal, tiltsim; print(tiltcal.__file__, tiltsim.__file__, sep='\\n')"
    where = python("-c", code).split()
    assert all(Path(file).is_relative_to(installed) for file in where), where
    return python


def test_the_installed_wheel_verifies_its_own_scenarios(far, installed, tmp_path):
    claims = tmp_path / "claims"
    claims.mkdir()
    for name in ("two_position_level", "six_faces_hidden_K2"):
        shutil.copy(installed / "tiltcal" / "scenarios" / f"{name}.toml", claims)
    assert "2 of 2 scenarios accepted" in far("-m", "tiltcal", "verify", claims, "-o", "out")
    assert (tmp_path / "out" / "report.html").stat().st_size > 1e6


def test_the_installed_wheel_runs_the_demo(far, installed, tmp_path):
    said = far(installed / "bin" / "tiltcal", "demo", "--seed", "5", "-o", "out")
    assert "6 of 6 scenarios accepted" in said
    assert (tmp_path / "out" / "diagnosis" / "report.html").exists()


def test_every_command_of_the_installed_wheel_has_its_help(far):
    code = """
from tiltcal.cli import main
from tiltcal import __version__
from tiltcal.cli.commands import COMMANDS
for name in COMMANDS:
    assert main([name, "--help"]) == 0, name
"""
    said = far("-c", code)
    assert all(f"tiltcal {name}" in said for name in COMMANDS)


def test_what_needs_the_source_says_so(far):
    said = far("-m", "tiltcal", "prove", status=2)
    assert said.startswith("tiltcal: blind trials: found an installation without them, need")
    assert said.count("\n") == 1
    assert "--trials CHECKOUT/tests" in said


def test_the_source_distribution_builds_the_same_wheel(published, tmp_path):
    with tarfile.open(published[".gz"]) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    (tmp_path / "out").mkdir()
    again = built(source, tmp_path / "out", "--wheel")[".whl"]
    assert sorted(zipfile.ZipFile(again).namelist()) == sorted(
        zipfile.ZipFile(published[".whl"]).namelist()
    )
    names = {p.name for p in source.iterdir()}
    assert {"Makefile", "requirements.lock", "LICENSE", "README.md", "CHANGELOG.md"} <= names
