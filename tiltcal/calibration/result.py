"""Calibration: recovered parameters with covariance, tests and a verdict; saved, loaded, applied,
which inverts ``reading = bias + M f + h(f)``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.bias_table import PlacingCorrector, tables_of
from tiltcal.calibration.stored import StoredCalibration
from tiltcal.calibration.validity import VERDICTS, Test, Verdict
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.files import write_json
from tiltcal.core.frames import tilt_of_force
from tiltcal.core.numerical import undetermined
from tiltcal.core.read_back import checked, read_json
from tiltcal.core.tabular import Tabular
from tiltcal.core.units import G0, PARAMETER_UNITS, readable_unit
from tiltcal.recordings.static_poses import PoseSpan
from tiltcal.setup.sensor import Sensor

LINEAR = ("bias_", "scale_", "cross_")
ROUNDS = 20  # each round reduces the error by about the size of the higher-order terms


def higher_order_terms(parameters: "Mapping[str, Estimate]", sensor: Sensor) -> dict[str, float]:
    """Terms of a sensor beyond bias, scale and cross-axis: effect parameter -> SI value."""
    from tiltcal.effects import CATALOGUE

    found = {}
    for name, estimate in parameters.items():
        owner, _, term = name.partition(".")
        if owner != sensor.name or term.startswith(LINEAR):
            continue
        if _effect_id(term) in CATALOGUE:
            found[term] = estimate.value * PARAMETER_UNITS[estimate.unit].factor
    return found


def force_of_reading(
    M: Array, unbiased: Array, higher: Mapping[str, float], sensor: Sensor, g: float
) -> Array:
    """f of ``unbiased = M f + h(f)``, (n, k), by fixed-point iteration from ``f = unbiased``.

    Args:
        M: sensitivity, (k, 3).
        unbiased: readings less the bias, SI, (n, k).
        higher: terms of h as ``higher_order_terms`` gives them.
        sensor: with two axes, the third component follows from |f| = g.
        g: m/s2.
    """
    inverse = np.asarray(np.linalg.inv(M[:, list(sensor.axis_indices)]), dtype=float)
    if not higher and len(sensor.axes) != 2:
        return product(inverse, unbiased)
    found = np.array(unbiased)
    rows = np.arange(len(found))
    for _ in range(ROUNDS):  # each reading for itself: the same whatever stands beside it
        before = found[rows]
        y = unbiased[rows] - _higher_order(higher, sensor, before, g)
        after = product(inverse, y - _by_missing_axis(M, sensor, before, g))
        found[rows] = after
        rows = rows[(np.abs(after - before) >= 1e-13 * g).any(axis=1)]
        if not len(rows):
            break
    return found


def product(A: Array, v: Array) -> Array:
    """A v for each row of v, (n, k) -> (n, m): summed in one order, so that a row's result does not
    depend on how many others stand beside it, as it may in a product of matrices.
    """
    found = np.empty((len(v), len(A)))
    for i, row in enumerate(A):
        total = row[0] * v[:, 0]
        for j in range(1, len(row)):
            total += row[j] * v[:, j]
        found[:, i] = total
    return found


def _effect_id(term: str) -> str:
    """Id of the effect behind a parameter such as ``K2_x``."""
    return f"acc_{term[:-2]}"


def _higher_order(higher: Mapping[str, float], sensor: Sensor, f: Array, g: float) -> Array | float:
    """h(f), (n, k)."""
    if not higher:
        return 0.0
    from tiltcal.effects import CATALOGUE
    from tiltcal.effects.base import TermEffect
    from tiltcal.effects.sense import Sense

    sense = Sense.at_rest(sensor, g, _all_axes(f, sensor, g))
    total = np.zeros_like(f)
    for term, value in higher.items():
        effect = CATALOGUE[_effect_id(term)]()
        if isinstance(effect, TermEffect):
            channel, column = effect.term(term[0].lower() + term[1:], sense)
            total[:, channel] += value * column
    return total


def _all_axes(f: Array, sensor: Sensor, g: float) -> Array:
    """Forces along all three body axes, (n, 3): a missing one follows from |f| = g, positive."""
    full = np.zeros((len(f), 3))
    full[:, list(sensor.axis_indices)] = f
    if f.shape[1] == 2:
        (missing,) = set(range(3)) - set(sensor.axis_indices)
        full[:, missing] = np.sqrt(np.maximum(g * g - (f * f).sum(axis=1), 0.0))
    return full


def _by_missing_axis(M: Array, sensor: Sensor, f: Array, g: float) -> Array | float:
    """What the force along a missing axis adds to the readings, (n, k); it is taken from the
    last f.
    """
    rows = list(sensor.axis_indices)
    if len(rows) != 2 or not sensor.is_accelerometer:
        return 0.0
    (missing,) = set(range(3)) - set(rows)
    return np.outer(_all_axes(f, sensor, g)[:, missing], M[:, missing])


FRAMES = (
    "world x East, y North, z Up; f = a - gravity, level at rest (0, 0, +g); body axes as the"
    " table's at zero angles"
)

WRITTEN = "a CAL.json as `tiltcal calibrate` writes it"


NO_SENSORS = ("base", "temperature")  # owners of parameters that belong to no sensor


@dataclass(frozen=True)
class Estimate:
    """A recovered value with its standard uncertainty and unit."""

    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Calibration(Tabular):
    """What a method found.

    Args:
        method: its name.
        verdict: good, suspect (a test failed) or cannot_tell (the recording does not determine it).
        parameters: ``<sensor>.<term>_<axes>`` -> estimate.
        covariance: (p, p) in the order of ``parameters``, in their units.
        equation: forward model in words; inverse: how a reading is corrected.
        poses: dwells used.
        tests: of its own validity.
        chi2_per_dof, dof: of the fit.
        heldout_rms: sensor -> rms residual of poses left out of the fit, SI.
        warnings: what the user should know.
        bias_tables: placing-angle tables, ``<sensor>.<axis>`` -> entries; lookup: how they are
            read.
        provenance: what it came from.
    """

    method: str
    verdict: Verdict
    parameters: Mapping[str, Estimate]
    covariance: Array
    equation: str = ""
    inverse: str = ""
    frames: str = FRAMES
    poses: Sequence[PoseSpan] = ()
    tests: Sequence[Test] = ()
    chi2_per_dof: float = 0.0
    dof: int = 0
    heldout_rms: Mapping[str, float] = field(default_factory=dict)
    warnings: Sequence[str] = ()
    bias_tables: Mapping[str, list[dict[str, Any]]] = field(default_factory=dict)
    lookup: str = "interpolated"
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        p = len(self.parameters)
        if np.shape(self.covariance) != (p, p):
            raise TiltcalError(
                f"calibration by {self.method}",
                found=f"a covariance of shape {np.shape(self.covariance)}",
                need=f"({p}, {p}), one row a parameter",
                do="return it in the order of the parameters",
            )
        one_of(self.verdict, VERDICTS, f"calibration by {self.method}", "verdict")

    def value(self, name: str, default: float = 0.0) -> float:
        """Value of a parameter, or the default where it was not estimated."""
        return self.parameters[name].value if name in self.parameters else default

    def shown_in(self, name: str, unit: str) -> tuple[float, str]:
        """The unit in which a parameter or a bias table is shown, and the factor into it."""
        columns = self.provenance.get("columns", {})
        return readable_unit(unit, columns.get(name.split(".")[0]))

    @property
    def heldout_shown(self) -> dict[str, tuple[float, str]]:
        """Held-out residual of each sensor, in the unit that its bias is shown in."""
        found = {}
        for name, rms in self.heldout_rms.items():
            own = [e.unit for n, e in self.parameters.items() if n.startswith(f"{name}.bias_")]
            factor, unit = self.shown_in(name, own[0]) if own else (1.0, "SI")
            found[name] = (rms * factor, unit)
        return found

    def sensors(self) -> list[str]:
        """Names of the sensors it has parameters for."""
        names = [name.split(".")[0] for name in (*self.parameters, *self.bias_tables)]
        return [n for n in dict.fromkeys(names) if n not in NO_SENSORS]

    def sensitivity(self, sensor: Sensor) -> Array:
        """The matrix M of ``reading = bias + M f``, (k, 3): identity rows plus scale and cross
        terms.
        """
        rows = sensor.axis_indices
        M = np.eye(3)[list(rows)]
        for i, axis in enumerate(sensor.axes):
            M[i, rows[i]] += self.value(f"{sensor.name}.scale_{axis}")
            for j, other in enumerate("xyz"):
                if other != axis:
                    M[i, j] += self.value(f"{sensor.name}.cross_{axis}{other}")
        return M

    def bias(self, sensor: Sensor) -> Array:
        """Bias of each channel, SI, (k,)."""
        return np.array([self.value(f"{sensor.name}.bias_{axis}") for axis in sensor.axes])

    def placing(
        self, sensor: Sensor, g: float, lookup: str | None = None
    ) -> PlacingCorrector | None:
        """The on-line corrector of a sensor with placing-angle tables; None without such tables."""
        values = {n: e.value for n, e in self.parameters.items()}
        tables = tables_of(self.bias_tables, sensor.name, values)
        return PlacingCorrector(tables, g, lookup or self.lookup) if tables else None

    def g_sensitivity(self, sensor: Sensor) -> Array | None:
        """G of ``reading = ... + G f`` of a gyro, rad/s per m/s2, (k, 3); None where it was not
        estimated.
        """
        names = [[f"{sensor.name}.gsens_{axis}{other}" for other in "xyz"] for axis in sensor.axes]
        if not any(name in self.parameters for row in names for name in row):
            return None
        G = np.array([[self.value(name) for name in row] for row in names])
        return G * PARAMETER_UNITS["deg_h_g"].factor / G0

    def correct(self, sensor: Sensor, reading: Array, g: float) -> Array:
        """Corrected readings, SI in the sensing form (f or rate), (n, k).

        A triad: M^-1 (reading - bias). Two channels: the third component follows from |f| = g, z
        up. Higher-order terms (K2, K3, ...) are subtracted at the last corrected force until
        nothing changes. With placing-angle tables: x and y less their table, NaN outside the range
        of the table.
        """
        corrector = self.placing(sensor, g)
        if corrector is not None:
            columns = [sensor.axes.index(a) for a in "xyz" if a in sensor.axes]
            corrected = np.array(reading)
            corrected[:, columns[:2]] = corrector.correct(reading[:, columns])
            return corrected
        unbiased = reading - self.bias(sensor)
        if sensor.kind == "fog":
            return np.asarray(unbiased / (1 + self.value(f"{sensor.name}.scale_a")))
        higher = higher_order_terms(self.parameters, sensor)
        return force_of_reading(self.sensitivity(sensor), unbiased, higher, sensor, g)

    def to_json(self) -> dict[str, Any]:
        """The table of CAL.json."""
        table: dict[str, Any] = {
            "schema": 1,
            "method": self.method,
            "verdict": self.verdict,
            "equation": self.equation,
            "inverse": self.inverse,
            "frames": self.frames,
            "parameters": {name: dict(vars(e)) for name, e in self.parameters.items()},
            "covariance": {
                "names": list(self.parameters),
                "matrix": np.asarray(self.covariance).tolist(),
            },
            "poses": [dict(vars(p)) for p in self.poses],
            "tests": [vars(t) for t in self.tests],
            "fit": {
                "chi2_per_dof": self.chi2_per_dof,
                "dof": self.dof,
                "heldout_rms": dict(self.heldout_rms),
            },
            "warnings": list(self.warnings),
            "provenance": dict(self.provenance),
        }
        if self.bias_tables:
            table |= {"bias_tables": dict(self.bias_tables), "lookup": self.lookup}
        return table

    def as_columns(self) -> Mapping[str, Sequence[Any]]:
        """Parameter, value, sigma and unit, one row a parameter."""
        rows = self.parameters.values()
        return {
            "parameter": list(self.parameters),
            "value": [float(e.value) for e in rows],
            "sigma": [float(e.sigma) for e in rows],
            "unit": [e.unit for e in rows],
        }

    def headline(self) -> str:
        """Method, verdict and the tests that failed."""
        failed = [f"{t.name}: {t.statement}" for t in self.tests if not t.passed]
        return "; ".join([f"calibration by {self.method}: {self.verdict}", *failed])

    def save(self, path: Path | str) -> None:
        """Write CAL.json, whole or not at all."""
        write_json(Path(path), self.to_json())


def require_finite(found: Calibration, source: str) -> None:
    """Refuse the result of a method that is not in numbers.

    Args:
        found: the result.
        source: the recording that it comes from.

    Raises:
        TiltcalError: naming what is none.
    """
    numbers: dict[str, Sequence[float]] = {
        name: (e.value, e.sigma) for name, e in found.parameters.items()
    }
    numbers |= {f"test {t.name}": (t.statistic, t.p_value) for t in found.tests}
    numbers |= {f"residual of {name}": (rms,) for name, rms in found.heldout_rms.items()}
    numbers["covariance"] = np.ravel(found.covariance).tolist()
    numbers["chi2_per_dof"] = (found.chi2_per_dof,)
    for name, values in numbers.items():
        if not np.all(np.isfinite(values)):
            raise undetermined(source, f"the parameters of {found.method}", f"{name} is no number")


def load_calibration(path: Path | str) -> Calibration:
    """Read CAL.json.

    Raises:
        TiltcalError: it is no calibration.
    """
    path = Path(path)
    return calibration_from(
        read_json(path, "calibration", WRITTEN), subject=f"calibration {path.name}"
    )


def calibration_from(table: Mapping[str, Any], subject: str = "calibration") -> Calibration:
    """A calibration from the table of CAL.json; only method, verdict and parameters with values are
    required.

    Raises:
        TiltcalError: naming the first key that does not fit.
    """
    c = checked(StoredCalibration, table, subject, WRITTEN)
    return Calibration(
        c.method,
        one_of(c.verdict, VERDICTS, subject, "verdict"),  # type: ignore[arg-type]
        {name: Estimate(e.value, e.sigma, e.unit) for name, e in c.parameters.items()},
        c.matrix,
        c.equation,
        c.inverse,
        FRAMES if c.frames is None else c.frames,
        [PoseSpan(p.start_s, p.end_s, p.label) for p in c.poses],
        [Test(t.name, t.statistic, t.dof, t.p_value, t.passed, t.statement) for t in c.tests],
        c.fit.chi2_per_dof,
        c.fit.dof,
        c.fit.heldout_rms,
        c.warnings,
        {name: [e.model_dump() for e in entries] for name, entries in c.bias_tables.items()},
        c.lookup,
        c.provenance,
    )


def tilt_angles(f: Array, sensor: Sensor, g: float) -> dict[str, Array]:
    """Elevations of body x and y from corrected forces, rad: ``asin(f / g)``; of a triad ``asin(f /
    |f|)``. f: m/s2, (n, k); (n,) each.
    """
    found = {}
    length = np.sqrt(np.einsum("ij,ij->i", f, f)) if f.shape[1] == 3 else np.full(len(f), g)
    for i, axis in enumerate(sensor.axes):
        if axis in ("x", "y"):
            found[axis] = tilt_of_force(f[:, i] / np.maximum(length, 1e-12), 1.0)
    return found
