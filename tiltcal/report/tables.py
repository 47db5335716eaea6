"""Rows of tables for the terminal and the reports: parameters of a calibration, lines of an
uncertainty budget.
"""

from collections.abc import Mapping, Sequence

from tiltcal.calibration.result import Calibration
from tiltcal.validation.uncertainty_budget import UncertaintyBudget


def parameter_rows(
    calibration: Calibration, truth: Mapping[str, float]
) -> Sequence[dict[str, str]]:
    """Rows of the parameter table: value, sigma, 95 % interval, truth, in readable units."""
    rows = []
    for name, e in calibration.parameters.items():
        factor, unit = calibration.shown_in(name, e.unit)
        low, high = (e.value - 1.96 * e.sigma) * factor, (e.value + 1.96 * e.sigma) * factor
        known = name in truth
        rows.append(
            {
                "name": name,
                "value": f"{e.value * factor:.6g}",
                "sigma": f"{e.sigma * factor:.3g}",
                "unit": unit,
                "interval": f"{low:.6g} ... {high:.6g}",
                "truth": f"{truth[name] * factor:.6g}" if known else "",
                "inside": ""
                if not known
                else "yes"
                if low <= truth[name] * factor <= high
                else "no",
            }
        )
    return rows


BUDGET_COLUMNS = (
    "parameter",
    "source",
    "kind",
    "size",
    "distribution",
    "standard",
    "sensitivity",
    "contribution",
    "unit",
)
NEGLIGIBLE = 0.01  # of the combined uncertainty


def budget_rows(budget: UncertaintyBudget, calibration: Calibration) -> list[dict[str, str]]:
    """Rows of text: the sources of each parameter, then combined and expanded uncertainty."""
    rows = []
    for name, unit in budget.units.items():
        factor, shown = calibration.shown_in(name, unit)
        combined = budget.combined[name]
        for line in budget.lines:
            if line.contributions[name] < NEGLIGIBLE * combined:
                continue
            b = line.kind == "B"
            rows.append(
                {
                    "parameter": name,
                    "source": line.name,
                    "kind": line.kind,
                    "distribution": line.distribution,
                    "size": f"{line.size:g} {line.unit}" if b else "",
                    "standard": f"{line.standard:.3g} {line.unit}" if b else "",
                    "sensitivity": f"{line.sensitivity(name) * factor:.3g}" if b else "1",
                    "contribution": f"{line.contributions[name] * factor:.3g}",
                    "unit": shown,
                }
            )
        ends = (("combined", combined), ("expanded, k = 2", budget.expanded[name]))
        rows += [
            dict.fromkeys(BUDGET_COLUMNS, "")
            | {
                "parameter": name,
                "source": label,
                "contribution": f"{u * factor:.3g}",
                "unit": shown,
            }
            for label, u in ends
        ]
    return rows
