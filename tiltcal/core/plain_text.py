"""Text from files and arguments, fit for a terminal: what would command it is written out."""

import re

COMMANDING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Control characters but tab and line feed, marks that turn the direction of text, and half
characters.
"""


def plain(text: str) -> str:
    """``text`` with what would command a terminal written out, as ``\\x1b``."""
    return COMMANDING.sub(lambda found: ascii(found.group())[1:-1], text)
