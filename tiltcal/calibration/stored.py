"""The schema of CAL.json, as it is read back."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from tiltcal.core.read_back import Finite, Stored

LARGEST = 1e30  # of a sigma: its powers are still numbers
ROUNDING = 1e-6  # of a covariance that was written as text, against its own scale


class StoredEstimate(Stored):
    """A parameter."""

    value: Finite
    sigma: Annotated[float, Field(ge=0)] = 0.0
    unit: str = ""


class StoredCovariance(Stored):
    """The covariance of the parameters, in the order of the names."""

    names: list[str] = []
    matrix: list[list[Finite]] = []

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
    end_s: Finite
    label: str | None = None


class StoredTest(Stored):
    """A test of its own validity."""

    name: str
    statistic: Finite
    dof: int
    p_value: Finite
    passed: bool
    statement: str


class StoredFit(Stored):
    """How well it fits."""

    chi2_per_dof: Finite = 0.0
    dof: int = 0
    heldout_rms: dict[str, Finite] = {}


class StoredEntry(Stored):
    """An entry of a placing-angle table."""

    angle_deg: Annotated[float, Field(ge=-360, le=360)]
    value: Finite
    sigma: Annotated[float, Field(ge=0)] = 0.0
    unit: str


class StoredReference(Stored):
    """An uncertain reference."""

    name: str
    size: Finite
    unit: str = ""
    distribution: str = "normal"
    standard: Annotated[float, Field(ge=0)]
    assumed: bool = False
    at_stops: bool = False
    contributions: dict[str, Annotated[float, Field(ge=0)]] = {}
    posterior: tuple[Finite, Annotated[float, Field(ge=0)]] | None = None


class StoredCalibration(Stored):
    """CAL.json; only method, verdict and parameters with values are required."""

    parameters: dict[str, StoredEstimate]
    method: str
    verdict: str
    covariance: StoredCovariance | None = None
    equation: str = ""
    inverse: str = ""
    frames: str | None = None
    poses: list[StoredPose] = []
    tests: list[StoredTest] = []
    fit: StoredFit = StoredFit()
    warnings: list[str] = []
    bias_tables: dict[str, list[StoredEntry]] = {}
    lookup: Literal["interpolated", "rounded", "smooth"] = "interpolated"
    own_frame: bool | None = None
    effects: list[dict[str, Any]] = []
    references: list[StoredReference] = []
    assumed_covariance: list[list[Finite]] | None = None
    provenance: dict[str, Any] = {}

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
