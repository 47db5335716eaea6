"""Do these calibrations say the same? Their difference over the whole working range, with its
uncertainty.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.evidence import in_standard_deviations
from tiltcal.calibration.result import Calibration, setup_of
from tiltcal.calibration.validity import SIGNIFICANCE, Test, chi2_test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import sphere
from tiltcal.core.tabular import Tabular
from tiltcal.core.units import ARCSEC, DEG, DEG_H
from tiltcal.effects.sense import Sense
from tiltcal.instrument.model import InstrumentModel
from tiltcal.setup.sensor import Sensor

DIRECTIONS = 400  # over the whole sphere
TEMPERATURES = 5  # over the range of terms over temperature
ANGLES = 181  # of a placing-angle table
RATES = 21
ROUNDING = 1e-9  # of an input: differences below it are none
# of the uncertainty, rms over the range: two models differ by less beyond their derivatives, by the
# product of two small errors, and a term without an uncertainty matters from there on
SECOND = 0.01
RANK = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class Range:
    """Where calibrations are compared.

    Args:
        tilt: largest angle from level, rad; pi: all directions.
        temperature: lowest and highest, degC; None: of their terms over temperature.
        rate: largest rate about each axis, rad/s.
        angle: lowest and highest placing angle, rad; None: of their tables.
    """

    tilt: float = np.pi
    temperature: tuple[float, float] | None = None
    rate: float = 100 * DEG
    angle: tuple[float, float] | None = None

    @classmethod
    def of(cls, stated: Sequence[str]) -> "Range":
        """From ``tilt=30``, ``temperature=-40:85``, ``rate=200`` and ``angle=-90:90``; deg, deg/s
        and degC.

        Raises:
            TiltcalError: another key, or no number.
        """
        found = cls()
        for text in stated:
            key, _, value = text.partition("=")
            try:
                numbers = [float(part) for part in value.split(":")]
                found = found._with(key, numbers)
            except (KeyError, ValueError) as error:
                raise TiltcalError(
                    f"range '{text}'",
                    found="no such range",
                    need="tilt=DEG, temperature=LOW:HIGH, rate=DEG_S or angle=LOW:HIGH",
                    do="correct it",
                ) from error
        return found

    def _with(self, key: str, numbers: Sequence[float]) -> "Range":
        """With one of its ranges; a KeyError or ValueError where there is none."""
        if key in ("tilt", "rate"):
            (number,) = numbers
            if not 0 < number < np.inf:
                raise ValueError
            if key == "tilt":
                return replace(self, tilt=min(number, 180.0) * DEG)
            return replace(self, rate=number * DEG)
        low, high = numbers
        if not -np.inf < low < high < np.inf:
            raise ValueError
        if key == "temperature":
            return replace(self, temperature=(low, high))
        if key == "angle":
            return replace(self, angle=(low * DEG, high * DEG))
        raise KeyError(key)


@dataclass(frozen=True)
class Curve:
    """The difference of one quantity from the first calibration, over a coordinate.

    Args:
        sensor: its name, or ``base``.
        quantity: tilt, norm, a channel of a rate sensor, bias of a table, or a parameter.
        coordinate: direction, rate, angle or nothing.
        unit: of the differences.
        at: where, (n, d): unit vectors, rates in deg/s, or angles in deg.
        difference: of each further calibration, (c, n).
        sigma: of these, (c, n).
    """

    sensor: str
    quantity: str
    coordinate: str
    unit: str
    at: Array
    difference: Array
    sigma: Array

    @property
    def rms(self) -> Array:
        """Rms difference of each further calibration, (c,)."""
        return np.sqrt(np.mean(self.difference**2, axis=1))

    @property
    def spread(self) -> float:
        """Rms deviation of all calibrations from their mean."""
        every = np.concatenate([np.zeros((1, self.difference.shape[1])), self.difference])
        return float(np.sqrt(np.mean((every - every.mean(axis=0)) ** 2)))


@dataclass(frozen=True)
class Comparison(Tabular):
    """Calibrations compared with the first of them.

    Args:
        names: of all calibrations.
        agree: whether all differences are within their uncertainty at 0.1 %.
        curves: of every quantity that they have in common.
        tests: for each sensor and further calibration.
        statement: as text.
    """

    names: Sequence[str]
    agree: bool
    curves: Sequence[Curve]
    tests: Sequence[Test]
    statement: str

    def as_columns(self) -> Mapping[str, Sequence[object]]:
        """Quantity, rms and worst difference and its sigma, one row for each calibration after the
        first.
        """
        rows = [(c, k) for c in self.curves for k in range(len(c.difference))]
        return {
            "sensor": [c.sensor for c, _ in rows],
            "quantity": [c.quantity for c, _ in rows],
            "calibration": [self.names[k + 1] for _, k in rows],
            "unit": [c.unit for c, _ in rows],
            "rms": [float(c.rms[k]) for c, k in rows],
            "worst": [float(np.abs(c.difference[k]).max()) for c, k in rows],
            "rms_sigma": [float(np.sqrt(np.mean(c.sigma[k] ** 2))) for c, k in rows],
        }

    def headline(self) -> str:
        """The statement."""
        return f"{'agree' if self.agree else 'differ'}: {self.statement}"

    def to_json(self) -> dict[str, object]:
        """All differences with their sigmas."""
        return {
            "schema": 1,
            "calibrations": list(self.names),
            "agree": self.agree,
            "statement": self.statement,
            "tests": [vars(t) for t in self.tests],
            "curves": [
                {
                    **{k: getattr(c, k) for k in ("sensor", "quantity", "coordinate", "unit")},
                    "at": c.at.tolist(),
                    "difference": c.difference.tolist(),
                    "sigma": c.sigma.tolist(),
                    "spread": c.spread,
                }
                for c in self.curves
            ],
        }


def compare(
    calibrations: Sequence[Calibration],
    names: Sequence[str] | None = None,
    within: Range | None = None,
) -> Comparison:
    """The differences of calibrations over the working range.

    The same readings are corrected by each: what differs is the corrected tilt and norm over all
    directions, the corrected rate, the placing-angle table, or the base tilt.

    Args:
        calibrations: two or more of one kind of instrument.
        names: of them.
        within: where; unless given everywhere.

    Raises:
        TiltcalError: fewer than two, or nothing in common.
    """
    within = within or Range()
    names = names or [f"calibration {k}" for k in range(1, len(calibrations) + 1)]
    if len(calibrations) < 2:
        raise TiltcalError(
            "comparison",
            found=f"{len(calibrations)} calibration",
            need="two or more",
            do="name another",
        )
    curves, tests = [], []
    first = setup_of(calibrations[0])
    for name in calibrations[0].sensors():
        if all(name in c.sensors() for c in calibrations):
            found = _of_sensor(calibrations, names, first.named(name), within)
            curves += found[0]
            tests += found[1]
    base = [n for n in calibrations[0].of_base() if all(n in c.parameters for c in calibrations)]
    if base:
        found = _of_base(calibrations, names, base)
        curves += found[0]
        tests += found[1]
    if not curves:
        raise TiltcalError(
            "comparison",
            found="no sensor that all of them calibrate",
            need="calibrations of one instrument",
            do="name others",
        )
    limit = SIGNIFICANCE / len(tests)
    tests = [replace(t, passed=bool(t.p_value > limit)) for t in tests]
    agree = all(t.passed for t in tests)
    return Comparison(list(names), agree, curves, tests, _statement(curves, tests, names))


Found = tuple[list[Curve], list[Test]]


def _of_sensor(
    calibrations: Sequence[Calibration], names: Sequence[str], sensor: Sensor, within: Range
) -> Found:
    """Curves and tests of one sensor."""
    if any(key.startswith(f"{sensor.name}.") for c in calibrations for key in c.bias_tables):
        return _of_tables(calibrations, names, sensor, within)
    gravity = setup_of(calibrations[0]).site.gravity
    models = [c.instrument((sensor,), gravity) for c in calibrations]
    given, at = _grid(models, sensor, within, gravity)
    # what the first reads over the range: there the derivatives of all are taken
    warmed = _warmed(given, models[0])
    reading = models[0].predict(sensor, warmed)
    slopes = models[0].slopes(sensor, given.true_input(), warmed)
    inverse = np.asarray(np.linalg.inv(slopes), dtype=np.float64)
    corrected, columns = zip(
        *(_corrected(model, sensor, reading, given, inverse) for model in models), strict=True
    )
    frames = [c.own_frame for c in calibrations]
    tests, left = [], []
    for k in range(1, len(models)):
        d = corrected[k] - corrected[0]
        X = np.concatenate([columns[0], columns[k]])
        if any(frames) and sensor.is_accelerometer and d.shape[1] == 3:
            d, X = _without_turn(d, X, given.force)
        tests.append(_agreement(d, X, f"{sensor.name}: {names[k]} and {names[0]}"))
        left.append((d, X))
    if sensor.is_accelerometer:
        return _tilt_curves(sensor, gravity, at, left), tests
    return _rate_curves(sensor, at, left), tests


def _corrected(
    model: InstrumentModel, sensor: Sensor, reading: Array, given: Sense, inverse: Array
) -> tuple[Array, Array]:
    """Inputs that readings stand for, (n, k), and their change per standard deviation of the
    model, (p, n, k). inverse: slopes, one for all models, so that a parameter that two of them have
    changes both alike.
    """
    given = _warmed(given, model)
    found = model.invert(sensor, reading, given)
    columns = in_standard_deviations(model, model.sensitivity(sensor, given))
    return found, -np.einsum("nij,pnj->pni", inverse, columns)


def _warmed(given: Sense, model: InstrumentModel) -> Sense:
    """With the temperature counted from T0 of a model."""
    T0 = model.reference_degC
    return replace(given, temperature=given.temperature - (0.0 if T0 is None else T0))


def _grid(
    models: Sequence[InstrumentModel], sensor: Sensor, within: Range, g: float
) -> tuple[Sense, Array]:
    """True inputs over the range, at temperatures in degC, and where they are, (n, d)."""
    low, high = within.temperature or _temperatures(models)
    steps = TEMPERATURES if high > low else 1
    warm = np.linspace(low, high, steps)
    if sensor.is_accelerometer:
        at = _directions(sensor, within.tilt)
        force, rate = g * at, np.zeros_like(at)
    else:
        speeds = np.linspace(-within.rate, within.rate, RATES)
        axes = [sensor.input_vector] if sensor.kind == "fog" else np.eye(3)
        rate = np.concatenate([np.outer(speeds, axis) for axis in axes])
        force = np.tile([0.0, 0.0, g], (len(rate), 1))
        at = rate / DEG
    n = len(at)
    sense = Sense.at_rest(sensor, g, np.tile(force, (steps, 1)))
    vector = sensor.input_vector if sensor.kind == "fog" else np.zeros(3)
    sense = replace(
        sense,
        rate=np.tile(rate, (steps, 1)),
        temperature=np.repeat(warm, n),
        temperature_memory=np.zeros(n * steps),
        input_vector=vector,
    )
    return sense, np.tile(at, (steps, 1))


def _temperatures(models: Sequence[InstrumentModel]) -> tuple[float, float]:
    """The reference temperatures of the models; 0 without any."""
    stated = [m.reference_degC for m in models if m.reference_degC is not None]
    return (min(stated), max(stated)) if stated else (0.0, 0.0)


def _directions(sensor: Sensor, tilt: float) -> Array:
    """Unit vectors of up over the range, (n, 3)."""
    if len(sensor.axes) == 2:
        tilt = min(tilt, 85 * DEG)  # beyond it the third component has either sign
    count = int(np.ceil(DIRECTIONS * 2 / max(1 - np.cos(tilt), 1e-3)))
    up = sphere(min(count, 40 * DIRECTIONS))
    return up[up[:, 2] >= np.cos(tilt) - 1e-12]


def _without_turn(d: Array, X: Array, force: Array) -> tuple[Array, Array]:
    """Differences and columns less the rotation that all directions have in common: the frame of
    one of them is the sensor's own.
    """
    turns = np.array([np.cross(axis, force).ravel() for axis in np.eye(3)]).T
    Q = np.linalg.qr(turns)[0]
    flat, columns = d.ravel(), X.reshape(len(X), -1)
    flat = flat - Q @ (Q.T @ flat)
    columns = columns - (columns @ Q) @ Q.T
    return flat.reshape(d.shape), columns.reshape(X.shape)


def _agreement(d: Array, X: Array, who: str) -> Test:
    """Chi-square of a difference whose covariance has these columns."""
    rows = X.reshape(len(X), -1)
    size = float(np.abs(d).max())
    U, s, _ = np.linalg.svd(rows.T, full_matrices=False) if len(rows) else (rows.T, np.zeros(0), 0)
    kept = s > RANK * s[0] if len(s) else np.zeros(0, bool)
    part = U[:, kept].T @ d.ravel()
    left = d.ravel() - U[:, kept] @ part
    chi2 = float(np.sum((part / s[kept]) ** 2))
    text = f"{who} agree within their uncertainty"
    least = max(SECOND * float(np.sqrt(np.mean((rows**2).sum(axis=0)))), ROUNDING, 1e-6 * size)
    if float(np.sqrt(np.mean(left**2))) > least:
        # one of them has terms without an uncertainty that the other lacks
        chi2 += float(np.sum((left / least) ** 2))
    return chi2_test("agreement", chi2, max(int(kept.sum()), 1), text)


Left = Sequence[tuple[Array, Array]]
"""Differences, SI, (n, k), and the columns of their covariance, (p, n, k), of each further one."""


def _tilt_curves(sensor: Sensor, g: float, at: Array, left: Left) -> list[Curve]:
    """Tilt and, of a triad, norm over the directions."""

    def curve(
        quantity: str, unit: str, size: float, difference: list[Array], sigma: list[Array]
    ) -> Curve:
        d, s = np.array(difference) / size, np.array(sigma) / size
        return Curve(sensor.name, quantity, "direction", unit, at, d, s)

    if len(sensor.axes) < 3:
        difference = [np.sqrt((d**2).sum(axis=1)) / g for d, _ in left]
        sigma = [np.sqrt((X**2).sum(axis=(0, 2))) / g for _, X in left]
        return [curve("tilt", "arcsec", ARCSEC, difference, sigma)]
    across = np.eye(3) - at[:, :, None] * at[:, None, :]
    tilt = [np.linalg.norm(np.einsum("nij,nj->ni", across, d), axis=1) / g for d, _ in left]
    tilts = [
        np.sqrt((np.einsum("nij,pnj->pni", across, X) ** 2).sum(axis=(0, 2))) / g for _, X in left
    ]
    norm = [np.einsum("ni,ni->n", at, d) / g for d, _ in left]
    norms = [np.sqrt((np.einsum("ni,pni->pn", at, X) ** 2).sum(axis=0)) / g for _, X in left]
    return [
        curve("tilt", "arcsec", ARCSEC, tilt, tilts),
        curve("norm", "ppm", 1e-6, norm, norms),
    ]


def _rate_curves(sensor: Sensor, at: Array, left: Left) -> list[Curve]:
    """Each channel over the rate about its own axis."""
    curves = []
    for i, axis in enumerate(sensor.axes):
        rows = np.arange(len(at))
        if sensor.kind != "fog":
            own = np.abs(at).argmax(axis=1) == sensor.axis_indices[i]
            rows = np.flatnonzero(own & at.any(axis=1))
        along = np.linalg.norm(at[rows], axis=1)
        signed = along * np.sign(at[rows].sum(axis=1))
        difference = np.array([d[rows, i] for d, _ in left]) / DEG_H
        sigma = np.array([np.sqrt((X[:, rows, i] ** 2).sum(axis=0)) for _, X in left]) / DEG_H
        curves.append(Curve(sensor.name, axis, "rate", "deg_h", signed[:, None], difference, sigma))
    return curves


def _of_tables(
    calibrations: Sequence[Calibration], names: Sequence[str], sensor: Sensor, within: Range
) -> Found:
    """Placing-angle tables of the axes that all of them have."""
    gravity = setup_of(calibrations[0]).site.gravity
    correctors = [c.placing(sensor, gravity) for c in calibrations]
    curves, tests = [], []
    for axis in "xy":
        tables = [c.tables[axis] for c in correctors if c is not None and axis in c.tables]
        if len(tables) < len(calibrations):
            continue
        low = max(t.range_deg[0] for t in tables) * DEG
        high = min(t.range_deg[1] for t in tables) * DEG
        if within.angle is not None:
            low, high = max(low, within.angle[0]), min(high, within.angle[1])
        if low >= high:
            continue
        step = max(t.step for t in tables)
        at = np.linspace(low, high, max(round((high - low) / step) + 1, 2))
        values = [t.at(at) for t in tables]
        sigmas = [replace(t, values=t.sigmas).at(at) for t in tables]
        d = np.array([v - values[0] for v in values[1:]])
        sigma = np.array([np.hypot(s, sigmas[0]) for s in sigmas[1:]])
        unit = gravity * ARCSEC
        curves.append(
            Curve(
                sensor.name,
                f"bias of {axis}",
                "angle",
                "arcsec",
                at[:, None] / DEG,
                d / unit,
                sigma / unit,
            )
        )
        for k, (one, s) in enumerate(zip(d, sigma, strict=True), start=1):
            chi2 = float(np.sum((one / np.maximum(s, ROUNDING)) ** 2))
            text = f"{sensor.name} {axis}: {names[k]} and {names[0]} agree within their uncertainty"
            tests.append(chi2_test("agreement", chi2, len(one), text))
    return curves, tests


def _of_base(
    calibrations: Sequence[Calibration], names: Sequence[str], parameters: Sequence[str]
) -> Found:
    """Base tilt and azimuth."""
    curves, tests = [], []
    values = np.array([[c.value(n) for n in parameters] for c in calibrations])
    rows = [[list(c.parameters).index(n) for n in parameters] for c in calibrations]
    covariances = [
        np.asarray(c.covariance)[np.ix_(r, r)] for c, r in zip(calibrations, rows, strict=True)
    ]
    d = (values[1:] - values[0] + np.pi) % (2 * np.pi) - np.pi
    totals = [C + covariances[0] for C in covariances[1:]]
    for k, (one, C) in enumerate(zip(d, totals, strict=True), start=1):
        chi2 = float(one @ np.linalg.pinv(C, hermitian=True) @ one)
        text = f"base: {names[k]} and {names[0]} agree within their uncertainty"
        tests.append(chi2_test("agreement", chi2, len(one), text))
    for j, name in enumerate(parameters):
        sigma = np.array([[np.sqrt(C[j, j])] for C in totals])
        owner, _, quantity = name.partition(".")
        curves.append(
            Curve(
                owner,
                quantity,
                "",
                "arcsec",
                np.zeros((1, 1)),
                d[:, j : j + 1] / ARCSEC,
                sigma / ARCSEC,
            )
        )
    return curves, tests


def _statement(curves: Sequence[Curve], tests: Sequence[Test], names: Sequence[str]) -> str:
    parts = []
    for curve in curves:
        k = int(np.argmax(curve.rms))
        sigma = float(np.sqrt(np.mean(curve.sigma[k] ** 2)))
        text = (
            f"{curve.sensor} {curve.quantity}: {curve.rms[k]:.4g} {curve.unit} rms between"
            f" {names[k + 1]} and {names[0]} ({sigma:.3g} expected)"
        )
        if len(names) > 2:
            text += f", spread {curve.spread:.4g}"
        parts.append(text)
    failed = [
        t.statement.replace(" agree within", " do not agree within") for t in tests if not t.passed
    ]
    return "; ".join([*parts, *failed])
