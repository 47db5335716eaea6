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


def run(*words, cwd, **environment):
    done = subprocess.run(
        list(map(str, words)),
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


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
    names = zipfile.ZipFile(published[".whl"]).namelist()
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


def test_the_installed_wheel_runs_a_packaged_scenario_far_from_the_checkout(installed, tmp_path):
    path = os.pathsep.join([str(installed), sysconfig.get_paths()["purelib"]])
    code = "import tiltcal, tiltsim; print(tiltcal.__file__, tiltsim.__file__, sep='\\n')"
    where = run(sys.executable, "-P", "-c", code, cwd=tmp_path, PYTHONPATH=path).split()
    assert all(Path(file).is_relative_to(installed) for file in where), where
    scenario = shutil.copy(
        installed / "tiltcal" / "scenarios" / "two_position_level.toml", tmp_path / "claim.toml"
    )
    said = run(
        sys.executable,
        "-P",
        "-m",
        "tiltcal",
        "run",
        scenario,
        "-o",
        "out",
        cwd=tmp_path,
        PYTHONPATH=path,
    )
    assert "1 of 1 scenarios accepted" in said
    assert (tmp_path / "out" / "report.html").stat().st_size > 1e6
    script = installed / "bin" / "tiltcal"
    assert "simulate" in run(sys.executable, "-P", script, "--help", cwd=tmp_path, PYTHONPATH=path)


def test_the_source_distribution_builds_the_same_wheel(published, tmp_path):
    with tarfile.open(published[".gz"]) as archive:
        archive.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    (tmp_path / "out").mkdir()
    again = built(source, tmp_path / "out", "--wheel")[".whl"]
    assert sorted(zipfile.ZipFile(again).namelist()) == sorted(
        zipfile.ZipFile(published[".whl"]).namelist()
    )
    assert {"Makefile", "requirements.lock", "LICENSE", "README.md"} <= {
        p.name for p in source.iterdir()
    }
