"""Noise of each channel in the longest standstill of a recording."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.numerical import determining
from tiltcal.core.progress import Progress, report_pieces, silent
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.data_quality.check import Finding
from tiltcal.recordings.pieces import estimated_rows, part_of, read_pieces
from tiltcal.recordings.quality import inspect_recording, with_repaired_readings
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.span_means import averaging_note, read_averaged, require_memory, spans_of
from tiltcal.setup.tables import axis_of
from tiltcal.statistics.allan import DENSE, LEAST, RunningAllan, allan_deviation
from tiltcal.statistics.goodness_of_fit import NeighbourCounts
from tiltcal.statistics.standstill_noise import StandstillNoise, fit_noise
from tiltcal.statistics.standstill_spectrum import RunningSpectrum, StandstillSpectrum

LEAST_SQUARE = 1e-60  # of all changes together: the powers of smaller ones are no numbers
NOISY = ("acceleration", "angle", "rate", "raw")  # quantities of a sensor's columns


@dataclass(frozen=True)
class RestNoise:
    """Noise of the channels of a recording at rest.

    Args:
        models: column -> noise.
        left_out: column -> why it has none.
        findings: faults of the data; a long recording is not inspected.
    """

    models: dict[str, StandstillNoise]
    left_out: dict[str, str]
    findings: tuple[Finding, ...] = ()


class _RunningNoise:
    """What the noise of a long channel is found from, piece by piece.

    Args:
        samples: that are expected.
        rate_hz: of the samples.
    """

    def __init__(self, samples: int, rate_hz: float) -> None:
        self._rate = rate_hz
        self._allan = RunningAllan(samples)
        self._spectrum = RunningSpectrum(samples, rate_hz)
        self.counts = NeighbourCounts.none()

    def add(self, values: Array) -> None:
        """Go on with further values, (n,)."""
        self._allan.add(values)
        self._spectrum.add(values)
        self.counts += NeighbourCounts.of(values)

    def fitted(self) -> StandstillNoise:
        """The noise of all values so far."""
        curve = self._allan.deviation(self._rate)
        return fit_noise(self._spectrum.spectrum(), curve, self.counts)


def rest_noise_of(path: Path | str, progress: Progress = silent) -> RestNoise:
    """The noise of each sensor channel of a file.

    A long recording is read in pieces, twice: its standstills are found in averages over spans of
    time, the Allan deviation and the spectrum are those of its samples, and a note states it.

    Args:
        path: of the recording.
        progress: callback, receives the share of a long one that was read.

    Raises:
        TiltcalError: there is no sensor channel, no standstill, or no noise in any channel.
    """
    if spans_of(path) is None:
        require_memory(path)
        return rest_noise(read_recording(path).require_increasing())
    recording = read_averaged(path, progress)
    names, longest = _channels(recording), _longest(recording)
    running: dict[str, _RunningNoise] = {}
    for piece in _between(path, longest.start, longest.end, progress):
        for name in names:
            known = ~np.isnan(values := piece.column(name))
            if name not in running and known.sum() > 1:
                rate = _rate(piece.time[known])
                running[name] = _RunningNoise(int((longest.end - longest.start) * rate), rate)
            if name in running and known.any():
                running[name].add(values[known])
    notes = (_how_it_was_read(recording),)
    counts = {name: NeighbourCounts.none() for name in names}
    left_out = _without_noise(counts | {name: r.counts for name, r in running.items()})
    models = {
        name: replace(_fitted(recording.source, name, found.fitted), notes=notes)
        for name, found in running.items()
        if name not in left_out
    }
    return _require_one(recording.source, models, left_out)


def _how_it_was_read(recording: Recording) -> str:
    return (
        f"{averaging_note(recording)} to find its standstills; the Allan deviation and the spectrum"
        f" are those of all samples, the deviation beyond averaging times of {DENSE} samples from"
        f" at most {DENSE} second differences within each"
    )


def rest_noise(recording: Recording) -> RestNoise:
    """The noise of each sensor channel in the longest standstill.

    Raises:
        TiltcalError: there is no sensor channel, no standstill, or no noise in any channel.
    """
    names, longest = _channels(recording), _longest(recording)
    inspection = inspect_recording(recording)
    rows = slice(longest.first, longest.last)
    left_out = _without_noise(_counts(recording, names, rows))
    recording = with_repaired_readings(recording, inspection)
    counts = _counts(recording, [n for n in names if n not in left_out], rows)
    left_out |= _without_noise(counts)
    columns = {name: recording.column(name)[rows] for name in counts}
    known = {name: ~np.isnan(column) for name, column in columns.items()}
    values = {name: column[known[name]] for name, column in columns.items()}
    models = {}
    for name in [n for n in counts if n not in left_out]:
        rate = _rate(recording.time[rows][known[name]])
        fit = partial(_noise_of, values[name], rate, counts[name])
        models[name] = _fitted(recording.source, name, fit)
    return replace(_require_one(recording.source, models, left_out), findings=inspection.findings)


def _noise_of(values: Array, rate_hz: float, counts: NeighbourCounts) -> StandstillNoise:
    spectrum = StandstillSpectrum.of(values, rate_hz)
    return fit_noise(spectrum, allan_deviation(values, rate_hz), counts)


def _counts(recording: Recording, names: Sequence[str], rows: slice) -> dict[str, NeighbourCounts]:
    """How often the readings of each column change within some rows."""
    columns = {name: recording.column(name)[rows] for name in names}
    return {name: NeighbourCounts.of(c[~np.isnan(c)]) for name, c in columns.items()}


def _without_noise(counts: Mapping[str, NeighbourCounts]) -> dict[str, str]:
    """Channel -> why it is left out."""
    found = {}
    for name, each in counts.items():
        if each.pairs + 1 < LEAST:
            found[name] = f"fewer than {LEAST} readings"
        elif each.square_sum < LEAST_SQUARE:
            found[name] = "its reading never changes: dead or frozen"
        elif each.changes < LEAST:
            found[name] = f"its reading changes {each.changes} times only: dead or frozen"
    return found


def _require_one(
    source: str, models: dict[str, StandstillNoise], left_out: dict[str, str]
) -> RestNoise:
    """All channels, where one has noise.

    Raises:
        TiltcalError: none has.
    """
    if not models:
        reasons = "; ".join(f"{name}: {why}" for name, why in left_out.items())
        raise TiltcalError(
            source,
            found=f"no channel with noise ({reasons})",
            need=f"one with {LEAST} readings or more that change",
            do="record the instrument switched on, at its full resolution",
        )
    return RestNoise(models, left_out)


def _channels(recording: Recording) -> list[str]:
    """The columns of sensors.

    Raises:
        TiltcalError: there is none.
    """
    found = [
        name
        for name in recording.column_names
        if COLUMN_UNITS[split_unit(name)[1] or "s"].quantity in NOISY and axis_of(name) is None
    ]
    if not found:
        raise TiltcalError(
            recording.source,
            found="no sensor column",
            need="one at rest",
            do="name columns <sensor>_<axis>_<unit>",
        )
    return found


def _longest(recording: Recording) -> Segment:
    """The longest dwell."""
    found = dwells(find_segments(recording))
    if not found:
        raise TiltcalError(
            recording.source,
            found="no standstill",
            need="a recording at rest",
            do="record the instrument at rest",
        )
    return max(found, key=lambda s: s.end - s.start)


def _between(path: Path | str, start: float, end: float, progress: Progress) -> Iterator[Recording]:
    """The pieces of a file between two stamps, s."""
    for piece in report_pieces(read_pieces(path), estimated_rows(path), progress):
        first, last = np.searchsorted(piece.time, [start, end], side="left")
        if last > first:
            yield part_of(piece, int(first), int(last))


def _rate(time: Array) -> float:
    """Sample rate of stamps, s, in Hz."""
    return float(1 / np.median(np.diff(time)))


def _fitted(source: str, name: str, fit: Callable[[], StandstillNoise]) -> StandstillNoise:
    """The noise of one column."""
    with determining(f"{source}, column {name}", "its noise"):
        return fit()
