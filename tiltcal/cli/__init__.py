"""The command line. Exit status: 0 done and accepted, 1 judged and not accepted, 2 unusable input, 130 interrupted."""

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the entry point of ``tiltcal``."""
    from tiltcal.cli.parser import build_parser

    parser = build_parser()
    args = parser.parse_args(arguments)
    if getattr(args, "command", None) is None:
        parser.print_help()
        return 0
    return guarded(args.run, args)


def guarded(run: object, args: object) -> int:
    """Run a command so that the user never sees a traceback."""
    import os

    from tiltcal.errors import TiltcalError

    try:
        return int(run(args))  # type: ignore[operator]
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


if __name__ == "__main__":
    sys.exit(main())
