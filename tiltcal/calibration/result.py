"""Calibration: recovered parameters with covariance, tests and a verdict; saved, loaded and
applied.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from tiltcal.calibration.stored import StoredCalibration
from tiltcal.calibration.validity import VERDICTS, Test, Verdict
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.files import write_json
from tiltcal.core.frames import tilt_of_force
from tiltcal.core.numerical import undetermined
from tiltcal.core.read_back import checked, read_json
from tiltcal.core.tabular import Tabular
from tiltcal.core.units import G0, readable_unit
from tiltcal.effects import make_effect
from tiltcal.effects.base import Effect
from tiltcal.effects.catalogue import to_file
from tiltcal.effects.sense import Sense
from tiltcal.instrument.model import InstrumentModel
from tiltcal.instrument.placing import PlacingBias, PlacingCorrector, tables_of
from tiltcal.instrument.terms import model_of, terms_table
from tiltcal.recordings.static_poses import PoseSpan
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

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
class Reference:
    """An uncertain reference, and its share of the uncertainty of each parameter.

    Args:
        name: as text.
        size: as stated, in ``unit``, with its distribution.
        standard: standard uncertainty, in ``unit``.
        assumed: whether it stands in the budget only: not in the covariance.
        at_stops: whether it is another error at each stop.
        contributions: parameter -> standard uncertainty it contributes, in the parameter's unit.
        posterior: the error by the recording, and its standard uncertainty then, in ``unit``; None
            where it was not fitted, or is another one at each stop.
    """

    name: str
    size: float
    unit: str
    distribution: str
    standard: float
    assumed: bool
    at_stops: bool
    contributions: Mapping[str, float]
    posterior: tuple[float, float] | None = None


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
        own_frame: whether its axes are the sensor's own, turned by an unknown small rotation
            against those of the table: the norm alone was the reference.
        bias_tables: placing-angle tables, ``<sensor>.<axis>`` -> entries; lookup: how they are
            read.
        provenance: what it came from.
        effects: of the instrument that are no terms, such as learned curves: known, without an
            uncertainty.
        references: the uncertain references; those that were stated are part of the covariance.
        assumed_covariance: by the references that are assumed, (p, p); None without any.
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
    own_frame: bool = False
    provenance: Mapping[str, Any] = field(default_factory=dict)
    effects: Sequence[Effect] = ()
    references: Sequence[Reference] = ()
    assumed_covariance: Array | None = None

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
    def with_assumed(self) -> "Calibration":
        """The same with the references that are assumed in its covariance."""
        if self.assumed_covariance is None:
            return self
        covariance = np.asarray(self.covariance) + self.assumed_covariance
        return replace(self, covariance=covariance, assumed_covariance=None)

    @property
    def heldout_shown(self) -> dict[str, tuple[float, str]]:
        """Held-out residual of each sensor, in the unit that its bias is shown in."""
        found = {}
        for name, rms in self.heldout_rms.items():
            own = [e.unit for n, e in self.parameters.items() if n.startswith(f"{name}.bias_")]
            factor, unit = self.shown_in(name, own[0]) if own else (1.0, "SI")
            found[name] = (rms * factor, unit)
        return found

    def of_base(self) -> list[str]:
        """Its parameters of the base: tilt and azimuth."""
        return [name for name in self.parameters if name.partition(".")[0] == "base"]

    def sensors(self) -> list[str]:
        """Names of the sensors it has parameters for."""
        names = [name.split(".")[0] for name in (*self.parameters, *self.bias_tables)]
        names += [e.sensor for e in self.effects if e.sensor is not None]
        return [n for n in dict.fromkeys(names) if n not in NO_SENSORS]

    def instrument(self, sensors: Sequence[Sensor], gravity: float) -> InstrumentModel:
        """The model of the instrument that the parameters and tables describe.

        Args:
            sensors: of the set-up.
            gravity: m/s2.
        """
        tables = []
        for sensor in sensors:
            if (corrector := self.placing(sensor, gravity)) is not None:
                tables += [
                    PlacingBias({}, sensor.name, axis, table=table, lookup=corrector.lookup)
                    for axis, table in corrector.tables.items()
                ]
        tabulated = {table.sensor for table in tables}
        # the smooth fit of a table is another form of the same bias
        values = {
            name: (e.value, e.unit)
            for name, e in self.parameters.items()
            if name.partition(".")[0] not in tabulated
        }
        names = list(self.parameters)
        rows = [names.index(name) for name in values]
        covariance = np.asarray(self.covariance)[np.ix_(rows, rows)]
        own = {s.name for s in sensors}
        others = [e for e in self.effects if e.sensor is None or e.sensor in own]
        return model_of(sensors, gravity, values, covariance, [*tables, *others])

    @cached_property
    def _models(self) -> dict[tuple[str, float], InstrumentModel]:
        return {}

    def of_sensor(self, sensor: Sensor, gravity: float) -> InstrumentModel:
        """The model of one sensor, kept for the next call. gravity: m/s2."""
        key = (sensor.name, gravity)
        if key not in self._models:
            self._models[key] = self.instrument((sensor,), gravity)
        return self._models[key]

    def sensitivity(self, sensor: Sensor) -> Array:
        """The matrix M of ``reading = bias + M f``, (k, 3)."""
        return self.of_sensor(sensor, G0).linear(sensor)[1]

    def bias(self, sensor: Sensor) -> Array:
        """Bias of each channel, SI, (k,)."""
        return self.of_sensor(sensor, G0).linear(sensor)[0]

    def placing(
        self, sensor: Sensor, g: float, lookup: str | None = None
    ) -> PlacingCorrector | None:
        """The on-line corrector of a sensor with placing-angle tables; None without such tables."""
        values = {n: e.value for n, e in self.parameters.items()}
        tables = tables_of(self.bias_tables, sensor.name, values)
        return PlacingCorrector(tables, g, lookup or self.lookup) if tables else None

    def correct(
        self, sensor: Sensor, reading: Array, g: float, given: Sense | None = None
    ) -> Array:
        """Corrected readings, SI in the sensing form (f or rate), (n, k): see
        ``InstrumentModel.invert``.

        With placing-angle tables: x and y less their table, NaN outside the range of the table.

        Args:
            sensor: which.
            reading: in the sensing form, SI, (n, k).
            g: m/s2.
            given: time, temperature, and the force with a gyro, where the model needs them.
        """
        corrector = self.placing(sensor, g)
        if corrector is not None:
            columns = [sensor.axes.index(a) for a in "xyz" if a in sensor.axes]
            corrected = np.array(reading)
            corrected[:, columns[:2]] = corrector.correct(reading[:, columns])
            return corrected
        return self.of_sensor(sensor, g).invert(sensor, reading, given)

    def to_json(self) -> dict[str, Any]:
        """The table of CAL.json."""
        table: dict[str, Any] = {
            "schema": 2,
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
        if "setup" in self.provenance:
            setup = setup_of(self)
            table["terms"] = terms_table(self.instrument(setup.sensor, setup.site.gravity))
        if self.references:
            table["references"] = [{**vars(r)} for r in self.references]
        if self.assumed_covariance is not None:
            table["assumed_covariance"] = np.asarray(self.assumed_covariance).tolist()
        if self.effects:
            table["effects"] = [to_file(effect) for effect in self.effects]
        if self.own_frame:
            table["own_frame"] = True
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


def setup_of(calibration: Calibration) -> Setup:
    """The set-up a calibration was made with.

    Raises:
        TiltcalError: it does not carry one, or one that is none.
    """
    stated = calibration.provenance.get("setup")
    if stated is None:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no provenance.setup",
            need="the set-up it belongs to",
            do="make it with `tiltcal calibrate`, which adds the set-up",
        )
    try:
        return Setup.model_validate(stated)
    except ValidationError as error:
        first = error.errors()[0]
        raise TiltcalError(
            f"calibration by {calibration.method},"
            f" provenance.setup.{'.'.join(map(str, first['loc']))}",
            found=first["msg"].lower(),
            need="the set-up as `tiltcal calibrate` writes it",
            do="make the calibration again",
        ) from error


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
    provenance = c.provenance.model_dump(exclude_unset=True)
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
        c.method == "norm" if c.own_frame is None else c.own_frame,
        provenance,
        _stored_effects(c.effects, provenance, subject),
        [Reference(**dict(r)) for r in c.references],
        c.assumed_matrix,
    )


def _stored_effects(
    tables: Sequence[Mapping[str, Any]], provenance: Mapping[str, Any], subject: str
) -> list[Effect]:
    """The effects that are no terms, as CAL.json states them.

    Raises:
        TiltcalError: one is unknown, or there is no set-up that they belong to.
    """
    if not tables:
        return []
    setup = setup_of(
        Calibration(subject, "cannot_tell", {}, np.zeros((0, 0)), provenance=provenance)
    )
    return [
        make_effect(
            str(table.get("id")),
            {k: v for k, v in table.items() if k not in ("id", "sensor", "axis", "role")},
            setup,
            sensor=table.get("sensor"),
            axis=table.get("axis"),
            role=table.get("role"),
            subject=f"{subject}, effect",
        )
        for table in tables
    ]


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
