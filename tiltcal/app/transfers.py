"""Files between browser and workspace: uploads are streamed to disk, and what is shown of a file
cannot act in the application's name.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path
from secrets import token_hex
from urllib.parse import unquote

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse, Response

from tiltcal.app.session import Session
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import TEMPORARY

LARGEST_UPLOAD = 1 << 30  # bytes: a log beyond that exceeds the 2048 MiB that reading it may take
HEADROOM = 256 << 20  # bytes of the disk that an upload leaves free
CONFINED = (
    "sandbox allow-scripts allow-modals; default-src 'none'; script-src 'unsafe-inline'"
    " 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:; font-src data:;"
    " frame-ancestors 'self'"
)
"""A report draws its plots by its own script; as a page of no origin it reaches neither the
application nor the network.
"""
SHOWN = {".html": "text/html", ".svg": "image/svg+xml", ".png": "image/png"}
"""What a browser may show; the rest is text or a download."""


def routes(session: Session) -> APIRouter:
    """The routes of uploads and files."""
    router = APIRouter()

    @router.put("/upload")
    async def upload(request: Request) -> Response:
        try:
            path = await receive(request, session)
        except TiltcalError as error:
            status = 413 if "bytes" in error.found else 400
            return JSONResponse({"error": str(error)}, status)
        session.listed()
        return JSONResponse({"name": path.name})

    @router.get("/files/{name:path}")
    async def file(name: str, download: bool = False) -> Response:
        try:
            path = session.workspace.path(name)
        except TiltcalError as error:
            return PlainTextResponse(f"tiltcal: {error}", 403)
        if not path.is_file():
            return PlainTextResponse("tiltcal: no such file", 404)
        kind = SHOWN.get(path.suffix.lower(), "text/plain; charset=utf-8")
        headers = {"Content-Security-Policy": CONFINED, "Cache-Control": "no-store"}
        if download:
            return FileResponse(path, headers=headers, filename=path.name)
        return FileResponse(path, headers=headers, media_type=kind)

    return router


async def receive(request: Request, session: Session) -> Path:
    """Stream an upload into the workspace; what is not whole is removed.

    Args:
        request: with the content as its body, and its name in the header ``x-file-name``.
        session: of the workspace.

    Raises:
        TiltcalError: it is no name, too large, or does not fit on the disk.
    """
    path = session.workspace.new(unquote(request.headers.get("x-file-name", "")))
    stated = request.headers.get("content-length", "")
    _require_room(int(stated) if stated.isdigit() else 0, path)
    part = path.with_name(f"{TEMPORARY}{token_hex(8)}")
    size = 0
    try:
        with part.open("xb") as out:
            async for block in request.stream():
                size += len(block)
                _require_room(size, path, len(block))
                out.write(block)
        path = session.workspace.new(path.name)  # another may have come meanwhile
        os.replace(part, path)
    finally:
        with suppress(FileNotFoundError):
            part.unlink()
    return path


def _require_room(size: int, path: Path, more: int | None = None) -> None:
    """Refuse what is too large, or fills the disk.

    Args:
        size: bytes so far, or as announced.
        path: where it goes.
        more: bytes that are about to be written; None: all of ``size``.

    Raises:
        TiltcalError: it does.
    """
    free = shutil.disk_usage(path.parent).free - HEADROOM
    if size > LARGEST_UPLOAD or (size if more is None else more) > free:
        raise TiltcalError(
            f"upload {path.name}",
            found=f"{size} bytes",
            need=f"at most {min(LARGEST_UPLOAD, max(free, 0))} bytes",
            do="put the file into the workspace folder yourself, or cut it",
        )
