"""Faults that can be seen in the columns themselves, and recordings without them."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array, Mask
from tiltcal.diagnosis.data_quality.coarse_codes import coarse_codes, truncated_angles
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.data_quality.flat_and_repeated import (
    clipped_values,
    lacking_bits,
    repeated_samples,
    stuck_values,
)
from tiltcal.diagnosis.data_quality.held_readout import held_readout
from tiltcal.effects.electronics.converter import AdcStuckBit
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording


@dataclass(frozen=True)
class Inspected:
    """Recordings after inspection.

    Args:
        recordings: repaired.
        faults: found; their effects are not in the scenario yet.
        notes: what is no mismatch but worth saying.
        left_out: rows that were left out because their stamps do not increase.
    """

    recordings: tuple[Recording, ...]
    faults: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple["LeftOut", ...] = ()


@dataclass(frozen=True)
class LeftOut:
    """Rows that are left out because their stamps do not increase.

    Args:
        row: of the file, the first; count: how many.
        out_of_order: of them those whose time is out of order, and does not only repeat.
        source: of the recording.
    """

    row: int
    count: int
    out_of_order: int
    source: str

    @property
    def words(self) -> str:
        """As a note, or what is said of a finding."""
        what = "is out of order" if self.out_of_order else "repeats or is missing"
        return (
            f"{self.source}: {self.count} row(s) whose time {what}, the first at data row"
            f" {self.row}; they are left out"
        )


def inspect(scenario: Scenario, recordings: Sequence[Recording]) -> Inspected:
    """Look for faults that can be seen in the columns themselves: order of time, frozen, repeated,
    clipped values, coarse codes.
    """
    known = {(e.id, e.sensor) for e in scenario.effects}
    faults: list[Fault] = []
    notes: list[str] = []
    left_out: list[LeftOut] = []
    repaired = []
    for recording in recordings:
        if ignored := recording.ignored_columns(scenario.sensor):
            notes.append(f"{recording.source}: {ignored}")
        recording, rows = in_order(recording)
        left_out += rows
        of_readout = (*truncated_angles(recording, scenario), *held_readout(recording, scenario))
        faults += [f for f in of_readout if (f.effect.id, None) not in known]
        for sensor in scenario.sensor:
            if not recording.has(sensor):
                continue
            recording, found = coarse_codes(recording, sensor)
            faults += [
                f for f in found if not f.ids & {id for id, name in known if name == sensor.name}
            ]
            # a coarse code stands still, and ends flat
            fine = [a for a in sensor.axes if all(a not in f.axes for f in found)]
            if (AdcStuckBit.id, sensor.name) not in known:
                lacking = lacking_bits(recording, sensor, fine)
                faults, fine = (
                    faults + lacking,
                    [a for a in fine if all(a not in f.axes for f in lacking)],
                )
            for look in (stuck_values, clipped_values, repeated_samples):
                recording, found = look(recording, sensor, fine)
                faults += [
                    f
                    for f in found
                    if not f.ids & {id for id, name in known if name == sensor.name}
                ]
        repaired.append(recording)
    return Inspected(tuple(repaired), tuple(once(faults)), tuple(notes), tuple(left_out))


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
    rows = LeftOut(before + int(np.argmin(keep)) + 1, count, wrong, recording.source)
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
