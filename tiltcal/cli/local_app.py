"""``tiltcal app``."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import WHOLE, Json, between
from tiltcal.cli.output import print_json, print_line, print_note
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder
from tiltcal.core.optional_library import library

PORT = Parameter(converter=WHOLE.converter, validator=between(0, 65535))
LOOPBACK = ("127.0.0.1", "::1", "localhost")
SHORTEST_TOKEN = 16  # characters: 64 bits or more, if they are drawn


def app(
    workspace: Annotated[
        Path, Parameter("WORKSPACE", help="Folder of recordings and results; made if missing.")
    ] = Path(),
    /,
    *,
    host: Annotated[str, Parameter(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, PORT, Parameter(help="TCP port; 0: a free one.")] = 0,
    no_browser: Annotated[bool, Parameter(help="Print the address, and open no browser.")] = False,
    token: Annotated[
        str | None,
        Parameter(help="Token of the address instead of one that is drawn and valid once."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Open the bench in a browser: import, calibrate, certify, diagnose, plan.

    A web application of this machine: it works in one folder, listens on the
    loopback address, and lets in the browser that opens the printed address.
    Each action is shown as the command that does the same. It runs until it is
    interrupted. It needs the extra tiltcal[app].

      tiltcal app bench
      tiltcal app bench --port 8080 --no-browser
    """
    library("nicegui", "app", "tiltcal app")
    from tiltcal.app.server import serve

    if token is not None and len(token) < SHORTEST_TOKEN:
        raise TiltcalError(
            "--token",
            found=f"{len(token)} characters",
            need=f"at least {SHORTEST_TOKEN}",
            do="leave it out: one is drawn",
        )
    if host not in LOOPBACK:
        print_note(
            f"{host}: other machines can reach this address, and what they send is not encrypted"
        )

    def show(address: str) -> None:
        """Print where the application is, at once."""
        if as_json:
            print_json({"address": address, "workspace": str(workspace.absolute())})
        else:
            print_line(address)
        sys.stdout.flush()

    serve(make_folder(workspace), host, port, token, show, not no_browser)
    return 0
