"""Entries of a certificate that no recording contains: who, what, where and when."""

import re
from dataclasses import dataclass
from datetime import date as Date

from tiltcal.core.errors import TiltcalError

NOT_STATED = "not stated"
NO_COUNTRY = "ZZ"  # ISO 3166 leaves it to users; here: not stated
_CONTROL = re.compile(r"[^\t\n\r\x20-\uD7FF\uE000-\uFFFD\U00010000-\U0010FFFF]")


@dataclass(frozen=True)
class Stated:
    """Statements of the laboratory. What is left out appears as "not stated".

    Args:
        number: Number of the certificate; from the calibration's digest if not given.
        instrument: Name of the instrument.
        manufacturer: Its manufacturer.
        model: Its model.
        serial: Its serial number.
        customer: Customer, with address.
        laboratory: Laboratory, with address.
        person: Responsible person.
        country: Country of the laboratory, two letters (ISO 3166-1).
        date: Day of the measurement, YYYY-MM-DD; a DCC needs it.
        issued: Day of issue, YYYY-MM-DD.
        traceability: A reference and its certificate; may be repeated.
    """

    number: str | None = None
    instrument: str | None = None
    manufacturer: str | None = None
    model: str | None = None
    serial: str | None = None
    customer: str | None = None
    laboratory: str | None = None
    person: str | None = None
    country: str | None = None
    date: str | None = None
    issued: str | None = None
    traceability: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("date", "issued"):
            _require_date(getattr(self, name), name)
        if self.country and not re.fullmatch("[A-Z]{2}", self.country):
            raise TiltcalError(
                "certificate, country",
                found=f"'{self.country}'",
                need="two capital letters (ISO 3166-1)",
                do="write for example DE",
            )

    def text(self, name: str) -> str:
        """A statement as text, or "not stated"."""
        return clean(getattr(self, name) or "") or NOT_STATED


def clean(text: str) -> str:
    """Text without the characters that XML forbids and without space at its ends."""
    return _CONTROL.sub("\ufffd", text).strip()


def _require_date(text: str | None, name: str) -> None:
    if text is None or _is_day(text):
        return
    raise TiltcalError(
        f"certificate, {name}",
        found=f"'{text}'",
        need="a day as YYYY-MM-DD",
        do="write for example 2026-11-23",
    )


def _is_day(text: str) -> bool:
    try:
        return Date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


NOTHING_STATED = Stated()
