"""A sequence as a CSV file for a laboratory, one step a row (docs/interfaces.md,
"Sequence files").
"""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path

import numpy as np

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import require_document
from tiltcal.core.frames import parse_mount
from tiltcal.core.safe_text import cell_of, text_of
from tiltcal.setup.schedule import Leg, build_schedule
from tiltcal.setup.sequence import Step, sliding_axes
from tiltcal.setup.setup import Rig
from tiltcal.setup.tables import FILE_AXES, angle_key, axis_names, length_key

# all go to the angles of their row; for a turn and a sweep the path matters
GOING = (
    "move",
    "turn",
    "sweep",
)
ACTIONS = ("rest", *GOING, "remount")
WHOLE_TURN = 360.0  # deg


def sequence_columns(axes: Sequence[str], sliding: Sequence[str] = ()) -> tuple[str, ...]:
    """Columns of a sequence file: the angles of the usual axes, unless the table has joints of
    other names only, and of any further one, and the positions of those that slide.
    """
    every = [*axes, *sliding]
    usual = FILE_AXES if not every or not set(FILE_AXES).isdisjoint(every) else ()
    keys = [*map(angle_key, dict.fromkeys((*usual, *axes))), *map(length_key, sliding)]
    rates = ("rate_deg_s", "rate_mm_s") if sliding else ("rate_deg_s",)
    return ("step", "action", *keys, *rates, "dwell_s", "mount", "label")


def sequence_text(steps: Sequence[Step], rig: Rig) -> str:
    """The file of a sequence: every move and dwell with the angles it ends at.

    Raises:
        TiltcalError: the file has no action for a step: an oscillation, or anything hand-held.
    """
    if not rig.axes:
        raise TiltcalError(
            "sequence file",
            found=f"table {rig.table}",
            need="a table with axes",
            do="write the steps down as text",
        )
    rows: list[dict[str, str]] = []
    mount, here = rig.mount, rig.reach.start * rig.reach.sizes
    for leg in build_schedule(steps, rig).legs:
        if leg.profile == "swing":
            raise TiltcalError(
                "sequence file",
                found="action oscillate",
                need=_one_of(ACTIONS),
                do="turn to and fro instead",
            )
        if leg.mount != mount:
            mount = leg.mount
            rows.append({"action": "remount", "mount": mount})
        if leg.profile == "ramp":
            rows.append(_going(leg, rig, here))
            here = leg.q0 + leg.dq
        elif rows and rows[-1]["action"] in GOING and "dwell_s" not in rows[-1]:
            rows[-1]["dwell_s"] = _number(leg.t1 - leg.t0)
        else:
            rows.append(
                {
                    "action": "rest",
                    "dwell_s": _number(leg.t1 - leg.t0),
                    "label": cell_of(leg.label or ""),
                }
            )
    text = StringIO()
    columns = sequence_columns(rig.kind.turning, sorted(rig.kind.sliding))
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({"step": str(k), **row} for k, row in enumerate(rows, start=1))
    return text.getvalue()


def _going(
    leg: Leg, rig: Rig, here: "np.ndarray[tuple[int], np.dtype[np.float64]]"
) -> dict[str, str]:
    """The row of a move."""
    table, target, longest = rig.kind, leg.q0 + leg.dq, {"deg": 0.0, "mm": 0.0}
    positions = {}
    for k, name in enumerate(rig.axis_names):
        unit, size = table.unit(name), table.size(name)
        longest[unit] = max(longest[unit], float(abs(leg.dq[k])) / size)
        if target[k] != here[k]:
            positions[table.key(name)] = _number(target[k] / size)
    rates = {
        f"rate_{unit}_s": _number(moved / (leg.t1 - leg.t0 - leg.ramp))
        for unit, moved in longest.items()
        if moved
    }
    return {
        "action": "turn" if longest["deg"] >= WHOLE_TURN - 1e-7 else "move",
        **positions,
        **rates,
        "label": cell_of(leg.label or ""),
    }


def _number(value: float) -> str:
    return f"{round(float(value), 6) + 0.0:g}"


def _one_of(valid: Sequence[str]) -> str:
    return "one of " + ", ".join(valid)


def read_sequence(path: Path | str) -> tuple[Step, ...]:
    """The steps of a sequence file.

    Raises:
        TiltcalError: naming the row and column that is wrong.
    """
    path = require_document(Path(path), "sequence")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            rows, head = list(reader), list(reader.fieldnames or ())
    except (UnicodeDecodeError, csv.Error) as error:
        raise TiltcalError(
            f"sequence {path.name}",
            found="bytes that are no table",
            need="a CSV in UTF-8",
            do="check the file",
        ) from error
    columns = sequence_columns(axis_names(), sliding_axes())
    for name in head:
        if name not in columns:
            raise TiltcalError(
                f"sequence {path.name}",
                found=f"column '{name}'",
                need=_one_of(columns),
                do=nearest(name, [*columns]),
            )
    if "action" not in head or not rows:
        raise TiltcalError(
            f"sequence {path.name}",
            found="no steps",
            need="a column action and a row a step",
            do="see `tiltcal design`",
        )
    return tuple(
        _step(row, f"sequence {path.name}, row {k}") for k, row in enumerate(rows, start=2)
    )


def _step(row: Mapping[str, str | None], subject: str) -> Step:
    action = (row.get("action") or "").strip()
    if action not in ACTIONS:
        raise TiltcalError(
            subject,
            found=f"action '{action}'",
            need=_one_of(ACTIONS),
            do=nearest(action, [*ACTIONS]),
        )
    known: dict[str, float] = {}
    positions = (*map(angle_key, axis_names()), *map(length_key, sliding_axes()))
    for name in (*positions, "rate_deg_s", "rate_mm_s", "dwell_s"):
        cell = (row.get(name) or "").strip()
        if cell:
            known[name] = _value(cell, name, subject)
    mount = (row.get("mount") or "").strip() or None
    if mount is not None:
        parse_mount(mount)
    if action == "remount" and mount is None:
        raise TiltcalError(
            subject,
            found="remount without a mount",
            need="a mounting such as Rz(180)",
            do="fill in the cell",
        )
    return Step.model_validate(
        {
            "action": "move" if action in GOING else action,
            **known,
            "mount": mount,
            "label": text_of(row.get("label") or "") or None,
        }
    )


def _value(cell: str, name: str, subject: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    least = {"rate_deg_s": 1e-6, "rate_mm_s": 1e-6, "dwell_s": 0.0}.get(name, -np.inf)
    if not np.isfinite(value) or value < least:
        need = (
            "a number"
            if least == -np.inf
            else "a number above zero"
            if least
            else "a number from zero on"
        )
        raise TiltcalError(
            f"{subject}, column {name}", found=f"'{cell}'", need=need, do="correct the cell"
        )
    return value
