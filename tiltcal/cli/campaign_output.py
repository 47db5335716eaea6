"""What ``campaign``, ``sweep`` and ``merge`` print."""

from typing import Any

from tiltcal.cli.output import paragraph, print_table

HEADER = ("method", "runs", "verdicts", "NEES/dof", "95 %", "tilt after, arcsec", "95 %", "bound")
ALL_PARAMETERS = ("tilt_after_arcsec", "nees_per_dof")
"""Results that hold all parameters together."""


def print_summary(summary: dict[str, Any]) -> None:
    """Print a row per combination of levels and method, sensitivities, and what failed."""
    cells = summary["cells"]
    names = list(cells[0]["values"]) if cells else []
    rows = [
        [*(_text(v) for v in cell["values"].values()), *_row(method, found)]
        for cell in cells
        for method, found in cell["methods"].items()
    ]
    print_table((*names, *HEADER), rows, title=summary["name"])
    for cell in cells:
        for method, found in cell["methods"].items():
            _print_sensitivity(method, cell["values"], found.get("sensitivity", {}))
    for failed in summary["failed"]:
        where = ", ".join(f"{k} = {_text(v)}" for k, v in failed["values"].items())
        paragraph(
            f"no result: {failed['method']}, {where}, seed {failed['seed']}: {failed['error']}"
        )
    for fault, count in summary["faults"].items():
        paragraph(f"{count} runs lost their process ({fault})")
    missing = summary["runs_planned"] - summary["runs"]
    paragraph(f"{summary['runs']} of {summary['runs_planned']} runs" + _missing(missing))


def _missing(count: int) -> str:
    return f"; {count} are not made yet" if count else ""


def _row(method: str, found: dict[str, Any]) -> list[str]:
    verdicts = ", ".join(f"{v} x{shown['count']}" for v, shown in found["verdicts"].items())
    nees, tilt = found["nees_per_dof"], found["tilt_arcsec"]
    row = [method, str(found["runs"]), verdicts]
    row += [_text(nees["value"]), _interval(nees["interval_95"])] if nees else ["", ""]
    if tilt:
        row += [_text(tilt["after_rms"]), _interval(tilt["after_rms_interval_95"])]
        row += [_text(tilt["bound_rms"])]
    return row + [""] * (len(HEADER) - len(row))


def _print_sensitivity(method: str, values: dict[str, Any], found: dict[str, Any]) -> None:
    rows = [  # those of each parameter's error are in the report
        [name, factor, *_index(first), *_index(indices["total"][factor])]
        for name, indices in found.items()
        if "total" in indices and name in ALL_PARAMETERS
        for factor, first in indices["first_order"].items()
    ]
    where = ", ".join(f"{k} = {_text(v)}" for k, v in values.items())
    if rows:
        header = ("result", "factor", "first-order index", "95 %", "total index", "95 %")
        print_table(header, rows, title=f"sensitivity: {method} {where}".rstrip())
    for name, indices in found.items():
        if "reason" in indices:
            paragraph(f"{method}, {name}: no sensitivity indices, {indices['reason']}")


def _index(index: dict[str, Any]) -> list[str]:
    value, low, high = (round(x, 2) + 0.0 for x in (index["value"], *index["interval_95"]))
    return [f"{value:.2f}", f"{low:.2f} ... {high:.2f}"]


def _interval(ends: list[float]) -> str:
    return " ... ".join(_text(x) for x in ends)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
