"""``tiltcal completion``."""

from typing import Annotated, Literal

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_line, print_note


def completion(
    shell: Annotated[Literal["bash", "zsh", "fish"], Parameter(help="Shell of the script.")],
    /,
    *,
    install: Annotated[
        bool,
        Parameter(help="Write the script to the shell's own folder and load it at startup."),
    ] = False,
    as_json: Json = False,
) -> int:
    """Print or install the completion script of a shell.

    Completion covers commands, options and their choices.

      tiltcal completion bash --install
      tiltcal completion zsh > ~/.zfunc/_tiltcal
    """
    from tiltcal.cli.app import make_app

    app = make_app()
    if install:
        location = app.install_completion(shell=shell)
        if as_json:
            print_json({"shell": shell, "file": str(location)})
        else:
            print_note(f"{location}: written; it applies to new shells")
        return 0
    script = app.generate_completion(shell=shell)
    if as_json:
        print_json({"shell": shell, "script": script})
    else:
        print_line(script.rstrip("\n"))
    return 0
