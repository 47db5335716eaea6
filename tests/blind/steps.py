"""A sequence file as a laboratory reads it: one step a row; and the track that a table makes of
it.
"""

import csv
import re
from pathlib import Path

import numpy as np

from blind.laboratory import AXIS_NAMES
from blind.motion import Plan, Track
from blind.rotations import DEG, about

GOING = ("move", "turn", "sweep")
COMING = 10.0  # deg, from where the first pose is come to
RATE_DEG_S = 20.0  # where a step does not say


def read_steps(path: Path) -> list[dict[str, str]]:
    """Rows of a sequence file.

    Raises:
        ValueError: an action that no laboratory knows.
    """
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["action"] not in ("rest", "remount", *GOING):
            raise ValueError(f"step {row['step']}: action {row['action']}")
    return rows


def track_of(rows: list[dict[str, str]], axes: int) -> Track:
    """The table's way through all steps, coming from a little below the first one.

    Columns of axes that the table has: the first ``axes`` of its names.
    """
    names = {1: ("outer",), 2: ("outer", "inner"), 3: AXIS_NAMES}[axes]
    first = next((r for r in rows if r["action"] in GOING), {})
    start = {k: float(first.get(f"{n}_deg") or 0) * DEG for k, n in enumerate(names)}
    plan = Plan([angle - COMING * DEG for angle in start.values()])
    plan.go(start, RATE_DEG_S * DEG)
    plan.dwell(1.0)
    for row in rows:
        target = {k: float(row[f"{n}_deg"]) * DEG for k, n in enumerate(names) if row[f"{n}_deg"]}
        if row["action"] in GOING and target:
            plan.go(
                target,
                float(row["rate_deg_s"] or RATE_DEG_S) * DEG,
                0.5 if row["action"] == "move" else 0.1,
            )
        if float(row["dwell_s"] or 0):
            plan.dwell(float(row["dwell_s"]))
    return plan.track()


def mount_of(rows: list[dict[str, str]]) -> tuple[str, np.ndarray]:
    """The mounting of the whole recording, in words and as body-to-faceplate components, (3, 3).

    Raises:
        ValueError: the mounting changes after the first step, which this laboratory does not do.
    """
    words = [r["mount"] for r in rows if r["mount"]]
    if len(set(words)) > 1 or (words and not rows[0]["mount"]):
        raise ValueError(
            "remounting between steps: this laboratory remounts before a recording only"
        )
    R = np.eye(3)
    for axis, angle in re.findall(r"R([xyz])\(\s*([-+.\d]+)\s*\)", words[0] if words else ""):
        R = R @ about("xyz".index(axis), np.array(float(angle) * DEG))
    return (words[0] if words else "identity"), np.round(R, 12)
