"""``tiltcal app``."""

import socket
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import WHOLE, Json, between
from tiltcal.cli.output import print_json, print_line
from tiltcal.core.addresses import host_of
from tiltcal.core.errors import TiltcalError
from tiltcal.core.optional_library import library


def bench_app(
    workspace: Annotated[Path, Parameter("WORKSPACE", help="Folder that it works in.")] = Path(),
    /,
    *,
    host: Annotated[str, Parameter(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int,
        Parameter(
            converter=WHOLE.converter,
            validator=between(0, 65535),
            help="TCP port; 0: a free one.",
        ),
    ] = 0,
    token: Annotated[
        str | None, Parameter(help="Token of the address; a new one each time if not given.")
    ] = None,
    browser: Annotated[
        bool, Parameter(negative="--no-browser", help="Open the address in a browser.")
    ] = True,
    as_json: Json = False,
) -> int:
    """Open the bench in a browser: import, calibrate, diagnose and plan.

    A server of this machine, for whoever has the address with its token. Everything
    that it does is a command of its own, shown to be copied; its files lie in
    WORKSPACE. It runs until it is interrupted. Needs the extra tiltcal[app].

      tiltcal app bench-folder
      tiltcal app bench-folder --port 8080 --no-browser
    """
    library("nicegui", "app", "the application")
    from tiltcal.app.server import serve

    used = port or _free_port(host_of(host))

    def ready(address: str) -> None:
        if as_json:
            print_json({"address": address})
        else:
            print_line(f"open {address}")
        sys.stdout.flush()
        if browser:
            webbrowser.open(address)

    serve(workspace, host, used, token, ready)
    return 0


def _free_port(host: str) -> int:
    try:
        with socket.create_server((host, 0)) as probe:
            return int(probe.getsockname()[1])
    except OSError as error:
        raise TiltcalError(
            f"host {host}",
            found=(error.strerror or str(error)).lower(),
            need="an address of this machine",
            do="correct --host",
        ) from error
