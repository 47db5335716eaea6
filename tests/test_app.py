"""``tiltcal app``: who is let in, which names and sizes are, and the journeys of the pages in a
browser, each against the command that the page shows.
"""

import asyncio
import json
import shlex
import shutil

import numpy as np
import pytest

from tests.running_app import TOKEN, Page, held_by_hand, running
from tests.scenario_files import BENCH_SCENARIO
from tiltcal.app import commands
from tiltcal.app.guard import Guard, Keys
from tiltcal.app.jobs import Jobs, as_command
from tiltcal.app.workspace import Workspace, file_name, kind_of
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.proposal.statements import notes_of, statements_of, with_values
from tiltcal.recordings.recording import Recording
from tiltcal.report.series import BUCKETS, envelope, series_plot, series_traces, visible_rows

pytest.importorskip("nicegui", reason="the extra tiltcal[app] is not installed")

HOSTILE = "<img src=x onerror=document.title='run'>.log"
TRICKS = (
    "../out.csv",
    "/etc/out.csv",
    "..\\out.csv",
    "a/b.csv",
    "%00.csv",
    "a%0ab.csv",
    ".hidden.csv",
    "CON.csv",
    "c:run.csv",
    "",
    "..",
    "a" * 200 + ".csv",
)
GIB = 2**30
PHONE = (390, 844)


def hand_held_log(path):
    """A log without times and units: 14 poses of a triad with an offset and a scale error, held
    by hand, and a gyro in rad/s.
    """
    rng = np.random.default_rng(57)
    rows, rate, still, turn = [], 50.0, 150, 40
    ups = [*np.eye(3), *-np.eye(3), *(np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T)]
    ups = [u / np.linalg.norm(u) for u in ups]
    for before, after in zip([ups[0], *ups[:-1]], ups, strict=True):
        way = np.linspace(0, 1, turn)[:, None]
        move = (1 - way) * before + way * (after + 1e-3)
        move = 9.80123 * move / np.linalg.norm(move, axis=1)[:, None]
        up = move / 9.80123
        rate_xyz = np.cross(np.gradient(up, 1 / rate, axis=0), up)
        hold = np.tile(9.80123 * after, (still, 1))
        force = np.vstack([move, hold])
        gyro = np.vstack([rate_xyz, np.zeros((still, 3))])
        rows.append(np.hstack([force * 1.01 + [0.1, -0.2, 0.05], gyro]))
    table = np.vstack(rows)
    table += rng.normal(size=table.shape) * ([0.01] * 3 + [0.001] * 3)
    np.savetxt(path, table, fmt="%.5f", header="ax ay az gx gy gz", comments="")


TURNED_MAPPING = (
    '[file]\nseparator = "space"\n[time]\nrate_hz = 50\n'
    + "".join(f'[[column]]\nfrom = "a{i}"\nto = "accel_{i}_m_s2"\n' for i in "xyz")
    + "".join(f'[[column]]\nfrom = "g{i}"\nto = "gyro_{i}_rad_s"\n' for i in "xyz")
)
"""How the log of ``hand_held_log`` is imported."""


@pytest.fixture(scope="module")
def app(tmp_path_factory):
    """An application on a workspace with a log, a bench with its recording, and a hostile name."""
    folder = tmp_path_factory.mktemp("app") / "bench"
    folder.mkdir()
    (folder / "bench.toml").write_text(BENCH_SCENARIO)
    assert main(["simulate", str(folder / "bench.toml"), "-o", str(folder / "bench.csv")]) == 0
    (folder / HOSTILE).write_text("<script>document.title='run'</script>,1\n2,3\n")
    hand_held_log(folder / "turned.log")
    (folder / "turned.map.toml").write_text(TURNED_MAPPING)
    words = ["--map", str(folder / "turned.map.toml"), "-o", str(folder / "turned.csv")]
    assert main(["import", str(folder / "turned.log"), *words]) == 0
    (folder / "turned.toml").write_text(held_by_hand(50))
    with running(folder, "--token", TOKEN) as started:
        yield started


@pytest.fixture(scope="module")
def page(browser, app):
    """One page for the journeys: each chooses the files that it needs."""
    opened = Page(browser, app)
    yield opened
    opened.context.close()


# --------------------------------------------------------------------------------------------------
# ---- who is let in


def test_nothing_is_answered_without_the_cookie(app):
    static = "/_nicegui/3/static/nicegui.js"
    paths = ("/", "/calibrate", "/files/bench.csv", "/_tiltcal/drawing.js", static)
    assert {app.request("GET", path)[0] for path in paths} == {401}
    assert app.request("PUT", "/upload", b"x", X_File_Name="a.csv")[0] == 401
    assert app.request("GET", "/_nicegui_ws/socket.io/?EIO=4&transport=polling")[0] == 401
    assert app.request("GET", "/?token=wrong")[0] == 403
    assert app.request("GET", "/", cookie=f"tiltcal_{app.host.split(':')[1]}=wrong")[0] == 401
    assert not (app.folder / "a.csv").exists()


def handshake(app, **headers):
    """The status of the opening of a websocket."""
    opening = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec_WebSocket_Version": "13",
        "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    return app.request("GET", path, **opening, **headers)[0]


def test_a_websocket_needs_the_cookie_and_this_origin(app):
    cookie = app.enter()
    own = f"http://{app.host}"
    assert handshake(app, Origin=own) == 403
    assert handshake(app, Origin="http://example.org", Cookie=cookie) == 403
    assert handshake(app, Cookie=cookie) == 403


def test_another_name_that_leads_here_is_refused(app):
    cookie, port = app.enter(), app.host.split(":")[1]
    assert app.request("GET", "/", cookie=cookie)[0] == 200
    assert app.request("GET", "/", cookie=cookie, Host=f"localhost:{port}")[0] == 200
    for name in (f"example.org:{port}", "127.0.0.1:1", "example.org", f"127.0.0.1.nip.io:{port}"):
        assert app.request("GET", "/", cookie=cookie, Host=name)[0] == 400


def test_another_page_of_this_machine_can_change_nothing(app):
    cookie, port = app.enter(), app.host.split(":")[1]
    for headers in ({"Origin": "http://127.0.0.1:1"}, {"Sec_Fetch_Site": "same-site"}):
        answer = app.request("PUT", "/upload", b"x", cookie=cookie, X_File_Name="b.csv", **headers)
        assert answer[0] == 403
    assert not (app.folder / "b.csv").exists()
    assert int(port) > 0


def test_a_drawn_token_is_exchanged_once_and_a_given_one_each_time():
    drawn, given = Keys(None, 80), Keys("x" * 20, 80)
    assert drawn.exchange(given.token) is None
    first = drawn.exchange(drawn.token)
    assert drawn.exchange(drawn.token) is None
    assert drawn.admits(first.partition(";")[0])
    assert given.exchange("x" * 20) == given.exchange("x" * 20)
    assert not given.admits(first.partition(";")[0])


@pytest.mark.parametrize(
    ("host", "is_ours"),
    [
        ("127.0.0.1:81", True),
        ("[::1]:81", True),
        ("bench.local:81", True),
        ("LOCALHOST:81", True),
        ("evil.org:81", False),
        ("127.0.0.1", False),
        ("127.0.0.1:81@evil.org", False),
        ("", False),
    ],
)
def test_a_host_is_a_number_localhost_or_the_name_that_was_given(host, is_ours):
    assert Guard(None, Keys(None, 81), "bench.local", 81).is_ours(host) is is_ours


def test_a_short_token_is_refused(capsys):
    assert main(["app", ".", "--token", "short", "--no-browser"]) == 2
    assert "need at least 16" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------
# ---- files


@pytest.mark.parametrize("name", TRICKS)
def test_a_name_that_is_a_path_hidden_or_reserved_is_refused(app, name):
    before = {p for p in app.folder.parent.rglob("*") if p.name != ".tiltcal-app.json"}
    answer = app.request("PUT", "/upload", b"x", cookie=app.enter(), X_File_Name=name)
    assert answer[0] == 400
    assert b"need a plain name" in answer[2]
    assert {p for p in app.folder.parent.rglob("*") if p.name != ".tiltcal-app.json"} == before


def test_an_upload_lands_whole_under_a_name_of_its_own(app):
    cookie = app.enter()
    for name in ("up.csv", "up-2.csv"):
        answer = app.request("PUT", "/upload", b"1,2\n", cookie=cookie, X_File_Name="up.csv")
        assert json.loads(answer[2]) == {"name": name}
        assert (app.folder / name).read_bytes() == b"1,2\n"
        (app.folder / name).chmod(0o644)
    for name in ("up.csv", "up-2.csv"):
        (app.folder / name).unlink()


def test_what_is_too_large_is_refused_before_it_is_read(app):
    size = str(2 * GIB)
    headers = {"Content_Length": size, "X_File_Name": "large.csv"}
    status, _, said = app.request("PUT", "/upload", b"", cookie=app.enter(), **headers)
    assert status == 413
    assert size.encode() in said
    assert not list(app.folder.glob(".part-*"))


def test_a_file_is_served_without_rights_and_none_outside(app):
    cookie = app.enter()
    (app.folder / "page.html").write_text("<script>1</script>")
    (app.folder / "link.csv").symlink_to("/etc/hostname")
    _, headers, _ = app.request("GET", "/files/page.html", cookie=cookie)
    assert headers["content-security-policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in headers["content-security-policy"]
    for path in ("/files/..%2f..%2fetc%2fhostname", "/files/link.csv", "/files/.tiltcal-app.json"):
        assert app.request("GET", path, cookie=cookie)[0] == 403
    assert app.request("GET", "/files/none.csv", cookie=cookie)[0] == 404
    for name in ("page.html", "link.csv"):
        (app.folder / name).unlink()


def test_a_name_that_is_like_an_option_is_none_to_a_command(tmp_path):
    assert file_name("-o.csv") == "_-o.csv"
    assert commands.segments("-o.csv", "a b.csv") == ["segments", "./-o.csv", "-o", "a b.csv"]
    assert as_command(["export", "a b;c.json"]) == "tiltcal export 'a b;c.json'"
    with pytest.raises(TiltcalError, match="out of the workspace"):
        Workspace(tmp_path).path("a/../../b")


def test_files_are_known_by_their_beginning(good):
    kinds = {name: kind_of(good / name) for name in ("bench.toml", "CAL.json", "run.csv")}
    assert kinds == {"bench.toml": "scenario", "CAL.json": "calibration", "run.csv": "recording"}


# --------------------------------------------------------------------------------------------------
# ---- the lines of a mapping, the points of a plot, the commands


MAPPING = """\
# Mapping of a.log
[file]
separator = "space"          # "#" is no comment here
[time]
rate_hz = "?"                # cannot know: the rate
[[column]]
from = 1
to = "gyro_x_?"              # three neighbours # and more

# cannot know: the unit
"""


def test_a_mapping_is_changed_line_by_line_and_keeps_its_reasons():
    found = statements_of(MAPPING)
    assert [(s.part, s.key, s.open) for s in found] == [
        ("file", "separator", False),
        ("time", "rate_hz", True),
        ("column 1", "from", False),
        ("column 1", "to", True),
    ]
    assert found[0].reason == '"#" is no comment here'
    assert found[3].reason == "three neighbours # and more"
    changed = with_values(MAPPING, [(found[1].line, 100), (found[3].line, "gyro_x_rad_s")])
    assert [s.value for s in statements_of(changed)] == ["space", 100, 1, "gyro_x_rad_s"]
    assert [s.reason for s in statements_of(changed)] == [s.reason for s in found]
    assert notes_of(changed) == [("cannot know", "the unit")]


def test_a_plot_shows_every_extreme_in_few_points(rng):
    time = np.arange(1_000_000) / 100.0
    values = rng.normal(size=len(time))
    values[654_321], values[123_456] = 99.0, -88.0
    values[700_000:701_000] = np.nan
    t, v = envelope(time, values)
    assert len(t) == 2 * BUCKETS
    assert np.all(np.diff(t) >= 0)
    assert np.nanmax(v) == 99.0
    assert np.nanmin(v) == -88.0
    assert abs(t[np.nanargmax(v)] - 6543.21) <= time[-1] / BUCKETS


def test_a_range_is_drawn_with_what_is_beside_it():
    time = np.arange(100_000) / 100.0
    recording = Recording.from_columns(time, {"accel_x_m_s2": np.sin(time), "gyro_x_rad_s": time})
    rows = visible_rows(recording, 10.0, 20.0)
    assert (time[rows][0], time[rows][-1]) == (4.99, 25.0)
    first, second = series_traces(recording, (10.0, 20.0))
    assert (first["name"], second["yaxis"]) == ("accel_x_m_s2", "y2")
    assert series_plot(recording).layout["xaxis"]["anchor"] == "y2"


def test_the_files_of_a_workspace_are_read_once_until_they_change(tmp_path):
    from tiltcal.app.session import Session

    session = Session(Workspace(tmp_path))
    (tmp_path / "a.csv").write_text("1")
    read = []
    for _ in range(3):
        session.read("a.csv", "text", lambda: read.append(1))
    assert len(read) == 1
    (tmp_path / "a.csv").write_text("22")
    session.read("a.csv", "text", lambda: read.append(1))
    assert len(read) == 2


def test_what_is_kept_of_a_session_survives_and_rubbish_does_not_stop_it(tmp_path):
    from tiltcal.app.session import Session

    Session(Workspace(tmp_path)).set("recording", "run.csv")
    assert Session(Workspace(tmp_path)).text("recording") == "run.csv"
    for rubbish in ("{", "[1]", '{"recording": 7}'):
        (tmp_path / ".tiltcal-app.json").write_text(rubbish)
        assert Session(Workspace(tmp_path)).text("recording") == ""


def test_a_command_can_be_cancelled_and_leaves_nothing(good, tmp_path):
    shutil.copy(good / "bench.toml", tmp_path)

    async def cancelled():
        jobs = Jobs(tmp_path, lambda: None)
        task = asyncio.create_task(jobs.run("Serve", ["serve", "bench.toml"]))
        while not jobs.all or jobs.all[0].process is None:
            await asyncio.sleep(0.02)
        await asyncio.sleep(1.5)
        await jobs.cancel(jobs.all[0])
        return await task

    job = asyncio.run(cancelled())
    assert job.cancelled
    assert job.status not in (None, 0)
    assert [p.name for p in tmp_path.iterdir()] == ["bench.toml"]


def test_a_program_of_the_workspace_is_not_run(good, tmp_path):
    shutil.copy(good / "CAL.json", tmp_path)
    (tmp_path / "tiltcal.py").write_text("open('ran', 'w')")
    words = commands.export("CAL.json", "px4", "px4.params")
    job = asyncio.run(Jobs(tmp_path, lambda: None).run("Export", words))
    assert job.status == 0
    assert (tmp_path / "px4.params").exists()
    assert not (tmp_path / "ran").exists()


# --------------------------------------------------------------------------------------------------
# ---- the journeys


def same_by_command(page, line, names, monkeypatch, tmp_path):
    """Run a command that a page shows in a copy of the workspace; it writes the same files."""
    copy = tmp_path / "copy"
    shutil.copytree(page.app.folder, copy)
    program, *words = shlex.split(line)
    assert program == "tiltcal"
    for name in names:
        (copy / name).unlink()
    monkeypatch.chdir(copy)
    assert main([*words, "--quiet"]) in (0, 1)
    for name in names:
        made = (copy / name).read_text().replace(str(copy), str(page.app.folder))
        assert made == (page.app.folder / name).read_text()


def test_from_a_log_to_a_certificate(page, tmp_path, monkeypatch):
    hand_held_log(tmp_path / "imu.log")
    page.page.set_input_files("input[type=file]", str(tmp_path / "imu.log"))
    page.shows(".cell.open")
    page.fill("time rate_hz", "50")
    page.page.get_by_label("Unit of gyro").click()
    page.page.locator(".q-menu .q-item", has_text="rad_s").first.click()
    page.page.wait_for_selector(".cell.open", state="detached")
    page.press("Import")
    page.shows(".figure .main-svg")
    same_by_command(page, page.command("tiltcal import"), ["imu.csv"], monkeypatch, tmp_path)
    page.fill("Scenario to write", "hand.toml")
    page.press("Make a scenario")
    page.shows("textarea")
    page.go("Calibrate")
    page.press("Try the methods")
    page.shows("tr.picked")
    assert page.page.get_by_label("Method", exact=True).input_value() == "norm"
    page.press("Calibrate")
    page.shows("text=calibration by norm: good")
    line = page.command("tiltcal calibrate")
    shutil.rmtree(tmp_path / "copy")
    same_by_command(page, line, ["CAL.json"], monkeypatch, tmp_path)
    page.fill("Serial", "00<b>42")
    page.press("Certify")
    frame = page.page.frame_locator("iframe.report")
    frame.get_by_text("00<b>42").wait_for(timeout=30_000)
    assert "serial=00<b>42" in "".join(page.commands())
    page.press("Export px4")
    page.shows("text=Download CAL.px4.params")
    page.go("Calibrate")
    page.shows("text=calibration by norm: good")
    assert "CAL_ACC0_XSCALE" in (page.app.folder / "CAL.px4.params").read_text()
    page.require_clean()


def test_two_tabs_and_a_reload_lose_nothing(page):
    page.go("Calibrate")
    page.fill("Serial", "00<b>42")
    other = page.second_tab("/calibrate")
    page.fill("Laboratory", "Bench 7")
    other.wait_for_function(
        "[...document.querySelectorAll('input')].some(i => i.value === 'Bench 7')"
    )
    other.reload()
    other.wait_for_function("window.did_handshake")
    assert other.get_by_label("Laboratory", exact=True).input_value() == "Bench 7"
    assert other.get_by_label("Serial", exact=True).input_value() == "00<b>42"
    other.close()
    kept = json.loads((page.app.folder / ".tiltcal-app.json").read_text())
    assert kept["stated.laboratory"] == "Bench 7"


def test_a_hostile_name_stays_text(page):
    page.go("Open")
    page.page.get_by_role("button", name=HOSTILE, exact=True).click()
    page.shows(".problem, .cell")
    assert page.page.title() == "Open · tiltcal"
    assert not page.page.locator("img[src=x]").count()
    page.require_clean()


def choose(page, label, name):
    """Choose a file in the bar of every page."""
    page.page.get_by_label(label, exact=True).click()
    page.page.locator(".q-menu:visible .q-item", has_text=name).first.click()
    page.page.wait_for_function(
        "name => [...document.querySelectorAll('.bar input, .bar span')].some("
        "i => (i.value || i.textContent) === name)",
        arg=name,
    )


def test_dwells_are_found_labelled_and_excluded(page):
    page.go("Recording")
    choose(page, "Recording", "bench.csv")
    choose(page, "Scenario", "bench.toml")
    page.press("Find the dwells")
    page.shows("tr.pickable")
    lines = (page.app.folder / "bench.segments.csv").read_text().splitlines()
    page.page.get_by_role("button", name="2", exact=True).click()
    page.fill("Label", "=1+1")
    page.press("Save")
    page.shows("td:has-text('=1+1')")
    assert ",'=1+1" in (page.app.folder / "bench.segments.csv").read_text()
    page.press("Exclude")
    page.page.wait_for_selector("td:has-text('=1+1')", state="detached")
    after = (page.app.folder / "bench.segments.csv").read_text().splitlines()
    assert len(after) == len(lines)
    assert [a for a, b in zip(after, lines, strict=True) if a != b] == [
        next(line for line in after if "=1+1" in line)
    ]
    page.shows(".figure .gl-container, .figure .main-svg")
    assert page.page.get_by_label("Dwells", exact=True).first.input_value() == "bench.segments.csv"
    choose(page, "Recording", "turned.csv")  # whose dwells they are not
    page.shows("text=Choose a list of dwells")
    assert page.page.get_by_label("Dwells", exact=True).first.input_value() == ""
    choose(page, "Recording", "bench.csv")
    page.page.wait_for_function("document.body.textContent.includes('bench.segments.csv')")
    page.require_clean()


def test_a_recording_is_diagnosed(page, tmp_path, monkeypatch):
    (page.app.folder / "bench.segments.csv").unlink(missing_ok=True)
    page.go("Diagnose")
    choose(page, "Recording", "bench.csv")
    choose(page, "Scenario", "bench.toml")
    page.press("Diagnose")
    page.shows(".job button")
    page.shows(".verdict")
    page.shows(".figure .main-svg")
    line = page.command("tiltcal diagnose")
    names = ["diagnosis/amended.toml"]
    same_by_command(page, line, names, monkeypatch, tmp_path)
    made = (tmp_path / "copy/diagnosis/diagnosis.json").read_text()
    own = json.loads((page.app.folder / "diagnosis/diagnosis.json").read_text())
    assert json.loads(made)["verdict"] == own["verdict"]
    page.require_clean()


def test_poses_are_planned(page, tmp_path, monkeypatch):
    page.go("Plan")
    choose(page, "Scenario", "bench.toml")
    page.fill("Table time, s", "60")
    page.fill("Goals, in the least time", "U=1deg")
    page.page.wait_for_function("document.body.textContent.includes('--budget-s 60')")
    page.press("Design")
    page.shows("iframe.report")
    line = page.command("tiltcal design")
    assert "--goal=U=1deg" in line
    page.shows("td:has-text('reached')")
    same_by_command(page, line, ["plan/steps.csv", "plan/design.toml"], monkeypatch, tmp_path)
    page.require_clean()


def test_a_replayed_recording_is_guided_to_its_goals(page):
    page.go("Guide")
    choose(page, "Scenario", "turned.toml")
    page.fill("Source", "turned.csv")
    page.fill("Replay speed of a file", "0")
    page.fill("Length of a dwell, s", "2")
    page.fill("Goals: the largest σ of each kind", "bias=100ug scale=150ppm cross=150ppm")
    page.page.wait_for_function("document.body.textContent.includes('--goal bias=100ug')")
    assert page.command("tiltcal guide").endswith("-o guided")
    page.press("Start")
    page.shows("text=Ended with")
    page.shows("text=Download calibration")
    assert json.loads((page.app.folder / "guided/CAL.json").read_text())["method"] == "norm"
    page.require_clean()


@pytest.mark.parametrize("size", [PHONE, (1280, 900)])
@pytest.mark.usefixtures("page")
def test_every_page_fits_and_follows_the_dark(browser, app, size):
    narrow = Page(browser, app, size, "dark")
    for title in ("Open", "Recording", "Calibrate", "Diagnose", "Plan", "Guide"):
        narrow.go(title)
        narrow.page.wait_for_timeout(500)
        assert narrow.overflows() <= 0, title
        assert narrow.page.evaluate("getComputedStyle(document.body).backgroundColor") == (
            "rgb(23, 25, 35)"
        )
        unnamed = narrow.page.evaluate(
            "[...document.querySelectorAll('input:not([type=file]), textarea')].filter("
            "i => !i.getAttribute('aria-label') && !i.closest('label') && !i.closest('.q-checkbox')"
            ").length"
        )
        assert unnamed == 0, title
    narrow.require_clean()
    narrow.context.close()


def test_the_keyboard_reaches_files_and_pages(page):
    page.go("Open")
    page.page.keyboard.press("Tab")
    assert page.page.evaluate("document.activeElement.textContent.trim()") == "Skip to the content"
    page.page.get_by_role("button", name="bench.csv", exact=True).focus()
    page.page.keyboard.press("Enter")
    page.page.wait_for_selector("tr.picked")
