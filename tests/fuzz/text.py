"""Mutations of text files: of CSV cells, columns and rows, and of bytes."""

import re
from collections.abc import Callable

import numpy as np

CELLS = (
    "",
    " ",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e400",
    "1e-320",
    "0",
    "-0",
    "1",
    "x",
    "1,2",
    '"',
    '"a',
    "0x10",
    "1_000",
    "٣",
    "\x00",
    "\x1b[2J",
    "=cmd()",
    "[0,0,0]",
    "[nan,1,2]",
    "[1e308,1e308,1e308]",
    "+x",
    "é" * 80,
    "9" * 400,
)
UNITS = ("", "_g", "_LSB", "_deg", "_degC", "_rad_s", "_m_s2", "_s", "_mV", "_xyz")
Rows = list[list[str]]


def mutated_csv(content: bytes, rng: np.random.Generator) -> bytes:
    """A CSV file with rows, columns or cells changed."""
    lines = content.decode(errors="replace").splitlines()
    first = next((k for k, line in enumerate(lines) if not line.startswith("#")), 0)
    head, rows = lines[:first], [line.split(",") for line in lines[first:]]
    for _ in range(int(rng.integers(1, 3))):
        if len(rows) > 1:
            rows = CHANGES[rng.integers(len(CHANGES))](rows, rng)
    if rng.random() < 0.1:
        head = [*head, *METADATA[: int(rng.integers(1, len(METADATA) + 1))]]
    end = "\r\n" if rng.random() < 0.1 else "\n"
    return (end.join([*head, *(",".join(row) for row in rows)]) + end).encode(errors="replace")


METADATA = ("# mount: Rz(180)", "# mount: Rq(1)", "# mount: Rx(nan)", "# :", "# a: \x1b[0m")


def keep_every(rows: Rows, rng: np.random.Generator) -> Rows:
    """Decimate."""
    return [rows[0], *rows[1 :: int(rng.choice([2, 3, 7, 20, 100]))]]


def cut(rows: Rows, rng: np.random.Generator) -> Rows:
    """Only some rows from the front or the end."""
    count = int(rng.choice([0, 1, 2, 3, 5, 10, 50]))
    return [rows[0], *(rows[1 : 1 + count] if rng.random() < 0.5 else rows[len(rows) - count :])]


def drop_column(rows: Rows, rng: np.random.Generator) -> Rows:
    """Without one column."""
    k = int(rng.integers(len(rows[0])))
    return [row[:k] + row[k + 1 :] for row in rows]


def repeat_column(rows: Rows, rng: np.random.Generator) -> Rows:
    """One column twice, perhaps under another name."""
    k = int(rng.integers(len(rows[0])))
    name = rows[0][k] + ("" if rng.random() < 0.5 else "_g")
    return [[*rows[0], name], *([*row, row[min(k, len(row) - 1)]] for row in rows[1:])]


def shorten_column(rows: Rows, rng: np.random.Generator) -> Rows:
    """One channel ends early, begins late, or is empty everywhere."""
    k, n = int(rng.integers(len(rows[0]))), len(rows)
    start, stop = sorted(rng.integers(1, n + 1, 2))
    if rng.random() < 0.3:
        start, stop = 1, n
    return with_cells(rows, k, lambda cell, i: "" if start <= i < stop else cell)


def set_column(rows: Rows, rng: np.random.Generator) -> Rows:
    """One channel constant, at an odd value."""
    cell = odd_cell(rng)
    return with_cells(rows, int(rng.integers(len(rows[0]))), lambda *_: cell)


def scale_column(rows: Rows, rng: np.random.Generator) -> Rows:
    """One channel much larger, smaller, or shifted."""
    factor = float(rng.choice([1e-200, 1e-30, 1e-3, 0, -1, 1e3, 1e30, 1e200]))
    shift = float(rng.choice([0, 0, 1, 1e9, 1e300]))

    def scaled(cell: str, _: int) -> str:
        try:
            return repr(float(cell) * factor + shift)
        except ValueError:
            return cell

    return with_cells(rows, int(rng.integers(len(rows[0]))), scaled)


def set_cells(rows: Rows, rng: np.random.Generator) -> Rows:
    """A few odd cells."""
    rows = [list(row) for row in rows]
    for _ in range(int(rng.choice([1, 2, 20]))):
        row = rows[rng.integers(0 if rng.random() < 0.2 else 1, len(rows))]
        row[rng.integers(len(row))] = odd_cell(rng)
    return rows


def rename(rows: Rows, rng: np.random.Generator) -> Rows:
    """A column under another name or unit."""
    header = list(rows[0])
    k = int(rng.integers(len(header)))
    stem = header[k].rpartition("_")[0] if rng.random() < 0.7 else header[k]
    header[k] = stem + str(rng.choice(UNITS)) if rng.random() < 0.8 else odd_cell(rng)
    return [header, *rows[1:]]


def reorder(rows: Rows, rng: np.random.Generator) -> Rows:
    """Rows backwards, shuffled, or twice."""
    kind, body = rng.integers(3), rows[1:]
    if kind == 0:
        body = body[::-1]
    elif kind == 1:
        body = [body[i] for i in rng.permutation(len(body))]
    else:
        body = [row for row in body for _ in range(2)]
    return [rows[0], *body]


def ragged(rows: Rows, rng: np.random.Generator) -> Rows:
    """One row of another length."""
    k = int(rng.integers(len(rows)))
    row = rows[k][:-1] if rng.random() < 0.5 else [*rows[k], "1"]
    return [*rows[:k], row, *rows[k + 1 :]]


def long_line(rows: Rows, rng: np.random.Generator) -> Rows:
    """A line of more than 131 072 characters, in one cell or in many."""
    k = int(rng.integers(len(rows)))
    cells = [*rows[k], "9" * 140_000] if rng.random() < 0.5 else rows[k] + ["1"] * 70_000
    return [*rows[:k], cells, *rows[k + 1 :]]


def with_cells(rows: Rows, column: int, changed: Callable[[str, int], str]) -> Rows:
    """One column changed, cell by cell."""
    return [
        rows[0],
        *(
            [changed(cell, i) if k == column else cell for k, cell in enumerate(row)]
            for i, row in enumerate(rows[1:], start=1)
        ),
    ]


def odd_cell(rng: np.random.Generator) -> str:
    """One of the odd cells."""
    return CELLS[rng.integers(len(CELLS))]


CHANGES: tuple[Callable[[Rows, np.random.Generator], Rows], ...] = (
    keep_every,
    cut,
    drop_column,
    repeat_column,
    shorten_column,
    shorten_column,
    set_column,
    scale_column,
    set_cells,
    set_cells,
    rename,
    reorder,
    ragged,
    long_line,
)


def mutated_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Any file with bytes cut, replaced, put in or doubled."""
    kind, n = rng.integers(6), len(content)
    at = int(rng.integers(n + 1))
    if kind == 0:
        return content[:at]
    if kind == 1:
        changed = bytearray(content)
        for _ in range(int(rng.choice([1, 3, 30]))):
            if changed:
                changed[rng.integers(len(changed))] = rng.integers(256)
        return bytes(changed)
    if kind == 2:
        return content[:at] + rng.bytes(int(rng.integers(1, 20))) + content[at:]
    if kind == 3:
        return (
            b"\xef\xbb\xbf" + content
            if rng.random() < 0.5
            else content.decode(errors="replace").encode("utf-16")
        )
    if kind == 4:
        return content + content[at:]
    return [b"", b"\n", b"\x00" * 1000, b"{}", b"[]", b"null", b"# only: words\n"][rng.integers(7)]


NUMBERS = ("", "nan", "inf", "1e300", "-1", "0", "0 0 0", "1e-300 0 0", "9" * 30, "x", "../x")
WRAPS = (
    '<replicate count="100000">{}</replicate>',
    '<replicate count="1000"><replicate count=" 1000 ">{}</replicate></replicate>',
    "<body>" * 3000 + "{}" + "</body>" * 3000,
    '<include file="arm.xml"/>{}',
    '<composite type="grid" count="3000 3000 1" spacing="1"/>{}',
    '<flexcomp name="f" type="grid" count="900 900 900" spacing="1 1 1" mass="1"/>{}',
)
BOMB = "<!DOCTYPE m [<!ENTITY a0 'x'>{}]>\n<mujoco>&a20;</mujoco>".format(
    "".join(f"<!ENTITY a{k + 1} '{f'&a{k};' * 10}'>" for k in range(20))
)
BEFORE = (
    '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
    '<asset><texture type="2d" builtin="flat" width="90000" height="90000"/></asset>',
    '<size memory="900G"/>',
    '<size nuserdata="2000000000"/>',
    '<option timestep="0"/>',
)


def mutated_xml(content: bytes, rng: np.random.Generator) -> bytes:
    """A model with odd values, elements taken away, copied, or much too many."""
    text, kind = content.decode(), rng.integers(6)
    lines = text.splitlines()
    k = int(rng.integers(len(lines)))
    if kind < 2:
        return re.sub(r'(?<==")[^"]*', lambda m: odd_number(m[0], rng), text).encode()
    if kind == 2:
        return "\n".join(lines[:k] + lines[k + 1 :] * int(rng.integers(1, 3))).encode()
    if kind == 3:
        wrap = WRAPS[rng.integers(len(WRAPS))]
        return re.sub(r"<geom[^>]*>", lambda m: wrap.format(m[0]), text, count=1).encode()
    if kind == 4:
        return text.replace("<worldbody", f"{BEFORE[rng.integers(len(BEFORE))]}<worldbody").encode()
    return BOMB.encode()


def odd_number(value: str, rng: np.random.Generator) -> str:
    """A value of an attribute, now and then another."""
    return NUMBERS[rng.integers(len(NUMBERS))] if rng.random() < 0.05 else value
