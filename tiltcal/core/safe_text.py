"""Text from files and arguments where it could act. On a terminal control characters are written
out; in a CSV cell a spreadsheet must not take it for a formula, and it reads back exactly.

A text that a spreadsheet would take for a formula gets an apostrophe in front, and so does one
that begins with an apostrophe.
"""

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


WORD = 200  # characters of a word that a message echoes whole
MOST = 4000  # of a message


def shortened(text: str) -> str:
    """A message without the middle of words that fill a screen, and without an end that does."""
    words = re.sub(rf"[^\s:;,]{{{WORD},}}", lambda found: f"{found[0][: WORD // 2]}...", text)
    return words if len(words) <= MOST else f"{words[:MOST]} ..."


FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""The beginning of a text that is a formula to a spreadsheet, or would be one after reading."""
HARMLESS = re.compile(r"[+-]?(?:[xyz]|\d+\.?\d*(?:[eE][+-]?\d+)?)?")
AFTER_COMMA = re.compile(r"([,;\t])(?=[=+\-@])")


def cell_of(text: str) -> str:
    """A text as a CSV file has it."""
    return f"'{text}" if FORMULA.match(text) and not HARMLESS.fullmatch(text) else text


def text_of(cell: str) -> str:
    """The text of a cell of a CSV file."""
    return cell[1:] if cell.startswith("'") and FORMULA.match(cell) else cell


def comment_of(text: str) -> str:
    """A text on a comment line, which a spreadsheet cuts at its separators: a blank after each that
    a formula follows.
    """
    return AFTER_COMMA.sub(r"\1 ", " ".join(text.splitlines()))
