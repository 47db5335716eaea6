"""What a calibration covers: the procedure it follows, where it is valid, what was not tested."""

from collections.abc import Callable
from dataclasses import dataclass

from tiltcal.calibration.result import Calibration
from tiltcal.setup.setup import Setup

TUMBLE = (
    "Implements the procedure of IEEE 1293 for the static model equation and the multipoint tumble"
    " in the gravity field."
)
PROCEDURES = {
    "six_position": TUMBLE,
    "thermal": TUMBLE + " Its temperature sensitivities are fitted together with it.",
    "gyro_rates": "Implements the procedure of IEEE 952 for scale factor and bias from input rates,"
    " for each axis of a triad.",
    "fog_scale": "Implements the procedure of IEEE 952 for the scale factor, with a second gyro"
    " instead of the rate table.",
}
NO_STANDARD = "No standard states this procedure; the documentation of the method describes it."


@dataclass(frozen=True)
class Covered:
    """Contents of a result: its method, kinds of terms and names of tests, and whether it has
    placing-angle tables.
    """

    method: str
    terms: frozenset[str]
    tests: frozenset[str]
    tables: bool

    @property
    def linear(self) -> bool:
        """Whether the model has no coefficient of a higher power of its input."""
        return not self.tables and not any(t.startswith("K") for t in self.terms)


Rule = tuple[str, Callable[[Covered], bool]]
RULES: tuple[Rule, ...] = (
    (
        "Temperature: no coefficient was determined; the result is valid at the temperature of"
        " the measurement.",
        lambda c: not any(t.startswith("temp") for t in c.terms),
    ),
    (
        "Non-linearity: coefficients of second and third order are taken as zero.",
        lambda c: c.linear and "second order" not in c.tests,
    ),
    (
        "Non-linearity of third order: taken as zero; second order was tested, not determined.",
        lambda c: c.linear and "second order" in c.tests,
    ),
    (
        "Scale factor: not determined, taken as stated.",
        lambda c: "scale" not in c.terms,
    ),
    (
        "Cross-axis sensitivity: not determined, taken as zero.",
        lambda c: "cross" not in c.terms,
    ),
    (
        "Orientation of the axes in the case: only their angles to each other are determined.",
        lambda c: c.method == "norm",
    ),
    (
        "g-sensitivity of the rate: not determined, taken as zero.",
        lambda c: c.method.startswith(("gyro", "fog")) and "gsens" not in c.terms,
    ),
)
NEVER = (
    "Stability: repeatability from turn-on to turn-on, hysteresis after cycles, ageing.",
    "Dynamics: bandwidth, vibration rectification, shock.",
    "Environment: supply voltage, magnetic field, pressure, radiation.",
)


def procedure(calibration: Calibration) -> str:
    """The procedure of a standard that the method implements, or that there is none."""
    return PROCEDURES.get(calibration.method, NO_STANDARD)


def not_tested(calibration: Calibration) -> list[str]:
    """What this calibration did not test, one sentence each."""
    terms = {name.partition(".")[2].split("_")[0] for name in calibration.parameters}
    tests = frozenset(t.name for t in calibration.tests)
    tables = bool(calibration.bias_tables)
    covered = Covered(calibration.method, frozenset(terms), tests, tables)
    return [text for text, missing in RULES if missing(covered)] + list(NEVER)


def validity(
    calibration: Calibration, setup: Setup, temperature: tuple[float, float] | None
) -> list[str]:
    """Range of validity of the result, one sentence each.

    Args:
        calibration: with the verdict.
        setup: of the recording.
        temperature: lowest and highest of the recording, degC; None where it was not recorded.
    """
    lines = [_verdict(calibration)]
    g = f"{setup.site.gravity:.6g} m/s² local gravity"
    lines.append(f"It is based on {len(calibration.poses)} dwells at {g}.")
    if temperature is None:
        lines.append("Temperature during the measurement: not stated.")
    else:
        low, high = temperature
        lines.append(f"Temperature during the measurement: {low:.1f} °C to {high:.1f} °C.")
    lines.append("The certificate states no period of validity: the user decides when to repeat.")
    return lines


def _verdict(calibration: Calibration) -> str:
    failed = [t.name for t in calibration.tests if not t.passed]
    if calibration.verdict == "good":
        return "All tests of the method were passed: the model fits the recording."
    reason = f" (failed: {', '.join(failed)})" if failed else ""
    return (
        f"The verdict is {calibration.verdict.replace('_', ' ')}{reason}: do not apply this result"
        " before the cause is found."
    )
