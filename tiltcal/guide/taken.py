"""A dwell while it is recorded."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.frames import angle_between
from tiltcal.core.units import DEG
from tiltcal.guide.live_checks import Found, clipped, inspected, saturation
from tiltcal.guide.planner import Candidate
from tiltcal.guide.reading import Reading
from tiltcal.guide.state import Dwell, Manner, triple
from tiltcal.guide.stream import Stream
from tiltcal.guide.task import Task
from tiltcal.recordings.segmentation import GUARD, WINDOW, Segment
from tiltcal.setup.pose_schemes import directions, label_of

OF_DWELL = ("pose", "saturation", "asked")
"""Kinds of notices that hold for the last dwell."""
# of a face by hand: the stated attitude of a housing on a table is better by far
NEAR = 20 * DEG
OPPOSITE = 150 * DEG  # from what was asked
# a dwell at a limit is flat: it takes the readings before it to tell a limit from a dead channel
BEFORE_S = 10.0
EDGE_S = GUARD + WINDOW  # what is cut off at an end, and what a window reaches beyond it


@dataclass(eq=False)
class Taken:
    """A dwell, from its first instant on.

    Args:
        start, end: s; the end moves while it goes on.
        asked: the pose that was proposed when it began.
        going_on: whether the sensor has stood still since.
        counted: whether it has lasted long enough.
        label: of its direction; in the recording only where ``labelled``.
        labelled: whether the label states the attitude.
        angles: typed, deg.
        up: up in the body frame, (3,); None where it is not known.
        reason: why it is rejected; empty: it is not.
    """

    start: float
    end: float
    asked: Candidate | None
    going_on: bool = True
    counted: bool = False
    label: str = ""
    labelled: bool = False
    angles: Mapping[str, float] = field(default_factory=dict)
    up: Array | None = None
    reason: str = ""

    @property
    def length(self) -> float:
        """How long it has lasted, s."""
        return self.end - self.start

    def rows(self, stream: Stream) -> slice:
        """Its rows."""
        return slice(
            stream.since(self.start), int(np.searchsorted(stream.time, self.end, side="right"))
        )

    def surroundings(self, stream: Stream) -> slice:
        """Its rows with its ends, in which the sensor stands still already or still."""
        first, last = self.start - EDGE_S, self.end + EDGE_S
        return slice(stream.since(first), stream.since(last) if not self.going_on else stream.rows)

    def segment(self, stream: Stream) -> Segment:
        """The dwell as a segment of the recording."""
        rows = self.rows(stream)
        label = self.label if self.labelled else None
        start, end = float(stream.time[rows.start]), float(stream.time[rows.stop - 1])
        return Segment(start, end, rows.start, rows.stop, "dwell", label)

    def shown(self, used: bool) -> Dwell:
        """The dwell for the state; ``used``: whether it enters the fit."""
        up = None if self.up is None else triple(self.up)
        return Dwell(self.start, self.end, up, self.label, dict(self.angles), used, self.reason)


def nearest_label(up: Array) -> str:
    """The face, edge or corner that is nearest to a direction. up: (3,)."""
    known = np.vstack([directions(scheme) for scheme in ("6", "12", "8")])
    return label_of(known[int(np.argmax(known @ up))])


def judge(dwell: Taken, read: Reading, task: Task, manner: Manner) -> None:
    """State the attitude of a dwell by hand, or why it has none.

    Args:
        dwell: that has lasted long enough; it is changed.
        read: means over it.
        task: what is calibrated.
        manner: how poses are set.
    """
    if manner == "head" and not task.by_norm:
        return
    dwell.up = read.up
    if read.up is None:
        return
    dwell.label = nearest_label(read.up)
    if manner != "hand" or task.by_norm:
        return
    faces = directions("6")
    face = faces[int(np.argmax(faces @ read.up))]
    off = float(angle_between(face, read.up)) / DEG
    dwell.label, dwell.labelled = label_of(face), True
    if off > NEAR / DEG:
        dwell.reason = f"{off:.0f} deg off the nearest face, {dwell.label}: its attitude is unknown"


def faults_of(dwell: Taken, read: Reading, task: Task, stream: Stream) -> Iterator[Found]:
    """What to mend in a dwell; one that is saturated is rejected.

    Args:
        dwell: that has lasted long enough; it is changed.
        read: means over it.
        task: what is calibrated.
        stream: samples so far.
    """
    if dwell.reason:
        yield "pose", f"the dwell at {dwell.start:.4g} s is {dwell.reason}"
    rows = dwell.rows(stream)
    found = inspected(stream, task.sensor, dwell.start - BEFORE_S, dwell.end)
    limited = [*saturation(task.sensor, read.columns), *clipped(found, rows.start, rows.stop)]
    if limited:
        dwell.reason = limited[0][1]
        yield limited[0]
    asked = dwell.asked
    if asked is None or asked.angles_deg or read.up is None:
        return
    if angle_between(asked.up, read.up) > OPPOSITE:
        yield (
            "asked",
            f"{asked.label} up was asked for, {nearest_label(read.up)} up is read: turned the other"
            " way, or the sign of an axis is wrong",
        )
