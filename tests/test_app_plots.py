"""What the plots of the application lead to: findings at their places, a residual to its dwell."""

import json
import shutil

import numpy as np
import pytest

from tests.running_app import TOKEN, Page, running
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.saving import write_recording

pytest.importorskip("nicegui", reason="the extra tiltcal[app] is not installed")
FROZEN = slice(700, 800)  # rows


@pytest.fixture(scope="module")
def page(browser, good, tmp_path_factory):
    """A page on a workspace with a sound recording, and one with a channel that froze."""
    folder = tmp_path_factory.mktemp("plots") / "bench"
    folder.mkdir()
    for name in ("bench.toml", "run.csv"):
        shutil.copy(good / name, folder)
    recording = read_recording(folder / "run.csv")
    columns = {name: recording.column(name).copy() for name in recording.column_names}
    columns["accel_y_m_s2"][FROZEN] = columns["accel_y_m_s2"][FROZEN.start]
    frozen = type(recording).from_columns(recording.time, columns)
    write_recording(frozen, folder / "frozen.csv")
    with running(folder, "--token", TOKEN) as app:
        opened = Page(browser, app)
        yield opened
        opened.context.close()


def traces(page):
    """Name, times and readings of what the first plot shows."""
    return page.page.evaluate(
        "document.querySelector('.figure .plot').data.map(t => [t.name, t.x, t.y])"
    )


def test_a_finding_is_marked_in_the_plot_where_it_is_also_when_zoomed(page):
    page.page.get_by_role("button", name="frozen.csv", exact=True).click()
    page.shows("td:has-text('frozen')")
    page.page.wait_for_function(
        "document.querySelector('.figure .plot')?.data?.some(t => t.name.startsWith('frozen'))"
    )
    recording = read_recording(page.app.folder / "frozen.csv")
    rows = np.arange(FROZEN.start + 1, FROZEN.stop)  # those that repeat the one before
    for turned in (0, -600):
        box = page.page.locator(".figure .plot .nsewdrag").first.bounding_box()
        page.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.page.mouse.wheel(0, turned)
        page.page.wait_for_timeout(800)
        marked = {name: (x, y) for name, x, y in traces(page) if "frozen" in name}
        x, y = marked["frozen: accel_y_m_s2"]
        assert x == pytest.approx(list(recording.time[rows]))
        assert y == pytest.approx(list(recording.column("accel_y_m_s2")[rows]), rel=1e-5)
    page.require_clean()


def test_a_click_on_a_residual_shows_its_dwell_and_one_on_a_line_nothing(page):
    page.page.get_by_role("button", name="run.csv", exact=True).click()
    page.page.get_by_role("button", name="bench.toml", exact=True).click()
    page.go("Calibrate")
    page.press("Try the methods")
    page.shows("tr.picked")
    page.press("Calibrate")
    figures = page.page.locator(".figure:has(.points path)")
    figures.nth(1).wait_for()
    line = figures.nth(1).locator(".lines path").first
    line.scroll_into_view_if_needed()
    box = line.bounding_box()  # of the curve of the first axis, between two measured points
    page.page.mouse.click(box["x"] + box["width"] / 4, box["y"] + box["height"] / 2)
    page.page.wait_for_timeout(800)
    assert page.page.title().startswith("Calibrate")
    point = figures.nth(0).locator(".points path").nth(2)
    point.scroll_into_view_if_needed()
    box = point.bounding_box()
    page.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.page.wait_for_function("document.title.startsWith('Recording')")
    page.page.wait_for_function("document.querySelector('.figure .plot')?.layout?.xaxis?.range")
    start, end = page.page.evaluate("document.querySelector('.figure .plot').layout.xaxis.range")
    pose = json.loads((page.app.folder / "CAL.json").read_text())["poses"][2]
    assert start < pose["start_s"] < pose["end_s"] < end
    assert (start + end) / 2 == pytest.approx((pose["start_s"] + pose["end_s"]) / 2, abs=0.05)
    page.require_clean()
