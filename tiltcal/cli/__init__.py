"""The command line. Exit status: 0 done and accepted, 1 judged and not accepted, 2 unusable input,
130 interrupted.
"""

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status, never with a traceback."""
    import os

    from tiltcal.cli.app import run
    from tiltcal.core.errors import TiltcalError

    try:
        status = run(sys.argv[1:] if arguments is None else arguments)
        sys.stdout.flush()  # a closed pipe is noticed here, not at exit
        return status
    except TiltcalError as error:
        print(f"tiltcal: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("tiltcal: interrupted; no partial output is left", file=sys.stderr)
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except SystemExit as stop:
        if isinstance(stop.__context__, BrokenPipeError):  # rich ends the process on a closed pipe
            return 0
        raise
    except Exception as error:
        if os.environ.get("TILTCAL_TRACEBACK"):
            raise
        name = type(error).__name__
        print(
            f"tiltcal: found an internal error ({name}: {error}), need a bug report; "
            "run again with TILTCAL_TRACEBACK=1 and report what it prints",
            file=sys.stderr,
        )
        return 2


if __name__ == "__main__":
    sys.exit(main())
