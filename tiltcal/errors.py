"""The one error that users see: what was found, what is needed, what to do."""


class TiltcalError(Exception):
    """Unusable input. The message names the subject, what was found, what is needed and what to do.

    Args:
        subject: the file, row, column, key or step it is about.
        found: what stands there.
        need: what has to stand there.
        do: the next step for the user, as an imperative.
    """

    def __init__(self, subject: str, *, found: str, need: str, do: str) -> None:
        self.subject, self.found, self.need, self.do = subject, found, need, do
        super().__init__(f"{subject}: found {found}, need {need}; {do}")


def nearest(word: str, valid: list[str]) -> str:
    """A hint ``did you mean ...`` with the nearest valid word, or the list of all when none is near."""
    import difflib

    close = difflib.get_close_matches(word, valid, n=1, cutoff=0.5)
    if not close:  # the beginning of a word often survives where the rest does not
        close = [v for v in valid if v.startswith(word[:4])][:1]
    if close:
        return f"did you mean '{close[0]}'?"
    return "valid are " + ", ".join(sorted(valid))
