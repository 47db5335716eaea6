"""The table in motion: solids of the model, the page that plays it, pictures and films."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from tests.scenario_files import refusal
from tiltcal.api.table_scene import stage, table_picture
from tiltcal.cli import main
from tiltcal.core.frames import rotation
from tiltcal.laboratory.scenario import load_scenario, parse_scenario
from tiltcal.report.poses import Pose, drive_of, poses_of
from tiltcal.report.scenes import sphere_plot, table_plot

SMALL = (64, 48)


def drawn():
    """Whether this machine draws without a display."""
    scenario = parse_scenario(of_table("vertical"))
    return isinstance(table_picture(scenario), bytes)


def of_table(table, **more):
    sensor = {"name": "accel", "kind": "accelerometer", "rate_hz": 10.0}
    site = {"gravity_m_s2": 9.81}
    return {
        "schema": 1,
        "name": "t",
        "site": site,
        "rig": {"table": table, **more},
        "sensor": [sensor],
    }


def pose(mount="identity", **angles):
    setup = parse_scenario(of_table("three", mount=mount))
    return Pose(np.array([0.0, 0.0, 1.0]), angles, 0.0, "", setup.rig.mount_rotation)


@pytest.fixture(scope="module")
def pictures():
    if not drawn():
        pytest.skip("no OpenGL without a display: no pictures are drawn")


@pytest.mark.parametrize("table", ["vertical", "placing", "dual", "three", "four"])
def test_every_table_has_solids_for_each_of_its_parts(table):
    setup = parse_scenario(of_table(table))
    scene = stage().scene(setup, drive_of([pose()], setup))
    parts = {solid.part for solid in scene.solids}
    assert parts == {"base", "instrument", *setup.rig.axis_names}
    instrument = [k for k, s in enumerate(scene.solids) if s.part == "instrument"]
    assert np.abs(scene.corners(instrument[0])).max() < 0.1  # at the axes' common point
    for solid in scene.solids:
        corners, faces = solid.corners(), solid.faces()
        # closed: every edge is shared by two triangles
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}
        np.testing.assert_allclose(np.abs(corners).max(axis=0), solid.half, rtol=0.02)


def test_the_solids_turn_as_the_contract_says():
    setup = parse_scenario(of_table("three"))
    poses = [pose(outer=20.0, middle=-35.0, inner=50.0), pose("Rx(90)", outer=90.0)]
    scene = stage().scene(setup, drive_of(poses, setup))
    last = next(k for k, s in enumerate(scene.solids) if s.part == "instrument")
    z, y, x = np.radians([20.0, -35.0, 50.0])
    expected = rotation("z", z) @ rotation("y", y) @ rotation("x", x)
    np.testing.assert_allclose(scene.rotations[0, last], expected, atol=1e-12)
    mounted = rotation("z", np.pi / 2) @ rotation("x", np.pi / 2)
    np.testing.assert_allclose(scene.rotations[1, last], mounted, atol=1e-12)


def test_poses_on_the_sphere_are_where_gravity_points(good):
    from tiltcal.recordings.recording_files import read_recording

    scenario = load_scenario(good / "bench.toml")
    poses = poses_of([read_recording(good / "run.csv")], scenario)
    assert len(poses) == 6
    plot = sphere_plot(poses)
    data = json.loads(plot.to_json())["data"][0]
    down = np.column_stack([data[k] for k in "xyz"])
    np.testing.assert_allclose(down[0], [0, 0, -1], atol=1e-3)
    np.testing.assert_allclose(np.sort(down.sum(axis=1)), [-1, -1, -1, 1, 1, 1], atol=1e-3)
    assert "outer 90" in data["text"][1]
    scene = stage().scene(scenario, drive_of(poses, scenario))
    shown = json.loads(table_plot(scene, [p.angles_and_time for p in poses]).to_json())
    assert len(shown["frames"]) == 6
    assert sphere_plot([]) is None


def test_a_page_of_the_table_in_motion_stands_alone(good, here, capfd):
    words = ["view", str(good / "run.csv"), "--scenario", str(good / "bench.toml")]
    assert main([*words, "--seconds", "2", "-o", "v.html", "--json"]) == 0
    out, _ = capfd.readouterr()
    answer = json.loads(out)  # the library that makes the page prints nothing
    assert answer["written"] == "v.html"
    assert answer["instants"] == 40
    text = (here / "v.html").read_text(encoding="utf-8")
    assert 100_000 < len(text) < 6 * 2**20
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=.?https?:", text)


@pytest.mark.usefixtures("pictures")
def test_a_film_has_its_pictures(good, here):
    av = pytest.importorskip("av", reason="PyAV is not installed")
    assert main(["film", str(good / "bench.toml"), "--seconds", "1", "-o", "f.mp4"]) == 0
    with av.open(str(here / "f.mp4")) as film:
        frames = [f.to_ndarray(format="rgb24") for f in film.decode(video=0)]
    assert 24 <= len(frames) <= 26
    assert frames[0].shape == (480, 640, 3)
    assert np.abs(frames[0].astype(int) - frames[12]).max() > 60  # it moves


@pytest.mark.usefixtures("pictures")
def test_pictures_show_the_table_as_it_stands():
    setup = parse_scenario(of_table("dual"))
    first, second = stage().pictures(setup, drive_of([pose(), pose(outer=40.0)], setup), *SMALL)
    assert len(first) == SMALL[0] * SMALL[1] * 3
    assert first != second
    (again,) = stage().pictures(setup, drive_of([pose()], setup), *SMALL)
    assert first == again


def test_without_opengl_one_error_says_how_to_get_it(good, here, monkeypatch, capsys):
    def missing(*_):
        raise ImportError("libEGL.so.1: cannot open shared object file")

    monkeypatch.setattr("mujoco.egl.GLContext", missing)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    said = refusal(["film", good / "bench.toml", "-o", "f.mp4"], here, capsys)
    assert "found no OpenGL without a display (libEGL.so.1" in said
    assert "apt install libegl1" in said
    assert not (here / "f.mp4").exists()
    words = table_picture(load_scenario(good / "bench.toml"))
    assert isinstance(words, str)
    assert main(["certificate", str(good / "CAL.json"), "-o", "c.html"]) == 0
    page = (here / "c.html").read_text(encoding="utf-8")
    assert page.count("No picture of the table: ") == 1
    assert "apt install libegl1" in page


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["view", "run.csv"], "without --scenario"),
        (["view", "still.toml"], "found no [[sequence]]"),
        (["film", "nosuch.toml"], "found no such file"),
        (["view", "run.csv", "--scenario", "hand.toml"], "how it was held"),
    ],
)
def test_refusals_write_nothing(good, here, capsys, words, said):
    head = (good / "bench.toml").read_text(encoding="utf-8").partition("[[sequence]]")[0]
    (here / "still.toml").write_text(head)
    (here / "hand.toml").write_text(head.replace('"dual"', '"handheld"'))
    (here / "run.csv").write_bytes((good / "run.csv").read_bytes())
    before = sorted(here.iterdir())
    assert main(words) == 2
    assert said in capsys.readouterr().err
    assert sorted(here.iterdir()) == before


def test_one_instant_is_no_motion(good, here, capsys):
    (here / "one.csv").write_text("time_s,table_outer_deg,table_inner_deg\n1,0,0\n")
    assert main(["view", "one.csv", "--scenario", str(good / "bench.toml"), "-o", "out.html"]) == 2
    assert "found one instant" in capsys.readouterr().err


@pytest.mark.parametrize(("module", "command"), [("viser", "view"), ("av", "film")])
def test_a_missing_library_is_named_with_its_extra(good, here, module, command):
    program = (
        f"import sys; sys.modules['{module}'] = None\n"
        "from tiltcal.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, command, str(good / "bench.toml"), "-o", "x"],
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert f'pip install "tiltcal[{command}]"' in done.stderr
    assert list(here.iterdir()) == []
