"""ISO 8601 time stamps, with or without a zone."""

import re
import warnings

import numpy as np
import numpy.typing as npt

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.formats.raw_table import Raw

_ZONE = re.compile(r"\s*(?:(Z|UTC)|([+-])(\d\d):?(\d\d))$")
_PARTS = re.compile(r"(\d{4})-(\d\d?)-(\d\d?)T(\d\d?):(.*)")
_MINUTE = 60 * 10**9  # ns


def iso_stamps(raw: Raw, source: str) -> npt.NDArray[np.datetime64]:
    """Stamps in UTC, datetime64[ns], (n,); those without a zone are taken as they are.

    Raises:
        TiltcalError: naming the first one that is no date with a time of day.
    """
    if raw.dtype.kind == "M":
        return raw.astype("datetime64[ns]")
    texts, shifts = [], np.zeros(len(raw), dtype=np.int64)
    for k, item in enumerate(raw):
        text = str(item).strip()
        zone = _ZONE.search(text)
        if zone:
            text = text[: zone.start()]
            if zone[2]:
                minutes = 60 * int(zone[3]) + int(zone[4])
                shifts[k] = (1 if zone[2] == "+" else -1) * minutes * _MINUTE
        texts.append(text.replace("/", "-").replace(",", ".").replace(" ", "T", 1))
    try:
        stamps = _dates(texts)
    except (ValueError, UserWarning) as error:
        raise _no_stamp(texts, source) from error
    return (stamps.astype(np.int64) - shifts).astype("datetime64[ns]")


def _dates(texts: list[str]) -> npt.NDArray[np.datetime64]:
    with warnings.catch_warnings():  # numpy reads a zone that is left, and warns
        warnings.simplefilter("error")
        try:
            return np.array(texts, dtype="datetime64[ns]")
        except ValueError:
            return np.array([_padded(t) for t in texts], dtype="datetime64[ns]")


def _padded(text: str) -> str:
    """A date whose month, day and hour have two digits each."""
    found = _PARTS.fullmatch(text)
    if found is None:
        return text
    year, month, day, hour, rest = found.groups()
    return f"{year}-{int(month):02d}-{int(day):02d}T{int(hour):02d}:{rest}"


def _no_stamp(texts: list[str], source: str) -> TiltcalError:
    for number, text in enumerate(texts, start=1):
        try:
            _dates([text])
        except (ValueError, UserWarning):
            return TiltcalError(
                f"foreign recording {source}, data line {number}",
                found=f"the text '{text}'",
                need="a time such as 2026-05-04T12:30:00.250",
                do="correct that cell, or set time.column and time.unit",
            )
    return TiltcalError(
        f"foreign recording {source}", found="no time stamps", need="ISO 8601", do="check the file"
    )
