"""Allan coefficients of each channel from the longest standstill of a recording."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.numerical import determining
from tiltcal.core.progress import Progress, report_pieces, silent
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.pieces import estimated_rows, part_of, read_pieces
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.segmentation import Segment, dwells, find_segments
from tiltcal.recordings.span_means import averaging_note, read_averaged, require_memory, spans_of
from tiltcal.setup.tables import axis_of
from tiltcal.statistics.allan import (
    DENSE,
    AllanDeviation,
    NoiseModel,
    RunningAllan,
    allan_deviation,
    fit_noise,
)

NOISY = ("acceleration", "angle", "rate", "raw")  # quantities of a sensor's columns


def noise_models_of(path: Path | str, progress: Progress = silent) -> dict[str, NoiseModel]:
    """The noise model of each sensor channel of a file.

    A long recording is read in pieces, twice: its standstills are found in averages over spans of
    time, the Allan deviation is that of its samples, and a note of each model states it.

    Args:
        path: of the recording.
        progress: callback, receives the share of a long one that was read.

    Raises:
        TiltcalError: there is no sensor channel, or no standstill.
    """
    if spans_of(path) is None:
        require_memory(path)
        return noise_models(read_recording(path).require_increasing())
    recording = read_averaged(path, progress)
    names, longest = _channels(recording), _longest(recording)
    running: dict[str, RunningAllan] = {}
    rates: dict[str, float] = {}
    for piece in _between(path, longest.start, longest.end, progress):
        for name in names:
            known = ~np.isnan(values := piece.column(name))
            if name not in running and known.sum() > 1:
                rates[name] = _rate(piece.time[known])
                running[name] = RunningAllan(int((longest.end - longest.start) * rates[name]))
            if name in running:
                running[name].add(values[known])
    curves = {name: found.deviation(rates[name]) for name, found in running.items()}
    notes = (_how_it_was_read(recording),)
    return {
        name: replace(_fitted(recording.source, name, curve), notes=notes)
        for name, curve in curves.items()
    }


def _how_it_was_read(recording: Recording) -> str:
    return (
        f"{averaging_note(recording)} to find its standstills; the Allan deviation is that of all"
        f" samples, beyond averaging times of {DENSE} samples from at most {DENSE} second"
        " differences within each"
    )


def noise_models(recording: Recording) -> dict[str, NoiseModel]:
    """The noise model of each sensor channel.

    Raises:
        TiltcalError: there is no sensor channel, or no standstill.
    """
    models = {}
    for name in _channels(recording):
        values, rate = longest_standstill(recording, name)
        models[name] = _fitted(recording.source, name, allan_deviation(values, rate))
    return models


def longest_standstill(recording: Recording, column: str) -> tuple[Array, float]:
    """The longest dwell of a column, (n,), and its sample rate, Hz.

    Raises:
        TiltcalError: the recording has no standstill.
    """
    longest = _longest(recording)
    values = recording.column(column)
    known = ~np.isnan(values)
    rows = np.flatnonzero(known[longest.first : longest.last]) + longest.first
    return values[rows], _rate(recording.time[rows])


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


def _fitted(source: str, name: str, curve: AllanDeviation) -> NoiseModel:
    """The noise model of one column."""
    with determining(f"{source}, column {name}", "its noise"):
        return fit_noise(curve)
