"""Acceptance of a calibration method over all its runs: verdict, required parameters, parameters
against the truth, tilt error.

A correct method is rejected with probability ``false_alarm`` at most: that probability is shared
equally by all tests that decide by chance (Bonferroni).

Recovered parameters are compared with the injected truth, and those that are required have to be
there.

Each limit is a number for each run, and the tilt error is compared with it in four ways: its rms
over runs, its expectation by the method's own covariance, its worst run, and a quantile. Chance is
what that covariance states: the squared error of a run is bound^2 chi2(dof) / dof. A limit below
the bound gets the chance of an error at the limit, never that of a larger one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.validity import SIGNIFICANCE
from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC
from tiltcal.laboratory.scenario import Scenario
from tiltcal.laboratory.scenario_tables import Accept, MethodTable
from tiltcal.setup.sensor import Sensor
from tiltcal.validation.accuracy import sensor_truth
from tiltcal.validation.runs import Row


@dataclass(frozen=True)
class Limit:
    """One acceptance limit: what was reached, what was allowed, as text.

    Args:
        interval: 95 % interval of what was reached, where it is an estimate.
        where: the seed or parameter that it is about, where it is about one.
    """

    name: str
    reached: float
    allowed: str
    passed: bool
    interval: tuple[float, float] | None = None
    where: str = ""


Judge = Callable[[float], Limit]
"""Makes a limit from the probability with which a correct method may break it."""


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
    text = ", ".join(
        name if count == len(rows) else f"{name} in {count} of {len(rows)} runs"
        for name, count in missing.items()
    )
    name, allowed = "required parameters that are missing", f"none of {len(required)}"
    return Limit(name, float(len(missing)), allowed, not missing, where=text)


def parameter_judges(rows: Sequence[Row]) -> Iterator[Judge]:
    """What decides on the errors of the parameters: with one run the sum of their squares and the
    largest.
    """
    z = errors_in_sigmas(rows)
    if not z or any(np.any(~np.isfinite(e)) for e in z.values()):
        names = [name for name, e in z.items() if np.any(~np.isfinite(e))]
        text = "a sigma above 0" if names else "a truth to compare with"
        where = ", ".join(names)
        yield lambda _: Limit("parameters against the truth", 0.0, text, False, where=where)
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


ROUNDING = 1e-9


@dataclass(frozen=True)
class TiltLimit:
    """Tilt errors of runs over one limit.

    Args:
        stem: its name.
        rms_name: that of its rms.
        ratio: error after calibration over the limit, (n,).
        own: the bound over it, (n,).
        dof: of the squared errors, (n,).
        seeds: of the runs.
        shown: from such a ratio to the figure in which the limit is stated.
        sign: ``<=`` or ``>=`` of that figure.
        quantile: that is judged.
    """

    stem: str
    rms_name: str
    ratio: Array
    own: Array
    dof: Array
    seeds: Sequence[int]
    shown: Callable[[float], float]
    sign: str
    quantile: float

    def judges(self) -> Iterator[Judge]:
        """What decides: with one run its error and its bound."""
        yield self.rms
        if self.stem != "tilt error over its bound":
            yield self.expected
        if len(self.ratio) > 1:
            yield self.worst
            yield self.below_quantile

    def rms(self, share: float) -> Limit:
        """The rms over runs."""
        reached = float(np.sqrt(np.mean(self.ratio**2)))
        dof = dof_of_mean(self.own, self.dof)
        own = min(float(np.sqrt(np.mean(self.own**2))), 1.0)
        allowed = max(1.0, own * float(_chance(share, dof)))
        ends = [self.shown(x) for x in rms_interval(reached, dof)]
        figure = self.shown(reached)
        return Limit(
            self.rms_name,
            figure,
            self._limit_text(allowed),
            reached <= allowed,
            (min(ends), max(ends)),
        )

    def expected(self, share: float) -> Limit:
        """The error that the covariance predicts: refused where its mean square over runs is above
        the limit by more than its own scatter (Student's t).
        """
        from scipy.stats import t

        squares, n = self.own**2, len(self.own)
        mean = float(np.mean(squares))
        spread = float(np.std(squares, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
        slack = float(t.isf(share, n - 1)) * spread if spread else 0.0
        passed = mean - slack <= 1.0 + ROUNDING
        name = f"{self.stem}, expected by the covariance"
        return Limit(name, self.shown(np.sqrt(mean)), self._limit_text(np.sqrt(1 + slack)), passed)

    def worst(self, share: float) -> Limit:
        """Every run by itself."""
        allowed = self._allowed(share / len(self.ratio))
        k = int(np.argmax(self.ratio / allowed))
        passed = bool(np.all(self.ratio <= allowed))
        figure, text = self.shown(self.ratio[k]), self._limit_text(allowed[k])
        return Limit(f"{self.stem}, worst run", figure, text, passed, where=f"seed {self.seeds[k]}")

    def below_quantile(self, share: float) -> Limit:
        """The number of runs beyond the quantile of an error at the limit (binomial)."""
        from scipy.stats import binom

        beyond = 1 - self.quantile
        n, count = len(self.ratio), int(np.sum(~(self.ratio <= self._allowed(beyond))))
        most = int(binom.isf(share, n, beyond))
        name = f"{self.stem}, runs beyond the {100 * self.quantile:g} % quantile"
        return Limit(name, float(count), f"<= {most} of {n}", count <= most)

    def _allowed(self, share: float) -> Array:
        """Largest ratio of each run by itself, (n,)."""
        return np.maximum(1.0, np.minimum(self.own, 1.0) * _chance(share, self.dof))

    def _limit_text(self, allowed: float) -> str:
        limit = f"{self.sign} {self.shown(1.0):.4g}"
        by_chance = f" ({self.shown(allowed):.4g} with chance)" if allowed > 1 + ROUNDING else ""
        return limit + by_chance


def tilt_limits(accept: Accept, rows: Sequence[Row]) -> Iterator[TiltLimit]:
    """The limits of the tilt error that are set. rows: with tilt errors, all of them."""
    before, after, bound = tilts(rows).T
    dof, seeds = np.array([r.tilt_dof for r in rows]), [r.seed for r in rows]

    def made(
        stem: str, rms_name: str, limit: Array, shown: Callable[[float], float], sign: str = "<="
    ) -> TiltLimit:
        ratio, own = _over(after, limit), _over(bound, limit)
        return TiltLimit(stem, rms_name, ratio, own, dof, seeds, shown, sign, accept.quantile)

    if (largest := accept.tilt_arcsec) is not None:
        limit = np.full(len(rows), largest * ARCSEC)
        yield made("tilt error, arcsec", "tilt error, arcsec rms", limit, lambda x: x * largest)
    if (factor := accept.tilt_over_bound) is not None:
        name = "tilt error over its bound"
        yield made(name, name, factor * bound, lambda x: x * factor)
    if (least := accept.better_by) is not None:
        name = "tilt error before over after"
        yield made(name, name, before / least, lambda x: least / x if x else np.inf, ">=")


def tilts(rows: Sequence[Row]) -> Array:
    """Tilt error before, after and as predicted, rad rms, (n, 3) of the rows that have one."""
    found = [(r.tilt_before, r.tilt_after, r.tilt_bound) for r in rows if r.tilt_before is not None]
    return np.array(found, dtype=float).reshape(-1, 3)


def dof_of_mean(scale: Array, dof: Array) -> float:
    """Degrees of freedom of the mean of ``scale_r^2 chi2(dof_r) / dof_r`` over runs: its sum over
    its largest weight, as for one run.

    Args:
        scale, dof: (n,).
    """
    weights = scale**2 / dof
    largest = float(np.max(weights, initial=0.0))
    total = float(np.sum(scale**2))
    return total / largest if 0 < largest < np.inf else float(np.sum(dof))


def rms_interval(rms: float, dof: float) -> tuple[float, float]:
    """95 % interval of an rms whose square has ``dof`` degrees of freedom (chi-square)."""
    from scipy.special import chdtri

    low, high = (dof / float(chdtri(dof, p)) for p in (0.025, 0.975))
    return float(rms * np.sqrt(low)), float(rms * np.sqrt(high))


def _chance(share: float, dof: Array | float) -> Array:
    """Ratio of an rms to its expectation that is exceeded with probability ``share``."""
    from scipy.special import chdtri

    return np.asarray(np.sqrt(chdtri(dof, share) / dof))


def _over(a: Array, b: Array) -> Array:
    """a / b, 0 where a is 0 and infinite where only b is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(a == 0, 0.0, a / b)


def limits_of(scenario: Scenario, table: MethodTable, rows: Sequence[Row]) -> list[Limit]:
    """All limits of a method over its runs.

    Args:
        scenario: that was run.
        table: the method's part of it.
        rows: one a run, none of them with an error.
    """
    certain: list[Limit] = []
    judges: list[Judge] = [lambda share: _verdict_limit(table, rows, share)]
    if table.expect != "cannot_tell":
        if table.accept.parameters or table.accept.required is not None:
            certain.append(missing_limit(required_parameters(scenario, table.accept, rows), rows))
        if table.accept.parameters:
            judges += parameter_judges(rows)
        judges += _tilt_judges(table, rows)
    share = table.accept.false_alarm / len(judges)
    verdict, *others = [judge(share) for judge in judges]
    return [verdict, *(limit for limit in certain if not limit.passed), *others]


def _tilt_judges(table: MethodTable, rows: Sequence[Row]) -> Iterator[Judge]:
    accept = table.accept
    if accept.tilt_arcsec is accept.tilt_over_bound is accept.better_by is None:
        return
    without = [r.seed for r in rows if r.tilt_after is None]
    if without:
        where = f"seed {without[0]}" if len(without) < len(rows) else ""
        n = float(len(rows) - len(without))
        yield lambda _: Limit("runs with a tilt error", n, f"{len(rows)}", False, where=where)
        return
    for limit in tilt_limits(accept, rows):
        yield from limit.judges()


def _verdict_limit(table: MethodTable, rows: Sequence[Row], share: float) -> Limit:
    """Runs with another verdict than the expected one. Where ``good`` is expected of several runs,
    as many may be ``suspect`` as the method's own tests let expect: each fails for a good
    calibration with probability SIGNIFICANCE.
    """
    from scipy.stats import binom

    shown = [r.shown_verdict for r in rows]
    wrong = sum(r.verdict != table.expect for r in rows)
    allowed = 0
    if table.expect == "good" and len(rows) > 1 and all(r.verdict != "cannot_tell" for r in rows):
        tests = max(r.tests for r in rows)
        allowed = int(binom.isf(share, len(rows), 1 - (1 - SIGNIFICANCE) ** tests)) if tests else 0
    text = ", ".join(f"{v} x{shown.count(v)}" if len(rows) > 1 else v for v in dict.fromkeys(shown))
    expected = f"{table.expect}, at most {allowed} others"
    return Limit(f"verdict ({text})", float(wrong), expected, wrong <= allowed)
