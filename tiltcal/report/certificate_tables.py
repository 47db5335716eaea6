"""The tables of a certificate as rows of text."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Any

import numpy as np

from tiltcal.calibration.result import Calibration
from tiltcal.core.units import unit_sign
from tiltcal.report.pose_residuals import PoseRow
from tiltcal.report.tables import NEGLIGIBLE
from tiltcal.setup.setup import Setup
from tiltcal.validation.uncertainty_budget import COVERAGE, UncertaintyBudget

POSES_SHOWN = 12  # of more, the largest residuals
ENTRIES_SHOWN = 72  # of a placing-angle table
PER_ROW = 6
_LINEAR = ("bias", "scale", "cross")


def rounded(value: float, uncertainty: float) -> tuple[str, str]:
    """A value and its uncertainty as text: two digits of the uncertainty, the value to the same
    decimal (GUM 7.2.6).
    """
    if not uncertainty > 0:
        return f"{value:.6g}", f"{uncertainty:g}"
    positions = 1 - floor(log10(uncertainty))
    if positions > 9:
        return f"{value:.6e}", f"{uncertainty:.1e}"
    kept = max(positions, 0)
    return f"{round(value, positions) + 0.0:.{kept}f}", f"{round(uncertainty, positions):.{kept}f}"


def _two_digits(uncertainty: float) -> str:
    """An uncertainty as text, without a power of ten: ``100`` rather than ``1e+02``."""
    return rounded(0.0, uncertainty)[1]


def parameter_table(
    calibration: Calibration, expanded: Mapping[str, float]
) -> list[dict[str, str]]:
    """Name, value, U at k = 2 and unit of each parameter.

    Args:
        calibration: the result.
        expanded: U of each, in the parameter's unit.
    """
    rows = []
    for name, e in calibration.parameters.items():
        factor, unit = calibration.shown_in(name, e.unit)
        value, u = rounded(e.value * factor, expanded[name] * factor)
        rows.append({"name": name, "value": value, "U": u, "unit": unit_sign(unit)})
    return rows


def budget_table(budget: UncertaintyBudget, calibration: Calibration) -> dict[str, Any]:
    """Sources with a letter each, and the contributions of each to each parameter."""
    letters = [f"{line.kind}{k}" if k else "A" for k, line in enumerate(budget.lines)]
    sources = [
        {
            "letter": letter,
            "name": line.name,
            "size": f"{line.size:g} {unit_sign(line.unit)}" if b else "by its covariance",
            "distribution": line.distribution,
            "standard": f"{line.standard:.3g} {unit_sign(line.unit)}" if b else "",
        }
        for letter, line in zip(letters, budget.lines, strict=True)
        for b in [line.kind == "B"]
    ]
    rows = []
    for name, unit in budget.units.items():
        factor, shown = calibration.shown_in(name, unit)
        least = NEGLIGIBLE * budget.combined[name]
        sizes = [line.contributions[name] for line in budget.lines]
        parts = [_two_digits(size * factor) if size >= least else "-" for size in sizes]
        ends = [_two_digits(u[name] * factor) for u in (budget.combined, budget.expanded)]
        rows.append({"name": name, "unit": unit_sign(shown), "parts": parts, "ends": ends})
    return {"sources": sources, "letters": letters, "rows": rows}


@dataclass(frozen=True)
class PoseTable:
    """Rows of the poses that are shown, and what is not."""

    angles: list[str]
    rows: list[dict[str, Any]]
    note: str


def pose_table(poses: Sequence[PoseRow]) -> PoseTable:
    """The residuals by pose; of many poses those with the largest ones."""
    if not poses:
        return PoseTable([], [], "")
    size = [max((abs(r) for r in p.residuals.values()), default=p.after or 0.0) for p in poses]
    largest = np.argsort(size)[::-1][:POSES_SHOWN]
    rows = [{"number": int(k) + 1, "pose": poses[k]} for k in sorted(largest)]
    hidden = len(poses) - len(rows)
    note = f"Of {len(poses)} poses the {len(rows)} with the largest residuals." if hidden else ""
    return PoseTable(list(poses[0].angles), rows, note)


def table_blocks(calibration: Calibration) -> list[dict[str, Any]]:
    """Placing-angle tables: entries in lines of six, and how many are shown."""
    blocks = []
    for name, entries in calibration.bias_tables.items():
        every = ceil(len(entries) / ENTRIES_SHOWN)
        cells = []
        for e in entries[::every]:
            factor, unit = calibration.shown_in(name, e["unit"])
            value, u = rounded(e["value"] * factor, COVERAGE * e["sigma"] * factor)
            cells.append(
                {"angle": f"{e['angle_deg']:g}°", "value": value, "U": u, "unit": unit_sign(unit)}
            )
        lines = [cells[k : k + PER_ROW] for k in range(0, len(cells), PER_ROW)]
        note = f"every {every}th of {len(entries)} entries" if every > 1 else "all entries"
        blocks.append({"name": name, "lines": lines, "note": note, "unit": cells[0]["unit"]})
    return blocks


def inverse_matrices(calibration: Calibration, setup: Setup) -> list[dict[str, Any]]:
    """Bias b and matrix M^-1 of each sensor with a linear model of three axes: f = M^-1 (reading -
    b).
    """
    found = []
    for name in calibration.sensors():
        sensor = setup.named(name)
        own = [n for n in calibration.parameters if n.startswith(f"{name}.")]
        linear = all(n.partition(".")[2].split("_")[0] in _LINEAR for n in own)
        others = any(n.startswith("temperature.") for n in calibration.parameters)
        if not own or not linear or others or len(sensor.axes) != 3:
            continue
        inverse = np.linalg.inv(calibration.sensitivity(sensor))
        unit = "m/s²" if sensor.is_accelerometer else "rad/s"
        bias = [f"{b:.7g}" for b in calibration.bias(sensor)]
        rows = [[f"{x:.7f}" for x in row] for row in inverse]
        found.append({"name": name, "bias": bias, "rows": rows, "unit": unit})
    return found
