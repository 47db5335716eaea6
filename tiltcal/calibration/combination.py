"""Calibrations of one instrument joined into one: those of a room and of a chamber, or of several
days.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tiltcal import __version__
from tiltcal.calibration.methods.common import undetermined_test
from tiltcal.calibration.result import Calibration, Estimate, setup_of
from tiltcal.calibration.validity import VERDICTS, Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.instrument.terms import SHARED, si_factor

EXACT = 1e-10  # of a variance: what is stated as exact is weighed as this exact
METHOD = "combined"


@dataclass(frozen=True)
class Combination:
    """Several calibrations as one.

    Args:
        calibration: the joint estimate.
        test: whether the parameters that they have in common agree.
        differing: the common parameters that differ most, with the difference in sigmas; empty
            where they agree.
    """

    calibration: Calibration
    test: Test
    differing: Mapping[str, float]

    @property
    def agrees(self) -> bool:
        """Whether the common parameters agree."""
        return self.test.passed


def combine(calibrations: Sequence[Calibration]) -> Combination:
    """The joint estimate of calibrations of one instrument, by generalised least squares.

    A calibration without terms over temperature holds at the temperature that it was made at; a
    joint bias is that at the reference temperature of the one with such terms. The parameters that
    one does not determine are those of the others.

    Args:
        calibrations: two or more; sensors of one name are one sensor.

    Raises:
        TiltcalError: fewer than two, other sensors under one name, terms over temperature or
            placing-angle tables of one axis in several, or frames that differ.
    """
    _require_one_instrument(calibrations)
    calibrations = _completed(calibrations)
    thermal = [c for c in calibrations if f"{SHARED}.T0" in c.parameters]
    names, units = _joint_names(calibrations)
    parts = [_Part.of(c, names, thermal) for c in calibrations]
    information = np.sum([p.H.T @ p.weight @ p.H for p in parts], axis=0)
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-14, hermitian=True)
    covariance = inverse * np.outer(scale, scale)
    x = covariance @ np.sum([p.H.T @ p.weight @ p.values for p in parts], axis=0)
    left = [p.values - p.H @ x for p in parts]
    chi2 = float(sum(r @ p.weight @ r for r, p in zip(left, parts, strict=True)))
    dof = sum(len(p.values) for p in parts) - len(names)
    text = f"{dof} parameters in common to {len(parts)} calibrations agree within their uncertainty"
    test = chi2_test("common parameters agree", chi2, dof, text)
    differing = {} if test.passed else _differing(parts, names, x)
    joint = _joined(calibrations, thermal, names, units, x, covariance, test)
    return Combination(joint, test, differing)


@dataclass(frozen=True)
class _Part:
    """One calibration as a measurement of the joint parameters.

    Args:
        values: of its parameters, SI, (m,).
        weight: inverse of their covariance, (m, m).
        H: its parameters by the joint ones, (m, p).
        sigmas: of its parameters, SI, (m,).
    """

    values: Array
    weight: Array
    H: Array
    sigmas: Array

    @classmethod
    def of(
        cls, calibration: Calibration, joint: Sequence[str], thermal: Sequence[Calibration]
    ) -> "_Part":
        own = _measured(calibration)
        factors = np.array([_factor(calibration, n) for n in own])
        rows = [list(calibration.parameters).index(n) for n in own]
        covariance = np.asarray(calibration.covariance)[np.ix_(rows, rows)]
        covariance = covariance * np.outer(factors, factors)
        values = np.array([calibration.value(n) for n in own]) * factors
        H = np.array([[float(n == name) for name in joint] for n in own])
        if thermal and calibration not in thermal:
            warm = temperature_of(calibration) - thermal[0].value(f"{SHARED}.T0")
            for i, name in enumerate(own):
                owner, _, term = name.partition(".")
                for j, other in enumerate(joint):
                    head, _, tail = other.partition(f"{owner}.temp")
                    power, _, of_term = tail.partition("_")
                    if not head and power.isdigit() and of_term == term:
                        H[i, j] = warm ** int(power)
        sigma = np.sqrt(np.diag(covariance))
        sigma = np.where(sigma > 0, sigma, 1e-12 * np.maximum(np.abs(values), 1e-6))
        correlation = covariance / np.outer(sigma, sigma)
        inverse = np.linalg.inv(correlation + EXACT * np.eye(len(sigma)))
        return cls(values, inverse / np.outer(sigma, sigma), H, sigma)


def _factor(calibration: Calibration, name: str) -> float:
    """SI value of one unit of a parameter.

    Raises:
        TiltcalError: the unit is unknown.
    """
    unit = calibration.parameters[name].unit
    factor = si_factor(unit)
    if factor is None:
        raise TiltcalError(
            f"calibration by {calibration.method}, {name}",
            found=f"the unit '{unit}'",
            need="a unit of tiltcal",
            do="return it in one, as docs/interfaces.md lists them",
        )
    return factor


def temperature_of(calibration: Calibration) -> float:
    """Temperature that a calibration was made at, degC: of its recording, else of its set-up."""
    stated = calibration.provenance.get("temperature_degC")
    return setup_of(calibration).site.temperature_degC if stated is None else float(stated)


def _measured(calibration: Calibration) -> list[str]:
    """Its parameters but for what its terms over temperature follow."""
    return [n for n in calibration.parameters if not n.startswith(f"{SHARED}.")]


def _completed(calibrations: Sequence[Calibration]) -> list[Calibration]:
    """The calibrations, judged without the parameters that they do not determine where others
    have them.
    """
    names = {n for c in calibrations for n in c.parameters}
    found = []
    for calibration in calibrations:
        missing = calibration.provenance.get("undetermined", [])
        settled = undetermined_test(missing)
        tests = [t for t in calibration.tests if t != settled]
        judged = calibration.dof > 0 and len(tests) < len(calibration.tests)
        if judged and names.issuperset(missing):
            known = all(t.passed for t in tests if t.name == settled.name)
            calibration = replace(calibration, tests=tests, verdict=verdict_of(tests, known))
        found.append(calibration)
    return found


def _joint_names(calibrations: Sequence[Calibration]) -> tuple[list[str], dict[str, str]]:
    """All parameters, and the unit of each where it is first stated."""
    units: dict[str, str] = {}
    for calibration in calibrations:
        for name in _measured(calibration):
            units.setdefault(name, calibration.parameters[name].unit)
    return list(units), units


def _require_one_instrument(calibrations: Sequence[Calibration]) -> None:
    """Refuse what is not one instrument.

    Raises:
        TiltcalError: see ``combine``.
    """
    problem = ""
    do = "combine calibrations of one instrument"
    if len(calibrations) < 2:
        problem = f"{len(calibrations)} calibration"
    sensors: dict[str, object] = {}
    for calibration in calibrations:
        setup = setup_of(calibration)
        for name in calibration.sensors():
            s = setup.named(name)
            kind = (s.kind, s.axes, s.input_axis)
            if sensors.setdefault(name, kind) != kind:
                problem = f"different sensors under the name {name}"
    if sum(f"{SHARED}.T0" in c.parameters for c in calibrations) > 1:
        problem, do = "terms over temperature in several", "combine one of them with the others"
    tables = [key for c in calibrations for key in c.bias_tables]
    if len(tables) > len(set(tables)):
        problem, do = "placing-angle tables of one axis in several", "combine one of them"
    if len({c.own_frame for c in calibrations}) > 1:
        problem = "axes in the table's frame and in the sensor's own"
        do = "calibrate all with known attitudes, or all by the norm"
    if problem:
        raise TiltcalError(
            "combination", found=problem, need="two or more calibrations of one instrument", do=do
        )


def _differing(parts: Sequence[_Part], names: Sequence[str], x: Array) -> dict[str, float]:
    """Common parameters whose estimates differ by most sigmas, those of another temperature carried
    to that of the joint estimate. x: SI, (p,).
    """
    found: dict[str, float] = {}
    for j, name in enumerate(names):
        seen = [
            (p.values[i] - p.H[i] @ x + x[j], p.sigmas[i])
            for p in parts
            for i in np.flatnonzero(p.H[:, j] == 1.0)
            if np.count_nonzero(p.H[i]) == 1 or ".temp" not in name
        ]
        for (a, sa), (b, sb) in pairwise(seen):
            found[name] = max(found.get(name, 0.0), float(abs(a - b) / np.hypot(sa, sb)))
    worst = sorted(found.items(), key=lambda item: -item[1])
    limit = np.sqrt(10.8)  # chi-square of one degree of freedom at 0.1 %
    beyond = {name: z for name, z in worst if z > limit}
    return beyond or dict(worst[:1])


def _joined(
    calibrations: Sequence[Calibration],
    thermal: Sequence[Calibration],
    names: Sequence[str],
    units: Mapping[str, str],
    x: Array,
    covariance: Array,
    test: Test,
) -> Calibration:
    """The joint estimate as a calibration."""
    factors = np.array([si_factor(units[n]) or 1.0 for n in names])
    shown = covariance / np.outer(factors, factors)
    shared = {
        n: e for c in thermal[:1] for n, e in c.parameters.items() if n.startswith(f"{SHARED}.")
    }
    parameters = shared | {
        n: Estimate(float(v), float(np.sqrt(max(s, 0.0))), units[n])
        for n, v, s in zip(names, x / factors, np.diag(shown), strict=True)
    }
    whole = np.zeros((len(parameters),) * 2)
    whole[len(shared) :, len(shared) :] = shown
    verdicts = [c.verdict for c in calibrations] + ["good" if test.passed else "suspect"]
    tables = [c for c in calibrations if c.bias_tables]
    joint = Calibration(
        METHOD,
        max(verdicts, key=VERDICTS.index),
        parameters,
        whole,
        poses=[p for c in calibrations for p in c.poses],
        tests=_tests(calibrations, test),
        chi2_per_dof=test.statistic / max(test.dof, 1),
        dof=test.dof,
        warnings=[w for c in calibrations for w in c.warnings],
        bias_tables={k: v for c in tables for k, v in c.bias_tables.items()},
        lookup=tables[0].lookup if tables else "interpolated",
        own_frame=calibrations[0].own_frame,
        provenance=_provenance(calibrations),
        effects=[e for c in calibrations for e in c.effects],
    )
    setup = setup_of(joint)
    sensors = [setup.named(name) for name in joint.sensors()]
    equations = [
        joint.instrument((sensor,), setup.site.gravity).equation(sensor) for sensor in sensors
    ]
    return replace(
        joint,
        equation="; ".join(equations),
        inverse="by Newton's iteration from the linear terms",
    )


def _tests(calibrations: Sequence[Calibration], test: Test) -> list[Test]:
    """The test of the combination, and those of each calibration with its number and method."""
    tests = [test]
    for k, calibration in enumerate(calibrations, start=1):
        where = f"{k} ({calibration.method})"
        tests += [replace(t, name=f"{t.name}, {where}") for t in calibration.tests]
    return tests


def _provenance(calibrations: Sequence[Calibration]) -> dict[str, object]:
    """The set-up of the first with the sensors of all, and where each part came from."""
    sensors = {s.name: s for c in calibrations for s in setup_of(c).sensor}
    stated = [s.model_dump(mode="json", exclude_none=True) for s in sensors.values()]
    columns = [c.provenance.get("columns", {}) for c in calibrations]
    parts = [
        {"method": c.method, "recording": c.provenance.get("recording", "")} for c in calibrations
    ]
    return {
        "made by": f"tiltcal {__version__}",
        "setup": {**calibrations[0].provenance["setup"], "sensor": stated},
        "columns": {k: v for each in columns for k, v in each.items()},
        "parts": parts,
    }
