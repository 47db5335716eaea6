"""S1: known attitudes. Six positions and every other set of labelled or table-read poses (8, 12,
24, tumble).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, wrap_up
from tiltcal.calibration.methods.screening import require_unsaturated
from tiltcal.calibration.methods.terms import term_columns
from tiltcal.calibration.result import Calibration, Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES, angle_between
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses, group_directions
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.least_squares import Fit, linear_fit

NAME = "six_position"
LINEAR = ("bias", "scale", "cross_axis")
DRIFT = "drift"


def six_position(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = LINEAR,
) -> Calibration:
    """Bias, scale factor and cross-axis terms from poses whose attitude is known.

    Model: ``reading_i = b_i + (1 + S_i) f_i + sum_j C_ij f_j`` with f = g up; further linear
    effects of the catalogue can be named in ``terms``. Weighted least squares on pose means. With
    ``drift`` among the terms each bias may run off linearly over the recording, ``+ d_i t / T``: a
    nuisance that is fitted and said, not kept; the bias is that of the first stamp.

    Args:
        recording: a continuous log; the dwells are found, or given as ``segments``.
        setup: with an accelerometer or inclinometer; attitudes from the table's readout, else from
            labels.
        segments: dwells to use.
        sensor: which, when several fit.
        terms: to estimate.

    Raises:
        TiltcalError: no pose has a known attitude, or a term is unknown.

    Errors:
        A pose error e enters scale as e^2/2 and cross-axis as e. A rotation common to all poses
            (fixture, mounting) is the antisymmetric part of the cross-axis matrix: it cannot be
            told from it. K3 hides in the scale factor.

    Source: seed S1 (CN patent on six-position cross-coupling calibration); PHYSICS 6 (1).
    """
    if (
        isinstance(terms, str)
        or not isinstance(terms, Sequence)
        or not all(isinstance(t, str) for t in terms)
    ):
        raise TiltcalError(
            f"method {NAME}, option terms",
            found=repr(terms),
            need="a list of names",
            do='write terms=\'["bias", "scale"]\'',
        )
    used = pick_sensor(setup, recording, ("accelerometer", "inclinometer"), sensor, NAME)
    require_unsaturated(recording, used)
    poses = find_poses(recording, setup, used, segments)
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    if not known.any():
        raise TiltcalError(
            recording.source,
            found=f"{len(poses)} dwells without table readout or direction label",
            need="attitudes: table columns, or labels such as +x, -z, [0, 1, 1]",
            do="label the dwells, or use --method norm",
        )
    warnings = (
        []
        if known.all()
        else [f"{np.sum(~known)} of {len(known)} dwells have no known attitude and are not used"]
    )
    poses = poses.subset(known)
    over = (float(recording.time[0]), float(recording.time[-1] - recording.time[0]))
    fit, units = solve(poses, setup, terms, over)
    tests = [*_fit_tests(poses, setup, fit, terms, over), *_attitude_tests(poses)]
    warnings.append(_gauge(fit, used))
    if fit.dropped or fit.dof == 0:
        tests.append(
            Test(
                "determined",
                float(len(fit.dropped)),
                fit.dof,
                0.0,
                False,
                f"{len(poses)} poses do not determine the model",
            )
        )
    heldout = _heldout(poses, setup, terms, over) if not fit.dropped else {}
    if DRIFT in terms:
        fit, units, said = _without_drift(fit, units, used)
        warnings.append(said)
    return wrap_up(
        NAME,
        verdict_of(tests, determined=not fit.dropped and fit.dof > 0),
        fit,
        units,
        tests,
        warnings,
        poses,
        recording,
        equation=f"{used.name}_i = bias_i + (1 + scale_i) f_i + sum_j cross_ij f_j",
        inverse="f = M^-1 (reading - bias)",
        heldout=heldout,
    )


def solve(
    poses: Poses, setup: Setup, terms: Sequence[str], over: tuple[float, float]
) -> tuple[Fit, list[str]]:
    """Weighted least squares on pose means; the fit and the units of its parameters. over: first
    stamp and length, s.
    """
    force = setup.site.gravity * poses.up
    names, units, columns = _columns(poses, setup, terms, over)
    ideal = force[:, list(poses.sensor.axis_indices)]
    design, target = [], []
    for k in range(len(poses)):
        whiten = np.linalg.inv(np.linalg.cholesky(poses.covariance(k)))
        design.append(whiten @ columns[:, k, :].T)
        target.append(whiten @ (poses.means[k] - ideal[k]))
    fit = linear_fit(names, np.vstack(design), np.concatenate(target))
    return fit, [u for n, u in zip(names, units, strict=True) if n in fit.names]


def _columns(
    poses: Poses, setup: Setup, terms: Sequence[str], over: tuple[float, float]
) -> tuple[list[str], list[str], Array]:
    """Names, units and columns of all parameters, (p, m, k): of the terms, and of a drift of each
    channel.
    """
    names, units, columns = term_columns(
        [t for t in terms if t != DRIFT], poses.sensor, setup, setup.site.gravity * poses.up
    )
    if DRIFT not in terms:
        return names, units, columns
    start, length = over
    along = np.array([((s.start_s + s.end_s) / 2 - start) / length for s in poses.spans])
    axes = poses.sensor.axes
    drifts = np.eye(len(axes))[:, None, :] * along[None, :, None]
    names += [f"{poses.sensor.name}.{DRIFT}_{axis}" for axis in axes]
    return (
        names,
        units + ["m_s2"] * len(axes),
        np.concatenate([columns.reshape(-1, *drifts.shape[1:]), drifts]),
    )


def _without_drift(fit: Fit, units: Sequence[str], sensor: Sensor) -> tuple[Fit, list[str], str]:
    """The fit with the drift fitted but not kept, its units, and the drift in words."""
    keep = np.array([f".{DRIFT}_" not in n for n in fit.names], dtype=bool)
    said = ", ".join(
        f"{n[-1]} {v / G0 * 1e6:.4g} +- {s / G0 * 1e6:.2g}"
        for n, v, s, kept in zip(fit.names, fit.values, fit.sigmas, keep, strict=True)
        if not kept
    )
    kept = replace(
        fit,
        names=tuple(np.array(fit.names)[keep].tolist()),
        values=fit.values[keep],
        covariance=fit.covariance[np.ix_(keep, keep)],
    )
    words = (
        f"a linear drift of {sensor.name} over the recording was fitted beside: {said} ug; the bias"
        " is that of the first stamp"
    )
    return kept, [u for u, k in zip(units, keep, strict=True) if k], words


def _fit_tests(
    poses: Poses, setup: Setup, fit: Fit, terms: Sequence[str], over: tuple[float, float]
) -> list[Test]:
    """The spare equations: do they close, and if not, does a second-order term close them?"""
    tests = [
        chi2_test(
            "fit",
            fit.chi2,
            fit.dof,
            f"residuals of {fit.dof} spare equations against the noise of the means",
        )
    ]
    if "K2" in terms or fit.dof < 3 or fit.dropped or "bias" not in terms:
        return tests
    wider, _ = solve(poses, setup, [*terms, "K2"], over)
    gained = len(wider.names) - len(fit.names)
    # else these poses do not tell K2 from the linear terms
    if gained > 0 and set(fit.names) <= set(wider.names):
        drop = fit.chi2 - wider.chi2
        sizes = ", ".join(f"{n} {wider.value(n):.3g}" for n in wider.names if ".K2_" in n)
        tests.append(
            chi2_test(
                "second order",
                drop,
                gained,
                f"a quadratic term (ug/g2: {sizes}) improves the fit by {drop:.3g} in chi2",
            )
        )
    return tests


def _attitude_tests(poses: Poses) -> list[Test]:
    """Wrong, swapped and missing faces, by name."""
    if len(poses.sensor.axes) < 3:
        return []
    tests = []
    measured = poses.means / np.linalg.norm(poses.means, axis=1)[:, None]
    off = angle_between(measured, poses.up) / DEG
    wrong = [
        f"the dwell at {s.start_s:.6g} s is stated {s.label or 'by the readout'} but reads"
        f" {_face(m)}"
        for s, m, angle in zip(poses.spans, measured, off, strict=True)
        if angle > 30
    ]
    wrong += _swapped(poses, measured, np.flatnonzero(off > 30))
    tests.append(
        Test(
            "faces as stated",
            float(off.max()),
            len(poses),
            float(not wrong),
            not wrong,
            "; ".join(wrong) or "all do",
        )
    )
    missing = [
        sign + axis
        for axis, e in zip(AXES, np.eye(3), strict=True)
        for sign, s in (("+", 1), ("-", -1))
        if np.max(poses.up @ (s * e)) < 0.5
    ]
    statement = (
        f"no pose within 60 deg of {', '.join(missing)} up"
        if missing
        else "every axis was seen up and down"
    )
    groups, counts = (
        np.unique(group_directions(poses.up), return_index=True)[1],
        np.bincount(group_directions(poses.up)),
    )
    twice = [
        f"{_face(poses.up[first])} {n} times"
        for first, n in zip(groups, counts, strict=True)
        if n > 1
    ]
    if missing and twice:
        statement += f", but {', '.join(twice)}: recorded twice instead?"
    tests.append(
        Test("faces complete", float(len(missing)), 6, float(not missing), not missing, statement)
    )
    return tests


def _swapped(poses: Poses, measured: Array, wrong: Index) -> list[str]:
    """Pairs of dwells that would both be right with their faces exchanged."""
    near = np.cos(30 * DEG)
    return [
        f"these two are swapped: {poses.spans[i].start_s:.6g} s and {poses.spans[j].start_s:.6g} s"
        for n, i in enumerate(wrong)
        for j in wrong[n + 1 :]
        if measured[i] @ poses.up[j] > near and measured[j] @ poses.up[i] > near
    ]


def _gauge(fit: Fit, sensor: Sensor) -> str:
    """The rotation of a fixture that the antisymmetric part of the cross-axis terms would be: it
    cannot be told from it.
    """
    said = (
        "a rotation common to all poses (fixture or mounting) is one with the antisymmetric part of"
        " the cross-axis terms"
    )
    pairs = [
        (f"{sensor.name}.cross_{a}{b}", f"{sensor.name}.cross_{b}{a}")
        for a, b in ("yz", "zx", "xy")
    ]
    if not all(n in fit.names for pair in pairs for n in pair):
        return said
    index = [[fit.names.index(n) for n in pair] for pair in pairs]
    turn = [(fit.values[i] - fit.values[j]) / 2 / ARCSEC for i, j in index]
    sigma = [
        float(np.sqrt(fit.covariance[i, i] + fit.covariance[j, j] - 2 * fit.covariance[i, j]))
        / 2
        / ARCSEC
        for i, j in index
    ]
    words = ", ".join(f"{a} {t:.4g} +- {s:.2g}" for a, t, s in zip(AXES, turn, sigma, strict=True))
    return (
        f"{said}: here it would be a turn of {words} arcsec; the symmetric part, scale and bias do"
        " not depend on it"
    )


def _face(direction: Array) -> str:
    i = int(np.argmax(np.abs(direction)))
    return ("+" if direction[i] > 0 else "-") + AXES[i]


def _heldout(
    poses: Poses, setup: Setup, terms: Sequence[str], over: tuple[float, float]
) -> dict[str, float]:
    """Residuals of directions left out of the fit, SI."""
    group = group_directions(poses.up)
    residuals = []
    for k in range(group.max() + 1):
        rest, out = poses.subset(group != k), poses.subset(group == k)
        if len(rest) == 0:
            return {}
        fit, _ = solve(rest, setup, terms, over)
        if fit.dropped:
            continue
        residuals.append(out.means - predicted(out, setup, fit, terms, over))
    return {poses.sensor.name: leave_out_rms(residuals)} if residuals else {}


def predicted(
    poses: Poses, setup: Setup, fit: Fit, terms: Sequence[str], over: tuple[float, float]
) -> Array:
    """What the fitted model says the poses read, (m, k)."""
    force = setup.site.gravity * poses.up
    names, _, columns = _columns(poses, setup, terms, over)
    values = np.array([fit.value(n) for n in names])
    return np.asarray(
        force[:, list(poses.sensor.axis_indices)] + np.tensordot(values, columns, axes=1)
    )
