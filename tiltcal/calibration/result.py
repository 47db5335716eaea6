"""Calibration: recovered parameters with covariance, tests and a verdict; saved, loaded,
applied.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tiltcal.calibration.bias_table import PlacingCorrector, tables_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.files import require_file, write_json
from tiltcal.core.frames import tilt_of_force
from tiltcal.core.units import G0, PARAMETER_UNITS
from tiltcal.recordings.static_poses import PoseSpan
from tiltcal.setup.sensor import Sensor

Verdict = Literal["good", "suspect", "cannot_tell"]
VERDICTS: tuple[Verdict, ...] = ("good", "suspect", "cannot_tell")
SIGNIFICANCE = 1e-3  # of each test of a method's own validity

FRAMES = (
    "world x East, y North, z Up; f = a - gravity, level at rest (0, 0, +g); body axes as the"
    " table's at zero angles"
)


@dataclass(frozen=True)
class Estimate:
    """A recovered value with its standard uncertainty and unit."""

    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Test:
    """One test of a method's own validity."""

    name: str
    statistic: float
    dof: int
    p_value: float
    passed: bool
    statement: str

    __test__ = False  # not a test case for pytest


@dataclass(frozen=True)
class Calibration:
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

    def sensors(self) -> list[str]:
        """Names of the sensors it has parameters for."""
        names = [name.split(".")[0] for name in (*self.parameters, *self.bias_tables)]
        return [n for n in dict.fromkeys(names) if n != "base"]

    # ----------------------------------------------------------------------------------------------
    # --------- the model

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
        tables = tables_of(
            self.bias_tables, sensor.name, {n: e.value for n, e in self.parameters.items()}
        )
        return PlacingCorrector(tables, g, lookup or self.lookup) if tables else None

    def g_sensitivity(self, sensor: Sensor) -> Array | None:
        """G of ``reading = ... + G f`` of a gyro, rad/s per m/s2, (k, 3); None where it was not
        estimated.
        """
        names = [[f"{sensor.name}.gsens_{axis}{other}" for other in "xyz"] for axis in sensor.axes]
        if not any(name in self.parameters for row in names for name in row):
            return None
        return (
            np.array([[self.value(name) for name in row] for row in names])
            * PARAMETER_UNITS["deg_h_g"].factor
            / G0
        )

    def correct(self, sensor: Sensor, reading: Array, g: float) -> Array:
        """Corrected readings, SI in the sensing form (f or rate), (n, k).

        A triad: M^-1 (reading - bias). Two channels: the third component follows from |f| = g, z
            up. Further terms
        (K2, K3, ...) are taken off at the last corrected force, until nothing changes. With
        placing-angle tables: x and y
        less their table, NaN where the table does not hold.
        """
        corrector = self.placing(sensor, g)
        if corrector is not None:
            columns = [sensor.axes.index(a) for a in "xyz" if a in sensor.axes]
            done = np.array(reading)
            done[:, columns[:2]] = corrector.correct(reading[:, columns])
            return done
        M, y = self.sensitivity(sensor), reading - self.bias(sensor)
        if sensor.kind == "fog":
            return np.asarray(y / (1 + self.value(f"{sensor.name}.scale_a")))
        further = self._further(sensor)
        f = np.array(y)
        for _ in range(20 if further or len(sensor.axes) == 2 else 1):
            before = f
            f = _solve(M, sensor, y - self._beyond_linear(further, sensor, f, g), f, g)
            if np.max(np.abs(f - before), initial=0.0) < 1e-13 * g:
                break
        return f

    def _further(self, sensor: Sensor) -> dict[str, float]:
        """Terms beyond bias, scale and cross-axis: effect parameter -> SI value."""
        from tiltcal.effects import CATALOGUE

        found = {}
        for name, e in self.parameters.items():
            owner, _, term = name.partition(".")
            if (
                owner == sensor.name
                and not term.startswith(("bias_", "scale_", "cross_"))
                and f"acc_{term[:-2]}" in CATALOGUE
            ):
                found[term] = e.value * PARAMETER_UNITS[e.unit].factor
        return found

    @staticmethod
    def _beyond_linear(
        further: Mapping[str, float], sensor: Sensor, f: Array, g: float
    ) -> Array | float:
        if not further:
            return 0.0
        from tiltcal.effects import CATALOGUE
        from tiltcal.effects.base import TermEffect
        from tiltcal.effects.sense import Sense

        sense = Sense.at_rest(sensor, g, _three(f, sensor, g))
        total = np.zeros_like(f)
        for term, value in further.items():
            effect = CATALOGUE[f"acc_{term[:-2]}"]()
            if isinstance(effect, TermEffect):
                channel, column = effect.term(term[0].lower() + term[1:], sense)
                total[:, channel] += value * column
        return total

    # ----------------------------------------------------------------------------------------------
    # ------------- files

    def to_json(self) -> dict[str, Any]:
        """The table of CAL.json."""
        table: dict[str, Any] = {
            "schema": 1,
            "method": self.method,
            "verdict": self.verdict,
            "equation": self.equation,
            "inverse": self.inverse,
            "frames": self.frames,
            "parameters": {
                n: {"value": e.value, "sigma": e.sigma, "unit": e.unit}
                for n, e in self.parameters.items()
            },
            "covariance": {
                "names": list(self.parameters),
                "matrix": np.asarray(self.covariance).tolist(),
            },
            "poses": [
                {"start_s": p.start_s, "end_s": p.end_s, "label": p.label} for p in self.poses
            ],
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

    def save(self, path: Path) -> None:
        """Write CAL.json, whole or not at all."""
        write_json(Path(path), self.to_json())


def _three(f: Array, sensor: Sensor, g: float) -> Array:
    """Forces of all three body axes, (n, 3): a missing one follows from |f| = g, positive."""
    full = np.zeros((len(f), 3))
    full[:, list(sensor.axis_indices)] = f
    if f.shape[1] == 2:
        (missing,) = set(range(3)) - set(sensor.axis_indices)
        full[:, missing] = np.sqrt(np.maximum(g * g - (f * f).sum(axis=1), 0.0))
    return full


def _solve(M: Array, sensor: Sensor, y: Array, f: Array, g: float) -> Array:
    """f of ``y = M f``; what a missing axis contributes is taken from the last f."""
    rows = list(sensor.axis_indices)
    if len(rows) == 2 and sensor.is_accelerometer:
        (missing,) = set(range(3)) - set(rows)
        y = y - np.outer(_three(f, sensor, g)[:, missing], M[:, missing])
    return np.asarray(np.linalg.solve(M[:, rows], y.T).T)


def load_calibration(path: Path | str) -> Calibration:
    """Read CAL.json.

    Raises:
        TiltcalError: it is no calibration.
    """
    path = require_file(Path(path), "calibration")
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        return calibration_from(table)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        what = f"no key {error}" if isinstance(error, KeyError) else str(error).splitlines()[0]
        raise TiltcalError(
            f"calibration {path.name}",
            found=what,
            need="a CAL.json as `tiltcal calibrate` writes it",
            do="write it again",
        ) from error


def calibration_from(table: Mapping[str, Any]) -> Calibration:
    """A calibration from the table of CAL.json; only method, verdict and parameters with values are
    required.
    """
    parameters = {
        name: Estimate(float(e["value"]), float(e.get("sigma", 0.0)), str(e.get("unit", "")))
        for name, e in table["parameters"].items()
    }
    covariance = np.diag([e.sigma**2 for e in parameters.values()])
    stated = table.get("covariance")
    if stated:
        order = [stated["names"].index(name) for name in parameters]
        covariance = np.array(stated["matrix"], dtype=float).reshape((len(stated["names"]),) * 2)[
            np.ix_(order, order)
        ]
    fit = table.get("fit", {})
    return Calibration(
        table["method"],
        table["verdict"],
        parameters,
        covariance,
        table.get("equation", ""),
        table.get("inverse", ""),
        table.get("frames", FRAMES),
        [PoseSpan(**p) for p in table.get("poses", ())],
        [Test(**t) for t in table.get("tests", ())],
        float(fit.get("chi2_per_dof", 0.0)),
        int(fit.get("dof", 0)),
        fit.get("heldout_rms", {}),
        list(table.get("warnings", ())),
        table.get("bias_tables", {}),
        table.get("lookup", "interpolated"),
        table.get("provenance", {}),
    )


def tilt_angles(f: Array, sensor: Sensor, g: float) -> dict[str, Array]:
    """Elevations of body x and y from corrected forces, rad: ``asin(f / g)``, or with a triad
    against its own length.
    """
    found = {}
    length = np.linalg.norm(f, axis=1) if f.shape[1] == 3 else np.full(len(f), g)
    for i, axis in enumerate(sensor.axes):
        if axis in ("x", "y"):
            found[axis] = tilt_of_force(f[:, i] / np.maximum(length, 1e-12), 1.0)
    return found


def chi2_test(
    name: str, statistic: float, dof: int, statement: str, significance: float = SIGNIFICANCE
) -> Test:
    """A chi-square test; passes while its p-value is above the significance."""
    from scipy.special import chdtrc

    p = float(chdtrc(dof, statistic)) if dof > 0 else 1.0
    return Test(name, float(statistic), int(dof), p, bool(p > significance), statement)


def verdict_of(tests: Sequence[Test], determined: bool = True) -> Verdict:
    """cannot_tell when the recording does not determine the model, suspect when a test failed, else
    good.
    """
    if not determined:
        return "cannot_tell"
    return "good" if all(t.passed for t in tests) else "suspect"
