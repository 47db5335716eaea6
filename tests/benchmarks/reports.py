"""Size of the demo's reports, and what it costs a browser to open them: by the clock, and of its
processor time. Needs Debian's Chromium.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PHONE = {"width": 390, "height": 800}
LIMIT_MiB, LIMIT_S = 6.0, 2.0


def main() -> None:
    """A line for each page."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        print("reports: no Chromium on this machine")
        return
    from playwright.sync_api import sync_playwright

    print(f"opening a report (at most {LIMIT_MiB:g} MiB, {LIMIT_S:g} s)")
    with tempfile.TemporaryDirectory() as place, sync_playwright() as play:
        command = [str(Path(sys.executable).with_name("tiltcal")), "demo", "-o", place, "--quiet"]
        subprocess.run(command, check=True, capture_output=True)
        browser = play.chromium.launch(executable_path=found, args=["--no-sandbox"])
        for path in sorted(Path(place).rglob("*.html")):
            page = browser.new_context(viewport=PHONE).new_page()
            costs = page.context.new_cdp_session(page)
            costs.send("Performance.enable", {"timeDomain": "threadTicks"})
            start = time.perf_counter()
            page.goto(path.as_uri())
            wall = time.perf_counter() - start
            told = costs.send("Performance.getMetrics")["metrics"]
            cpu = next(m["value"] for m in told if m["name"] == "TaskDuration")
            size = path.stat().st_size / 2**20
            name = path.relative_to(place)
            print(f"  {name!s:32s} {size:4.1f} MiB  {wall:5.2f} s  processor {cpu:5.2f} s")
        browser.close()


if __name__ == "__main__":
    main()
