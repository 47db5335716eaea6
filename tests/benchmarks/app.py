"""What `tiltcal app` makes its user wait for: its start, a long recording, and the Guide page
during live input. By the clock, on an idle machine; needs Debian's Chromium. Where other programs
run, the times on a processor are what compares.

Panning is a mouse that drags without a pause. A frame is one that the browser has painted after
the plot had moved.
"""

import os
import shutil
import socket
import statistics
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from hand_simulation import Hand

import tiltcal as tc
from tests.benchmarks import sized
from tests.running_app import TOKEN, Page, held_by_hand, running
from tiltcal.recordings.saving import write_recording
from tiltcal.setup.pose_schemes import directions

STARTS = sized(5, 1)
ROWS = sized(1_000_000, 20_000)
FORMS = sized((".csv", ".parquet"), (".csv",))
SETTLED_S = 3  # of a page, before its user has found the file
DRAG_S = sized(4.0, 0.5)
LIVE_S = sized(600.0, 15.0)
RATE_HZ, BLOCK = 1000, 10  # lines a second, lines a packet
MOVE_S, HOLD_S = 5.0, 15.0
START_S, DRAWN_S, FRAMES, SHARE = 3.0, 2.0, 20.0, 0.5
"""Limits: seconds, seconds, frames a second, share of a core."""
DRAWN = "document.querySelector('.figure .plot')?.calcdata?.length >= 6"
COUNT = """() => {
  const plot = document.querySelector(".figure .plot");
  let moved = false;
  window.painted = 0;
  plot.on("plotly_relayouting", () => { moved = true; });
  const frame = () => {
    if (moved) { window.painted += 1; moved = false; }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}"""


def main() -> None:
    """A line for each figure."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        print("app: no Chromium on this machine")
        return
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as place, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=found, args=["--no-sandbox"])
        folder = Path(place) / "bench"
        folder.mkdir()
        _start(folder)
        _draw(browser, folder)
        _guide(browser, folder)
        browser.close()


def _start(folder: Path) -> None:
    """Seconds until the application answers, and until the first page has come."""
    answers, pages, used = [], [], []
    for _ in range(STARTS):
        begun = time.perf_counter()
        with running(folder, "--token", TOKEN) as app:
            cookie = app.enter()
            answers.append(time.perf_counter() - begun)
            used.append(_used_s(app.process.pid))
            assert app.request("GET", "/", cookie=cookie)[0] == 200
            pages.append(time.perf_counter() - begun)
    print(f"app answers after {statistics.median(answers):.1f} s (limit {START_S:g}),", end=" ")
    print(f"{statistics.median(used):.1f} s of it on a processor;", end=" ")
    print(f"its first page has come after {statistics.median(pages):.1f} s")


def _draw(browser, folder: Path) -> None:
    """Seconds from the choice of a long recording to its plot, and frames while it is panned."""
    rng = np.random.default_rng(3)
    time_s = np.arange(ROWS) / RATE_HZ
    names = [f"accel_{a}_m_s2" for a in "xyz"] + [f"gyro_{a}_deg_s" for a in "xyz"]
    recording = tc.Recording.from_columns(time_s, {n: rng.normal(size=ROWS) for n in names})
    for form in FORMS:
        write_recording(recording, folder / f"long{form}")
    for form in FORMS:
        with running(folder, "--token", TOKEN) as app:
            page = Page(browser, app)
            page.page.set_default_timeout(120_000)
            button = page.page.get_by_role("button", name=f"long{form}", exact=True)
            button.wait_for()
            page.page.wait_for_timeout(1000 * SETTLED_S)
            begun, before = time.perf_counter(), _used_s(app.process.pid)
            button.click()
            page.page.wait_for_function(DRAWN, timeout=120_000)
            took, used = time.perf_counter() - begun, _used_s(app.process.pid) - before
            page.page.get_by_text("The checks of the data").or_(
                page.page.locator("th", has_text="check")
            ).first.wait_for()
            checked = time.perf_counter() - begun
            page.page.wait_for_timeout(500)
            print(f"long{form} of {ROWS} rows x 6: drawn after {took:.1f} s", end=" ")
            print(f"(limit {DRAWN_S:g}; server {used:.1f} s on a processor),", end=" ")
            print(f"checked after {checked:.1f} s,", end=" ")
            print(f"panned at {_pan(page):.0f} frames a second (limit {FRAMES:g} or more)")
            page.context.close()
        (folder / ".tiltcal-app.json").unlink()
        (folder / f"long{form}").unlink()


def _pan(page: Page) -> float:
    """Painted frames a second while the mouse drags the plot to and fro."""
    area = page.page.locator(".figure .plot .nsewdrag").first
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.evaluate(COUNT)
    mouse = page.page.mouse
    mouse.move(x, y)
    mouse.down()
    begun, step = time.perf_counter(), 0
    while time.perf_counter() - begun < DRAG_S:
        step += 1
        mouse.move(x + 0.3 * box["width"] * np.sin(step / 20), y)
    took = time.perf_counter() - begun
    painted = page.page.evaluate("window.painted")
    mouse.up()
    return float(painted / took)


class Sender(threading.Thread):
    """A sensor that sends lines over TCP at its rate, and turns from pose to pose.

    Args:
        length_s: after which it ends.
    """

    def __init__(self, length_s: float) -> None:
        super().__init__(daemon=True)
        self._length = length_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.sent = 0
        self.ended = threading.Event()

    def run(self) -> None:
        """Send until the end."""
        wire, _ = self._server.accept()
        begun = time.monotonic()
        with wire, self._server:
            names = [f"accel_{a}_m_s2" for a in "xyz"] + [f"gyro_{a}_deg_s" for a in "xyz"]
            wire.sendall(f"time_s,{','.join(names)}\n".encode())
            for stamp, text in self._blocks():
                time.sleep(max(0.0, begun + stamp - time.monotonic()))
                wire.sendall(text)
                self.sent += BLOCK
                if stamp >= self._length:
                    break
            self.ended.wait()

    def _blocks(self):
        """The latest stamp of some lines, and their text."""
        hand = Hand(rate_hz=RATE_HZ, white=100e-6 * 9.80665 * np.sqrt(RATE_HZ))
        rng = np.random.default_rng(1)
        poses = np.vstack([directions(scheme) for scheme in ("6", "12", "8")])
        number = 0
        while True:
            for stamps, read in (hand.turn(poses[number % 26], MOVE_S), hand.hold(HOLD_S)):
                gyro = rng.normal(0, 0.05, (len(stamps), 3))
                table = np.column_stack([stamps, *read.values(), gyro])
                for first in range(0, len(table), BLOCK):
                    rows = table[first : first + BLOCK]
                    lines = (
                        ",".join(f"{v:.6g}" if k else f"{v:.3f}" for k, v in enumerate(row))
                        for row in rows
                    )
                    yield float(rows[-1, 0]), ("\n".join(lines) + "\n").encode()
            number += 1


def _used_s(pid: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident_mib(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(x for x in lines if x.startswith("VmRSS")).split()[1]) / 1024


@contextmanager
def _guiding(browser, folder: Path, sender: Sender):
    """The Guide page, with a source that has begun to send."""
    (folder / "hand.toml").write_text(held_by_hand(1000))
    with running(folder, "--token", TOKEN) as app:
        page = Page(browser, app)
        page.page.get_by_role("button", name="hand.toml", exact=True).click()
        page.go("Guide")
        page.fill("Source", f"tcp://127.0.0.1:{sender.port}")
        page.fill("Goals: the largest σ of each kind", "bias=0.1ug")  # never reached
        page.page.wait_for_function("document.body.textContent.includes('--goal bias=0.1ug')")
        sender.start()
        page.press("Start")
        page.page.get_by_text("rows;").first.wait_for()
        yield app.process.pid, page
        page.context.close()


def _guide(browser, folder: Path) -> None:
    """Share of a core, how far the page is behind, and memory."""
    sender = Sender(LIVE_S)
    with _guiding(browser, folder, sender) as (pid, page):
        before, begun, behind = _used_s(pid), time.monotonic(), []
        while sender.sent < LIVE_S * RATE_HZ:
            page.page.wait_for_timeout(1000)
            shown = page.page.evaluate("/(\\d+) rows/.exec(document.body.textContent)[1]")
            behind.append((sender.sent - int(shown)) / RATE_HZ)
        share = (_used_s(pid) - before) / (time.monotonic() - begun)
        memory = _resident_mib(pid)
        sender.ended.set()
    print(f"guide page, {LIVE_S:g} s of {RATE_HZ} Hz x 6 over TCP: {share:.2f} of a core", end=" ")
    print(f"(limit {SHARE:g}), behind by {statistics.median(behind):.2f} s,", end=" ")
    print(f"at most {max(behind):.1f} s, {memory:.0f} MiB")
