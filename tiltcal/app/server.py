"""The server of the application: one workspace, one session, one process."""

import asyncio
import importlib
import os
import socket
import sys
import webbrowser
from collections.abc import Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError

os.environ["NICEGUI_STORAGE_PATH"] = os.devnull  # NiceGUI keeps nothing of its own

import uvicorn
from fastapi import FastAPI, Response
from fastapi.responses import FileResponse, PlainTextResponse
from nicegui import ui

from tiltcal.app import open_page
from tiltcal.app.guard import Guard, Keys
from tiltcal.app.session import Session
from tiltcal.app.shell import follow_recording, frame
from tiltcal.app.transfers import routes
from tiltcal.app.workspace import Workspace
from tiltcal.report.page import TEMPLATES

RECONNECT_S = 30.0  # in which a tab that lost its connection is taken up again
CONTENT = {
    "/": open_page.__name__,
    "/recording": "tiltcal.app.recording_page",
    "/calibrate": "tiltcal.app.calibrate_page",
    "/diagnose": "tiltcal.app.diagnose_page",
    "/plan": "tiltcal.app.plan_page",
    "/guide": "tiltcal.app.guide_page",
}
"""The module of each page. All but the first take a second to import, as what they show does: they
are loaded beside the start.
"""
WARM = ("tiltcal.api.scenario", "tiltcal.report.series", *CONTENT.values())


def serve(
    folder: Path,
    host: str,
    port: int,
    token: str | None,
    ready: Callable[[str], None],
    browser: bool,
) -> None:
    """Serve a workspace until the process is interrupted.

    Args:
        folder: the workspace.
        host: address to listen on.
        port: 0: a free one.
        token: of the address; None: drawn, for one use.
        ready: called with the address, once it answers.
        browser: whether it is opened there.

    Raises:
        TiltcalError: the address cannot be listened on.
    """
    session = Session(Workspace(folder))
    follow_recording(session)
    listening = _socket(host, port)
    keys = Keys(token, listening.getsockname()[1])
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{listening.getsockname()[1]}/?token={keys.token}"

    def started() -> None:
        ready(address)
        if browser:
            webbrowser.open(address)

    app = application(session, started)
    guarded = Guard(app, keys, host, listening.getsockname()[1])
    config = uvicorn.Config(
        guarded, log_level="critical", ws="wsproto", server_header=False, access_log=False
    )
    uvicorn.Server(config).run(sockets=[listening])


def application(session: Session, started: Callable[[], None]) -> FastAPI:
    """The pages, uploads, files and scripts of a session."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> Any:
        warming = asyncio.create_task(asyncio.to_thread(_warm))
        asyncio.get_running_loop().call_later(0.05, started)  # the socket listens already
        yield
        warming.cancel()
        await session.jobs.end()

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan)
    app.include_router(routes(session))

    @app.get("/_tiltcal/{name}")
    def script(name: str) -> Response:
        path = _scripts().get(name)
        if path is None:
            return PlainTextResponse("no such script", 404)
        return FileResponse(path, headers={"Cache-Control": "private, max-age=3600"})

    for path in CONTENT:
        _add_page(session, path)
    ui.run_with(
        app,
        title="tiltcal",
        dark=None,
        tailwind=False,
        reconnect_timeout=RECONNECT_S,
        show_welcome_message=False,
        language="en-US",
        favicon=ICON,
    )
    return app


ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><circle cx="8" cy="8" r="6.5"'
    ' fill="none" stroke="#2b6cb0" stroke-width="1.6"/><path d="M3 10.5 13 5.5" stroke="#2b6cb0"'
    ' stroke-width="1.8"/></svg>'
)


def _add_page(session: Session, path: str) -> None:
    def page() -> None:
        frame(session, path, lambda: importlib.import_module(CONTENT[path]).build(session))

    ui.page(path)(page)


def _scripts() -> dict[str, Path]:
    import plotly

    folder = Path(str(plotly.__file__)).parent / "package_data"
    return {"plotly.js": folder / "plotly.min.js", "drawing.js": TEMPLATES / "drawing.js"}


def _warm() -> None:
    for name in WARM:
        importlib.import_module(name)


def _socket(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Raises:
        TiltcalError: the address is not ours, or the port is taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    if sys.platform != "win32":
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host, port))
        made.listen()
    except OSError as error:
        made.close()
        raise TiltcalError(
            f"address {host}:{port}",
            found=(error.strerror or str(error)).lower(),
            need="an address of this machine and a free port",
            do="choose another --port, or leave it out",
        ) from error
    return made
