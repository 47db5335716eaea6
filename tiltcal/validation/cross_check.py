"""Is this calibration good on that other recording?"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.evidence import Evidence, evidence_at_rest, linear_columns
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.turning_evidence import evidence_in_turns
from tiltcal.calibration.validity import SIGNIFICANCE, Test, chi2_test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.tabular import Tabular
from tiltcal.core.units import ARCSEC, DEG_H, G0
from tiltcal.instrument.terms import BASE, si_factor
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

AGREES = "agrees with its uncertainty"
DOWN = 0.01  # of g along the axis that a two-axis sensor lacks: nearer to horizontal it has no sign


@dataclass(frozen=True)
class Limits:
    """Largest accepted rms differences; None: none.

    Args:
        tilt: rad.
        force: of an accelerometer's reading, m/s2.
        ratio: of the norm of the force, as a share of g.
        rate: of a rate sensor's reading, rad/s.
    """

    tilt: float | None = None
    force: float | None = None
    ratio: float | None = None
    rate: float | None = None

    @classmethod
    def of(
        cls,
        arcsec: float | None = None,
        ug: float | None = None,
        ppm: float | None = None,
        deg_h: float | None = None,
    ) -> "Limits":
        """From numbers in the units of the command line.

        Args:
            arcsec: of the tilt.
            ug: of the force.
            ppm: of the norm.
            deg_h: of the rate.
        """
        stated = ((arcsec, ARCSEC), (ug, 1e-6 * G0), (ppm, 1e-6), (deg_h, DEG_H))
        return cls(*(None if value is None else value * unit for value, unit in stated))


@dataclass(frozen=True)
class Quantity:
    """One quantity of one sensor on the recording.

    Args:
        sensor: its name, or ``base``.
        quantity: tilt, norm, force or rate with its channel, base.
        unit: of the numbers.
        rms, worst: difference of reading and prediction.
        expected: rms by noise and by the calibration's covariance.
        limit: largest accepted rms; None without one.
    """

    sensor: str
    quantity: str
    unit: str
    rms: float
    worst: float
    expected: float
    limit: float | None = None

    @property
    def kept(self) -> bool:
        """Whether it keeps its limit."""
        return self.limit is None or self.rms <= self.limit


@dataclass(frozen=True)
class Check(Tabular):
    """How well a calibration predicts another recording.

    Args:
        accepted: within all limits, or without one within its own uncertainty.
        judged_by: what the first sensor is judged by: ``tilt`` against known attitudes, ``norm``
            where they are not known, ``table`` for placing-angle tables, ``rate``; or, measured
            again, ``base`` with a base tilt or azimuth, else ``parameters``.
        rms, worst: error over the rows in the leading quantity, SI.
        expected: rms error that noise and the calibration's covariance predict.
        poses: error of each row, SI, (m,).
        tests: statistical ones, one for each sensor.
        statement: as text.
        quantities: all that the recording shows.
        not_shown: parameters that nothing in the recording depends on.
    """

    accepted: bool
    judged_by: str
    rms: float
    worst: float
    expected: float
    poses: Array
    spans: Sequence[tuple[float, float]]
    tests: Sequence[Test]
    statement: str
    quantities: Sequence[Quantity] = ()
    not_shown: Sequence[str] = ()

    @property
    def unit(self) -> tuple[str, float]:
        """Unit in which the errors are shown, that of the leading quantity, and its size in SI."""
        unit = self.quantities[0].unit if self.quantities else "arcsec"
        return unit, si_factor(unit) or 1.0

    def as_columns(self) -> Mapping[str, Sequence[float]]:
        """Beginning, end and error of each row."""
        unit, factor = self.unit
        return {
            "start_s": [a for a, _ in self.spans],
            "end_s": [b for _, b in self.spans],
            f"error_{unit}": [float(e / factor) for e in self.poses],
        }

    def headline(self) -> str:
        """The judgement."""
        return f"{'accepted' if self.accepted else 'not accepted'}: {self.statement}"


def check(
    calibration: Calibration,
    recording: Recording,
    setup: Setup,
    limits: Limits | None = None,
    segments: Sequence[Segment] | None = None,
) -> Check:
    """Judge a calibration on a recording: what each channel reads against what the calibration
    predicts.

    Accelerometers and inclinometers are judged at rest, by each channel where attitudes are known,
    else by the norm; rate sensors at rest and in steady turns of a table with a readout. What needs
    more (a base tilt, rate sensors without a table) is measured again by the same method.

    Args:
        calibration: to judge.
        recording: that it may not have seen.
        setup: of the recording.
        limits: without one every difference has to agree with its own uncertainty at 0.1 %.
        segments: dwells to use.

    Raises:
        TiltcalError: the recording shows nothing that the calibration states, or a channel is
            saturated.
    """
    limits = limits or Limits()
    found: list[_Judged] = []
    more = bool(calibration.of_base())
    if not more and not calibration.sensors():
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no parameter of a sensor",
            need="one to check",
            do="check it on what it calibrates",
        )
    calibrated = [setup.named(name) for name in calibration.sensors()]
    # the zero of an encoder is no more than where its drive happens to stand
    for sensor in () if more else (s for s in calibrated if s.of is None):
        turning = not sensor.is_accelerometer and _has_scale(calibration, sensor)
        judged = _judged(calibration, sensor, recording, setup, limits, segments, turning)
        more = more or judged is None
        found += [judged] if judged else []
    if more:
        found = [_measured_again(calibration, recording, setup, limits, segments)]
    return _with_faults(_answer(found), data_tests(recording, *calibrated))


def _with_faults(answer: Check, tests: Sequence[Test]) -> Check:
    """The answer, not accepted where the readings that were judged are at fault."""
    faults = [t.statement for t in tests if not t.passed]
    if not faults:
        return answer
    statement = ". ".join([answer.statement, *faults])
    return replace(answer, accepted=False, statement=statement)


def _has_scale(calibration: Calibration, sensor: Sensor) -> bool:
    """Whether a calibration states more of a sensor than its reading without input."""
    model = calibration.instrument((sensor,), G0)
    own = [model.effects[p.effect].calibration_term for p in model.parameters]
    return any(term in ("scale", "cross_axis") for term in own)


@dataclass(frozen=True)
class _Judged:
    """What one piece of evidence says.

    Args:
        kind: as ``judged_by`` of a Check.
        quantities: the leading one first.
        errors: of each row, in SI of the leading quantity, (m,).
        spans: of the rows.
        test: chi-square.
        change: the likeliest change, as text; empty where the test passes.
        hidden: parameters that the rows do not depend on.
        note: what else should be known, as text.
        over: of which rows, for a sentence.
    """

    kind: str
    quantities: Sequence[Quantity]
    errors: Array
    spans: Sequence[tuple[float, float]]
    test: Test
    change: str = ""
    hidden: Sequence[str] = ()
    note: str = ""
    over: str = ""


def _judged(
    calibration: Calibration,
    sensor: Sensor,
    recording: Recording,
    setup: Setup,
    limits: Limits,
    segments: Sequence[Segment] | None,
    turning: bool,
) -> _Judged | None:
    """The evidence of one sensor; None where the recording has no turns of a table that show what
    is stated of it.
    """
    model = calibration.instrument((sensor,), setup.site.gravity)
    if turning:
        turns = evidence_in_turns(model, sensor, recording, setup)
        if turns is None:
            return None
        evidence = turns
    else:
        evidence = evidence_at_rest(
            model, sensor, recording, setup, segments, calibration.own_frame
        )
    if not evidence.judged.any():
        raise TiltcalError(
            recording.source,
            found="no dwell with a calibrated axis horizontal at an angle of its table",
            need="some to judge it by",
            do="record dwells on the table it was made on, at angles inside it",
        )
    chi2, dof = evidence.chi2()
    text = f"errors against noise and covariance over {len(evidence.spans)} {evidence.rows}"
    test = chi2_test(AGREES, chi2, dof, text)
    change = "" if test.passed else _change(calibration, sensor, evidence)
    errors, quantities = _quantities(evidence, limits)
    hidden = [p.name for p, x in zip(model.parameters, evidence.shown, strict=True) if not x]
    return _Judged(
        evidence.kind,
        quantities,
        errors,
        evidence.spans,
        test,
        change,
        hidden,
        _unknown_sign(sensor, evidence),
        f" over {len(errors)} {evidence.rows}",
    )


def _unknown_sign(sensor: Sensor, evidence: Evidence) -> str:
    """A note where the axis that a two-axis sensor lacks points down: its readings do not show
    that.
    """
    if not sensor.is_accelerometer or len(sensor.axes) != 2:
        return ""
    (missing,) = set(range(3)) - set(sensor.axis_indices)
    force = evidence.sense.force
    below = int(np.sum(force[:, missing] < -DOWN * evidence.sense.gravity))
    if not below:
        return ""
    return (
        f"in {below} of {len(force)} dwells {'xyz'[missing]} points down, which two axes do not"
        " show: `tiltcal correct` takes it as pointing up"
    )


def _change(calibration: Calibration, sensor: Sensor, evidence: Evidence) -> str:
    """The likeliest change of one term, as text."""
    if evidence.kind == "norm":
        return ""
    columns = linear_columns(sensor, evidence.sense)
    name, size, sigma = evidence.likeliest_change(columns)
    if not name:
        return ""
    own = "m_s2" if sensor.is_accelerometer else "rad_s"
    factor, unit = calibration.shown_in(name, own if ".bias_" in name else "1")
    size, sigma = size * factor, sigma * factor
    return f"most likely {name} has changed, by {size:.4g} +- {sigma:.2g} {unit}"


def _quantities(evidence: Evidence, limits: Limits) -> tuple[Array, list[Quantity]]:
    """Errors of the rows in the leading quantity, SI, (m,), and all quantities."""
    name, g = evidence.sensor.name, evidence.sense.gravity
    if evidence.kind == "norm":
        errors = np.abs(evidence.residual[:, 0])
        expected = float(np.sqrt(evidence.expected[:, 0, 0].mean()))
        return errors, [
            _quantity(name, "norm", "arcsec", ARCSEC, errors, expected, limits.tilt),
            _quantity(name, "norm", "ppm", 1e-6, errors, expected, limits.ratio),
        ]
    channels = []
    unit, factor, limit = (
        ("deg_h", DEG_H, limits.rate)
        if evidence.kind == "rate"
        else ("ug", 1e-6 * G0, limits.force)
    )
    for i, axis in enumerate(evidence.sensor.axes):
        left = evidence.residual[evidence.judged[:, i], i]
        if len(left):
            sigma = float(np.sqrt(evidence.expected[evidence.judged[:, i], i, i].mean()))
            channels.append(_quantity(name, axis, unit, factor, np.abs(left), sigma, limit))
    if evidence.kind == "rate":
        errors = np.sqrt(np.nanmean(evidence.residual**2, axis=1))
        return errors, channels
    across, shares = _tilt_errors(evidence, g)
    leading = _quantity(name, evidence.kind, "arcsec", ARCSEC, across[0], across[1], limits.tilt)
    found = [leading, *channels]
    if shares is not None:
        found.append(_quantity(name, "norm", "ppm", 1e-6, shares[0], shares[1], limits.ratio))
    return across[0], found


Errors = tuple[Array, float]
"""Errors of the rows, (m,), and the rms that is expected."""


def _tilt_errors(evidence: Evidence, g: float) -> tuple[Errors, Errors | None]:
    """Tilt errors, rad, and of a triad those of the norm, as shares of g: corrected by the
    sensitivity of the channels.
    """
    left = np.nan_to_num(evidence.residual)
    used = evidence.judged.any(axis=1)
    spread = np.where(
        evidence.judged[:, :, None] & evidence.judged[:, None, :], evidence.expected, 0.0
    )
    if left.shape[1] < 3:
        errors = np.sqrt((left**2).sum(axis=1)) / g
        expected = np.sqrt(np.einsum("mii->m", spread)[used].mean()) / g
        return (errors[used], float(expected)), None
    up = evidence.sense.force / np.linalg.norm(evidence.sense.force, axis=1)[:, None]
    if evidence.kind == "table":
        across, both = left, np.broadcast_to(np.eye(3), spread.shape)
    else:
        both = np.eye(3) - up[:, :, None] * up[:, None, :]
        turn = _common_turn(evidence, up, left / g)
        across = np.einsum("mij,mj->mi", both, left - g * np.cross(turn, up))
    errors = np.sqrt((across**2).sum(axis=1)) / g
    expected = np.sqrt(np.einsum("mij,mji->m", both, spread)[used].mean()) / g
    if evidence.kind == "table":
        return (errors[used], float(expected)), None
    along = np.abs(np.einsum("mi,mi->m", up, left)) / g
    share = float(np.sqrt(np.einsum("mi,mij,mj->m", up, spread, up).mean()) / g)
    return (errors[used], float(expected)), (along, share)


def _common_turn(evidence: Evidence, up: Array, left: Array) -> Array:
    """The rotation that all rows have in common, rad, (3,); zero unless the frame is the sensor's
    own.
    """
    if not evidence.free:
        return np.zeros(3)
    A = np.array([np.cross(axis, up).ravel() for axis in np.eye(3)]).T
    return np.asarray(np.linalg.lstsq(A, left.ravel(), rcond=None)[0])


def _quantity(
    sensor: str,
    quantity: str,
    unit: str,
    factor: float,
    errors: Array,
    expected: float,
    limit: float | None,
) -> Quantity:
    """A quantity from errors in SI, (m,)."""
    rms = float(np.sqrt(np.mean(errors**2)))
    shown = None if limit is None else limit / factor
    worst = float(errors.max()) / factor
    return Quantity(sensor, quantity, unit, rms / factor, worst, expected / factor, shown)


def _again(
    calibration: Calibration,
    recording: Recording,
    setup: Setup,
    segments: Sequence[Segment] | None,
) -> tuple[Calibration, list[str]]:
    """The same method on this recording, and the parameters that both have.

    Raises:
        TiltcalError: the method is not built in, or gives none of the parameters.
    """
    from tiltcal.calibration.methods.registry import METHODS, calibrate

    # a file may name any function: only what is built in is run
    if calibration.method not in METHODS:
        raise TiltcalError(
            recording.source,
            found=f"nothing that shows what the calibration by {calibration.method} states",
            need="steady turns of a table with a readout, or a built-in method to measure again",
            do="record turns about every axis on a table",
        )
    options = calibration.provenance.get("options", {})
    again = calibrate(calibration.method, recording, setup, segments=segments, **options)
    names = [n for n in calibration.parameters if n in again.parameters]
    if not names:
        raise TiltcalError(
            recording.source,
            found=f"that {calibration.method} determines none of its parameters again",
            need="a recording that shows what the calibration states",
            do="record the sequence of the method",
        )
    return again, names


def _measured_again(
    calibration: Calibration,
    recording: Recording,
    setup: Setup,
    limits: Limits,
    segments: Sequence[Segment] | None,
) -> _Judged:
    """Judged by the same method on this recording: the parameters of both, as far as both have
    them.
    """
    again, names = _again(calibration, recording, setup, segments)
    rows, others = ([list(c.parameters).index(n) for n in names] for c in (calibration, again))
    difference = np.array([again.value(n) - calibration.value(n) for n in names])
    turns = np.array([calibration.parameters[n].unit == "rad" for n in names])
    difference[turns] = (difference[turns] + np.pi) % (2 * np.pi) - np.pi
    total = np.asarray(calibration.covariance)[np.ix_(rows, rows)]
    total = total + np.asarray(again.covariance)[np.ix_(others, others)]
    chi2 = float(difference @ np.linalg.pinv(total, hermitian=True) @ difference)
    test = chi2_test(AGREES, chi2, len(names), f"{', '.join(names)} measured again")
    sigmas = np.sqrt(np.diag(total))
    quantities = [
        _parameter(calibration, name, d, s, limits)
        for name, d, s in zip(names, difference.tolist(), sigmas.tolist(), strict=True)
    ]
    tilts = [k for k, n in enumerate(names) if n in BASE]
    if tilts:
        error, expected = (float(np.hypot(*v[tilts])) for v in (difference, sigmas))
        tilt = _quantity("base", "tilt", "arcsec", ARCSEC, np.array([error]), expected, limits.tilt)
        quantities.insert(0, tilt)
    worst = int(np.argmax(np.abs(difference) / np.maximum(sigmas, 1e-300)))
    change = "" if test.passed else f"{names[worst]} differs most"
    spans = [(float(recording.time[0]), float(recording.time[-1]))]
    leading = quantities[0]
    errors = np.array([leading.rms * (si_factor(leading.unit) or 1.0)])
    kind = "base" if calibration.of_base() else "parameters"
    return _Judged(kind, quantities, errors, spans, test, change, over=" measured again")


def _parameter(
    calibration: Calibration, name: str, difference: float, sigma: float, limits: Limits
) -> Quantity:
    """Difference of one parameter in the unit that it is shown in."""
    estimate: Estimate = calibration.parameters[name]
    factor, unit = calibration.shown_in(name, estimate.unit)
    by_unit = {
        "arcsec": (limits.tilt, ARCSEC),
        "ug": (limits.force, 1e-6 * G0),
        "ppm": (limits.ratio, 1e-6),
        "deg_h": (limits.rate, DEG_H),
    }
    limit, size = by_unit.get(unit, (None, 1.0))
    owner, _, term = name.partition(".")
    found = abs(difference) * factor
    return Quantity(
        owner, term, unit, found, found, sigma * factor, None if limit is None else limit / size
    )


NAMED = {
    "tilt": "tilt error",
    "norm": "error of the norm (as an angle; attitudes are not known)",
    "base": "difference of the base tilt",
    "table": "error of a horizontal axis",
    "rate": "error of the rate",
    "parameters": "difference of the first parameter",
}


def _answer(found: Sequence[_Judged]) -> Check:
    first = found[0]
    # each of several tests takes its share of the false alarms
    tests = [
        replace(j.test, passed=bool(j.test.p_value > SIGNIFICANCE / len(found))) for j in found
    ]
    quantities = [q for j in found for q in j.quantities]
    # a limit replaces the test of a sensor only where it limits one of its quantities
    accepted = all(
        all(q.kept for q in j.quantities) and (t.passed or _is_limited(j))
        for j, t in zip(found, tests, strict=True)
    )
    leading = first.quantities[0]
    factor = si_factor(leading.unit) or 1.0
    return Check(
        accepted,
        first.kind,
        leading.rms * factor,
        leading.worst * factor,
        leading.expected * factor,
        first.errors,
        first.spans,
        tests,
        _statement(found, accepted),
        quantities,
        [name for j in found for name in j.hidden],
    )


def _is_limited(judged: _Judged) -> bool:
    return any(q.limit is not None for q in judged.quantities)


def _statement(found: Sequence[_Judged], accepted: bool) -> str:
    parts = []
    for judged in found:
        q = judged.quantities[0]
        several = f" of {q.sensor}" if len(found) > 1 else ""
        text = (
            f"{NAMED[judged.kind]}{several}{judged.over}: {q.rms:.4g} {q.unit} rms,"
            f" {q.worst:.4g} worst; "
        )
        if _is_limited(judged):
            text += _against_limits(judged)
        else:
            side = "within" if judged.test.p_value > SIGNIFICANCE / len(found) else "beyond"
            text += f"{side} its own uncertainty ({q.expected:.3g} {q.unit} expected)"
        if judged.change and not accepted:
            text += f"; {judged.change}"
        if judged.hidden:
            text += f"; not shown by this recording: {', '.join(judged.hidden)}"
        if judged.note:
            text += f"; {judged.note}"
        parts.append(text)
    return ". ".join(parts)


def _against_limits(judged: _Judged) -> str:
    limited = [q for q in judged.quantities if q.limit is not None]
    beyond = [q for q in limited if not q.kept]
    if beyond:
        listed = [f"{q.quantity} {q.rms:.4g} of {q.limit:.4g} {q.unit}" for q in beyond]
        return "beyond the limit: " + ", ".join(listed)
    kept = dict.fromkeys(f"{q.limit:.4g} {q.unit}" for q in limited)
    return "within the limit of " + ", ".join(kept)
