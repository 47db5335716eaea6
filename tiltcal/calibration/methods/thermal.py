"""Bias, scale and axes over temperature, warming and cooling told apart, from soaks, ramps or
cycles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.calibration.methods.common import provenance, split_of, undetermined_test
from tiltcal.calibration.methods.terms import LINEAR, require_names
from tiltcal.calibration.methods.thermal_blocks import (
    BlockFit,
    blocks_of,
    fit_over_blocks,
    misfit_of_blocks,
    stretches_at_rest,
    temperature_of,
)
from tiltcal.calibration.methods.thermal_model import (
    Blocks,
    Choice,
    Further,
    compared,
    estimate,
    memories,
    names,
    smallest,
    units,
)
from tiltcal.calibration.result import Calibration, Estimate
from tiltcal.calibration.screen.causes import cause_test
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.screen.outliers import outlier_tests
from tiltcal.calibration.validity import Test, threshold_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0
from tiltcal.data_quality.flat import standing_still
from tiltcal.data_quality.log import Channel
from tiltcal.instrument.temperature import Memory, TemperatureCourse
from tiltcal.instrument.terms import SHARED
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.recordings.static_poses import PoseSpan, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.statistics.dwell_noise import second_difference_noise

NAME = "thermal"
RESOLVED = 1 / 2000  # of the range of temperature: noise below it needs no smoothing
LONGEST = 1 / 1000  # of the length: of the low-pass over the noise of the temperature
BOTH_WAYS = 0.5  # of the range that was passed warming and cooling
WAYS = 400  # stretches of time whose means say which way the temperature goes
TREND = 3.0  # of the noise of such a mean: less is no change
OVERFIT = 2.0  # held-out over fitted variance


def thermal(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    terms: Sequence[str] = LINEAR,
) -> Calibration:
    """Bias of every channel as a polynomial of temperature with a memory of earlier temperatures;
    where attitudes are known and vary, scale factor and cross-axis terms likewise.

    Model: ``reading = b + M f + sum_n (T - T0)^n (b_n + M_n f) + m h``. The memory h is ``T -
    T_lagged`` with a time constant (a rate of change where it is short) or a hysteresis of some
    degC. Orders and memory are those of the smallest model within one standard error of the least
    held-out error; blocks of time are left out.

    Args:
        recording: at rest, or with dwells, over a range of temperature; with a temperature column.
        setup: with the sensors; attitudes from the table's readout or labels, where there are any.
        segments: dwells to use; unless given those found, or the whole recording where none is.
        sensor: which; all that are recorded unless given.
        terms: linear effects of an accelerometer or inclinometer that are fitted where attitudes
            are known and vary; bias, scale and cross_axis always are, and they alone over
            temperature.

    Raises:
        TiltcalError: no temperature, one that hardly changes, too few readings, or further terms
            that are unknown or without known attitudes.

    Errors:
        At one attitude scale and cross-axis errors are part of the bias over temperature. A
            temperature that only rises cannot tell memory from polynomial. Outside the range that
            was seen a polynomial means nothing.

    Source: IEEE 1293-2018, temperature sensitivities of the model equation; Breiman et al. (1984).
    """
    require_names(terms, NAME)
    used = _sensors(recording, setup, sensor)
    temperature = temperature_of(recording)
    stretches, warnings = stretches_at_rest(recording, segments)
    span = float(np.ptp(temperature))
    smoothing = _smoothing(recording.time, temperature)
    tried = [
        (m, TemperatureCourse.of(recording.time, temperature, smoothing, m))
        for m in memories(recording.time, span)
    ]
    reference = float(np.mean(temperature))
    parts = [_part(recording, setup, s, stretches, tried, reference, span / 2, terms) for s in used]
    memory = _common_memory(parts)
    parts = [p.under(memory) for p in parts]
    shared = {
        "T0": (reference, "degC"),
        "lowest": (float(temperature.min()), "degC"),
        "highest": (float(temperature.max()), "degC"),
        "smoothing": (smoothing, "s"),
    }
    if memory.kind != "none":
        shared[memory.kind] = (memory.size, "s" if memory.kind == "lag" else "degC")
    tests = [t for s in used for t in _channels_tested(recording, setup, s, stretches)]
    tests += [_both_ways(tried[0][1], span), *(p.heldout_test() for p in parts)]
    fits = [fit_over_blocks(recording, setup, p.sensor, p.blocks, *p.left()) for p in parts]
    for part, fit in zip(parts, fits, strict=True):
        tests.append(fit.test())
        if not tests[-1].passed:
            tests.append(part.cause(fit, setup, recording))
    warnings += [note for p in parts for note in p.notes()]
    dropped = [name for p in parts for name in p.dropped()]
    if dropped:
        tests.append(undetermined_test(dropped))
    result = _calibration(recording, parts, shared, tests, warnings, stretches, dropped)
    dof = sum(fit.dof for fit in fits)
    return replace(result, chi2_per_dof=sum(fit.chi2 for fit in fits) / max(dof, 1), dof=dof)


def _sensors(recording: Recording, setup: Setup, name: str | None) -> list[Sensor]:
    """The recorded sensors, or the named one."""
    used = [s for s in setup.sensor if recording.has(s) and name in (None, s.name)]
    if used:
        return used
    found = name or ", ".join(s.name for s in setup.sensor)
    raise TiltcalError(
        f"method {NAME}", found=f"no columns of {found}", need="a sensor", do="name another"
    )


def _channels_tested(
    recording: Recording, setup: Setup, sensor: Sensor, stretches: Sequence[Segment]
) -> list[Test]:
    """Whether the channels of a sensor measure, and their means are not spoilt by outliers."""
    poses = find_poses(recording, setup, sensor, stretches)
    return [*data_tests(recording, sensor, temperature=True), *outlier_tests(recording, poses)]


def _smoothing(time: Array, temperature: Array) -> float:
    """Time constant of a first-order low-pass that takes the noise of the temperature down to what
    is resolved, s; it delays the temperature, so it is as short as it can be.
    """
    step = float(np.median(np.diff(time)))
    excess = second_difference_noise(temperature) / (RESOLVED * float(np.ptp(temperature)))
    return float(min(step / 2 * excess**2 if excess > 1 else 0.0, LONGEST * np.ptp(time)))


@dataclass(frozen=True)
class SensorFit:
    """One sensor over temperature.

    Args:
        sensor: which; blocks: of its readings.
        tried: every model with its held-out errors.
        choice: the one that is taken.
        scale: half the range of temperature, degC.
        known: whether the constant is the bias: the force that acts is known.
    """

    sensor: Sensor
    blocks: Blocks
    tried: Sequence[Choice]
    choice: Choice
    scale: float
    known: bool

    def under(self, memory: Memory) -> "SensorFit":
        """With the best model of that memory."""
        own = [c for c in self.tried if c.model.memory == memory]
        return SensorFit(
            self.sensor, self.blocks, self.tried, smallest(own), self.scale, self.known
        )

    def left(self) -> tuple[Array, int]:
        """Residual of each block, SI, (n, k), and how many parameters were fitted to them."""
        found = estimate(self.choice, self.blocks)
        return found.residuals, found.rank

    def cause(self, fit: BlockFit, setup: Setup, recording: Recording) -> Test:
        """The cause of a misfit. fit: how well the blocks were fitted."""
        name = f"cause of {self.sensor.name}"
        # of a thermometer only then: a constant soak is no fault
        column = str(recording.channel("temperature"))
        stuck = standing_still(Channel(column, recording.column(column)), recording.time)
        if stuck is not None:
            return threshold_test(name, 1, False, stuck.statement)
        left, design = self.left()[0], self.choice.design
        misfit = misfit_of_blocks(self.sensor, setup, self.blocks, fit, left, design)
        return cause_test(misfit.explanations(), recording.source, name)

    def heldout_test(self) -> Test:
        """Do blocks that were left out fit as those that were not?"""
        left = estimate(self.choice, self.blocks).left
        ratio = float(np.mean(self.choice.heldout**2 / np.maximum(np.mean(left**2, axis=0), 1e-30)))
        words = (
            f"{self.sensor.name}: {self.choice.model.words()}; readings left out have"
            f" {np.sqrt(ratio):.3g} times the residual of those fitted ({_sizes(self)})"
        )
        return threshold_test(f"held out, {self.sensor.name}", ratio, ratio <= OVERFIT, words)

    def notes(self) -> list[str]:
        """What a polynomial alone leaves, and what one attitude cannot tell."""
        plain = smallest([c for c in self.tried if c.model.memory.kind == "none"])
        notes = []
        if self.choice.model.memory.kind != "none":
            before = SensorFit(self.sensor, self.blocks, (), plain, self.scale, self.known)
            notes.append(
                f"{self.sensor.name}: a polynomial of temperature alone (order {plain.model.bias})"
                f" leaves {_sizes(before)} of readings left out, with a"
                f" {self.choice.model.memory.words()} {_sizes(self)}"
            )
        if self.blocks.force is None:
            notes.append(
                f"{self.sensor.name}: scale and cross-axis terms over temperature need several"
                " known attitudes; here they are part of the bias"
            )
        return notes

    def dropped(self) -> list[str]:
        """Names of the parameters that the blocks do not determine."""
        fits, design = estimate(self.choice, self.blocks).channels, self.choice.design
        return [n for i, fit in enumerate(fits) for n in names(self.sensor, i, design, fit.dropped)]

    def parameters(self) -> tuple[dict[str, Estimate], list[Array], Array]:
        """Estimates by name, the covariance of each channel, SI, (p, p), and what one standard
        uncertainty of each reference changes, (all p, q).
        """
        design, found = self.choice.design, dict[str, Estimate]()
        blocks, changes = [], []
        for i, fit in enumerate(estimate(self.choice, self.blocks).channels):
            powers = np.maximum(design.power[fit.keep], 0)
            force = np.where(design.axis[fit.keep] >= 0, G0, 1.0)
            factor = 1 / (self.scale**powers * force)
            called = names(self.sensor, i, design, fit.keep)
            kept = [k for k, n in enumerate(called) if self.known or ".bias_" not in n]
            C = fit.covariance * np.outer(factor, factor)
            blocks.append(C[np.ix_(kept, kept)])
            changes.append((fit.contributions * factor[:, None])[kept])
            unit = units(self.sensor, self.choice, fit.keep)
            for k in kept:
                value, sigma = fit.values[k] * factor[k], np.sqrt(max(C[k, k], 0.0))
                found[called[k]] = Estimate(float(value), float(sigma), unit[k])
        return found, blocks, np.concatenate(changes)


def _sizes(part: SensorFit) -> str:
    """Held-out rms of each channel in its own words."""
    if part.sensor.quantity == "rate":
        return ", ".join(f"{np.degrees(v):.3g}" for v in part.choice.heldout) + " deg/s"
    return ", ".join(f"{v / G0 * 1e3:.3g}" for v in part.choice.heldout) + " mg"


def _part(
    recording: Recording,
    setup: Setup,
    sensor: Sensor,
    stretches: Sequence[Segment],
    tried: Sequence[tuple[Memory, TemperatureCourse]],
    reference: float,
    scale: float,
    terms: Sequence[str],
) -> SensorFit:
    """All models of one sensor."""
    blocks, known = blocks_of(recording, setup, sensor, stretches)
    named = [] if sensor.quantity == "rate" else [t for t in terms if t not in LINEAR]
    further = Further.of(named, sensor, setup, blocks)
    found = compared(blocks, tried, reference, scale, further)
    return SensorFit(sensor, blocks, found, smallest(found), scale, known)


def _common_memory(parts: Sequence[SensorFit]) -> Memory:
    """The memory that all sensors share: they sit in one body."""
    kinds = {c.model.memory: 0.0 for p in parts for c in p.tried}
    for memory in kinds:
        kinds[memory] = sum(
            min(c.score for c in p.tried if c.model.memory == memory) for p in parts
        )
    plain = Memory()
    best = min(kinds, key=lambda m: kinds[m])
    spread = sum(min(p.tried, key=lambda c: c.score).spread for p in parts)
    return plain if kinds[plain] <= kinds[best] + spread else best


def _both_ways(course: TemperatureCourse, span: float) -> Test:
    """Was most of the range passed warming and cooling?"""
    edges = np.linspace(course.level.min(), course.level.max(), 21)
    # of means over stretches: the noise of a thermometer goes both ways all the time
    stretches = np.array_split(course.level, min(WAYS, len(course.level)))
    level = np.array([part.mean() for part in stretches])
    place = np.clip(np.digitize(level, edges) - 1, 0, 19)
    noise = second_difference_noise(course.level) / np.sqrt(len(course.level) / len(level))
    change = np.gradient(level)
    way = np.where(np.abs(change) > TREND * noise, np.sign(change), 0.0)
    share = np.array(
        [[np.mean(way[place == k] == w) for w in (1, -1)] for k in range(20) if np.any(place == k)]
    )
    both = float(np.mean(share.min(axis=1) > 0.1))
    words = f"{both:.0%} of the range of {span:.3g} degC was passed warming and cooling"
    ok = both >= BOTH_WAYS
    if not ok:
        words += ": lag and hysteresis cannot be separated from the polynomial; record the way back"
    return threshold_test("warming and cooling", both, ok, words)


def _calibration(
    recording: Recording,
    parts: Sequence[SensorFit],
    shared: dict[str, tuple[float, str]],
    tests: Sequence[Test],
    warnings: Sequence[str],
    stretches: Sequence[Segment],
    dropped: Sequence[str],
) -> Calibration:
    from scipy.linalg import block_diag

    parameters = {f"{SHARED}.{n}": Estimate(v, 0.0, unit) for n, (v, unit) in shared.items()}
    covariances: list[Array] = [np.zeros((len(parameters),) * 2)]
    uncertain = max((p.blocks.references for p in parts), key=lambda r: len(r.owner))
    changes = [np.zeros((len(parameters), len(uncertain.owner)))]
    for part in parts:
        found, blocks, change = part.parameters()
        parameters |= found
        covariances += blocks
        # a sensor that lacks some dwells has none
        changes.append(change if change.size else np.zeros((len(found), len(uncertain.owner))))
    spans = [PoseSpan(s.start, s.end, s.label) for s in stretches]
    return Calibration(
        NAME,
        verdict_of(tests, not dropped),
        parameters,
        block_diag(*covariances),
        "reading = bias + M f + sum_n (T - T0)^n (bias_n + M_n f) + tempmem h",
        "f = (M + sum_n (T - T0)^n M_n)^-1 (reading - bias - sum_n (T - T0)^n bias_n - tempmem h)",
        poses=spans,
        tests=list(tests),
        heldout_rms={p.sensor.name: float(np.sqrt(np.mean(p.choice.heldout**2))) for p in parts},
        warnings=list(warnings),
        provenance=provenance(recording, dropped),
        **split_of(uncertain, list(parameters), np.concatenate(changes)),
    )
