"""The guide: samples in, state out. It knows nothing of sources and of displays."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.api.certifying import Certificate
from tiltcal.api.scenario import Scenario
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import make_folder
from tiltcal.core.frames import angle_between
from tiltcal.core.units import DEG, split_unit
from tiltcal.design.goals import limits_of
from tiltcal.guide.live_checks import Found, inspected
from tiltcal.guide.planner import Candidate, Planner, by_hand, on_table
from tiltcal.guide.progress import INCOMPLETE, Progress, progress_of
from tiltcal.guide.reading import Reading, read_between
from tiltcal.guide.saving import save_all
from tiltcal.guide.standstill import Look, look
from tiltcal.guide.state import Action, GuideState, Manner, NextPose, Notice, triple
from tiltcal.guide.stream import Stream
from tiltcal.guide.taken import OF_DWELL, Taken, faults_of, judge, nearest_label
from tiltcal.guide.task import task_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.report.stated import Stated
from tiltcal.setup.tables import angle_channel

LOOK_S = 0.2  # of the stream, between two looks at it: a change is seen sooner than a hand turns
READ_S = 0.5  # that are averaged for what the sensor reads now
CHECK_S = 2.0  # between two checks of the data
CHECKED_S = 10.0  # of the stream that are checked each time
REFIT_S = 5.0  # between two fits while a dwell goes on: sigma falls with the root of its length
# dwells after which a calibration that reached its goals and is suspect stays so: more of the same
# do not mend it
FURTHER = 3


class Guide:
    """Guides an operator through a calibration while it is recorded.

        guide = tc.Guide(scenario, "norm", goal={"bias": "60ug", "scale": "40ppm"})
        for block in source:  # tiltcal.guide.sources, or your own
            guide.feed(block.time, block.columns)
            draw(guide.state)  # tiltcal.guide.state.GuideState; .to_json() for a page
            if guide.state.done:
                break
        guide.save("out")

    Args:
        scenario: site, rig and sensors.
        method: ``six_position`` or ``norm``.
        goal: sigma of each kind of parameter, such as ``{"accel.bias": "50ug"}``; a kind may lack
            the sensor (``bias``) or name one axis (``accel.bias_x``). What is not named gets what
            ``tiltcal design`` expects of a few poses.
        hold_s: length of a dwell, s.
        manner: ``hand``, ``head`` or ``table``; by the scenario and the columns unless given.
        sensor: its name, if the scenario has several that fit.
        options: of the method.

    Raises:
        TiltcalError: the method cannot be guided, the scenario lacks a sensor for it, or a goal
            names no parameter.
    """

    def __init__(
        self,
        scenario: Scenario,
        method: str = "norm",
        *,
        goal: Mapping[str, str | float] | None = None,
        hold_s: float = 5.0,
        manner: Manner | None = None,
        sensor: str | None = None,
        **options: Any,
    ) -> None:
        self._task = task_of(scenario, method, sensor, options)
        self._hold, self._asked_manner = hold_s, manner
        self._stream = Stream()
        self._look = Look()
        self._reading = Reading()
        self._dwells: list[Taken] = []
        self._present: Taken | None = None
        self._asked_goals = dict(goal or {})
        self._noted: dict[tuple[str, str], Notice] = {}
        self._live: tuple[Found, ...] = ()
        self._since: dict[Found, float] = {}
        self._looked = self._checked = self._fitted = -np.inf
        self._reached_at: int | None = None
        self._columns: tuple[str, ...] = ()
        self._proposed: Candidate | None = None
        self._manner = self._manner_of(())
        self._progress = Progress.none(self._planner())
        self._goals = self._all_goals()
        self._plan()

    # what comes in

    def feed(self, time: Array, columns: Mapping[str, Array]) -> None:
        """Take further samples.

        Args:
            time: stamps, s, (n,).
            columns: readings by column name with its unit (``accel_x_m_s2``), (n,) each, NaN where
                not sampled; the same names at every call.

        Raises:
            TiltcalError: a column of the sensor is missing, or lengths differ.
        """
        time = np.asarray(time, dtype=float)
        first = not self._stream.rows
        for part in _pieces(time, LOOK_S):
            self._stream.append(time[part], {n: np.asarray(v)[part] for n, v in columns.items()})
            if first and self._stream.rows:
                self._begin()
                first = False
            if self._stream.rows and self._now - self._looked >= LOOK_S:
                self._look_again()

    def set_angles(self, angles_deg: Mapping[str, float] | None = None) -> None:
        """State where the dividing head stands in the present dwell, or in the last.

        Args:
            angles_deg: axis -> angle, deg; those of the proposed pose unless given.

        Raises:
            TiltcalError: there is no dwell yet, or the table has no such axis.
        """
        if not self._dwells:
            raise TiltcalError(
                "angles of the head",
                found="no dwell yet",
                need="one that has lasted long enough",
                do="hold still first",
            )
        dwell = self._dwells[-1]
        asked = {} if dwell.asked is None else dwell.asked.angles_deg
        rig = self._task.scenario.rig
        stated = dict(asked if angles_deg is None else angles_deg)
        rig.narrowed({}, stated)  # refuses an axis that is none, and what the limits forbid
        start = dict(zip(rig.axis_names, rig.reach.start, strict=True))
        dwell.angles = {axis: float(stated.get(axis, at)) for axis, at in start.items()}
        self._fit()

    def reject(self, number: int = -1) -> None:
        """Leave a dwell out.

        Args:
            number: of the dwell, from 0; the last unless given.

        Raises:
            TiltcalError: there is no such dwell.
        """
        if not -len(self._dwells) <= number < len(self._dwells):
            raise TiltcalError(
                f"dwell {number}",
                found=f"{len(self._dwells)} dwells",
                need="one of them",
                do="correct the number",
            )
        self._dwells[number].reason = "rejected by the operator"
        self._fit()

    def note(self, kind: str, statement: str) -> None:
        """Add a notice, for example of a connection that dropped.

        Args:
            kind: one word.
            statement: one sentence; an empty one removes the notices of this kind.
        """
        if not statement:
            self._noted = {key: n for key, n in self._noted.items() if n.kind != kind}
            return
        self._noted[kind, statement] = Notice(kind, statement, max(self._now, 0.0))

    # what goes out

    @property
    def state(self) -> GuideState:
        """What is to be shown now."""
        now, there = self._now, bool(self._stream.rows)
        present = self._look.present if self._present is None else self._present
        held = 0.0 if present is None or not self._look.standing else now - present.start
        calibration = self._progress.calibration
        action, instruction = self._action(held)
        used = self._used
        return GuideState(
            manner=self.manner,
            action=action,
            instruction=instruction,
            time_s=now if there else None,
            rows=self._stream.rows,
            rate_hz=self._stream.rate,
            reading=self._reading.columns,
            up=None if self._reading.up is None else triple(self._reading.up),
            standing=self._look.standing,
            held_s=held,
            hold_s=self._hold,
            dwells=tuple(d.shown(d in used) for d in self._dwells),
            expected_dwells=self._expected(len(used)),
            next=None if self.done else self._shown_next(),
            parameters=self._parameters,
            notices=self._notices(),
            verdict=None if calibration is None else calibration.verdict,
            reached=self.reached,
            done=self.done,
        )

    @property
    def manner(self) -> Manner:
        """How poses are set."""
        return self._manner

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the head whose angles are proposed and typed, outermost first."""
        return tuple(self._next[0].angles_deg)

    @property
    def reached(self) -> bool:
        """Whether every sigma has reached its goal, with enough dwells to test the fit by."""
        enough = len(self._used) >= self._progress.planner.least
        return enough and all(p.reached for p in self._parameters.values())

    @property
    def done(self) -> bool:
        """Whether nothing more is needed: the goals are reached, and the calibration is good or
        stays as it is with further dwells.
        """
        calibration = self._progress.calibration
        if calibration is None or not self.reached or self._reached_at is None:
            return False
        return calibration.verdict == "good" or len(self._used) >= self._reached_at + FURTHER

    @property
    def recording(self) -> Recording:
        """All that was fed, with labels and typed angles; readings of rejected dwells left out."""
        stream, more = self._stream, {}
        labels = None
        if any(d.labelled for d in self._dwells):
            labels = np.full(stream.rows, None, dtype=object)
        typed = [d for d in self._dwells if d.angles]
        for axis in self._task.scenario.rig.axis_names if typed else ():
            more[f"{angle_channel(axis)}_deg"] = np.full(stream.rows, np.nan)
        rejected = [d for d in self._dwells if d.reason]
        more |= {name: stream.column(name).copy() for name in self._columns if rejected}
        for dwell in self._dwells:
            rows = dwell.rows(stream)
            if labels is not None and dwell.labelled:
                labels[rows] = dwell.label
            for axis, angle in dwell.angles.items():
                more[f"{angle_channel(axis)}_deg"][rows] = angle
            for name in self._columns if dwell.reason else ():
                more[name][dwell.surroundings(stream)] = np.nan
        return stream.recording(more=more, labels=labels)

    @property
    def raw(self) -> Recording:
        """All that was fed, as it came."""
        return self._stream.recording()

    @property
    def segments(self) -> Sequence[Segment]:
        """The dwells of the recording that are used."""
        return [d.segment(self._stream) for d in self._used]

    def calibrate(self) -> Calibration:
        """The calibration of what was recorded so far.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        return self._task.calibrate(self.recording, self.segments)

    def certify(self, stated: Stated | None = None) -> Certificate:
        """The same with its uncertainty budget, as a certificate.

        Args:
            stated: what only the laboratory knows.

        Raises:
            TiltcalError: the recording does not have what the method needs.
        """
        return self._task.certify(self.recording, self.segments, stated)

    def save(self, folder: Path | str, stated: Stated | None = None) -> dict[str, Path]:
        """Write recording.csv, segments.csv, CAL.json and state.json; raw.csv where dwells were
        rejected; with ``stated`` certificate.html, and certificate.xml where it has a date.

        Args:
            folder: made where it does not exist.
            stated: what only the laboratory knows; without it no certificate is written.

        Returns:
            The files that were written, by what they are; no ``calibration`` where there were too
            few dwells for one.

        Raises:
            TiltcalError: a file cannot be written.
        """
        if self._dwells:
            self._fit()  # what was fed after the last fit enters the files
        return save_all(self, make_folder(Path(folder)), stated)

    # inside

    @property
    def _now(self) -> float:
        return float(self._stream.time[-1]) if self._stream.rows else -np.inf

    @property
    def _used(self) -> list[Taken]:
        """The dwells that enter the fit."""
        known = self.manner != "head" or self._task.by_norm
        return [d for d in self._dwells if not d.reason and (known or d.angles)]

    def _manner_of(self, names: Sequence[str]) -> Manner:
        """How poses are set, by the columns of the stream."""
        if self._asked_manner is not None:
            return self._asked_manner
        rig = self._task.scenario.rig
        if not rig.kind.tilting:
            return "hand"
        channels = {angle_channel(axis) for axis in rig.axis_names}
        if channels <= {split_unit(name)[0] for name in names}:
            return "table"
        return "hand" if self._task.by_norm else "head"

    def _planner(self) -> Planner:
        task = self._task
        hand = self.manner == "hand"
        poses = by_hand(not task.by_norm) if hand else on_table(task.seen, task.sensor)
        return Planner(task.fitted.model, poses, self._hold)

    def _all_goals(self) -> dict[str, float]:
        """The goal of each parameter: asked for, or what a few dwells bring."""
        planner = self._progress.planner
        units = dict(zip(planner.model.names, planner.model.units, strict=True))
        return planner.usual_goals() | limits_of(self._asked_goals, units)

    def _begin(self) -> None:
        """The first samples show the columns, and by them the manner."""
        self._task.require_columns(self._stream.recording())
        names = self._stream.names
        channels = {f"{self._task.sensor.name}_{axis}" for axis in self._task.sensor.axes}
        self._columns = tuple(n for n in names if split_unit(n)[0] in channels)
        self._manner = self._manner_of(names)
        self._progress = Progress.none(self._planner())
        self._plan()

    def _look_again(self) -> None:
        """What the last samples show: reading, standstill, faults."""
        stream, task, now = self._stream, self._task, self._now
        self._looked = now
        g = task.scenario.site.gravity
        self._reading = read_between(stream, task.sensor, g, now - READ_S, now)
        over = [d for d in self._dwells if d.reason and not d.going_on]
        self._look = look(stream, self._columns, [d.surroundings(stream) for d in over])
        self._follow()
        if now - self._checked >= CHECK_S:
            self._checked = now
            found = inspected(stream, task.sensor, now - CHECKED_S, now)
            self._live = tuple((f.kind, f.statement) for f in found)

    def _follow(self) -> None:
        """The present dwell, by what is seen: it begins, goes on, is long enough, or ends."""
        seen, present = self._look.present, self._present
        if present is not None and (seen is None or seen.start > present.end):
            self._end(present)
            present = None
        if seen is None:
            return
        if present is None:
            present = Taken(seen.start, seen.end, self._next[0])
        # what moved before shows how quiet quiet is; only a dwell longer than that is older
        present.start = seen.start if seen.first > 0 else min(present.start, seen.start)
        present.end = max(present.end, seen.end)
        self._present = present
        if not present.counted and present.length >= self._hold:
            self._count(present)
        elif present.counted and self._now - self._fitted >= REFIT_S:
            self._fit()

    def _end(self, present: Taken) -> None:
        """A dwell is over: its last part, in which hands came near, is cut off."""
        self._present, present.going_on = None, False
        over = [s for s in self._look.dwells if s.start < present.end and s.end > present.start]
        if over:
            present.end = over[-1].end
        elif present.counted:  # by what came later it was none
            self._dwells.remove(present)
        if present.counted:
            self._fit()

    def _count(self, dwell: Taken) -> None:
        """A dwell has lasted long enough."""
        task = self._task
        dwell.counted, self._proposed = True, None
        self._dwells.append(dwell)
        read = read_between(
            self._stream, task.sensor, task.scenario.site.gravity, dwell.start, dwell.end
        )
        self._noted = {k: n for k, n in self._noted.items() if n.kind not in OF_DWELL}
        judge(dwell, read, task, self.manner)
        for kind, statement in faults_of(dwell, read, task, self._stream):
            self.note(kind, statement)
        self._fit()

    def _fit(self) -> None:
        """What the dwells so far bring, and the next pose."""
        first = self._progress.up is None
        self._fitted = self._now
        planner, used = self._progress.planner, self._used
        segments = self.segments
        self._progress = progress_of(self._task, planner, self.recording, segments)
        if self._progress.up is not None:
            for dwell, up in zip(used, self._progress.up, strict=False):
                if not np.isnan(up).any():
                    dwell.up, dwell.label = up, dwell.label or nearest_label(up)
            if first and not self._task.noise_is_stated:
                self._goals = self._all_goals()
        self._plan()
        self._reached_at = (self._reached_at or len(used)) if self.reached else None

    def _plan(self) -> None:
        """The sigmas, the most useful pose, and how many are still needed."""
        unit = split_unit(self._columns[0])[1] if self._columns else None
        progress = self._progress
        self._parameters = progress.parameters(self._goals, unit)
        here = self._dwells[-1].up if self._dwells else None
        self._next = progress.planner.best(progress.information, self._way, self._proposed, here)
        self._proposed = self._next[0]
        self._further = progress.planner.further(progress.information, self._goals)

    def _expected(self, used: int) -> int | None:
        """How many dwells there will be: what the goals need, and the fit to be tested by."""
        if self._further is None:
            return None
        return max(used + self._further, self._progress.planner.least)

    def _way(self, pose: Candidate) -> float:
        """How far a pose is from where the sensor is now, rad."""
        if pose.angles_deg:
            last = next((d.angles for d in reversed(self._dwells) if d.angles), {})
            return max(abs(a - last.get(axis, 0.0)) for axis, a in pose.angles_deg.items()) * DEG
        up = self._reading.up
        return 0.0 if up is None else float(angle_between(up, pose.up))

    def _shown_next(self) -> NextPose:
        pose, gain = self._next
        up = self._reading.up
        return NextPose(
            triple(pose.up),
            pose.label,
            dict(pose.angles_deg),
            pose.instruction,
            gain,
            None if up is None else float(angle_between(up, pose.up)) / DEG,
        )

    def _action(self, held: float) -> tuple[Action, str]:
        """What the operator does now, and the sentence."""
        if not self._stream.rows:
            return "wait", "waiting for samples"
        if self.done:
            calibration = self._progress.calibration
            good = calibration is not None and calibration.verdict == "good"
            but = "" if good else "; further dwells did not mend what is suspect"
            return "done", f"done: {len(self._used)} dwells, every goal is reached{but}"
        present = self._present
        if self._look.standing and (present is None or not present.counted):
            return "hold", f"hold still: {max(self._hold - held, 0.0):.0f} s"
        asks = self.manner == "head" and not self._task.by_norm and bool(self._dwells)
        if asks and not (self._dwells[-1].angles or self._dwells[-1].reason):
            return "type", "type the angles of the head in this dwell"
        return "turn", self._next[0].instruction

    def _notices(self) -> tuple[Notice, ...]:
        """What to mend, the last first."""
        now = max(self._now, 0.0)
        more = INCOMPLETE if not self.reached else ()  # to come
        faults = (*self._live, *(f for f in self._progress.found if f[0] not in more))
        stream = self._stream
        keys = {f: (f[0], f[1].partition(":")[0]) for f in faults}
        self._since = {key: self._since.get(key, now) for key in keys.values()}
        found = [Notice(*f, self._since[keys[f]]) for f in faults]
        if stream.late:
            words = f"{stream.late} rows came late or twice and were left out"
            found.append(Notice("stamps", words, now))
        if stream.restarts:
            words = f"the clock of the source began again {stream.restarts} times: continued"
            found.append(Notice("stamps", words, now))
        return tuple(found + sorted(self._noted.values(), key=lambda n: -n.since_s))


def _pieces(time: Array, length: float) -> Iterator[slice]:
    """Successive parts of some stamps, none much longer than a time, s. time: s, (n,)."""
    if not len(time):
        return
    part = np.floor((time - time[0]) / length)
    edges = np.flatnonzero(np.diff(part) != 0) + 1
    for first, last in zip([0, *edges], [*edges, len(time)], strict=True):
        yield slice(int(first), int(last))
