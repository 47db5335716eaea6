"""``tiltcal app`` as a process of its own, requests to it, and a page of it in a browser."""

import http.client
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

TOKEN = "a-token-for-every-test-0123456789"
PATIENCE_MS = 120_000  # a machine that is busy is no failure


@dataclass
class Running:
    """A running application.

    Args:
        folder: its workspace.
        address: that it printed.
        process: of it.
    """

    folder: Path
    address: str
    process: subprocess.Popen

    @property
    def host(self):
        """Host and port."""
        return urlsplit(self.address).netloc

    def request(self, method, path, body=None, cookie=None, **headers):
        """Status, headers and content of an answer."""
        connection = http.client.HTTPConnection(self.host, timeout=20)
        if cookie is not None:
            headers["Cookie"] = cookie
        try:
            connection.putrequest(method, path, skip_host="Host" in headers)
            for name, value in headers.items():
                connection.putheader(name.replace("_", "-"), value)
            if body is not None and "Content_Length" not in headers:
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def enter(self):
        """The cookie that the token is exchanged for."""
        status, headers, _ = self.request("GET", f"/?token={TOKEN}")
        assert status == 200
        assert "HttpOnly" in headers["set-cookie"]
        assert "SameSite=Strict" in headers["set-cookie"]
        return headers["set-cookie"].partition(";")[0]


def held_by_hand(rate_hz):
    """A scenario of an accelerometer triad that is turned by hand."""
    return HELD_BY_HAND.format(rate_hz=rate_hz)


HELD_BY_HAND = """schema = 1
name = "live"
[site]
gravity_m_s2 = 9.80123
[rig]
table = "handheld"
[[sensor]]
name = "accel"
kind = "accelerometer"
rate_hz = {rate_hz}
adjustable = ["bias", "scale", "cross_axis"]
"""


@contextmanager
def running(folder, *words):
    """An application in a folder, until the block ends."""
    command = [sys.executable, "-P", "-m", "tiltcal", "app", str(folder), "--no-browser", *words]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder.parent
    ) as process:
        try:
            address = process.stdout.readline().strip()
            assert address.startswith("http://"), process.stderr.read()
            yield Running(folder, address, process)
        finally:
            process.terminate()
            _, said = process.communicate(timeout=30)
            assert "Traceback" not in said, said


class Page:
    """A page of the application in a browser, and what it complained of or asked for."""

    def __init__(self, browser, app, size=(1280, 900), scheme="light"):
        viewport = {"width": size[0], "height": size[1]}
        self.context = browser.new_context(viewport=viewport, color_scheme=scheme)
        self.app, self.complaints, self.asked = app, [], []
        self.page = self._tab()
        self.page.goto(f"http://{app.host}/?token={TOKEN}")
        self.page.wait_for_function("window.did_handshake", timeout=PATIENCE_MS)

    def _tab(self):
        page = self.context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("console", self._noted)
        page.on("request", lambda request: self.asked.append(request.url))
        return page

    def _noted(self, message):
        if message.type == "error":
            self.complaints.append(message.text)

    def second_tab(self, path):
        """Another tab of the same browser."""
        page = self._tab()
        page.goto(f"http://{self.app.host}{path}")
        page.wait_for_function("window.did_handshake")
        return page

    def go(self, title):
        """Another page, by its link."""
        self.page.get_by_role("link", name=title, exact=True).click()
        self.page.wait_for_function(
            f"window.did_handshake && document.title.startsWith('{title} ')"
        )

    def press(self, name):
        """A button, by the keyboard: beside a frame of no origin a headless mouse misses it."""
        button = self.page.get_by_role("button", name=name, exact=True)
        button.wait_for()
        button.focus()
        self.page.keyboard.press("Enter")

    def fill(self, label, text):
        """An input, until the server has it."""
        control = self.page.get_by_label(label, exact=True)
        control.fill(text)
        control.press("Tab")
        self.page.wait_for_timeout(150)

    def shows(self, selector):
        """Wait for an element."""
        return self.page.wait_for_selector(selector)

    def commands(self):
        """The commands that are shown."""
        return [
            text.strip() for text in self.page.locator(".action .command code").all_inner_texts()
        ]

    def command(self, beginning):
        """The command that begins so."""
        return next(c for c in self.commands() if c.startswith(beginning))

    def overflows(self):
        """How many pixels the page is wider than the window."""
        return self.page.evaluate(
            "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        )

    def require_clean(self):
        """No complaint, and nothing asked of another machine."""
        assert self.complaints == []
        hosts = {urlsplit(url).netloc for url in self.asked if url.startswith(("http", "ws"))}
        assert hosts <= {self.app.host}
