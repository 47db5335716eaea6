"""Standstill in a stream: the dwells of the last minutes, found as in a whole recording."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.errors import TiltcalError
from tiltcal.guide.stream import Stream
from tiltcal.recordings.segmentation import WINDOW, Segment, dwells, find_segments

HISTORY = 300.0  # s that are looked at: moves and dwells among them show how quiet quiet is
# rows a second: 25 to a window of WINDOW, whose variance is then known to 30 %
RATE = 50.0


@dataclass(frozen=True)
class Look:
    """What the last minutes show.

    Args:
        dwells: those that are over and the present one, in order; times of the stream.
        standing: whether the last of them is going on.
    """

    dwells: tuple[Segment, ...] = ()
    standing: bool = False

    @property
    def present(self) -> Segment | None:
        """The dwell that is going on."""
        return self.dwells[-1] if self.standing else None


def look(stream: Stream, columns: tuple[str, ...], without: Sequence[slice] = ()) -> Look:
    """The dwells of the last minutes.

    Each time every k-th of the rows in which the sensor was sampled is looked at, so that the work
    does not grow with the rate nor with the length of the recording.

    Args:
        stream: samples so far.
        columns: of the sensor.
        without: rows that are left out: a channel at its limit is quieter than quiet.
    """
    end = float(stream.time[-1]) if stream.rows else 0.0
    first = stream.since(end - HISTORY)
    sampled = ~np.isnan(stream.column(columns[0])[first:])
    for name in columns[1:]:
        sampled &= ~np.isnan(stream.column(name)[first:])
    for part in without:
        sampled[max(part.start - first, 0) : max(part.stop - first, 0)] = False
    rows = first + np.flatnonzero(sampled)
    if len(rows) < 2:
        return Look()
    rate = (len(rows) - 1) / float(stream.time[rows[-1]] - stream.time[rows[0]])
    step = max(1, int(rate / RATE))
    rows = rows[(len(rows) - 1) % step :: step]  # the last sample is always among them
    if stream.time[rows[-1]] - stream.time[rows[0]] < 2 * WINDOW:
        return Look()
    try:
        found = find_segments(stream.recording(rows))
    except TiltcalError:  # no channel shows motion yet
        return Look()
    return Look(tuple(dwells(found)), found[-1].kind == "dwell")
