"""The command line. Exit status: 0 done and accepted, 1 judged and not accepted, 2 unusable input,
130 interrupted.
"""

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, never with a traceback; the entry point of ``tiltcal``."""
    import os

    from tiltcal.core.errors import TiltcalError

    try:
        status = _run(arguments)
        sys.stdout.flush()  # a reader that has gone is noticed here, not at exit
        return status
    except TiltcalError as error:
        print(f"tiltcal: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("tiltcal: interrupted; nothing half-written is left behind", file=sys.stderr)
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get("TILTCAL_TRACEBACK"):
            raise
        name = type(error).__name__
        print(
            f"tiltcal: found an error of its own ({name}: {error}), need a bug report; "
            "do: run again with TILTCAL_TRACEBACK=1 and report what it prints",
            file=sys.stderr,
        )
        return 2


def _run(arguments: Sequence[str] | None) -> int:
    from tiltcal.cli.parser import build_parser

    parser = build_parser()
    args = parser.parse_args(arguments)
    if getattr(args, "command", None) is None:
        parser.print_help()
        return 0
    return int(args.run(args))


if __name__ == "__main__":
    sys.exit(main())
