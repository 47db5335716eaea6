"""Faults that can be seen in the columns themselves, and recordings without them."""

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.data_quality.check import Finding
from tiltcal.data_quality.stamps import faults_of_order
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.readout_faults import held_readout, truncated_angles
from tiltcal.effects.base import Effect
from tiltcal.effects.data.faults import DataDuplicate, DataStuck
from tiltcal.effects.electronics.converter import AdcQuantisation, AdcStuckBit, GyrQuantisation
from tiltcal.effects.sensor.dynamics import AccSaturation, GyrSaturation
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.quality import inspect_recording, with_repaired_readings
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.samples import si_values
from tiltcal.setup.sensor import Sensor


@dataclass(frozen=True)
class Inspected:
    """Recordings after inspection.

    Args:
        recordings: repaired.
        faults: found; their effects are not in the scenario yet.
        stated: found as well, but the scenario has them.
        notes: what is no mismatch but worth saying.
        left_out: rows that were left out because their stamps do not increase.
    """

    recordings: tuple[Recording, ...]
    faults: tuple[Fault, ...] = ()
    stated: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple["LeftOut", ...] = ()


@dataclass(frozen=True)
class LeftOut:
    """Rows that are left out because their stamps do not increase.

    Args:
        row: of the file, the first; count: how many.
        out_of_order: of them those whose time is out of order, and does not only repeat.
        source: of the recording.
        statement: of the first finding of the stamps.
    """

    row: int
    count: int
    out_of_order: int
    source: str
    statement: str

    @property
    def words(self) -> str:
        """As a note, or what is said of a finding."""
        return (
            f"{self.source}: {self.statement}; {self.count} row(s) are left out, the first of them"
            f" data row {self.row}"
        )


def inspect(scenario: Scenario, recordings: Sequence[Recording]) -> Inspected:
    """Look for faults that can be seen in the columns themselves, and repair them.

    What the catalogue has an effect for is a fault; the other findings are notes.
    """
    faults: list[Fault] = []
    notes: list[str] = []
    left_out: list[LeftOut] = []
    repaired = []
    for recording in recordings:
        if ignored := recording.ignored_columns(scenario.sensor):
            notes.append(f"{recording.source}: {ignored}")
        recording, rows = in_order(recording)
        left_out += rows
        faults += [*truncated_angles(recording, scenario), *held_readout(recording, scenario)]
        sensors = [s for s in scenario.sensor if recording.has(s)]
        inspection = inspect_recording(recording, sensors)
        for finding in inspection.findings:
            fault = fault_of(finding, recording, sensors)
            if fault is None:
                notes.append(f"{recording.source}: {finding.statement}")
            else:
                faults.append(fault)
        repaired.append(with_repaired_readings(recording, inspection))
    known = {(e.id, e.sensor) for e in scenario.effects}
    new = [f for f in faults if not {(id, f.effect.sensor) for id in f.ids} & known]
    stated = [f for f in faults if f not in new]
    return Inspected(
        tuple(repaired), tuple(once(new)), tuple(once(stated)), tuple(notes), tuple(left_out)
    )


def fault_of(finding: Finding, recording: Recording, sensors: Sequence[Sensor]) -> Fault | None:
    """The fault that a finding is, as an effect of the catalogue; None where it has none."""
    place = {recording.channel(f"{s.name}_{axis}"): (s, axis) for s in sensors for axis in s.axes}
    if finding.column not in place or finding.kind not in EFFECTS:
        return None
    sensor, axis = place[finding.column]
    if finding.kind == "coarse" and sensor.input is not None:
        return None  # raw codes of a stated converter
    effect, interval = EFFECTS[finding.kind](finding, recording, sensor, axis)
    names: tuple[str, ...] = ()
    if isinstance(effect, AdcQuantisation) and not sensor.is_accelerometer:
        names = (AdcQuantisation.id, GyrQuantisation.id)
    axes = tuple(place[c][1] for c in finding.columns)
    sigma = {n: _size(v, n, sensor, finding.column) for n, v in finding.sigma.items()}
    words = f"{finding.statement}."
    return Fault(effect, (sensor.name,), axes, words, interval, names, sigma)


def _size(value: float, name: str, sensor: Sensor, column: str) -> float:
    """A size in the unit of a column, SI; a share is one as it is."""
    if name == "share":
        return value
    unit = str(split_unit(column)[1])
    if sensor.input is not None and unit == sensor.input.unit:
        return abs(value / sensor.input.slope)
    return value * COLUMN_UNITS[unit].factor


Interval = tuple[float, float | None] | None


def _stuck(
    finding: Finding, recording: Recording, sensor: Sensor, axis: str
) -> tuple[Effect, Interval]:
    begin = float(recording.time[0])
    start, length = finding.size.get("start", begin) - begin, finding.size.get("length")
    length = float(np.ptp(recording.time)) if length is None else length
    effect = DataStuck(
        {"start": start, "length": length},
        sensor.name,
        axis,
        "found",
        seen_in=recording.fingerprint,
    )
    return effect, (start, start + length)


def _clipped(
    finding: Finding, recording: Recording, sensor: Sensor, axis: str
) -> tuple[Effect, Interval]:
    full_scale = np.array([[finding.size["full_scale"]]])
    limit = abs(float(si_values(sensor, [finding.column], full_scale, recording.source)[0, 0]))
    cls = AccSaturation if sensor.is_accelerometer else GyrSaturation
    return cls({"full_scale": limit}, sensor.name, axis, "found"), None


def _sized(
    cls: type[Effect], name: str, own_axis: bool
) -> Callable[[Finding, Recording, Sensor, str], tuple[Effect, Interval]]:
    def make(
        finding: Finding, recording: Recording, sensor: Sensor, axis: str
    ) -> tuple[Effect, Interval]:
        del recording
        size = _size(finding.size[name], name, sensor, finding.column)
        return cls({name: size}, sensor.name, axis if own_axis else None, "found"), None

    return make


EFFECTS = {
    "dead": _stuck,
    "frozen": _stuck,
    "clipped": _clipped,
    "repeated": _sized(DataDuplicate, "share", False),
    "stuck_bit": _sized(AdcStuckBit, "bit_value", True),
    "coarse": _sized(AdcQuantisation, "lsb", False),
}
"""What a finding is in the catalogue, by the name of its check."""


def by_recording(left_out: Sequence[LeftOut]) -> list[LeftOut]:
    """Rows that were left out, those of one recording together: a long one is read in pieces."""
    found: dict[str, LeftOut] = {}
    for rows in left_out:
        first = found.setdefault(rows.source, replace(rows, count=0, out_of_order=0))
        found[rows.source] = replace(
            first,
            count=first.count + rows.count,
            out_of_order=first.out_of_order + rows.out_of_order,
        )
    return list(found.values())


def once(faults: Sequence[Fault]) -> list[Fault]:
    """One fault of each kind and place, though several recordings show it."""
    kept: dict[tuple[str, str | None, tuple[str, ...], tuple[str, ...]], Fault] = {}
    for f in faults:
        kept.setdefault((f.effect.id, f.effect.axis, f.sensors, f.axes), f)
    return list(kept.values())


def in_order(
    recording: Recording, last: float = -np.inf, before: int = 0
) -> tuple[Recording, list[LeftOut]]:
    """The recording with increasing stamps: the longest sequence of rows that has them, so that one
    stamp too large does not cost all that follow it; and the rows that are left out, if any are.

    Args:
        recording: as it was read.
        last: the latest stamp before these rows, s.
        before: rows before them.
    """
    time = recording.time
    later = np.isfinite(time) & (time > last)
    keep = later.copy()
    keep[later] = _increasing(time[later])
    count = int((~keep).sum())
    if count == 0:
        return recording, []
    before_it = np.maximum.accumulate(np.where(keep, time, last))
    wrong = int((~keep & np.isfinite(time) & (time != before_it)).sum())
    faults = faults_of_order(time, before, last)
    words = faults[0].statement if faults else "time_s: a stamp is missing"
    rows = LeftOut(before + int(np.argmin(keep)) + 1, count, wrong, recording.source, words)
    columns = {name: recording.column(name)[keep] for name in recording.column_names}
    labels = None if recording.labels is None else recording.labels[keep]
    return Recording.from_columns(
        time[keep],
        columns,
        labels=labels,
        extra={name: texts[keep] for name, texts in recording.extra.items()},
        metadata=recording.metadata,
        source=recording.source,
        origin=recording.fingerprint,
    ), [rows]


def _increasing(time: Array) -> Mask:
    """The rows of the longest strictly increasing subsequence (patience sorting: Fredman, Discrete
    Math. 11, 1975); of equal stamps the first. time: (n,).
    """
    if np.all(np.diff(time) > 0):
        return np.ones(len(time), bool)
    ends: list[float] = []  # the least stamp at which a subsequence of each length ends
    row: list[int] = []  # where that is
    earlier: list[int] = []  # the row before each row, in the longest subsequence that ends there
    for k, t in enumerate(time.tolist()):
        place = bisect_left(ends, t)
        earlier.append(row[place - 1] if place else -1)
        if place == len(ends):
            ends.append(t)
            row.append(k)
        elif t < ends[place]:
            ends[place], row[place] = t, k
    keep, k = np.zeros(len(time), bool), row[-1] if row else -1
    while k >= 0:
        keep[k], k = True, earlier[k]
    return keep
