"""The command line. Exit status: 0 done and accepted, 1 judged and not accepted, 2 unusable input,
130 interrupted, 143 ended by SIGTERM.
"""

import os
import sys
from collections.abc import Sequence

TRACEBACK = "TILTCAL_TRACEBACK"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status, never with a traceback.

    Args:
        arguments: None: those of the program.
    """
    from tiltcal.cli.signals import ignore, unwinding

    status = 0
    try:
        if arguments is None:
            _quiet()
        with unwinding():
            status = _run_command(sys.argv[1:] if arguments is None else arguments)
    finally:
        if arguments is None:
            ignore()  # nothing is left to be interrupted
    return status


def _quiet() -> None:
    """No warnings of libraries between the lines of a command, unless Python is asked for them."""
    import warnings

    if not sys.warnoptions and not os.environ.get(TRACEBACK):
        warnings.simplefilter("ignore")


def _run_command(arguments: Sequence[str]) -> int:
    """Run a command; no exception passes it without the one message."""
    from tiltcal.cli.signals import received
    from tiltcal.core.errors import TiltcalError

    try:
        from tiltcal.cli.app import run
        from tiltcal.core.budget import restoring

        with restoring():
            status = run(arguments)
        sys.stdout.flush()  # a closed pipe is noticed here, not at exit
        return status
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except SystemExit as stop:
        if isinstance(stop.__context__, BrokenPipeError):  # rich ends the process on a closed pipe
            return 0
        raise
    except Exception as error:
        if received:  # what an interrupt has become on its way
            return _interrupted()
        if isinstance(error, TiltcalError):
            return _refused(str(error))
        if isinstance(error, OSError):
            return _refused(_from_system(error))
        if os.environ.get(TRACEBACK):
            raise
        return _refused(_unexpected(error))


def _interrupted() -> int:
    """One line, and the exit status of the signal that came."""
    from tiltcal.cli.signals import INTERRUPTED, TERMINATED, terminated
    from tiltcal.core.files import remove_temporary

    remove_temporary()
    text = "ended by SIGTERM" if terminated() else "interrupted"
    print(f"tiltcal: {text}; no partial output is left", file=sys.stderr)
    return TERMINATED if terminated() else INTERRUPTED


def _refused(message: str) -> int:
    """The one message, and the exit status of unusable input."""
    from tiltcal.core.safe_text import plain, shortened

    print(shortened(plain(f"tiltcal: {message}")), file=sys.stderr)
    return 2


def _from_system(error: OSError) -> str:
    """The message for what the operating system refuses."""
    name = "" if error.filename is None else f" {error.filename}"
    reason = (error.strerror or str(error)).lower()
    return (
        f"file or device{name}: found {reason}, need one that can be read and written; choose"
        " another, or free some space"
    )


def _unexpected(error: Exception) -> str:
    """The message for what should not have happened."""
    again = f"run again with {TRACEBACK}=1 and report what it prints"
    if isinstance(error, MemoryError):
        return f"memory: found none left, need more of it; use shorter recordings, or {again}"
    if isinstance(error, RecursionError):
        return f"input: found tables nested too deeply, need flat ones; write them flat, or {again}"
    if isinstance(error, OverflowError):
        return f"input: found numbers too large to compute with, need smaller ones; or {again}"
    name = type(error).__name__
    errors = getattr(error, "errors", None)
    if name == "ValidationError" and errors is not None:  # of pydantic, without its import
        first = errors()[0]
        where = ".".join(map(str, first["loc"])) or "a key"
        return f"input, {where}: found a wrong value, need another: {first['msg']}; or {again}"
    return f"found an internal error ({name}: {error}), need a bug report; {again}"


if __name__ == "__main__":
    sys.exit(main())
