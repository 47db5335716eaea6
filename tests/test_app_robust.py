"""``tiltcal app`` where something is in the way: no mouse, a file too large, a connection that
drops.
"""

import contextlib
import socket
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from hand_simulation import Hand
from test_app import GIB, hand_held_log

from tests.running_app import TOKEN, Page, held_by_hand, running
from tiltcal.app.elements import read_for_page
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording_files import read_recording

pytest.importorskip("nicegui", reason="the extra tiltcal[app] is not installed")
FOCUSED = """() => {
  const at = document.activeElement;
  const label = at.getAttribute("aria-label") || at.closest("label")?.textContent || at.textContent;
  return [label.trim(), at.tagName];
}"""
MOST_TABS = 150
GAP_S = 1.5


@pytest.fixture
def page(browser, tmp_path):
    """A page on an empty workspace."""
    (tmp_path / "bench").mkdir()
    with running(tmp_path / "bench", "--token", TOKEN) as app:
        opened = Page(browser, app)
        yield opened
        opened.context.close()


class Keys:
    """Somebody who has a keyboard only.

    Args:
        page: that it is at.
    """

    def __init__(self, page):
        self.page, self.keyboard = page, page.page.keyboard

    def to(self, label, tag=""):
        """Go on by Tab to what has a label, and perhaps a tag."""
        for _ in range(MOST_TABS):
            at, kind = self.page.page.evaluate(FOCUSED)
            if at == label and kind.startswith(tag):
                return
            self.keyboard.press("Tab")
        raise AssertionError(f"Tab does not reach {label!r}")

    def press(self, label, tag="BUTTON"):
        """Press a button, or follow a link."""
        self.to(label, tag)
        self.keyboard.press("Enter")

    def type(self, label, text):
        """Type into a field, in place of what is there."""
        self.to(label)
        self.keyboard.press("Control+A")
        self.keyboard.type(text)
        self.keyboard.press("Tab")
        self.page.page.wait_for_timeout(600)  # the field waits for the end of the typing

    def choose(self, label, option):
        """Choose from a list."""
        self.to(label)
        self.keyboard.press("Enter")
        self.page.shows(".q-menu:visible")
        for _ in range(MOST_TABS):
            self.keyboard.press("ArrowDown")
            there = self.page.page.locator(".q-menu .q-manual-focusable--focused")
            if there.count() and there.first.inner_text().strip() == option:
                break
        self.keyboard.press("Enter")


def test_a_keyboard_leads_from_a_log_to_a_certificate(page):
    hand_held_log(page.app.folder / "imu.log")
    keys = Keys(page)
    page.shows("button:has-text('imu.log')")  # put into the folder, not uploaded
    keys.press("imu.log")
    page.shows(".cell.open")
    keys.type("time rate_hz", "50")
    keys.choose("Unit of gyro", "rad_s")
    page.page.wait_for_selector(".cell.open", state="detached")
    keys.press("Import")
    page.shows(".figure .main-svg")
    keys.press("Make a scenario")
    page.shows("textarea")
    keys.press("Calibrate", "A")
    page.page.wait_for_function("window.did_handshake && document.title.startsWith('Calibrate')")
    keys.press("Try the methods")
    page.shows("tr.picked")
    keys.press("Calibrate")
    page.shows("text=calibration by norm: good")
    keys.type("Serial", "0042")
    keys.press("Certify")
    frame = page.page.frame_locator("iframe.report")
    frame.get_by_text("0042").first.wait_for()
    assert "0042" in (page.app.folder / "certificate.html").read_text()
    page.require_clean()


def test_a_file_that_is_too_large_is_told_of_and_not_sent(page):
    large = page.app.folder.parent / "large.csv"
    with large.open("wb") as file:
        file.truncate(2 * GIB)  # without blocks on the disk
    page.page.set_input_files("input[type=file]", str(large))
    told = page.shows(".drop [role=alert]").inner_text()
    assert "large.csv has 2 GiB, and an upload at most 1 GiB" in told
    assert not any(urlsplit(url).path == "/upload" for url in page.asked)
    page.require_clean()


def test_a_file_that_is_put_into_the_folder_is_listed(page):
    page.shows("text=The workspace is empty.")
    (page.app.folder / "bench.toml").write_text("[rig]\n")
    page.shows("button:has-text('bench.toml')")
    (page.app.folder / "bench.toml").unlink()
    page.shows("text=The workspace is empty.")
    assert not page.page.locator("button:has-text('bench.toml')").count()


class Dropping(threading.Thread):
    """A sensor whose connection drops once and comes back."""

    def __init__(self):
        super().__init__(daemon=True)
        self.port, self.ended = None, threading.Event()
        self.listening = threading.Event()

    def run(self):
        """Send, drop, send on until the test has ended."""
        hand = Hand(rate_hz=100.0)
        for length_s in (2.0, 60.0):
            with socket.create_server(("127.0.0.1", self.port or 0)) as server:
                self.port = server.getsockname()[1]
                self.listening.set()
                wire, _ = server.accept()
            with wire, contextlib.suppress(OSError):
                wire.sendall(b"time_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n")
                for _ in range(int(10 * length_s)):
                    stamps, read = hand.hold(0.1)
                    table = np.column_stack([stamps, *read.values()])
                    text = "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in table)
                    wire.sendall(text.encode())
                    if self.ended.wait(0.1):
                        return
            time.sleep(GAP_S)


def rows(page):
    """How many samples the page says have come."""
    return int(page.page.evaluate("/(\\d+) rows/.exec(document.body.textContent)[1]"))


def test_a_source_that_drops_and_returns_is_told_of_and_goes_on(page):
    sensor = Dropping()
    sensor.start()
    sensor.listening.wait(10)
    (page.app.folder / "hand.toml").write_text(held_by_hand(100))
    page.page.get_by_role("button", name="hand.toml", exact=True).click()
    page.go("Guide")
    page.fill("Source", f"tcp://127.0.0.1:{sensor.port}")
    page.press("Start")
    page.shows(".problem:has-text('the connection dropped')")
    before = rows(page)
    page.shows(".problem:has-text('back after')")
    page.page.wait_for_function(
        f"/(\\d+) rows/.exec(document.body.textContent)[1] > {before + 100}"
    )
    page.press("Stop and write")
    page.shows("text=Download recording")
    sensor.ended.set()
    (written,) = page.app.folder.glob("**/recording.csv")
    assert len(read_recording(written)) > before + 100
    page.require_clean()


def test_a_file_that_goes_away_while_it_is_read_is_one_message(tmp_path):
    with pytest.raises(TiltcalError, match=r"gone\.csv.*choose it again"):
        read_for_page((tmp_path / "gone.csv").read_text)
