"""A package of somebody else brings an effect, a table and a method: each is as good as ours."""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from extension_files import CONCEALED, FACES, HEAD, tumble

from tiltcal.core.errors import TiltcalError
from tiltcal.effects.base import FrameEffect
from tiltcal.effects.catalogue import Catalogue
from tiltcal.effects.table.readout import TableSag
from tiltcal.setup.tables import DUAL, Table, tables
from tiltsim.rig import open_model

PACKAGE = Path(__file__).with_name("extension_package")
BOTH_FACES = """
import numpy as np
from tiltcal.effects import make_effect
from tiltcal.forward.kinematics import closed_form
from tiltcal.laboratory.scenario import load_scenario
from tiltsim.motion import mujoco_motion
scenario = load_scenario("known.toml")
drive = scenario.schedule.drive(np.linspace(*scenario.schedule.times, 400))
words = [("table_wobble_third", "roll", {"cos_arcsec": 40, "sin_arcsec": -25}),
         ("table_encoder_zero", None, {"azimuth_zero_arcsec": 50, "spin_zero_arcsec": 90}),
         ("axis_nonorthogonality", None, {"roll_spin_arcsec": 70, "elevation_roll_arcsec": -40})]
effects = [make_effect(id, values, scenario, axis=axis) for id, axis, values in words]
for some in ((), *[(e,) for e in effects], effects):
    algebra, mechanics = closed_form(scenario, drive, some), mujoco_motion(scenario, drive, some)
    assert np.abs(algebra.force - mechanics.force).max() < 1e-12
    assert np.abs(algebra.rate - mechanics.rate).max() < 1e-12
    print(np.abs(algebra.force).sum())
"""

ADJUSTED = """
from tiltcal.core.units import ARCSEC
from tiltcal.diagnosis.data_faults.prepare import prepare
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
found = prepare(load_scenario("free.toml"), [read_recording("run.csv")]).start.nuisance
for term in found:
    if term.effect.id == "table_wobble_third":
        print(term.effect.axis, *(term.effect.value(n) / ARCSEC for n in ("cos", "sin")))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The package, installed into a folder of its own, without a network."""
    target = tmp_path_factory.mktemp("installed")
    source = tmp_path_factory.mktemp("source") / "package"
    shutil.copytree(PACKAGE, source)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    command = [*pip, "--no-build-isolation", "--target", str(target), str(source)]
    subprocess.run(command, check=True, capture_output=True, cwd=target)
    return target


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with scenarios of its table."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "known.toml").write_text(HEAD + tumble())
    (folder / "truth.toml").write_text(HEAD + CONCEALED + tumble())
    (folder / "faces.toml").write_text(HEAD + FACES)
    return folder


@pytest.fixture(scope="module")
def run(installed, lab):
    """Runs Python in that folder, with the package installed."""

    def run(*words):
        done = subprocess.run(
            [sys.executable, *words],
            cwd=lab,
            env=os.environ | {"PYTHONPATH": str(installed)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
        return done.stdout

    return run


@pytest.fixture(scope="module")
def tiltcal(run):
    """The command, with the package installed."""
    return lambda *words: run("-m", "tiltcal", *words)


def test_its_effect_and_its_method_are_listed(tiltcal):
    assert "table_wobble_third" in [e["id"] for e in json.loads(tiltcal("effects", "--json"))]
    assert "opposite_faces" in [m["method"] for m in json.loads(tiltcal("methods", "--json"))]
    explained = tiltcal("effects", "table_wobble_third")
    assert "three-lobed tilt of the rotation axis" in explained
    assert "similar:" in explained
    assert "azimuth_zero_arcsec" in tiltcal("effects", "table_encoder_zero")


@pytest.fixture(scope="module")
def recording(tiltcal):
    """A recording with its effect."""
    tiltcal("simulate", "truth.toml", "-o", "run.csv")
    return "run.csv"


def test_its_effect_on_its_table_is_injected_diagnosed_and_simulated_again(tiltcal, recording):
    found = json.loads(tiltcal("diagnose", recording, "--scenario", "known.toml", "--json"))
    (finding,) = found["findings"]
    assert (found["verdict"], finding["effect"]) == ("explained", "table_wobble_third")
    assert finding["where"]["coordinate"] == "table_roll"
    for name, true in (("cos_arcsec", 40.0), ("sin_arcsec", -25.0)):
        estimate = finding["parameters"][name]
        assert abs(estimate["value"] - true) < 5 * estimate["sigma"]


@pytest.mark.usefixtures("recording")
def test_its_effect_may_be_adjustable(run, lab):
    """It is fitted with bias and scale before anything is looked for, on each axis it has."""
    free = HEAD.replace('"cross_axis"]', '"cross_axis", "table_wobble_third"]')
    (lab / "free.toml").write_text(free + tumble())
    said = [line.split() for line in run("-c", ADJUSTED).splitlines()]
    fitted = {axis: [float(size) for size in sizes] for axis, *sizes in said}
    assert fitted.pop("roll") == pytest.approx([40.0, -25.0], abs=1.5)
    assert fitted
    assert all(sizes == pytest.approx([0.0, 0.0], abs=1.5) for sizes in fitted.values())


def test_its_method_is_judged_like_ours_as_the_page_on_methods_shows(tiltcal, monkeypatch):
    """The last of the rows is that of `run`, which accepts it."""
    monkeypatch.setenv("COLUMNS", "160")
    tiltcal("simulate", "faces.toml", "-o", "faces.csv")
    words = ["--scenario", "faces.toml", "--method", "opposite_faces"]
    printed = tiltcal("calibrate", "faces.csv", *words) + tiltcal("run", "faces.toml")
    rows = [x for x in printed.splitlines() if re.match(r" (accel|a gimbal)|opposite_faces:", x)]
    page = (Path(__file__).parents[1] / "docs" / "extend_method.md").read_text(encoding="utf-8")
    assert len(rows) == 8
    assert rows[-1].split()[-1] == "accepted"
    assert [row for row in rows if row not in page.splitlines()] == []


def test_mujoco_and_the_closed_form_agree_on_its_table(run):
    sums = run("-c", BOTH_FACES).split()
    assert len(set(sums)) == len(sums) == 5  # each effect does something


def test_help_looks_for_no_package(run):
    code = """if True:
        import sys
        from tiltcal.cli import main
        try:
            main(["--help"])
        except SystemExit:
            pass
        wanted = {"importlib.metadata", "rotary_lab", "tiltcal.effects", "tiltcal.setup"}
        print(wanted & set(sys.modules))
    """
    assert run("-c", code).splitlines()[-1] == "set()"


@pytest.mark.parametrize(
    ("page", "file"),
    [("effect", "wobble.py"), ("table", "gimbal.py"), ("method", "opposite_faces.py")],
)
def test_the_guide_shows_the_code_of_the_package(page, file):
    shown = (PACKAGE.parents[1] / "docs" / f"extend_{page}.md").read_text(encoding="utf-8")
    code = (PACKAGE / "src" / "rotary_lab" / file).read_text(encoding="utf-8")
    assert f"```python\n{code}```" in shown


# --------------------------------------------------------------------------------------------------
# what is refused


class NoStage(FrameEffect):
    id = "no_stage"

    def turns(self, slot, context):
        return ()


class Taken(TableSag):
    pass


def offered(monkeypatch, **named):
    """Entry points of every group that name these things of a module."""
    module = ModuleType("offering")
    vars(module).update(named)
    monkeypatch.setitem(sys.modules, "offering", module)
    points = [EntryPoint(name, f"offering:{name}", "any") for name in named]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: points)
    return module


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (3, r"entry point it = offering:it of tiltcal\.effects: found 3, need an Effect"),
        (FrameEffect, r"found <class .*FrameEffect'>, need an Effect with an id"),
        ([], r"found nothing, need an Effect with an id"),
        (ModuleType("empty"), r"found nothing, need an Effect with an id"),
        (Taken, r"found effect 'table_sag', which exists already, need an id of its own"),
        (NoStage, r"found NoStage without stage, title, parameters, physics"),
    ],
)
def test_what_is_no_effect_is_refused(item, message, monkeypatch):
    offered(monkeypatch, it=item)
    with pytest.raises(TiltcalError, match=message):
        len(Catalogue())


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ("dual", r"of tiltcal\.tables: found 'dual', need a tiltcal\.setup\.tables\.Table"),
        (DUAL, r"found table 'dual', which exists already, need a name of its own"),
        (Table("twice", (("a", "x"), ("a", "z"))), r"found table 'twice' with axes a x, a z"),
        (Table("slanted", (("a", "w"),)), r"found table 'slanted' with axes a w, need"),
    ],
)
def test_what_is_no_table_is_refused(item, message, monkeypatch):
    offered(monkeypatch, it=item)
    with pytest.raises(TiltcalError, match=message):
        tables.__wrapped__()


def test_an_entry_point_that_does_not_import_is_named(monkeypatch):
    points = [EntryPoint("gone", "no_such_package:it", "any")]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: points)
    with pytest.raises(TiltcalError, match=r"entry point gone = no_such_package:it.*No module"):
        tables.__wrapped__()


def test_a_module_and_a_sequence_may_bring_several(monkeypatch):
    one, other = Table("one", (("a", "x"),)), Table("other", (("b", "y"),))
    offered(monkeypatch, both=(one, other))
    assert tables.__wrapped__()["other"] is other
    module = offered(monkeypatch, one=one)
    points = [EntryPoint("all", "offering", "any")]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: points)
    assert tables.__wrapped__()["one"] is module.one


def test_a_table_without_its_mjcf_is_refused(tmp_path):
    with pytest.raises(TiltcalError, match=r"table lost: found .*lost\.xml.*, need its MJCF"):
        open_model(Table("lost", (("outer", "z"),), tmp_path / "lost.xml"))


def test_an_mjcf_without_an_axis_is_refused():
    with pytest.raises(TiltcalError, match="no body spin_bearing, no body spin, no joint spin"):
        open_model(Table("more", (*DUAL.axes, ("spin", "x")), DUAL.mjcf))
    assert np.isfinite(open_model(DUAL).compile().nq)
