"""Parameters of a calibration as rows of a table, for the terminal and the reports."""

from collections.abc import Mapping, Sequence

from tiltcal.calibration.result import Calibration


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
