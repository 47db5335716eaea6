"""The one error that users see: what was found, what is needed, what to do."""

from collections.abc import Callable, Collection
from typing import Any

MOST_FOUND = 2000  # characters of what was found: need and do stay in sight


class TiltcalError(Exception):
    """Unusable input. The message names the subject, what was found, what is needed and what to do.

    Args:
        subject: the file, row, column, key or step it is about.
        found: what stands there.
        need: what has to stand there.
        do: the next step for the user, as an imperative.
    """

    def __init__(self, subject: str, *, found: str, need: str, do: str) -> None:
        found = found if len(found) <= MOST_FOUND else f"{found[:MOST_FOUND]} ..."
        self.subject, self.found, self.need, self.do = subject, found, need, do
        super().__init__(f"{subject}: found {found or 'nothing'}, need {need}; {do}")

    def __reduce__(self) -> "tuple[Callable[..., TiltcalError], tuple[str, str, str, str]]":
        """So that the error of another process arrives whole."""
        return _rebuilt, (self.subject, self.found, self.need, self.do)


def _rebuilt(subject: str, found: str, need: str, do: str) -> TiltcalError:
    return TiltcalError(subject, found=found, need=need, do=do)


def shown(value: Any) -> str:
    """A value in a message, shortened; ``repr`` alone refuses whole numbers of thousands of
    digits.
    """
    try:
        text = repr(value)
    except ValueError:
        return "a whole number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:57]}..."


def one_of(token: str, valid: Collection[str], subject: str, what: str = "") -> str:
    """``token`` when it is valid.

    Args:
        token: as the user wrote it.
        valid: valid entries.
        subject: file and key of the entry.
        what: kind of the entry, when the subject does not state it.

    Raises:
        TiltcalError: it is none of them.
    """
    if token not in valid:
        close = nearest_of(token, list(valid))
        raise TiltcalError(
            subject,
            found=f"{what} '{token}'".strip(),
            need="one of " + ", ".join(valid),
            do=f"did you mean '{close}'?" if close else "correct it",
        )
    return token


def nearest(token: str, valid: list[str]) -> str:
    """A hint ``did you mean ...`` with the nearest valid entry, or the list of all when none is
    near.
    """
    close = nearest_of(token, valid)
    return f"did you mean '{close}'?" if close else "valid are " + ", ".join(sorted(valid))


def nearest_of(token: str, valid: list[str]) -> str:
    """The valid entry that is nearest to a token; empty when none is near."""
    import difflib

    close = difflib.get_close_matches(token, valid, n=1, cutoff=0.5)
    # the first letters are often right
    return next(iter(close or (v for v in valid if token[:4] and v.startswith(token[:4]))), "")
