"""The application in a browser: who may use it, what stays in the workspace, the journeys."""

import http.client
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import tiltcal as tc
from tiltcal.app.workspace import Workspace
from tiltcal.cli import main as tiltcal
from tiltcal.core.errors import TiltcalError
from tiltcal.report.series import thinned

pytest.importorskip("nicegui")
SCENARIOS = Path(__file__).parents[1] / "scenarios"
TOKEN = "a-token-of-the-tests"


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


@contextmanager
def running(folder):
    """The application over a folder: its port."""
    port = free_port()
    words = ("app", str(folder), "--no-browser", "--port", str(port), "--token", TOKEN)
    program = subprocess.Popen(
        [sys.executable, "-m", "tiltcal", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={k: v for k, v in os.environ.items() if not k.startswith(("NICEGUI", "PYTEST"))},
    )
    try:
        assert program.stdout is not None
        assert f"http://127.0.0.1:{port}/?token={TOKEN}" in program.stdout.readline()
        for _ in range(100):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        yield port
    finally:
        program.kill()
        program.communicate(timeout=20)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    scenario = folder / "bench.toml"
    shutil.copy(SCENARIOS / "six_faces_dual.toml", scenario)
    assert tiltcal(["simulate", str(scenario), "-o", str(folder / "run.csv")]) == 0
    (folder / "<img src=x onerror=alert(1)>.csv").write_text("time_s,accel_x_g\n0,1\n1,1\n")
    return folder


@pytest.fixture(scope="module")
def served(folder):
    with running(folder) as port:
        yield port


def asked(port, path, headers=(), method="GET"):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request(method, path, headers=dict(headers))
    answer = connection.getresponse()
    found = answer.status, dict(answer.getheaders()), answer.read()
    connection.close()
    return found


def cookie_of(port):
    _, headers, _ = asked(port, f"/?token={TOKEN}")
    return headers["set-cookie"].split(";")[0]


def test_nothing_is_answered_without_the_token(served):
    for path in ("/", "/file/run.csv", "/_nicegui_ws/socket.io/?EIO=4&transport=polling"):
        assert asked(served, path)[0] == 401, path
    assert asked(served, "/?token=wrong")[0] == 403
    cookie = cookie_of(served)
    assert asked(served, "/", {"Cookie": cookie})[0] == 200
    assert asked(served, "/", {"Cookie": cookie, "Host": f"evil.example:{served}"})[0] == 400
    foreign = {"Cookie": cookie, "Origin": "http://evil.example"}
    assert asked(served, "/", foreign)[0] == 403


def test_the_cookie_and_the_pages_keep_to_themselves(served):
    _, headers, _ = asked(served, f"/?token={TOKEN}")
    assert "HttpOnly" in headers["set-cookie"]
    assert "SameSite=Strict" in headers["set-cookie"]
    _, page, body = asked(served, "/", {"Cookie": cookie_of(served)})
    assert "default-src 'self'" in page["content-security-policy"]
    assert not re.findall(rb"(?:src|href)=.https?://", body)


@pytest.mark.parametrize("name", ["../secret", "..%2fsecret", "/etc/passwd", ".tiltcal-app.json"])
def test_a_file_outside_the_workspace_is_not_there(served, folder, name):
    (folder.parent / "secret").write_text("secret")
    status, _, body = asked(served, f"/file/{name}", {"Cookie": cookie_of(served)})
    assert status == 404
    assert b"secret" not in body.replace(name.encode(), b"")


def test_a_report_is_shown_without_rights_and_a_file_is_downloaded(served, folder):
    (folder / "page.html").write_text("<script>1</script>")
    _, page, _ = asked(served, "/file/page.html", {"Cookie": cookie_of(served)})
    assert page["content-security-policy"].startswith("sandbox allow-scripts;")
    _, file, _ = asked(served, "/file/run.csv", {"Cookie": cookie_of(served)})
    assert file["content-disposition"].startswith("attachment")


@pytest.mark.parametrize(
    ("given", "stored"),
    [
        ("../../evil.csv", "evil.csv"),
        ("C:\\x\\evil.csv", "evil.csv"),
        (".hidden", "hidden"),
        ("<b>.csv", "_b_.csv"),
        ("a\0b.csv", "a_b.csv"),
    ],
)
def test_the_name_of_an_upload_is_a_plain_one(tmp_path, given, stored):
    space = Workspace(tmp_path)
    assert space.free_name(given) == stored
    (tmp_path / stored).write_text("")
    second = space.free_name(given)
    assert second != stored
    assert (tmp_path / second).parent == tmp_path


@pytest.mark.parametrize("given", ["", "../", "..", "   "])
def test_an_upload_without_a_name_is_refused(tmp_path, given):
    with pytest.raises(TiltcalError, match="found no name"):
        Workspace(tmp_path).free_name(given)


def test_a_link_out_of_the_workspace_is_no_file_of_it(tmp_path):
    outside = tmp_path / "outside.csv"
    outside.write_text("x")
    inside = tmp_path / "bench"
    inside.mkdir()
    (inside / "link.csv").symlink_to(outside)
    space = Workspace(inside)
    assert space.names() == []
    with pytest.raises(TiltcalError, match="leads out"):
        space.path("link.csv")


def test_choices_are_kept_and_bad_ones_are_none(tmp_path):
    Workspace(tmp_path).choose(recording="run.csv", stated={"serial": "7"})
    assert Workspace(tmp_path).chosen.recording == "run.csv"
    assert Workspace(tmp_path).chosen.stated == {"serial": "7"}
    (tmp_path / ".tiltcal-app.json").write_text('{"recording": 7}')
    assert Workspace(tmp_path).chosen.recording == ""


def test_thinning_keeps_what_stands_out():
    rng = np.random.default_rng(1)
    time, values = np.arange(300_000) / 1000, rng.normal(size=300_000)
    values[123_456], values[200_001] = 50.0, -40.0
    at, shown = thinned(time, values, 1000)
    assert len(shown) == 2000
    assert {50.0, -40.0} <= set(shown)
    assert (np.diff(at) >= 0).all()
    few = thinned(time[:100], values[:100], 1000)
    np.testing.assert_array_equal(few[1], values[:100])


def chromium():
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no chromium on this machine")
    return found


@contextmanager
def browsing(port, **options):
    """A page of the application, and what went wrong in it."""
    play = pytest.importorskip("playwright.sync_api")
    with play.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | options)
        page, wrong = context.new_page(), []
        page.set_default_timeout(60_000)
        page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("dialog", lambda dialog: wrong.append(f"dialog {dialog.message}"))
        page.on(
            "request",
            lambda r: (
                None
                if r.url.startswith((f"http://127.0.0.1:{port}/", "data:", "blob:"))
                else wrong.append(r.url)
            ),
        )
        page.goto(f"http://127.0.0.1:{port}/?token={TOKEN}")
        page.wait_for_selector(".q-tab")
        yield page, wrong
        browser.close()


def choose(page, label, name):
    page.get_by_label(label).first.click()
    page.get_by_role("option", name=name, exact=True).last.click()
    page.wait_for_timeout(800)


def choose_files(page):
    go_to(page, "Open")
    choose(page, "Recording of the workspace", "run.csv")
    choose(page, "Scenario of the workspace", "bench.toml")


def go_to(page, tab):
    page.get_by_role("tab", name=tab).click()
    page.wait_for_timeout(1000)


def test_from_a_recording_to_certificate_diagnosis_and_plan(served, folder):
    with browsing(served) as (page, wrong):
        choose_files(page)
        go_to(page, "Recording")
        page.get_by_text("6 dwells").wait_for()
        go_to(page, "Calibrate")
        choose(page, "Method", "six_position")
        page.get_by_role("button", name="Calibrate", exact=True).click()
        page.get_by_text("accel.bias_x").first.wait_for()
        calibration = tc.load_calibration(folder / "CAL.json")
        assert page.locator(".q-badge").first.inner_text().lower() == calibration.verdict
        page.get_by_text("Certificate", exact=True).click()
        page.get_by_label("Serial number").fill("<b>42</b>")
        page.get_by_label("Day of the measurement, YYYY-MM-DD").fill("2026-11-29")
        page.get_by_role("button", name="Write certificate and DCC").click()
        page.get_by_role("link", name="certificate.xml").wait_for()
        assert "&lt;b&gt;42&lt;/b&gt;" in (folder / "certificate.html").read_text(encoding="utf-8")
        go_to(page, "Diagnose")
        page.get_by_role("button", name="Diagnose", exact=True).click()
        page.locator("iframe").first.wait_for()
        stated = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
        page.get_by_text(stated["statement"][:40]).first.wait_for()
        go_to(page, "Plan")
        page.get_by_label("Table time, s").fill("60")
        page.get_by_role("button", name="Design", exact=True).click()
        page.get_by_role("link", name="steps.csv").wait_for()
        assert json.loads((folder / "plan" / "design.json").read_text())["budget_s"] == 60
        assert wrong == []


def test_the_command_that_is_shown_is_the_one_that_ran(served, folder):
    with browsing(served) as (page, _):
        choose_files(page)
        go_to(page, "Calibrate")
        choose(page, "Method", "six_position")
        line = page.locator(".command").first.inner_text().split()
    program, *words = line
    assert program == "tiltcal"
    words_of_page = ["calibrate", "run.csv", "--scenario", "bench.toml"]
    assert words[:4] == words_of_page
    (folder / "CAL.json").unlink(missing_ok=True)
    here = Path.cwd()
    try:
        os.chdir(folder)
        assert tiltcal(words) in (0, 1)
    finally:
        os.chdir(here)
    own = tc.load_scenario(folder / "bench.toml").calibrate(
        tc.read(folder / "run.csv"), "six_position"
    )
    found = tc.load_calibration(folder / "CAL.json")
    assert {n: p.value for n, p in found.parameters.items()} == pytest.approx(
        {n: p.value for n, p in own.parameters.items()}
    )


def test_two_tabs_and_a_reload_show_the_same(served):
    with browsing(served) as (page, wrong):
        go_to(page, "Open")
        choose(page, "Recording of the workspace", "run.csv")
        other = page.context.new_page()
        other.goto(f"http://127.0.0.1:{served}/")
        other.wait_for_selector(".q-tab")
        page.reload()
        for shown in (page, other):
            go_to(shown, "Open")
            assert shown.get_by_label("Recording of the workspace").input_value() == "run.csv"
        assert wrong == []


def test_the_guide_follows_a_recording_and_writes_what_it_took(served, folder):
    with browsing(served) as (page, wrong):
        go_to(page, "Open")
        choose(page, "Scenario of the workspace", "bench.toml")
        go_to(page, "Guide")
        page.get_by_label("Source").fill("run.csv")
        choose(page, "Method", "six_position")
        page.get_by_role("button", name="Start", exact=True).click()
        page.get_by_text(re.compile("1 dwells of about")).wait_for()
        page.get_by_text(re.compile("reads: accel_x")).wait_for()
        page.get_by_role("button", name="Stop", exact=True).click()
        page.get_by_text("Stopped.").wait_for()
        page.get_by_role("button", name="Save recording and calibration").click()
        page.get_by_text(re.compile("written to guided")).wait_for()
        assert len(tc.read(folder / "guided" / "recording.csv")) > 500
        assert wrong == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_telephone_shows_every_page_without_scrolling_sideways(served, scheme):
    small = {"viewport": {"width": 390, "height": 844}, "color_scheme": scheme}
    with browsing(served, **small) as (page, wrong):
        for tab in ("Open", "Recording", "Calibrate", "Diagnose", "Plan", "Guide"):
            go_to(page, tab)
            assert page.evaluate("document.documentElement.scrollWidth") <= 390, tab
        assert wrong == []


def test_the_tabs_are_reached_by_the_keyboard(served):
    with browsing(served) as (page, _):
        for _ in range(12):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.getAttribute('role')") == "tab":
                break
        page.keyboard.press("ArrowRight")
        assert page.evaluate("document.activeElement.getAttribute('role')") == "tab"
        page.keyboard.press("Enter")
        page.wait_for_timeout(500)
        assert page.locator(".q-tab--active").count() == 1


def test_dwells_that_were_kept_are_those_of_their_recording(served, folder):
    shutil.copy(folder / "run.csv", folder / "second.csv")
    with browsing(served) as (page, _):
        choose_files(page)
        go_to(page, "Recording")
        page.get_by_role("checkbox", name=re.compile("^2: ")).click()
        page.get_by_role("button", name="Keep the marked dwells").click()
        page.get_by_role("button", name="Use all again").wait_for()
        kept = (folder / "run-dwells.csv").read_text()
        assert kept.count("dwell") == 5
        assert "+z" in kept
        go_to(page, "Calibrate")
        assert "--segments run-dwells.csv" in page.locator(".command").first.inner_text()
        go_to(page, "Open")
        choose(page, "Recording of the workspace", "second.csv")
        go_to(page, "Calibrate")
        assert "--segments" not in page.locator(".command").first.inner_text()
    (folder / "run-dwells.csv").unlink()
