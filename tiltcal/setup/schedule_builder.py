"""From the steps of a sequence to its schedule."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import angle_between, parse_up, unit
from tiltcal.core.units import DEG, MM
from tiltcal.setup.pose_schemes import directions, label_of, table_angles
from tiltcal.setup.schedule import RAMP, Leg, Schedule, rotations
from tiltcal.setup.sequence import Climate, Step
from tiltcal.setup.setup import Rig

MOST_LEGS = 100_000


def build_schedule(steps: Sequence[Step], rig: Rig, climate: Climate | None = None) -> Schedule:
    """The schedule of a sequence on a rig.

    Raises:
        TiltcalError: a step asks for an axis the table does not have, or for nothing at all.
    """
    if not steps:
        raise TiltcalError(
            "sequence",
            found="no steps",
            need="at least one",
            do="add a [[sequence]] table with action = 'rest'",
        )
    builder = _Builder(rig)
    for number, step in enumerate(steps, start=1):
        builder.add(number, step)
    if not builder.legs:
        raise TiltcalError(
            "sequence",
            found="no motion and no dwell",
            need="dwell_s or a move",
            do="give the steps a dwell_s",
        )
    return Schedule(tuple(builder.legs), rig.axis_names, climate or Climate())


class _Builder:
    """Lays legs end to end while it remembers where the table stands."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.names = rig, rig.axis_names
        self.slides = np.array([name in rig.kind.sliding for name in self.names], bool)
        self.q = np.zeros(len(self.names) or 3)
        self.R = np.eye(3)
        self.mount = rig.mount
        self.label: str | None = None
        self.t, self.stops = 0.0, 0
        self.legs: list[Leg] = []

    def add(self, number: int, step: Step) -> None:
        self.subject = f"sequence step {number} ({step.action})"
        self.label = step.label or step.up
        if step.action == "scheme":
            self._scheme(number, step)
            return
        if step.mount is not None:
            self.mount = step.mount
        if not self.names:
            self._by_hand(step)
        elif step.action == "sweep":
            self._sweep(step)
        elif step.action == "oscillate":
            # the step's own check has seen to it that it stands there
            frequency = step.frequency_hz or 1.0
            dq = self._turned(step.axis, (step.amplitude_deg or 0.0) * DEG)
            self._leg(step.cycles / frequency, dq, "swing", frequency=frequency)
        elif step.action == "turn":
            self._go(self.q + self._turned(step.axis, (step.angle_deg or 0.0) * DEG), step)
        else:
            self._go(self._target(step), step)
        if step.action != "sweep":
            self._dwell(step.dwell_s)

    def _target(self, step: Step) -> Array:
        target = self.q.copy()
        table = self.rig.kind
        for stated, places in (("deg", step.angles_deg), ("mm", step.lengths_mm)):
            for name, place in places.items():
                k = self._index(name)
                if table.unit(name) != stated:
                    raise TiltcalError(
                        self.subject,
                        found=f"{name}_{stated}",
                        need=table.key(name),
                        do="correct the step",
                    )
                target[k] = place * table.size(name)
        return target

    def _index(self, name: str) -> int:
        if name not in self.names:
            have = ", ".join(self.names) or "none (hand-held)"
            raise TiltcalError(
                self.subject,
                found=f"axis {name}",
                need=f"an axis of this table: {have}",
                do="correct the step",
            )
        return self.names.index(name)

    def _turned(self, axis: object, angle: float) -> Array:
        k = self._index(str(axis))
        if self.slides[k]:
            raise TiltcalError(
                self.subject,
                found=f"axis {axis}, which slides",
                need="an axis that turns",
                do=f"move it with {axis}_mm",
            )
        dq = np.zeros(len(self.q))
        dq[k] = angle
        return dq

    def _sweep(self, step: Step) -> None:
        start, end = self.q.copy(), self._target(step)
        sizes = np.where(self.slides, step.step_mm * MM, step.step_deg * DEG)
        steps = float((np.abs(end - start) / sizes).max()) - 1e-9
        self._require_room(steps)
        n = max(1, ceil(steps))
        for k in range(0 if not self.legs else 1, n + 1):
            self._go(start + (end - start) * k / n, step)
            self._dwell(step.dwell_s)

    def _require_room(self, more: float) -> None:
        """Refuse more legs than a sequence may have."""
        if not len(self.legs) + more <= MOST_LEGS:
            raise TiltcalError(
                self.subject,
                found=f"{more:.4g} stops",
                need=f"at most {MOST_LEGS} legs in a sequence",
                do="give it a larger step_deg",
            )

    def _scheme(self, number: int, step: Step) -> None:
        """All positions of a scheme, each with its direction as the label."""
        for k, up in enumerate(directions(str(step.scheme))):
            self.label = label_of(up)
            if not self.names:
                self.add(
                    number,
                    Step(
                        action="move",
                        up=self.label,
                        rate_deg_s=step.rate_deg_s,
                        dwell_s=step.dwell_s,
                    ),
                )
                continue
            self._go(table_angles(self.rig, up, k, self.subject), step)
            self._dwell(step.dwell_s)

    def _by_hand(self, step: Step) -> None:
        if step.action in ("sweep", "oscillate") or step.angles_deg:
            raise TiltcalError(
                self.subject,
                found="table words",
                need="rest, move with up, or turn with axis and angle_deg",
                do="correct the step",
            )
        vector = np.zeros(3)
        if step.action == "turn":
            vector = self._body_axis(step.axis) * (step.angle_deg or 0.0) * DEG
        elif step.up is not None and (up := parse_up(step.up)) is not None:
            # up in the body frame has to go from ``now`` to ``up``
            now = self.R.T @ np.array([0.0, 0.0, 1.0])
            angle = float(angle_between(now[None], up[None])[0])
            axis = np.cross(up, now)
            if np.linalg.norm(axis) < 1e-9:
                axis = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
            vector = unit(axis) * angle
        angle = float(np.linalg.norm(vector))
        if angle > 0:
            self._leg(move_time(angle, step.rate_deg_s * DEG), vector, "ramp")
            self.R = self.R @ rotations(vector[None])[0]

    def _body_axis(self, axis: object) -> Array:
        if isinstance(axis, str) and axis in ("x", "y", "z"):
            return np.eye(3)["xyz".index(axis)]
        if isinstance(axis, tuple) and np.any(axis):
            return unit(axis)
        raise TiltcalError(
            self.subject,
            found=f"axis {axis}",
            need="x, y, z or [ux, uy, uz]",
            do="correct the step",
        )

    def _go(self, target: Array, step: Step) -> None:
        dq = target - self.q
        rates = np.where(self.slides, step.rate_mm_s * MM, step.rate_deg_s * DEG)
        cruise = float((np.abs(dq) / rates).max())
        if cruise > 0:
            self._leg(move_time(cruise, 1.0), dq, "ramp")
            self.q = target.copy()

    def _leg(
        self,
        duration: float,
        dq: Array,
        law: Literal["rest", "ramp", "swing"],
        frequency: float = 0.0,
    ) -> None:
        leg = Leg(
            self.t,
            self.t + duration,
            self.q.copy(),
            dq,
            law,
            RAMP,
            frequency,
            self.R,
            self.mount,
            self.label,
        )
        if not self.names:
            leg = replace(leg, q0=np.zeros(3))
        self.legs.append(leg)
        self.t = leg.t1

    def _dwell(self, duration: float) -> None:
        if duration > 0:
            self._leg(duration, np.zeros(len(self.q)), "rest")
            self.legs[-1] = replace(self.legs[-1], stop=self.stops)
            self.stops += 1


def move_time(distance: float, rate: float) -> float:
    """Time of a move, s: cruising plus half of each ramp, or two ramps when it is too short to
    reach the rate.
    """
    return distance / rate + RAMP if distance > rate * RAMP else 2 * RAMP
