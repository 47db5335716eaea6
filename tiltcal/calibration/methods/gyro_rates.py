"""A gyro triad against the rates of its table: bias, scale factor, cross-axis terms, and further
linear terms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.common import (
    fitted_sensitivity,
    leave_out_rms,
    pick_sensor,
    whitening,
    with_equation,
    wrap_up,
)
from tiltcal.calibration.methods.terms import columns_under
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.causes import Misfit, cause_test, lacking_terms, part_words
from tiltcal.calibration.screen.columns import order_test, unit_tests
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.validity import Test, chi2_test, threshold_test, verdict_of
from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.numerical import undetermined
from tiltcal.core.units import DEG
from tiltcal.effects.base import Effect
from tiltcal.effects.sense import Sense
from tiltcal.forward.kinematics import closed_form
from tiltcal.forward.signal_chain import make_sense, readings
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.references import NO_REFERENCES, References, references
from tiltcal.recordings.replay import Replay, nearest_rows, replay
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.trajectory import Drive
from tiltcal.statistics.least_squares import CommonErrors, Fit, linear_fit

NAME = "gyro_rates"
BLOCK = 0.5  # s: the shortest time in which the table's readout resolves a rate
STEADY = 0.02  # of the highest rate: the rate of a steady block changes by less
LEAST_RATE = 1 * DEG
FOLDS = 8
DELAY = "the readings lag or lead the readout of the table"
DELAYS = 12  # that are tried, each way
UNCERTAIN = 0.01  # standard uncertainty of a scale factor whose axis counts as not turned


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
    steady rates and at rest are fitted by least squares. The ramps between are used only where a
    parameter cannot be determined otherwise: there a delay would look like an error.

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

    Source: IEEE 1431, 952 (rate tables); docs/physics.md, "Gyro triads by gravity and by a table".
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
    live = data_tests(recording, gyro)
    poses = find_poses(recording, setup, gyro, segments)
    blocks, units = _blocks(recording, setup, gyro, terms, poses)
    used, fit = blocks.steady, blocks.fit(blocks.steady)
    if fit.dropped:
        used = np.ones(len(used), bool)
        fit = blocks.fit(used)
    tests = [*_tests(blocks, used, fit, recording), *live]
    uncertain = [
        n.split(".")[1]
        for n, s in zip(fit.names, fit.sigmas, strict=True)
        if ".scale_" in n and s > UNCERTAIN
    ]
    result = wrap_up(
        NAME,
        verdict_of(tests, not fit.dropped and not uncertain and fit.dof > 0),
        fit,
        [units[n] for n in fit.names],
        tests,
        _notes(setup, ramps_used=used.sum() > blocks.steady.sum(), uncertain=uncertain),
        replace(poses, references=blocks.references),
        recording,
        equation="",
        inverse="w by Newton's iteration from M^-1 (reading - bias)",
        heldout={gyro.name: blocks.held_out(used)},
    )
    return with_equation(result, gyro, setup)


def _tests(blocks: "Blocks", used: Mask, fit: Fit, recording: Recording) -> list[Test]:
    """Of the fit, with the cause of a misfit, of the turns, and of the columns of a triad."""
    gyro = blocks.gyro
    tests = [_fit_test(fit, used)]
    if not tests[0].passed:
        tests.append(cause_test(blocks.misfit(used, fit).explanations(), recording.source))
    tests += _turn_tests(blocks, used)
    if len(gyro.axes) == 3:
        M = fitted_sensitivity(fit, gyro.name)
        tests += [order_test(M), *unit_tests(gyro, M, recording.sensor(gyro).units[0])]
    return tests


@dataclass(frozen=True)
class Blocks:
    """Means over short blocks, and what the model says of them.

    Args:
        names: of the parameters, (p,).
        columns: reading per unit parameter, (p, b, k).
        target: mean reading less the true rate, rad/s, (b, k).
        whiten: of a block's mean, (k, k).
        steady: blocks of a constant rate whose readout is complete, (b,).
        size: samples of a block.
        gyro: that was read.
        sense: what it senses at every sample.
        references: what uncertain references add to the means, (q, b, k).
    """

    names: Sequence[str]
    columns: Array
    target: Array
    whiten: Array
    steady: Mask
    size: int
    gyro: Sensor
    sense: Sense
    references: References = NO_REFERENCES

    def misfit(self, used: Mask, fit: Fit) -> Misfit:
        """What a fit over some of the blocks leaves. used: (blocks,)."""
        rows = np.flatnonzero(used)
        time, inputs = (
            block_means(values, self.size)[rows]
            for values in (self.sense.time[:, None], self.sense.true_input())
        )
        part = np.cumsum(np.diff(rows, prepend=rows[0]) > 1, dtype=np.intp)
        ends = [time[part == k, 0][[0, -1]] for k in range(part[-1] + 1)]
        sigma = np.sqrt(np.diag(np.linalg.inv(self.whiten.T @ self.whiten)))
        lacking = {DELAY: self._delayed(), **lacking_terms(self.gyro, self.sense)}
        return Misfit(
            [f"{self.gyro.name}_{a}" for a in self.gyro.axes],
            time[:, 0],
            self.target[rows] + inputs,
            inputs,
            np.broadcast_to(sigma, inputs.shape),
            part,
            [part_words("steady stretch", a - BLOCK / 2, b + BLOCK / 2) for a, b in ends],
            fit.residuals,
            whitened(self.columns[:, used], self.whiten),
            lambda errors: (errors @ self.whiten.T).reshape(len(errors), -1).T,
            {
                words: np.array(
                    [[block_means(c, self.size)[rows] for c in course] for course in courses]
                )
                for words, courses in lacking.items()
            },
        ).sharing(self._common(used))

    def _delayed(self) -> Array:
        """Errors of readings that lag or lead the readout by up to a block, (c, 1, n, k)."""
        time, true = self.sense.time, self.sense.true_input()
        step = float(np.median(np.diff(time)))
        found = []
        for delay in np.geomspace(step, self.size * step, DELAYS):
            for late in (delay, -delay):
                read = [np.interp(time - late, time, column) for column in true.T]
                found.append([np.column_stack(read) - true])
        return np.array(found)

    def fit(self, used: Mask | Index) -> Fit:
        """Least squares over some of the blocks. used: (blocks,), or their numbers."""
        target, common = self.target[used], self._common(used)
        return fit_blocks(self.names, self.columns[:, used], target, self.whiten, common)

    def _common(self, used: Mask | Index) -> CommonErrors:
        """What uncertain references add to some of the blocks. used: (blocks,), or numbers."""
        count = len(self.target[used])
        whiten = np.broadcast_to(self.whiten, (count, *self.whiten.shape))
        return self.references.at(used).whitened(whiten)

    def held_out(self, used: Mask) -> float:
        """Rms of blocks left out of the fit, in FOLDS stretches, rad/s. used: (blocks,)."""
        chosen = np.flatnonzero(used)
        part = np.arange(len(chosen)) * FOLDS // len(chosen)
        left = []
        for k in range(FOLDS):
            fit = self.fit(chosen[part != k])
            values = np.array([fit.value(n) for n in self.names])
            out = chosen[part == k]
            left.append(self.target[out] - np.einsum("p,pbk->bk", values, self.columns[:, out]))
        return leave_out_rms(left)


def whitened(columns: Array, whiten: Array) -> Array:
    """Columns (p, b, k) in units of the noise, (b k, p). whiten: (k, k)."""
    return np.einsum("ij,pbj->bip", whiten, columns).reshape(-1, len(columns))


def fit_blocks(
    names: Sequence[str],
    columns: Array,
    target: Array,
    whiten: Array,
    common: CommonErrors | None = None,
) -> Fit:
    """Least squares over blocks and channels. columns: (p, b, k); target: (b, k)."""
    return linear_fit(names, whitened(columns, whiten), (target @ whiten.T).ravel(), common)


def _blocks(
    recording: Recording, setup: Setup, gyro: Sensor, terms: Sequence[str], poses: Poses
) -> tuple[Blocks, dict[str, str]]:
    """The blocks of a recording, and the unit of each parameter."""
    samples = recording.sensor(gyro)
    complete = ~np.isnan(samples.values).any(axis=1)
    course, time = replay(recording, setup), samples.time[complete]
    drive = course.drive(time)
    speed = np.column_stack([np.asarray(jet.v) for jet in drive.axes.values()])
    _require_turning(speed, recording)
    sense = make_sense(gyro, setup, closed_form(setup.seen_by(gyro), drive), drive)
    names, units, design = columns_under(terms, gyro, sense)
    size = max(round(BLOCK * gyro.rate_hz), 2)
    if len(drive.time) < size:
        words = f"{len(drive.time)} rows, less than one block of {BLOCK:g} s at {gyro.rate_hz:g} Hz"
        raise undetermined(recording.source, "the parameters of gyro_rates", words)
    error = samples.values[complete] - sense.true_input()
    blocks = Blocks(
        names,
        np.array([block_means(column, size) for column in design]),
        block_means(error, size),
        whitening(poses.noise * poses.inflation / float(size)),
        steady_blocks(drive, speed, size),
        size,
        gyro,
        sense,
        block_references(gyro, setup, course, time, size),
    )
    return blocks, dict(zip(names, units, strict=True))


def block_references(
    sensor: Sensor, setup: Setup, course: Replay, time: Array, size: int
) -> References:
    """What uncertain references add to means over blocks of a rate sensor on a table.

    Args:
        sensor: which.
        setup: of the recording.
        course: its readout.
        time: of the samples, s, (n,).
        size: samples of a block.
    """

    def evaluate(where: Setup, effect: Effect | None) -> Array:
        effects = () if effect is None else (effect,)
        predicted = readings(where, course, {sensor.name: time}, effects)[sensor.name]
        return block_means(predicted, size)

    middle = time[np.arange(len(time) // size) * size + size // 2]
    return references(setup, evaluate, course.stop[nearest_rows(course.time, middle)])


def _require_turning(speed: Array, recording: Recording) -> None:
    """Refuse a table that does not turn. speed: of its axes, rad/s, (n, axes)."""
    if np.abs(speed).max() < LEAST_RATE:
        raise TiltcalError(
            recording.source,
            found=f"no rate above {np.abs(speed).max() / DEG:.2g} deg/s",
            need="turns of the table about every axis",
            do="turn at several steady rates, both ways",
        )


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


def steady_blocks(drive: Drive, speed: Array, size: int) -> Mask:
    """Which blocks have a constant rate, a complete readout and no gap, (b,).

    Args:
        drive: the readout of the table, (n,) rows.
        speed: of each axis, rad/s, (n, axes).
        size: samples of a block.
    """
    limit = max(STEADY * np.abs(speed).max(), LEAST_RATE / 20)
    steady = np.zeros(len(drive.time) // size, bool)
    for k in range(len(steady)):
        part = slice(k * size, (k + 1) * size)
        time = drive.time[part]
        constant = np.all(np.ptp(speed[part], axis=0) < limit)
        steady[k] = constant and drive.known[part].all() and time[-1] - time[0] < 2 * BLOCK
    return steady


def block_means(values: Array, size: int) -> Array:
    """Means over blocks of some samples, (b, k)."""
    blocks = len(values) // size
    return np.asarray(values[: blocks * size].reshape(blocks, size, -1).mean(axis=1))


def _fit_test(fit: Fit, used: Mask) -> Test:
    words = f"{int(used.sum())} means of {BLOCK:g} s follow the table within the gyro's noise"
    return chi2_test("fit", fit.chi2, fit.dof, words)


def _turn_tests(blocks: Blocks, used: Mask) -> list[Test]:
    """Was the gyro turned about each axis in both directions?"""
    tests = []
    for i, axis in enumerate(blocks.gyro.axes):
        name = f"{blocks.gyro.name}.scale_{axis}"
        if name not in blocks.names:
            continue
        rates = blocks.columns[list(blocks.names).index(name), used, i]
        low, high = rates.min(), rates.max()
        both = high > LEAST_RATE and low < -LEAST_RATE
        words = f"rates about {axis} from {low / DEG:.3g} to {high / DEG:.3g} deg/s"
        if not both:
            words += f": turn about {axis} both ways"
        tests.append(threshold_test(f"turned about {axis}", np.ptp(rates) / DEG, both, words))
    return tests


def _notes(setup: Setup, *, ramps_used: bool, uncertain: list[str]) -> list[str]:
    notes = []
    if uncertain:
        notes.append(f"not determined: {', '.join(uncertain)}: turn about those axes")
    if ramps_used:
        notes.append(
            "the steady rates do not determine every parameter: ramps are used as well, where a"
            " delay would look like an error"
        )
    if setup.site.latitude_deg is None:
        notes.append(
            "no latitude: the Earth's rate, up to 15 deg/h, is left in bias and cross-axis terms"
        )
    elif setup.site.heading_deg == "unknown":
        notes.append(
            "heading unknown: the Earth's horizontal rate is computed as if the table's North mark"
            " pointed north"
        )
    return notes
