"""Limits of the recovered parameters over all runs, against the injected truth, and which of them
have to be there.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import Accept
from tiltcal.setup.sensor import Sensor
from tiltcal.validation.accuracy import sensor_truth
from tiltcal.validation.limit import Judge, Limit
from tiltcal.validation.runs import Row

INJECTED = 1e-12  # a smaller truth is a rounding error


def required_parameters(scenario: Scenario, accept: Accept, rows: Sequence[Row]) -> list[str]:
    """Names that every run has to return.

    What the scenario states as ``required``; else of each sensor that the method gave a parameter
    of (of all sensors when it gave none): its adjustable bias, scale and cross-axis terms, and
    every injected term. A base tilt is roll and pitch.
    """
    found = list(dict.fromkeys(p.name for r in rows for p in r.parameters))
    if accept.required is not None:
        return [name for entry in accept.required for name in _names(entry, scenario)]
    if "base.roll" in found or "base.pitch" in found:
        return ["base.roll", "base.pitch"]
    owners = {name.partition(".")[0] for name in found}
    sensors = [s for s in scenario.sensor if s.name in owners or not owners]
    symmetric = any(r.method == "norm" for r in rows)
    return [name for s in sensors for name in _of_sensor(s, scenario, symmetric)]


def _of_sensor(sensor: Sensor, scenario: Scenario, symmetric: bool) -> list[str]:
    adjustable = {"cross" if t == "cross_axis" else t for t in sensor.adjustable}
    names = []
    for name, value in sensor_truth(sensor, scenario.effects, symmetric).items():
        stem, _, axes = name.partition(".")[2].partition("_")
        listed = stem in adjustable and set(axes) <= set(sensor.axes)
        if listed or abs(value) > INJECTED:
            names.append(name)
    return names


def _names(entry: str, scenario: Scenario) -> list[str]:
    """``accel.bias`` as the names of all its axes; any other name as it is."""
    owner, _, term = entry.partition(".")
    sensors = [s for s in scenario.sensor if s.name == owner]
    if not sensors or "_" in term:
        return [entry]
    axes = sensors[0].axes
    pairs = [a + b for a in axes for b in axes if a != b] if term == "cross" else list(axes)
    return [f"{entry}_{axis}" for axis in pairs]


def missing_limit(required: Sequence[str], rows: Sequence[Row]) -> Limit:
    """Whether every run returned every required parameter."""
    missing: dict[str, int] = {}
    for row in rows:
        returned = {p.name for p in row.parameters}
        for name in required:
            if name not in returned:
                missing[name] = missing.get(name, 0) + 1
    words = ", ".join(
        name if count == len(rows) else f"{name} in {count} of {len(rows)} runs"
        for name, count in missing.items()
    )
    name, allowed = "required parameters that are missing", f"none of {len(required)}"
    return Limit(name, float(len(missing)), allowed, not missing, where=words)


def parameter_judges(rows: Sequence[Row]) -> Iterator[Judge]:
    """What decides on the errors of the parameters: with one run the sum of their squares and the
    largest.
    """
    z = errors_in_sigmas(rows)
    if not z or any(np.any(~np.isfinite(e)) for e in z.values()):
        names = [name for name, e in z.items() if np.any(~np.isfinite(e))]
        words = "a sigma above 0" if names else "a truth to compare with"
        where = ", ".join(names)
        yield lambda _: Limit("parameters against the truth", 0.0, words, False, where=where)
        return
    yield lambda share: _nees(rows, share)
    yield lambda share: _worst_error(rows, z, share)
    if len(rows) > 1:
        yield lambda share: _worst_run(rows, share)
        yield lambda share: _worst_parameter(z, share)
        yield lambda share: _worst_mean(z, share)


def errors_in_sigmas(rows: Sequence[Row]) -> dict[str, Array]:
    """Error over sigma of each parameter with a truth, (runs that returned it,); infinite where
    sigma is 0.
    """
    found: dict[str, list[float]] = {}
    for row in rows:
        for p in row.parameters:
            if p.truth is not None:
                z = (p.value - p.truth) / p.sigma if p.sigma > 0 else np.inf
                found.setdefault(p.name, []).append(z)
    return {name: np.array(z) for name, z in found.items()}


def _nees(rows: Sequence[Row], share: float) -> Limit:
    """All parameters of all runs: the sum of squared errors in units of their covariance (NEES)."""
    from scipy.special import chdtri

    total, dof = sum(r.nees for r in rows), sum(r.nees_dof for r in rows)
    name = "parameters, NEES per degree of freedom"
    if dof == 0:
        return Limit(name, 0.0, "a covariance that is not singular", False)
    low, high = chdtri(dof, 1 - share / 2), chdtri(dof, share / 2)
    low_end, high_end = (total / float(chdtri(dof, p)) for p in (0.025, 0.975))
    allowed, passed = f"{low / dof:.3g} ... {high / dof:.3g}", bool(low <= total <= high)
    return Limit(name, total / dof, allowed, passed, (low_end, high_end))


def _worst_run(rows: Sequence[Row], share: float) -> Limit:
    """The NEES of every run by itself."""
    from scipy.special import chdtrc, chdtri

    dof = np.array([r.nees_dof for r in rows])
    nees = np.array([r.nees for r in rows])
    p = np.where(dof > 0, chdtrc(np.maximum(dof, 1), nees), 0.0)
    k = int(np.argmin(p))
    largest = float(chdtri(max(dof[k], 1), share / len(rows)) / max(dof[k], 1))
    name = "parameters, NEES per degree of freedom, worst run"
    reached, passed = nees[k] / max(dof[k], 1), bool(np.all(p >= share / len(rows)))
    return Limit(name, float(reached), f"<= {largest:.3g}", passed, where=f"seed {rows[k].seed}")


def _worst_error(rows: Sequence[Row], z: dict[str, Array], share: float) -> Limit:
    """Every parameter of every run by itself."""
    from scipy.stats import norm

    count = sum(len(e) for e in z.values())
    most = float(norm.isf(share / 2 / count))
    size, name, seed = max(
        (abs(p.value - p.truth) / p.sigma, p.name, row.seed)
        for row in rows
        for p in row.parameters
        if p.truth is not None
    )
    where = f"{name}, seed {seed}"
    return Limit(
        "parameters, largest error, sigma", size, f"<= {most:.3g}", size <= most, where=where
    )


def _worst_parameter(z: dict[str, Array], share: float) -> Limit:
    """The squared errors of every parameter over runs, in units of its own sigma."""
    from scipy.special import chdtri

    name, p = min(
        ((n, _two_sided(float(e @ e), len(e))) for n, e in z.items()), key=lambda pair: pair[1]
    )
    n, each = len(z[name]), share / len(z)
    low, high = chdtri(n, 1 - each / 2) / n, chdtri(n, each / 2) / n
    reached = float(np.mean(z[name] ** 2))
    low_end, high_end = (n * reached / float(chdtri(n, q)) for q in (0.025, 0.975))
    return Limit(
        "parameters, mean square error over sigma^2, worst parameter",
        reached,
        f"{low:.3g} ... {high:.3g}",
        p >= each,
        (low_end, high_end),
        name,
    )


def _two_sided(total: float, dof: int) -> float:
    from scipy.special import chdtr, chdtrc

    return 2 * float(min(chdtr(dof, total), chdtrc(dof, total)))


def _worst_mean(z: dict[str, Array], share: float) -> Limit:
    """The mean error of every parameter over runs, in units of the sigma of that mean."""
    from scipy.stats import norm

    means = {name: float(e.sum() / np.sqrt(len(e))) for name, e in z.items()}
    name = max(means, key=lambda n: abs(means[n]))
    most, reached = float(norm.isf(share / 2 / len(z))), means[name]
    return Limit(
        "parameters, mean error over its sigma, worst parameter",
        reached,
        f"-{most:.3g} ... {most:.3g}",
        abs(reached) <= most,
        (reached - float(norm.isf(0.025)), reached + float(norm.isf(0.025))),
        name,
    )
