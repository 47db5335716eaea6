"""The schedule of a sequence: its steps as smooth angles with exact rates and accelerations."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import ceil, pi
from typing import Literal

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import angle_between, parse_mount, parse_up, unit
from tiltcal.core.units import DEG, MM
from tiltcal.setup.pose_schemes import directions, label_of, table_angles
from tiltcal.setup.sequence import Climate, Step
from tiltcal.setup.setup import Rig
from tiltcal.setup.trajectory import Attitude, Drive, Jet, Standstills

RAMP = 0.4  # s, the time a drive takes to reach its rate or to stop


@dataclass(frozen=True)
class Leg:
    """A section of the schedule: from angles ``q0``, along ``dq`` with a motion profile.

    Args:
        t0, t1: s.
        q0, dq: rad, (axes,); hand-held: rotation vector about a body axis from attitude ``R0``.
        profile: ``rest``, ``ramp`` (smooth start, constant rate, smooth stop) or ``swing``.
        ramp: s, of the start and of the stop.
        frequency: Hz, of a swing.
    """

    t0: float
    t1: float
    q0: Array
    dq: Array
    profile: Literal["rest", "ramp", "swing"] = "rest"
    ramp: float = RAMP
    frequency: float = 0.0
    R0: Array | None = None
    mount: str = "identity"
    label: str | None = None
    stop: int = -1

    def progress(self, time: Array) -> Jet:
        """Share of ``dq`` covered, with its derivatives. time: s, (n,)."""
        t = time - self.t0
        if self.profile == "rest":
            zero = np.zeros_like(t)
            return Jet(zero, zero, zero)
        return (
            _swing(t, self.t1 - self.t0, self.frequency)
            if self.profile == "swing"
            else _ramp(t, self.t1 - self.t0, self.ramp)
        )


def _ramp(t: Array, duration: float, ramp: float) -> Jet:
    """0 -> 1: the rate rises as u - sin(2 pi u)/(2 pi), stays, and falls alike: continuous
    acceleration.
    """
    w = 1.0 / (duration - ramp)
    second_half = t > duration / 2
    u = np.clip(np.where(second_half, duration - t, t) / ramp, 0.0, None)
    rising = u < 1
    r = np.minimum(u, 1.0)
    s = w * ramp * np.where(rising, r * r / 2 + (np.cos(2 * pi * r) - 1) / (4 * pi * pi), u - 0.5)
    v = w * np.where(rising, r - np.sin(2 * pi * r) / (2 * pi), 1.0)
    a = w / ramp * np.where(rising, 1 - np.cos(2 * pi * r), 0.0)
    return Jet(np.where(second_half, 1 - s, s), v, np.where(second_half, -a, a))


def _swing(t: Array, duration: float, frequency: float) -> Jet:
    """A sine under a sin^2 envelope that starts and ends at standstill."""
    p, q = pi / duration, 2 * pi * frequency
    e, ev, ea = np.sin(p * t) ** 2, p * np.sin(2 * p * t), 2 * p * p * np.cos(2 * p * t)
    s, sv, sa = np.sin(q * t), q * np.cos(q * t), -q * q * np.sin(q * t)
    return Jet(e * s, ev * s + e * sv, ea * s + 2 * ev * sv + e * sa)


@dataclass(frozen=True)
class Schedule:
    """Angles, rates and accelerations of a whole sequence at any time: a Course.

    Args:
        legs: in order, without gaps.
        axes: names of the table's axes; empty when hand-held.
        climate: temperature against time.
    """

    legs: tuple[Leg, ...]
    axes: tuple[str, ...]
    climate: Climate = field(default_factory=Climate)

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s."""
        return self.legs[0].t0, self.legs[-1].t1

    def leg_of(self, time: Array) -> Index:
        """Number of the leg at each time, (n,). time: s."""
        starts = np.array([leg.t0 for leg in self.legs])
        return np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(self.legs) - 1)

    def labels(self, time: Array) -> "np.ndarray[tuple[int], np.dtype[np.object_]]":
        """The operator's label at each time, (n,) of str or None."""
        text = np.array([leg.label for leg in self.legs], dtype=object)
        return text[self.leg_of(time)]

    def mountings(self, time: Array) -> tuple[tuple[int, str], ...]:
        """(first row, mount) of each mounting. time: s."""
        which = self.leg_of(time)
        texts = [self.legs[0].mount] + [leg.mount for leg in self.legs[1:]]
        found: list[tuple[int, str]] = []
        for row in [0, *(np.flatnonzero(np.diff(which)) + 1).tolist()]:
            text = texts[int(which[row])]
            if not found or found[-1][1] != text:
                found.append((int(row), text))
        return tuple(found)

    def standstills(self) -> Standstills:
        """When each standstill begins and ends."""
        begin = {leg.stop: leg.t0 for leg in reversed(self.legs) if leg.stop >= 0}
        end = {leg.stop: leg.t1 for leg in self.legs if leg.stop >= 0}
        if self.legs[-1].stop >= 0:
            end[self.legs[-1].stop] = np.inf
        found = Standstills(*(np.array([side[k] for k in sorted(begin)]) for side in (begin, end)))
        return found.led_in(self.legs[0].stop < 0)

    def drive(self, time: Array) -> Drive:
        """The drive at these times (standstill before the first and after the last instant).

        Args:
            time: s, (n,).
        """
        which = self.leg_of(time)
        inside = np.clip(time, *self.times)
        edges = [*np.flatnonzero(np.diff(which, prepend=-1)).tolist(), len(time)]
        q, v, a = (np.empty((len(time), len(self.legs[0].q0))) for _ in range(3))
        R = np.empty((len(time), 3, 3)) if not self.axes else None
        for start, end in pairwise(edges):
            leg = self.legs[which[start]]
            part = leg.progress(inside[start:end])
            q[start:end] = leg.q0 + np.outer(part.x, leg.dq)
            v[start:end], a[start:end] = np.outer(part.v, leg.dq), np.outer(part.a, leg.dq)
            if R is not None and leg.R0 is not None:
                R[start:end] = leg.R0 @ rotations(np.outer(part.x, leg.dq))
        stop = np.array([leg.stop for leg in self.legs])[which]
        # a turn about a fixed body axis: rate = dq's rate
        attitude = None if R is None else Attitude(R, v, a)
        return Drive(
            time,
            {name: Jet(q[:, i], v[:, i], a[:, i]) for i, name in enumerate(self.axes)},
            self.times[0],
            self.climate.at(time - self.times[0]),
            self.climate.reference(self.times[1] - self.times[0]),
            stop,
            tuple((row, parse_mount(text)) for row, text in self.mountings(time)),
            attitude,
            np.ones(len(time), bool),
            standstills=self.standstills,
        )


def rotations(vectors: Array) -> Array:
    """Rotation matrices, (n, 3, 3), of rotation vectors, rad, (n, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


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


def require_allowed(steps: Sequence[Step], rig: Rig) -> None:
    """Refuse a sequence that leaves the reach of the rig: every move is straight from end to end.

    Raises:
        TiltcalError: naming the axis, its joint, and the limit.
    """
    legs = build_schedule(steps, rig).legs
    ends = np.array([position for leg in legs for position in (leg.q0, leg.q0 + leg.dq)])
    rig.reach.require(ends / rig.reach.sizes, "sequence")


class _Builder:
    """Lays legs end to end while it remembers where the table stands."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.names = rig, rig.axis_names
        self.slides = np.array([name in rig.kind.sliding for name in self.names], bool)
        self.q = rig.reach.start * rig.reach.sizes if self.names else np.zeros(3)
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
        for stated, positions in (("deg", step.angles_deg), ("mm", step.lengths_mm)):
            for name, position in positions.items():
                k = self._index(name)
                if table.unit(name) != stated:
                    raise TiltcalError(
                        self.subject,
                        found=f"{name}_{stated}",
                        need=table.key(name),
                        do="correct the step",
                    )
                target[k] = position * table.size(name)
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
        self._require_few_legs(steps)
        n = max(1, ceil(steps))
        for k in range(0 if not self.legs else 1, n + 1):
            self._go(start + (end - start) * k / n, step)
            self._dwell(step.dwell_s)

    def _require_few_legs(self, more: float) -> None:
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
                found="options of a table",
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
        with np.errstate(over="ignore"):  # the budget refuses what takes for ever
            cruise = float((np.abs(dq) / rates).max())
        if cruise > 0:
            self._leg(move_time(cruise, 1.0), dq, "ramp")
            self.q = target.copy()

    def _leg(
        self,
        duration: float,
        dq: Array,
        profile: Literal["rest", "ramp", "swing"],
        frequency: float = 0.0,
    ) -> None:
        leg = Leg(
            self.t,
            self.t + duration,
            self.q.copy(),
            dq,
            profile,
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
