"""What to say of a foreign file that its library cannot read."""

from tiltcal.core.errors import TiltcalError


def unreadable(source: str, format: str, error: BaseException) -> TiltcalError:
    """What to raise where a library cannot read a file."""
    text = str(error).strip().splitlines()
    return TiltcalError(
        f"foreign recording {source}",
        found=text[0][:200] if text else type(error).__name__,
        need=f"a whole {format} file",
        do="check the file, or export it again",
    )
