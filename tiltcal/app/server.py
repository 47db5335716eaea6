"""The application as a server of this machine."""

import secrets
from collections.abc import Callable
from pathlib import Path

from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse
from nicegui import app, ui

from tiltcal.app.bench import Bench, progress
from tiltcal.app.calibrate_page import calibrate_page
from tiltcal.app.diagnose_page import diagnose_page
from tiltcal.app.guard import Guard, Keys
from tiltcal.app.guide_page import guide_page
from tiltcal.app.open_page import open_page
from tiltcal.app.plan_page import plan_page
from tiltcal.app.recording_page import recording_page
from tiltcal.app.workspace import PAGES, Workspace
from tiltcal.core.errors import TiltcalError

TABS = {
    "Open": open_page,
    "Recording": recording_page,
    "Calibrate": calibrate_page,
    "Diagnose": diagnose_page,
    "Plan": plan_page,
    "Guide": guide_page,
}
STYLE = Path(__file__).with_name("style.css")
HTML = "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; frame-ancestors 'self'"


def serve(
    folder: Path,
    host: str,
    port: int,
    token: str | None,
    ready: Callable[[str], None],
) -> None:
    """Serve the application until it is interrupted.

    Args:
        folder: the workspace.
        host, port: to listen on.
        token: that has to be brought; a new one if not given.
        ready: is called with the address to open.

    Raises:
        TiltcalError: the folder cannot be made.
    """
    import uvicorn

    bench = Bench(Workspace(folder))
    keys = Keys(token, port)
    inside = FastAPI(openapi_url=None)
    inside.add_api_route("/file/{name:path}", lambda name: _file(bench, name), methods=["GET"])
    ui.page("/", title=f"tiltcal: {bench.workspace.folder.name}")(lambda: _page(bench))
    app.on_startup(lambda: ready(f"http://{host}:{port}/?token={keys.token}"))
    ui.run_with(inside, dark=None, storage_secret=secrets.token_urlsafe(24))
    # the guard stands before everything, websockets and NiceGUI's own routes too
    uvicorn.run(Guard(inside, keys, host, port), host=host, port=port, log_level="warning")


def _file(bench: Bench, name: str) -> FileResponse:
    """A file of the workspace: a report to look at, everything else to download."""
    try:
        path = bench.path(name)
    except TiltcalError as error:
        raise HTTPException(404) from error
    if not path.is_file():
        raise HTTPException(404)
    if path.suffix.lower() in PAGES:
        return FileResponse(path, headers={"Content-Security-Policy": HTML})
    return FileResponse(path, filename=path.name, media_type="application/octet-stream")


def _page(bench: Bench) -> None:
    """All pages, as tabs; only that which is looked at is drawn."""
    ui.add_css(STYLE.read_text(encoding="utf-8"))
    space = bench.workspace
    now = space.chosen.tab if space.chosen.tab in TABS else "Open"

    @ui.refreshable
    def content() -> None:
        TABS[now](bench)

    def turn(name: str) -> None:
        nonlocal now
        if name != now:
            now = name
            space.choose(tab=name)
            content.refresh()

    with ui.header().classes("items-center q-py-xs"):
        ui.label("tiltcal").classes("text-h6")
        ui.label(space.folder.name).classes("opacity-75")
    with ui.tabs() as tabs:
        for name in TABS:
            ui.tab(name).props("no-caps")
    tabs.set_value(now)
    tabs.on_value_change(lambda event: turn(str(event.value)))
    tabs.classes("w-full").props("dense align=left mobile-arrows")
    progress(bench)
    with ui.column().classes("w-full q-px-md"):
        content()
    client = ui.context.client
    bench.shown(client.id, content.refresh)
    client.on_delete(lambda: bench.left(client.id))
