"""Text in the cells of CSV files: a spreadsheet must not take it for a formula, and it reads back
exactly.

A text that a spreadsheet would take for a formula gets an apostrophe in front, which reading takes
away. The directions ``+x`` and ``-z`` and numbers stay as they are: they compute nothing.
"""

import re

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
