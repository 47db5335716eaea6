"""Faults of the data, found before any physics: they break every fit. Each is reported, and
repaired so that the rest can be seen.

What was repaired: frozen, repeated, clipped and gross values become missing; a wrong unit, sign,
    permutation or sense of
rotation becomes an effect of the scenario, so that the model reads as the file does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.core.quantisation import code_grid, code_width
from tiltcal.diagnosis.conclusions.finding import Finding, Where
from tiltcal.diagnosis.data.channels import (
    CHANCE,
    at_least,
    changed,
    column_values,
    repeat_chance,
    written,
)
from tiltcal.diagnosis.data_quality.stuck_bit import stuck_bit
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.data.faults import DataDuplicate, DataStuck
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.electronics.converter import AdcQuantisation, AdcStuckBit, GyrQuantisation
from tiltcal.effects.sensor.dynamics import AccSaturation, GyrSaturation
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.setup.setup import Sensor


@dataclass(frozen=True)
class Fault:
    """A fault of the data.

    Args:
        effect: what the file does, at its size; it goes into the amended scenario.
        sensors, axes: where.
        interval: s from the first stamp.
        names: ids that could be meant as well, itself first.
        words: what was seen.
        sigma: standard uncertainty of the sizes, by name, SI.
    """

    effect: Effect
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    words: str
    interval: tuple[float, float | None] | None = None
    names: tuple[str, ...] = ()
    sigma: dict[str, float] = field(default_factory=dict)

    @property
    def ids(self) -> set[str]:
        """What it may be."""
        return {self.effect.id, *self.names}

    def finding(self) -> Finding:
        """As a finding."""
        cls = CATALOGUE[self.effect.id]
        parameters = {
            f"{name}{p.suffix}": (value / p.factor, self.sigma.get(name, 0.0) / p.factor)
            for p in cls.parameters
            for name, value in self.effect.values.items()
            if name == p.name or ("{" in p.name and name.startswith(p.name.split("{")[0]))
        }
        return Finding(
            self.effect.id,
            self.names or (self.effect.id,),
            cls.stage,
            self.sensors,
            self.axes,
            Where("sample", None, self.interval),
            parameters,
            CHANCE,
            0.0,
            0.0,
            (),
            self.words,
            "look at the file and at what wrote it",
        )


@dataclass(frozen=True)
class Inspected:
    """Recordings after inspection.

    Args:
        recordings: repaired.
        faults: found; their effects are not in the scenario yet.
        notes: what is no mismatch but worth saying.
    """

    recordings: tuple[Recording, ...]
    faults: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()


def inspect(scenario: Scenario, recordings: Sequence[Recording]) -> Inspected:
    """Look for faults that can be seen in the columns themselves: order of time, frozen, repeated,
    clipped values, coarse codes.
    """
    known = {(e.id, e.sensor) for e in scenario.effects}
    faults: list[Fault] = []
    notes: list[str] = []
    repaired = []
    for recording in recordings:
        recording, words = in_order(recording)
        notes += words
        faults += [f for f in _cut(recording, scenario) if (f.effect.id, None) not in known]
        for sensor in scenario.sensor:
            if not recording.has(sensor):
                continue
            recording, found = _coarse(recording, sensor)
            faults += [
                f for f in found if not f.ids & {id for id, name in known if name == sensor.name}
            ]
            fine = [
                a for a in sensor.axes if all(a not in f.axes for f in found)
            ]  # a coarse code stands still, and ends flat
            if (AdcStuckBit.id, sensor.name) not in known:
                lacking = _lacking_bits(recording, sensor, fine)
                faults, fine = (
                    faults + lacking,
                    [a for a in fine if all(a not in f.axes for f in lacking)],
                )
            for look in (_stuck, _clipped, _repeated):
                recording, found = look(recording, sensor, fine)
                faults += [
                    f
                    for f in found
                    if not f.ids & {id for id, name in known if name == sensor.name}
                ]
        repaired.append(recording)
    return Inspected(tuple(repaired), tuple(_once(faults)), tuple(notes))


def _once(faults: Sequence[Fault]) -> list[Fault]:
    """One fault of a kind and place, though several recordings show it."""
    kept: dict[tuple[str, str | None, tuple[str, ...], tuple[str, ...]], Fault] = {}
    for f in faults:
        kept.setdefault((f.effect.id, f.effect.axis, f.sensors, f.axes), f)
    return list(kept.values())


def in_order(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with stamps that increase: rows that go back or repeat a stamp are left out,
    and it is said.
    """
    time = recording.time
    good = np.isfinite(time)
    highest = np.maximum.accumulate(np.where(good, time, -np.inf))
    keep = good & (time > np.concatenate([[-np.inf], highest[:-1]]))
    lost = int((~keep).sum())
    if lost == 0:
        return recording, []
    row = int(np.argmin(keep)) + 1
    words = (
        f"{recording.source}: {lost} row(s) whose time goes back or repeats, the first at data row"
        f" {row}; they are left out"
    )
    columns = {name: recording.column(name)[keep] for name in recording.column_names}
    labels = None if recording.labels is None else recording.labels[keep]
    return Recording.from_columns(
        time[keep], columns, labels=labels, metadata=recording.metadata, source=recording.source
    ), [words]


def _runs(same: Mask) -> tuple[Index, Index]:
    """First and last index (exclusive) of runs of true in a mask, (m,) each."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    return edges[::2], edges[1::2]


def _stuck(
    recording: Recording, sensor: Sensor, fine: Sequence[str]
) -> tuple[Recording, list[Fault]]:
    """A channel that repeats one value for longer than chance and its codes allow."""
    found = []
    for axis in fine:
        rows, time, values = column_values(recording, sensor, axis)
        if len(values) < 32:
            continue
        first, last = _runs(np.diff(values) == 0)
        runs = np.sort(last - first)
        usual = runs[:-1].sum() / max(
            len(values) - runs[-1:].sum(), 1
        )  # how often it repeats outside the longest run
        p = max(repeat_chance(values), float(usual))
        least = max(5, int(np.ceil(np.log(CHANCE / len(values)) / np.log(np.clip(p, 1e-3, 0.95)))))
        long = [
            (a, b + 1)
            for a, b in zip(first, last, strict=True)
            if b - a >= least and not _at_end(values, values[a])
        ]
        if not long:
            continue
        a, b = max(long, key=lambda run: run[1] - run[0])
        start, length = float(time[a] - recording.time[0]), float(time[b - 1] - time[a])
        effect = DataStuck(
            {"start": start, "length": length},
            sensor.name,
            axis,
            "found",
            seen_in=recording.fingerprint,
        )
        mask = np.zeros(len(values), bool)
        for run in long:
            mask[run[0] + 1 : run[1]] = True
        recording = changed(recording, sensor, axis, rows[mask], np.nan)
        words = (
            f"{sensor.name} {axis} is frozen at one value from {start:.2f} s for {length:.2f} s."
        )
        found.append(Fault(effect, (sensor.name,), (axis,), words, (start, start + length)))
    return recording, found


def _at_end(values: Array, value: float) -> bool:
    """Whether a value is the largest or smallest of all: clipping, not freezing."""
    return bool(value in (values.max(), values.min()))


def _lacking_bits(recording: Recording, sensor: Sensor, fine: Sequence[str]) -> list[Fault]:
    """Channels of a sensor with a bit that is never set, in what the file holds, whatever its zero
    and unit.
    """
    found = []
    for axis in fine:
        rows, _, values = column_values(recording, sensor, axis)
        if repeat_chance(values) > FLAT:
            continue
        codes = written(recording, sensor, axis)[rows]
        if (bit := stuck_bit(codes)) is None:
            continue
        span = float(np.ptp(values))
        bit *= span / float(np.ptp(codes))
        effect = AdcStuckBit({"bit_value": bit}, sensor.name, axis, "found")
        words = (
            f"In {sensor.name} {axis} the bit worth {bit:.4g} (SI) is never set: half of all codes"
            " are missing."
        )
        found.append(
            Fault(effect, (sensor.name,), (axis,), words, sigma={"bit_value": bit**2 / span})
        )
    return found


def _clipped(
    recording: Recording, sensor: Sensor, fine: Sequence[str]
) -> tuple[Recording, list[Fault]]:
    """A channel whose noise ends at its largest or smallest value."""
    found = []
    cls = AccSaturation if sensor.is_accelerometer else GyrSaturation
    for axis in fine:
        rows, _, values = column_values(recording, sensor, axis)
        free = values[
            (values > values.min()) & (values < values.max())
        ]  # most of a recording may be clipped
        if len(free) < 32 or repeat_chance(free) > FLAT:
            continue
        noise = noise_of(free)
        limits = []
        for sign in (1.0, -1.0):
            top = float((sign * values).max())
            there = sign * values >= top - 1e-9 * max(abs(top), 1e-9)
            near = sign * values > top - 4 * noise
            if (
                top > 0
                and there.sum() >= 6
                and there.sum() > 0.3 * near.sum()
                and _in_runs(there)
                and top > 20 * noise
            ):
                limits.append((sign, top, there))
        if not limits:
            continue
        full_scale = min(top for _, top, _ in limits)
        # half of the noise of what lies just below is cut off as well
        mask = np.any([sign * values > top - 4 * noise for sign, top, _ in limits], axis=0)
        effect = cls({"full_scale": full_scale}, sensor.name, axis, "found")
        recording = changed(recording, sensor, axis, rows[mask], np.nan)
        flat = sum(int(t.sum()) for *_, t in limits)
        words = (
            f"{sensor.name} {axis} is clipped at {full_scale:.6g} (SI): {flat} samples without"
            " noise."
        )
        found.append(
            Fault(
                effect,
                (sensor.name,),
                (axis,),
                words,
                sigma={"full_scale": noise / np.sqrt(mask.sum())},
            )
        )
    return recording, found


def _in_runs(mask: Mask) -> bool:
    first, last = _runs(mask)
    return bool(len(first) and (last - first).max() >= 3)


def noise_of(values: Array) -> float:
    """White noise of a column from its second differences, one code at least."""
    second = values[2:] - 2 * values[1:-1] + values[:-2]
    return float(
        max(
            1.4826 * np.median(np.abs(second)) / np.sqrt(6), code_width(values) / np.sqrt(12), 1e-15
        )
    )


def _repeated(
    recording: Recording, sensor: Sensor, fine: Sequence[str]
) -> tuple[Recording, list[Fault]]:
    """Samples that repeat the one before more often than their codes explain."""
    again, expected, columns = [], [], []
    for axis in fine:
        rows, _, values = column_values(recording, sensor, axis)
        columns.append((axis, rows, values))
        again.append(np.concatenate([[False], np.diff(values) == 0]))
        expected.append(min(repeat_chance(values), 1.0))
    hit = [
        k
        for k, (a, p) in enumerate(zip(again, expected, strict=True))
        if len(a) > 64
        and at_least(int(a.sum()), len(a), min(1.5 * p, 1.0)) < CHANCE
        and a.mean() > 1.5 * p + 5e-4
    ]
    if not hit:
        return recording, []
    share = float(np.mean([again[k].mean() - expected[k] for k in hit]))
    for k in hit:
        axis, rows, _ = columns[k]
        recording = changed(recording, sensor, axis, rows[again[k]], np.nan)
    axes = tuple(columns[k][0] for k in hit)
    n = sum(len(again[k]) for k in hit) / len(hit)
    effect = DataDuplicate({"share": share}, sensor.name, None, "found")
    words = (
        f"{100 * share:.2g} % of the samples of {sensor.name} {', '.join(axes)} repeat the one"
        " before exactly."
    )
    return recording, [
        Fault(effect, (sensor.name,), axes, words, sigma={"share": float(np.sqrt(share / n))})
    ]


FLAT = 0.3  # chance of a repeat above which a coarse code is flat everywhere
# code over noise: below it what rounding does is white to exp(-2 (pi / 1.5)^2), a part in 6000
COARSE = 1.5


def _coarse(recording: Recording, sensor: Sensor) -> tuple[Recording, list[Fault]]:
    """Codes that are not small beside the noise; raw codes of a converter that the scenario states
    are no news.
    """
    if sensor.input is not None:
        return recording, []
    found = []
    for axis in sensor.axes:
        _, _, values = column_values(recording, sensor, axis)
        width = code_grid(values) if len(values) >= 64 else None
        spread = _spread_at_rest(values)
        if width is not None and width > COARSE * spread:
            found.append(
                (
                    axis,
                    AdcQuantisation({"lsb": width}, sensor.name, None, "found"),
                    width,
                    spread,
                )
            )
    if not found:
        return recording, []
    still = [
        a for a in sensor.axes if len(np.unique(column_values(recording, sensor, a)[2])) < 3
    ]  # one code all along
    axes = tuple(dict.fromkeys([*(axis for axis, *_ in found), *still]))
    _, effect, width, spread = max(found, key=lambda item: item[2])
    words = (
        f"{sensor.name} {', '.join(axes)} is coded in steps of {width:.4g} (SI), not small beside"
        " its noise."
    )
    names: tuple[str, ...] = (AdcQuantisation.id,)
    if not sensor.is_accelerometer:
        names, words = (
            (*names, GyrQuantisation.id),
            f"{words[:-1]}: by its own output or by the converter behind it.",
        )
    return recording, [
        Fault(effect, (sensor.name,), axes, words, names=names, sigma={"lsb": 1e-3 * width})
    ]


CUT = (
    0.002  # deg: no encoder that is worth a calibration has coarser steps, and no noise hides them
)


def _cut(recording: Recording, scenario: Scenario) -> list[Fault]:
    """A readout of the table that was written with too few decimals."""
    found = []
    for axis in scenario.rig.axis_names:
        angle = recording.table(axis)
        if angle is None:
            continue
        angle = angle[~np.isnan(angle)]
        step = code_grid(angle) if len(angle) >= 64 else None
        if step is None or step < np.radians(CUT):
            continue
        counts = angle / step
        if np.abs(counts - np.rint(counts)).max() < 0.03 and len(np.unique(np.rint(counts))) > 64:
            effect = DataTruncation({"step": step}, None, axis, "found")
            names = tuple(s.name for s in scenario.sensor)
            words = f"The {axis} angle is written in steps of {np.degrees(step):.4g} deg."
            found.append(
                Fault(
                    effect,
                    names[:1],
                    tuple(scenario.sensor[0].axes),
                    words,
                    sigma={"step": 1e-3 * step},
                )
            )
    return found


def _spread_at_rest(values: Array) -> float:
    """Standard deviation over sixteen samples where they are quiet, SI: the noise, if the table
    rests a fifth of the time.

    What stands at the largest or smallest value of all may be clipped, the longest stretch of one
        value frozen: both are left
    out, where anything else is left.
    """
    first, last = _runs(np.diff(values) == 0)
    if len(first):
        k = int(np.argmax(last - first))
        rest = np.concatenate([values[: first[k]], values[last[k] + 1 :]])
        values = rest if len(rest) > len(values) // 4 else values
    inside = values[(values < values.max()) & (values > values.min())]
    values = inside if len(inside) > max(len(values) // 4, 32) else values
    blocks = values[: len(values) // 16 * 16].reshape(-1, 16)
    return float(np.quantile(blocks.std(axis=1), 0.2)) if len(blocks) else float(values.std())
