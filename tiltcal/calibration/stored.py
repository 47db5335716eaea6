"""The schema of CAL.json, as it is read back."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from tiltcal.core.read_back import Finite, Stored

LARGEST = 1e30  # of an estimate and its sigma: their powers are still numbers
Size = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Sigma = Annotated[float, Field(ge=0, le=LARGEST)]
ROUNDING = 1e-6  # of a covariance that was written as text, against its own scale


class StoredEstimate(Stored):
    """A parameter with its standard uncertainty."""

    value: Size
    """Estimate, in its unit."""
    sigma: Sigma = 0.0
    """Standard uncertainty, in the same unit."""
    unit: str = ""
    """SI, `1`, or the unit of the effect."""


class StoredCovariance(Stored):
    """The covariance of the parameters, in the order of the names."""

    names: list[str] = []
    """Parameters in the order of the rows."""
    matrix: list[list[Finite]] = []
    """Covariance, in the units of the parameters."""

    @model_validator(mode="after")
    def _is_covariance(self) -> "StoredCovariance":
        n = len(self.names)
        if len(set(self.names)) != n or [len(row) for row in self.matrix] != [n] * n:
            raise ValueError(f"a matrix of {n} by {n}, one row a name, each name once")
        matrix = np.array(self.matrix).reshape(n, n)
        scale = np.sqrt(np.abs(np.diag(matrix)))
        if n and not np.abs(matrix).max() <= LARGEST**2:
            raise ValueError(f"sigmas of at most {LARGEST:g}")
        bounds = np.outer(scale, scale)
        unit = np.divide(matrix, bounds, out=np.zeros((n, n)), where=bounds > 0)
        if np.any(np.abs(unit - unit.T) > ROUNDING) or np.any((bounds == 0) & (matrix != 0)):
            raise ValueError("a symmetric matrix")
        if n and np.linalg.eigvalsh((unit + unit.T) / 2)[0] < -ROUNDING * n:
            raise ValueError("a matrix without negative eigenvalues")
        return self


class StoredPose(Stored):
    """A dwell that was used."""

    start_s: Finite
    """Its start on the clock of the recording, s."""
    end_s: Finite
    """Its end on the same clock, s."""
    label: str | None = None
    """The operator's label."""


class StoredTest(Stored):
    """A test of the calibration's own validity."""

    name: str
    """What was tested."""
    statistic: Finite
    """Value of the test statistic."""
    dof: int
    """Its degrees of freedom."""
    p_value: Finite
    """Probability of so large a value by chance."""
    passed: bool
    """Whether the test passed."""
    statement: str
    """The result in a sentence."""


class StoredFit(Stored):
    """How well it fits."""

    chi2_per_dof: Finite = 0.0
    """Chi-square per degree of freedom."""
    dof: int = 0
    """Degrees of freedom."""
    heldout_rms: dict[str, Finite] = {}
    """Rms residual of poses left out of the fit, by sensor, SI."""


class StoredEntry(Stored):
    """An entry of a placing-angle table."""

    angle_deg: Annotated[float, Field(ge=-360, le=360)]
    """Placing angle, the readout of the table's outer axis, deg."""
    value: Size
    """Bias there, in its unit."""
    sigma: Sigma = 0.0
    """Standard uncertainty, in the same unit."""
    unit: str
    """Unit of the bias."""


class StoredReference(Stored):
    """An uncertain reference."""

    name: str
    """What it is, as text."""
    size: Size
    """As stated, in its unit, with its distribution."""
    unit: str = ""
    """Unit of the size."""
    distribution: str = "normal"
    """What the size is: a standard uncertainty, a half-width, or U at k = 2."""
    standard: Sigma
    """Standard uncertainty, in its unit."""
    assumed: bool = False
    """It stands in the budget only, not in the covariance."""
    at_stops: bool = False
    """It is another error at each stop."""
    contributions: dict[str, Sigma] = {}
    """Standard uncertainty that it contributes to each parameter, in the parameter's unit."""
    posterior: tuple[Size, Sigma] | None = None
    """Its error by the recording and the uncertainty of that, in its unit, where it was fitted."""


class StoredProvenance(Stored):
    """What it came from."""

    columns: dict[str, str | None] = {}
    """Unit of the columns of each sensor."""
    temperature_degC: Finite | None = None
    """Mean temperature of the recording."""
    undetermined: list[str] = []
    """Parameters that the recording does not determine."""


class StoredCalibration(Stored):
    """CAL.json; only method, verdict and parameters with values are required."""

    schema_: Annotated[int, Field(alias="schema")] = 1
    """Version of the file's keys; 2 is written, 1 is read as well."""
    parameters: dict[str, StoredEstimate]
    """Estimates, by `<sensor>.<term>_<axes>`."""
    method: str
    """Method that made it."""
    verdict: str
    """`good`, `suspect` or `cannot_tell`."""
    covariance: StoredCovariance | None = None
    """Covariance of the parameters; not given: their sigmas, uncorrelated."""
    equation: str = ""
    """Forward model, for readers."""
    inverse: str = ""
    """How a reading is corrected, for readers."""
    frames: str | None = None
    """Definition of the frames, for readers."""
    poses: list[StoredPose] = []
    """Dwells that were used."""
    tests: list[StoredTest] = []
    """Tests of its own validity."""
    fit: StoredFit = StoredFit()
    """How well the model fits the recording."""
    warnings: list[str] = []
    """Notes for the user."""
    bias_tables: dict[str, list[StoredEntry]] = {}
    """Placing-angle tables: entries by `<sensor>.<axis>`."""
    lookup: Literal["interpolated", "rounded", "smooth"] = "interpolated"
    """How those tables are read between their entries."""
    own_frame: bool | None = None
    """The axes are the sensor's own, turned against the table's: the norm was the only
    reference.
    """
    terms: list[dict[str, Any]] = []
    """The same parameters as effects of the catalogue: written for other programs, not read."""
    effects: list[dict[str, Any]] = []
    """`[[effect]]` tables of what is no term, such as learned curves."""
    references: list[StoredReference] = []
    """Uncertain references, stated or assumed, with their shares of the uncertainty."""
    assumed_covariance: list[list[Finite]] | None = None
    """Covariance by the references that are assumed, in the order of the parameters."""
    provenance: StoredProvenance = StoredProvenance()
    """What it came from: recording, set-up, ranges, versions."""

    @model_validator(mode="after")
    def _names_fit(self) -> "StoredCalibration":
        if self.covariance and self.covariance.names:
            missing = set(self.parameters) - set(self.covariance.names)
            if missing:
                raise ValueError(f"a covariance of every parameter; {min(missing)} is not in it")
        p, assumed = len(self.parameters), self.assumed_covariance
        if assumed is not None and [len(row) for row in assumed] != [p] * p:
            raise ValueError(f"an assumed_covariance of {p} by {p}, one row a parameter")
        unknown = {n for r in self.references for n in r.contributions} ^ set(self.parameters)
        if self.references and unknown:
            raise ValueError(f"a contribution to each parameter; {min(unknown)} is not in both")
        return self

    @property
    def assumed_matrix(self) -> "np.typing.NDArray[np.float64] | None":
        """The covariance by assumed references, (p, p); None without any."""
        return None if self.assumed_covariance is None else np.array(self.assumed_covariance)

    @property
    def matrix(self) -> "np.typing.NDArray[np.float64]":
        """The covariance in the order of the parameters; of the sigmas where none is stated. (p,
        p).
        """
        stated = self.covariance
        if stated is None or not stated.names:
            return np.diag([e.sigma**2 for e in self.parameters.values()])
        order = [stated.names.index(name) for name in self.parameters]
        n = len(stated.names)
        return np.array(stated.matrix, dtype=float).reshape(n, n)[np.ix_(order, order)]
