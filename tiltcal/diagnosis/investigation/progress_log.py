"""How far an investigation is, and its log."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Entry:
    """One block that was recorded.

    Args:
        block: its name; words: why; minutes: of table time; confidence: probability, as planned,
            that the verdict then is `explained`.
        sequence, recording: file names.
    """

    block: str
    words: str
    minutes: float
    confidence: float
    sequence: str
    recording: str


@dataclass(frozen=True)
class Investigation:
    """How far it is.

    Args:
        given: recordings that it began with; entries: blocks recorded since; verdicts: after each
            diagnosis.
        statement: where it stands, in words.
    """

    given: tuple[str, ...]
    entries: tuple[Entry, ...] = ()
    verdicts: tuple[str, ...] = ()
    statement: str = ""

    @property
    def minutes(self) -> float:
        """Table time of all that was recorded."""
        return sum(e.minutes for e in self.entries)

    @property
    def designed(self) -> int:
        """How many blocks were designed: with nothing given the first one was not."""
        return len(self.entries) - (0 if self.given else 1)

    @property
    def explained(self) -> bool:
        """Whether nothing is left open."""
        return bool(self.verdicts) and self.verdicts[-1] in DONE

    def to_json(self) -> dict[str, Any]:
        """As the file has it."""
        return {
            "schema": 1,
            "explained": self.explained,
            "statement": self.statement,
            "given": list(self.given),
            "verdicts": list(self.verdicts),
            "blocks": [asdict(e) for e in self.entries],
            "table_minutes": self.minutes,
        }


def log_of(state: Investigation) -> str:
    """The story in words."""
    lines = [
        "# Investigation",
        "",
        f"Began with: {', '.join(state.given) or 'nothing recorded'}.",
        "",
    ]
    verdicts = list(state.verdicts)
    if state.given and verdicts:
        lines.append(f"- Diagnosed: **{verdicts.pop(0)}**.")
    for entry in state.entries:
        sure = (
            f", probability {100 * entry.confidence:.0f} % to be explained then"
            if entry.confidence
            else ""
        )
        lines.append(
            f"- Recorded '{entry.block}' as {entry.recording} ({entry.minutes:.1f} min of table"
            f" time{sure}): {entry.words}."
        )
        if verdicts:
            lines.append(
                f"  Diagnosed together with all earlier recordings: **{verdicts.pop(0)}**."
            )
    lines += ["", f"Table time: {state.minutes:.1f} min.", "", state.statement, ""]
    return "\n".join(lines)


DONE = ("match", "explained")
