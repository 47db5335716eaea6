"""Long recordings on a table, diagnosed as averages over short spans of time.

What averages hide is looked for before, in the samples: frozen, clipped and repeated values and
outliers part by part, spectral lines and faults of every sample in the first part. Where the first
part shows something that averages do not keep, the diagnosis is of the beginning of the recording,
sample by sample.

The mean over a span differs from the reading at the mean angle by the bend of the motion within it.
So the mean residual of a span is taken, against the scenario with its adjustable terms fitted, and
added to what the same model says of the averaged readout.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.progress import Part, Progress, Stages
from tiltcal.diagnosis.data.channels import as_written, undo_labelling_faults
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.inspection import LeftOut, in_order, inspect, once
from tiltcal.diagnosis.data_faults.outliers import find_outliers
from tiltcal.diagnosis.data_faults.prepare import PreparedData, calibrated, prepare
from tiltcal.diagnosis.data_faults.units_signs_axes import find_labelling_faults
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.electronics.converter import AdcQuantisation, AdcStuckBit
from tiltcal.effects.timing.delays import DataJitter
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.fingerprint import fingerprint_of
from tiltcal.recordings.pieces import estimated_rows, joined, part_of, read_pieces
from tiltcal.recordings.recording import Recording, is_reading
from tiltcal.recordings.span_means import (
    LONGEST,
    Spans,
    averaged,
    averaging_note,
    whole_spans,
)
from tiltcal.recordings.table_standstills import forget_replays
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.noise_spectrum import WhiteFlickerWalk

AVERAGES = 250_000  # that are left of a recording, at most
PART = 100_000  # rows that are held sample by sample
AVERAGING, RESIDUALS = "averaging", "averaging residuals"
SHARES = {AVERAGING: 14, RESIDUALS: 86}  # of the time, per cent, measured
OF_SAMPLES = (AdcQuantisation, AdcStuckBit, DataJitter, DataTruncation)
"""Faults that every sample tells, and no average."""


@dataclass(frozen=True)
class LongRecording:
    """What is diagnosed in place of a long recording.

    Args:
        recording: averages over spans, or its beginning, sample by sample.
        faults: of its samples that were found and repaired.
        left_out: rows that were left out because their stamps do not increase.
        said: how it was read, where not sample by sample.
    """

    recording: Recording
    faults: tuple[Fault, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    said: str = ""


def read_long(
    path: Path,
    scenario: Scenario,
    spans: Spans,
    kept: Callable[[PreparedData, int], bool],
    progress: Progress,
) -> LongRecording:
    """What is diagnosed in place of a long recording on a table.

    Args:
        path: of the recording.
        scenario: what is known of it.
        spans: to average over.
        kept: whether averages over so many samples keep every spectral line.
        progress: is told what is being done.

    Raises:
        TiltcalError: as ``read_pieces`` does, or a column is missing.
    """
    first = joined(list(islice(_parts(path, spans, []), 1)))
    prepared = prepare(scenario, [first])
    if any(isinstance(f.effect, OF_SAMPLES) for f in prepared.faults) or not kept(
        prepared, spans.samples
    ):
        return read_beginning(path, f"what they show would be lost in averages over {spans.text}")
    stages, rows = Stages(progress, SHARES), estimated_rows(path)
    left_out: list[LeftOut] = []
    stages.begin(AVERAGING)
    read = _told(_parts(path, spans, left_out), rows, stages.part)
    raw = joined([averaged(part, spans) for part in read])
    meant = find_labelling_faults(scenario, raw)
    stages.begin(RESIDUALS)
    sought = _Model(scenario, tuple(meant), raw)
    parts = [
        sought.averaged_residuals(part, spans)
        for part in _told(_parts(path, spans, []), rows, stages.part)
        if _was_read(part, scenario)
    ]
    whole = sought.with_model(joined([recording for recording, _ in parts]))
    whole = replace(whole, origin=_fingerprint(path))
    forget_replays()  # of the parts
    faults = once([*meant, *(f for _, found in parts for f in found)])
    return LongRecording(whole, tuple(faults), tuple(left_out), averaging_note(raw) or "")


def _told(parts: Iterable[Recording], rows: int, part: Part) -> Iterator[Recording]:
    """The same parts; ``part`` is told what part of the rows they are."""
    read = 0
    for one in parts:
        yield one
        read += len(one)
        part(min(read / rows, 1.0))


def _was_read(part: Recording, scenario: Scenario) -> bool:
    """Whether each axis of the table was read in a part: without it nothing has a model."""
    angles = (part.table(axis) for axis in scenario.rig.axis_names)
    return all(angle is not None and not np.isnan(angle).all() for angle in angles)


def _fingerprint(path: Path) -> str:
    """That of the recording as it is in the file."""
    pieces = read_pieces(path, ordered=False)
    first = next(pieces)
    readings = {n: first.column(n) for n in first.column_names if is_reading(n)}
    return fingerprint_of(chain([first.time], (p.time for p in pieces)), readings)


def read_beginning(path: Path, why: str) -> LongRecording:
    """The beginning of a recording, sample by sample: as many rows as are taken so.

    Args:
        path: of the recording.
        why: the rest is left out, in words.

    Raises:
        TiltcalError: as ``read_pieces`` does.
    """
    left_out: list[LeftOut] = []
    pieces, kept = _onward(read_pieces(path, ordered=False), left_out), list[Recording]()
    while sum(len(p) for p in kept) <= LONGEST and (piece := next(pieces, None)) is not None:
        kept.append(piece)
    recording = joined(kept)
    if len(recording) <= LONGEST:
        return LongRecording(recording, (), tuple(left_out))
    recording = part_of(recording, 0, LONGEST)
    words = (
        f"{recording.source}: only the first {np.ptp(recording.time):.6g} s were read, sample by"
        f" sample: {why}"
    )
    return LongRecording(recording, (), tuple(left_out), words)


def _parts(path: Path, spans: Spans, left_out: list[LeftOut]) -> Iterator[Recording]:
    """Parts of a file that end where a span ends, of about ``PART`` rows; rows whose time is out
    of order are left out, and told.
    """
    return whole_spans(_onward(read_pieces(path, ordered=False), left_out), spans, PART)


def _onward(pieces: Iterable[Recording], left_out: list[LeftOut]) -> Iterator[Recording]:
    """Pieces without the rows whose time is out of order, which are added to those left out."""
    last, rows = -np.inf, 0
    for piece in pieces:
        sound, out = in_order(piece, last, rows)
        left_out += out
        rows += len(piece)
        if len(sound):
            last = float(sound.time[-1])
            yield sound


class _Model:
    """The scenario's table and sensors, with the adjustable terms fitted to averages of a
    recording. Known effects are left out: they hardly bend a motion, and some begin with the
    recording.

    Args:
        scenario: what is known; meant: what its columns mean.
        recording: averages, as written.
    """

    def __init__(self, scenario: Scenario, meant: tuple[Fault, ...], recording: Recording) -> None:
        self._scenario = scenario
        self._meant = [*scenario.effects, *(f.effect for f in meant)]
        observations = self._observed(undo_labelling_faults(recording, scenario, self._meant))
        self._fitted = calibrated(observations, WhiteFlickerWalk)[0]

    def averaged_residuals(self, part: Recording, spans: Spans) -> tuple[Recording, list[Fault]]:
        """The residuals of a part in place of its readings, averaged; and the faults of its
        samples, which are left out.
        """
        inspected = inspect(self._scenario, [part])
        sound = undo_labelling_faults(inspected.recordings[0], self._scenario, self._meant)
        observations = self._observed(sound)
        wild, mended = find_outliers(observations, self._fitted)
        if mended[0] is not sound:
            observations = self._observed(mended[0])
        predicted = observations.predict(self._fitted.effects)
        residuals = self._changed(observations, [-p for p in predicted])
        return averaged(residuals, spans), [*inspected.faults, *wild]

    def with_model(self, residuals: Recording) -> Recording:
        """Averaged residuals with what the model says of the averaged readout."""
        observations = self._observed(residuals)
        return self._changed(observations, observations.predict(self._fitted.effects))

    def _observed(self, recording: Recording) -> Observations:
        return observe(self._scenario, [recording])

    def _changed(self, observations: Observations, added: Sequence[Array]) -> Recording:
        """A recording with something added to each channel, SI, (n,) each; none where it has no
        model.
        """
        recording = observations.recordings[0]
        columns = {name: recording.column(name) for name in recording.column_names}
        silent = np.full(len(recording), np.nan)
        for sensor in self._scenario.sensor:
            columns |= dict.fromkeys(_columns(recording, sensor).values(), silent)
        for channel, more in zip(observations.channels, added, strict=True):
            sensor = self._scenario.named(channel.sensor)
            name = _columns(recording, sensor)[channel.axis]
            columns[name] = silent.copy()
            columns[name][channel.rows] = recording.column(name)[channel.rows] + as_written(
                more, sensor, name
            )
        return recording.rewritten(columns)


def _columns(recording: Recording, sensor: Sensor) -> dict[str, str]:
    """The columns of a sensor by axis, where it has them."""
    found = {axis: recording.channel(f"{sensor.name}_{axis}") for axis in sensor.axes}
    return {axis: name for axis, name in found.items() if name is not None}
