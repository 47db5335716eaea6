"""A gyro triad against the rates of its table: bias, scale factor, cross-axis terms, and what else
is asked for.
"""

from collections.abc import Sequence

import numpy as np

from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, wrap_up
from tiltcal.calibration.methods.screening import order_test, require_unsaturated
from tiltcal.calibration.methods.terms import columns_under
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive
from tiltcal.statistics.least_squares import Fit, linear_fit

NAME = "gyro_rates"
BLOCK = 0.5  # s, whose means are compared: no shorter than the table's readout resolves a rate in
STEADY = 0.02  # of the highest rate: a block in which the table's rate changes by less is steady
LEAST_RATE = 1 * DEG
FOLDS = 8
LOST = 0.01  # standard uncertainty of a scale factor above which its axis counts as not turned


def gyro_rates(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = ("bias", "scale", "cross_axis"),
) -> Calibration:
    """Bias, scale factor, cross-axis terms and, where asked for, g-sensitivity or non-linearity of
    a gyro triad on a table.

    Model: ``reading = b + (I + S + C) w + G f + ...``; w is the table's own rate by its readout
    and, with latitude and heading stated, the Earth's; f gravity. Means over BLOCK seconds at
    steady rates and at rest are fitted by least squares; the ramps between are used only where
    nothing else tells a parameter: there a delay would look like an error.

    Args:
        recording: rests and steady rates about every axis of the body, both ways, with the table's
            readout.
        setup: with the table and the gyro triad.
        segments: dwells to use for the noise.
        sensor: which gyro, when several fit.
        terms: of bias, scale, cross_axis, gsens, g2sens, scale_asym, nonlinearity.

    Raises:
        TiltcalError: the table has no readout or does not turn, or an unknown term.

    Errors:
        The rate of the table's readout enters scale 1:1; an unknown heading leaves up to 15 deg/h
            in bias and cross-axis terms; a fixed mounting rotation is antisymmetric cross-axis.

    Source: IEEE 1431, 952 (rate tables); PHYSICS 1.1, 3.5.
    """
    if isinstance(terms, str) or "bias" not in terms:
        raise TiltcalError(
            f"method {NAME}, option terms",
            found=str(terms),
            need="a list with bias in it",
            do="correct it",
        )
    gyro = pick_sensor(setup, recording, ("gyro",), sensor, NAME)
    _require_readout(recording, setup)
    require_unsaturated(recording, gyro)
    poses = find_poses(recording, setup, gyro, segments)
    samples = recording.sensor(gyro)
    whole = ~np.isnan(samples.values).any(axis=1)
    drive = replay(recording, setup).drive(samples.time[whole])
    speed = np.column_stack([np.asarray(jet.v) for jet in drive.axes.values()])
    if np.abs(speed).max() < LEAST_RATE:
        raise TiltcalError(
            recording.source,
            found=f"no rate above {np.abs(speed).max() / DEG:.2g} deg/s",
            need="turns of the table about every axis",
            do="turn at several steady rates, both ways",
        )
    names, units, design = columns_under(
        terms, gyro, make_sense(gyro, setup, closed_form(setup, drive), drive)
    )
    first, steady = _blocks(drive, speed, gyro)
    target = _means(samples.values[whole] - _nominal(gyro, setup, drive), first)
    columns = np.array([_means(c, first) for c in design])
    sigma = _whitener(poses, first)
    fit = fit_blocks(names, columns[:, steady], target[steady], sigma)
    used = steady
    if fit.dropped:
        used = np.ones(len(steady), bool)
        fit = fit_blocks(names, columns, target, sigma)
    tests = _tests(fit, columns, used, names, gyro.name)
    tests += [order_test(_sensitivity(fit, gyro))] if len(gyro.axes) == 3 else []
    kept = [units[names.index(n)] for n in fit.names]
    lost = [
        n.split(".")[1]
        for n, s in zip(fit.names, fit.sigmas, strict=True)
        if ".scale_" in n and s > LOST
    ]
    notes = _notes(setup, steady, used, lost)
    verdict = verdict_of(tests, not fit.dropped and not lost and fit.dof > 0)
    return wrap_up(
        NAME,
        verdict,
        fit,
        kept,
        tests,
        notes,
        poses,
        recording,
        equation=f"{gyro.name} = bias + (I + scale + cross) w + gsens f",
        inverse="w = M^-1 (reading - bias - gsens f)",
        heldout={gyro.name: _held_out(names, columns[:, used], target[used], sigma)},
    )


def _sensitivity(fit: Fit, gyro: Sensor) -> Array:
    """I + scale + cross, (3, 3)."""
    M = np.eye(3)
    for i, a in enumerate(AXES):
        M[i] += [
            fit.value(f"{gyro.name}.scale_{a}" if i == j else f"{gyro.name}.cross_{a}{b}")
            for j, b in enumerate(AXES)
        ]
    return M


def _require_readout(recording: Recording, setup: Setup) -> None:
    missing = [n for n in setup.rig.axis_names if recording.table(n) is None]
    if missing or not setup.rig.axis_names:
        what = f"no table_{missing[0]}" if missing else f"table {setup.rig.table}"
        raise TiltcalError(
            recording.source,
            found=what,
            need="the readout of a table as the reference",
            do="record it, or use gyro_turns or fog_scale",
        )


def _nominal(gyro: Sensor, setup: Setup, drive: Drive) -> Array:
    """The true rate along each channel, rad/s, (n, k)."""
    return make_sense(gyro, setup, closed_form(setup, drive), drive).true_input()


def _blocks(drive: Drive, speed: Array, gyro: Sensor) -> tuple[Index, Mask]:
    """First rows of the blocks, with a row after the last, (b + 1,), and which are steady and read
    throughout, (b,).
    """
    size = max(round(BLOCK * gyro.rate_hz), 2)
    edges = np.arange(0, len(drive.time) + 1, size)
    limit = max(STEADY * np.abs(speed).max(), LEAST_RATE / 20)
    steady = np.zeros(len(edges) - 1, bool)
    for k in range(len(edges) - 1):
        part = speed[edges[k] : edges[k + 1]]
        span = drive.time[edges[k + 1] - 1] - drive.time[edges[k]]
        steady[k] = bool(
            np.all(np.ptp(part, axis=0) < limit)
            and drive.known[edges[k] : edges[k + 1]].all()
            and span < 2 * BLOCK
        )
    return edges, steady


def _means(values: Array, edges: Index) -> Array:
    """Means over the blocks, (b, k)."""
    size = int(edges[1] - edges[0])
    return np.asarray(values[: edges[-1]].reshape(len(edges) - 1, size, -1).mean(axis=1))


def _whitener(poses: Poses, edges: Index) -> Array:
    """Inverse Cholesky factor of the noise of a block's mean, (k, k)."""
    return np.asarray(
        np.linalg.inv(
            np.linalg.cholesky(poses.noise * poses.inflation / float(edges[1] - edges[0]))
        )
    )


def fit_blocks(names: Sequence[str], columns: Array, target: Array, whiten: Array) -> Fit:
    """Least squares over blocks and channels. columns: (p, b, k); target: (b, k)."""
    A = np.einsum("ij,pbj->bip", whiten, columns).reshape(-1, len(names))
    return linear_fit(names, A, (target @ whiten.T).ravel())


def _tests(fit: Fit, columns: Array, used: Mask, names: Sequence[str], gyro: str) -> list[Test]:
    tests = [
        chi2_test(
            "fit",
            fit.chi2,
            fit.dof,
            f"{int(used.sum())} means of {BLOCK:g} s follow the table within the gyro's noise",
        )
    ]
    for i, axis in enumerate(AXES):
        name = f"{gyro}.scale_{axis}"
        if name not in names:
            continue
        rates = columns[list(names).index(name), used, i]
        both = bool(rates.max() > LEAST_RATE and rates.min() < -LEAST_RATE)
        words = f"rates about {axis} from {rates.min() / DEG:.3g} to {rates.max() / DEG:.3g} deg/s"
        words += "" if both else f": turn about {axis} both ways"
        tests.append(
            Test(f"turned about {axis}", float(np.ptp(rates) / DEG), 0, float(both), both, words)
        )
    return tests


def _notes(setup: Setup, steady: Mask, used: Mask, lost: list[str]) -> list[str]:
    notes = [f"not determined: {', '.join(lost)}: turn about those axes"] if lost else []
    if used.sum() > steady.sum():
        notes.append(
            "the steady rates do not tell every parameter: ramps are used as well, where a delay"
            " would look like an error"
        )
    if setup.site.latitude_deg is None:
        notes.append(
            "no latitude: the Earth's rate, up to 15 deg/h, is left in bias and cross-axis terms"
        )
    elif setup.site.heading_deg == "unknown":
        notes.append(
            "heading unknown: the Earth's horizontal rate is taken as if the table's North mark"
            " pointed north"
        )
    return notes


def _held_out(names: Sequence[str], columns: Array, target: Array, whiten: Array) -> float:
    """Rms of blocks left out of the fit, in FOLDS stretches, rad/s."""
    part = np.arange(len(target)) * FOLDS // len(target)
    left = []
    for k in range(FOLDS):
        fit = fit_blocks(names, columns[:, part != k], target[part != k], whiten)
        found = np.array([fit.value(n) for n in names])
        left.append(target[part == k] - np.einsum("p,pbk->bk", found, columns[:, part == k]))
    return leave_out_rms(left)
