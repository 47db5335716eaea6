"""What all methods share: the choice of the sensor, whitening, and the Calibration made of a
fit.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal import __version__
from tiltcal.calibration.result import Calibration, Estimate, Reference
from tiltcal.calibration.validity import SIGNIFICANCE, Test, Verdict, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import References
from tiltcal.recordings.static_poses import Poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit

DETERMINED = 0.5  # of a stated uncertainty: with less the readings say more than the statement
MOST = np.sqrt(0.5)  # of a standard uncertainty: half of the variance


def pick_sensor(
    setup: Setup, recording: Recording, kinds: Sequence[str], name: str | None, method: str
) -> Sensor:
    """The sensor a method works on: the named one, or the only recorded one of these kinds.

    Raises:
        TiltcalError: none or several qualify.
    """
    if name is not None:
        sensor = setup.named(name)
        if sensor.kind not in kinds:
            raise TiltcalError(
                f"method {method}",
                found=f"sensor {name} of kind {sensor.kind}",
                need=" or ".join(kinds),
                do="name another",
            )
        return sensor
    fitting = [s for s in setup.sensors(*kinds) if recording.has(s)]
    if len(fitting) == 1:
        return fitting[0]
    names = ", ".join(s.name for s in fitting or setup.sensors(*kinds)) or "none"
    if not fitting and setup.sensors(*kinds):
        recording.sensor(setup.sensors(*kinds)[0])  # says which column is missing
    raise TiltcalError(
        f"method {method}",
        found=f"{len(fitting)} recorded sensors that fit ({names})",
        need=f"one {' or '.join(kinds)}",
        do="name it with --option sensor=NAME" if fitting else "use a method for your sensors",
    )


def require_triad(sensor: Sensor, method: str, do: str) -> None:
    """Refuse a sensor without three axes.

    Raises:
        TiltcalError: it has one or two.
    """
    if len(sensor.axes) != 3:
        found = f"{len(sensor.axes)} axes of {sensor.name}"
        raise TiltcalError(f"method {method}", found=found, need="a triad", do=do)


def require_xy(sensor: Sensor, method: str) -> None:
    """Refuse a sensor without the axes x and y.

    Raises:
        TiltcalError: one of them is missing.
    """
    if not {"x", "y"} <= set(sensor.axes):
        raise TiltcalError(
            f"method {method}",
            found=f"axes {', '.join(sensor.axes)} of {sensor.name}",
            need="x and y",
            do="add the other channel",
        )


def whitening(covariance: Array) -> Array:
    """W with ``W C W' = 1``: the inverse Cholesky factor, (..., k, k)."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def whitening_of_means(poses: Poses) -> Array:
    """Whitening of the mean of each pose, (m, k, k)."""
    return whitening(poses.covariances)


def wrap_up(
    method: str,
    verdict: Verdict,
    fit: Fit,
    units: Sequence[str],
    tests: Sequence[Test],
    warnings: Sequence[str],
    poses: Poses,
    recording: Recording,
    *,
    equation: str,
    inverse: str,
    heldout: dict[str, float] | None = None,
) -> Calibration:
    """A Calibration from a fit.

    Where the test named ``fit`` fails, the covariance is multiplied by chi2/dof, with a warning.
    """
    factor = 1.0
    notes = list(warnings)
    fit_failed = any(t.name == "fit" and not t.passed for t in tests)
    if fit_failed and fit.chi2_per_dof > 1 and not fit.dropped:
        factor = fit.chi2_per_dof
        notes.append(
            f"the residuals are {np.sqrt(factor):.2g} times the noise of the means; all sigmas are"
            " widened by that factor"
        )
    if fit_failed and (worst := worst_dwell(fit, poses)):
        notes.append(worst)
    notes += reference_notes(poses.references, fit)
    covariance = fit.covariance * factor
    sigmas = np.sqrt(np.diag(covariance))
    parameters = {
        n: Estimate(float(v), float(s), u)
        for n, v, s, u in zip(fit.names, fit.values, sigmas, units, strict=True)
    }
    if fit.dropped:
        notes.append("cannot be determined from these poses: " + ", ".join(fit.dropped))
    return Calibration(
        method,
        verdict,
        parameters,
        covariance,
        equation,
        inverse,
        poses=poses.spans,
        tests=list(tests),
        chi2_per_dof=fit.chi2_per_dof,
        dof=fit.dof,
        heldout_rms=heldout or {},
        warnings=notes,
        provenance=provenance(recording, fit.dropped),
        **split_of(poses.references, fit.names, fit.contributions, fit.posterior),
    )


def reference_notes(references: References, fit: Fit) -> list[str]:
    """What a recording says of its uncertain references: the error of each that it determines; of
    each other one the parameters that take it up, where most of their uncertainty comes from it.
    """
    if not references.sources:
        return []
    shares = references.shares(fit.contributions).T
    notes = []
    for source, found, share in zip(
        references.sources, references.single(fit.posterior), shares, strict=True
    ):
        if found is None:
            continue
        value, sigma = (source.standard * v for v in found)
        stated = f"{source.standard:.4g} {source.unit}"
        taken_up = [n for n, part in zip(fit.names, share > MOST * fit.sigmas, strict=True) if part]
        if found[1] < DETERMINED:
            notes.append(
                f"{source.name} by this recording: {value:.6g} +- {sigma:.2g} {source.unit}"
                f" (stated: 0 +- {stated})"
            )
        elif taken_up:
            notes.append(
                f"these readings do not distinguish {source.name} from {', '.join(taken_up)}:"
                f" its {stated} stay in their uncertainty"
            )
    return notes


def split_of(
    references: References,
    names: Sequence[str],
    contributions: Array,
    posterior: Array | None = None,
) -> dict[str, Any]:
    """What a Calibration says of its uncertain references: ``references`` with their shares of the
    uncertainty, and ``assumed_covariance``.

    Args:
        references: of the observations.
        names: of the parameters, (p,).
        contributions: of each column of the references, in the parameters' units, (p, q).
        posterior: of each column, in its standard uncertainties, and its own, (2, q); None where
            it was not fitted.
    """
    if not references.sources:
        return {}
    found = references.single(posterior)
    shares = references.shares(contributions).T.tolist()
    assumed = contributions[:, ~references.fitted]
    listed = [
        Reference(
            s.name,
            s.size,
            s.unit,
            s.distribution,
            s.standard,
            s.assumed,
            s.at_stops,
            dict(zip(names, share, strict=True)),
            None if error is None else (error[0] * s.standard, error[1] * s.standard),
        )
        for s, share, error in zip(references.sources, shares, found, strict=True)
    ]
    return {
        "references": listed,
        "assumed_covariance": assumed @ assumed.T if assumed.size else None,
    }


def with_equation(result: Calibration, sensor: Sensor, setup: Setup) -> Calibration:
    """A calibration with the equation of its model.

    Args:
        result: of one sensor.
        sensor: that one.
        setup: of the recording.
    """
    model = result.instrument((sensor,), setup.site.gravity)
    return replace(result, equation=model.equation(sensor))


def worst_dwell(fit: Fit, poses: Poses) -> str:
    """The dwell that fits worst, as text; empty where residuals belong to no single dwell, or none
    stands out.

    Args:
        fit: with residuals in units of their noise, those of one dwell next to each other.
        poses: the dwells.
    """
    if len(fit.residuals) not in (len(poses), len(poses) * len(poses.sensor.axes)):
        return ""
    from scipy.special import chdtrc, chdtri

    squares = (fit.residuals.reshape(len(poses), -1) ** 2).sum(axis=1)
    size = len(fit.residuals) // len(poses)
    k = int(np.argmax(squares))
    # against the spread of the others: the middle of a chi-square where all are alike
    scale = float(np.median(squares)) / float(chdtri(size, 0.5))
    if scale <= 0 or len(poses) * chdtrc(size, squares[k] / scale) > SIGNIFICANCE:
        return ""
    each = np.sqrt(squares / size)
    span = poses.spans[k]
    label = f" ({span.label})" if span.label else ""
    return (
        f"the dwell from {span.start_s:.6g} to {span.end_s:.6g} s{label} fits worst: its residual"
        f" is {each[k]:.3g} times its noise, that of the middle one {np.median(each):.3g} times"
    )


def undetermined_test(names: Sequence[str]) -> Test:
    """The test that fails where a recording does not determine some parameters.

    Args:
        names: of them; none where it only leaves no residual.
    """
    words = f"the recording does not determine {', '.join(names)}"
    if not names:
        words = "the poses determine the model, and leave nothing to judge it by"
    return threshold_test("determined", len(names), False, words)


def provenance(recording: Recording, undetermined: Sequence[str] = ()) -> dict[str, Any]:
    """Where a calibration came from.

    Args:
        recording: the readings.
        undetermined: names of the parameters that they do not determine.
    """
    return {
        "recording": recording.source,
        "made by": f"tiltcal {__version__}",
        **dict(recording.metadata),
        **({"undetermined": list(undetermined)} if undetermined else {}),
    }


def fitted_sensitivity(fit: Fit, sensor: str, axes: Sequence[str] = AXES) -> Array:
    """M of ``reading = bias + M f`` along some axes: 1 plus scale and cross-axis terms, (k, k)."""
    M = np.eye(len(axes))
    for i, a in enumerate(axes):
        M[i] += [
            fit.value(f"{sensor}.scale_{a}" if i == j else f"{sensor}.cross_{a}{b}")
            for j, b in enumerate(axes)
        ]
    return M


def leave_out_rms(residuals: Sequence[Array]) -> float:
    """Root mean square over all left-out residuals, SI. residuals: of each part left out, (n,)."""
    stacked = np.concatenate([np.ravel(r) for r in residuals])
    return float(np.sqrt(np.mean(stacked**2)))
