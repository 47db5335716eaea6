"""A recorded readout replayed: the Course that a model needs to predict a recording."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.core.arrays import NOWHERE, Array, Index, Mask
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_mounts
from tiltcal.core.units import COLUMN_UNITS, split_unit
from tiltcal.recordings.differentiation import Rates
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import can_show_standstill, dwells_at_settings
from tiltcal.recordings.table_columns import other_tables
from tiltcal.recordings.table_standstills import edges_of, rates_of, sign_of, standstills_of
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import angle_channel
from tiltcal.setup.trajectory import Drive, Jet, Standstills


@dataclass(frozen=True)
class Replay:
    """The readout of a recording as a Course.

    Args:
        time: the recording's stamps, s, (n,).
        angles: of each axis, rad, (n,), gaps interpolated.
        known: rows where every axis was read, (n,).
        temperature: degC, (n,).
        reference: T0.
        mounts: (from time, R_mount).
        stop: number of the stop of each row, -1 while moving, (n,).
        rests_only: whether the angles tell nothing but where each stop is.
    """

    time: Array
    angles: dict[str, Array]
    known: Mask
    temperature: Array
    reference: float
    mounts: tuple[tuple[float, Array], ...]
    stop: Index
    rests_only: bool = False

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s."""
        return float(self.time[0]), float(self.time[-1])

    def with_angles(self, angles: dict[str, Array]) -> "Replay":
        """The same with other angles, its stops determined from them. angles: rad, (n,) each."""
        stop = self.stop if self.rests_only else numbered_stops(self.time, angles)
        return replace(self, angles=angles, stop=stop)

    def drive(self, time: Array) -> Drive:
        """The drive at these times; between the stamps by interpolation. time: s, (n,)."""
        axes = {}
        nearest = nearest_rows(self.time, time)
        for name, angle in self.angles.items():
            v, a, *_ = self._rates[name]
            if len(time) == len(self.time) and np.array_equal(time, self.time):
                axes[name] = Jet(angle, v, a)
                continue
            # a short step from the nearest stamp; between stamps the acceleration is what takes one
            # rate to the next: on a straight line between them it would lose what it bends
            within = np.clip(time, self.time[0], self.time[-1])
            shift, here = time - self.time[nearest], self._accelerations[name](within)
            axes[name] = Jet(
                angle[nearest] + v[nearest] * shift + (2 * a[nearest] + here) * shift**2 / 6,
                v[nearest] + (a[nearest] + here) * shift / 2,
                here,
            )
        return self.standing(time, axes)

    def motion_noise(self, axis: str) -> tuple[Array, Array]:
        """Standard deviations of the rate, rad/s, and the acceleration, rad/s2, of an axis
        from its readout, (n,) each.
        """
        return self._rates[axis].noise, self._rates[axis].acceleration_noise

    @cached_property
    def speed(self) -> Array:
        """Of the axis that moves fastest, each in units of its largest rate, (n,)."""
        fastest = np.zeros(len(self.time))
        for rates in self._rates.values():
            speed = np.abs(rates.rate)
            fastest = np.maximum(fastest, speed / max(float(speed.max()), np.finfo(float).tiny))
        return fastest

    @property
    def _read(self) -> Mask:
        """Rows that determine the motion, (n,): those that were read; all, where hardly any was."""
        enough = can_show_standstill(self.time[self.known])
        return self.known if enough and self.known.any() else np.ones(len(self.time), bool)

    @cached_property
    def _rates(self) -> dict[str, Rates]:
        """Rate and acceleration of each axis: the drive is asked for many times. Where nothing was
        read it turns evenly: no motion is estimated from interpolated angles.
        """
        found, read = {}, self._read
        for name, angle in self.angles.items():
            if self.rests_only:
                found[name] = Rates(*np.zeros((4, len(angle))))
                continue
            # counted the other way it has the same rates, turned
            sign = sign_of(angle)
            estimates = rates_of(self.time[read].tobytes(), (sign * angle[read]).tobytes())
            rates = Rates(*np.zeros((4, len(angle))))
            if not read.all():
                rates.rate[:] = sign * np.gradient(angle, self.time)
            for whole, part in zip(rates, estimates, strict=True):
                whole[read] = part
            found[name] = rates._replace(
                rate=sign * rates.rate, acceleration=sign * rates.acceleration
            )
        return found

    @cached_property
    def _accelerations(self) -> dict[str, Callable[[Array], Array]]:
        """Of each axis as a function of time, between the first stamp and the last: the slope of
        the cubic through its rates; nothing of a single row.
        """
        from scipy.interpolate import CubicHermiteSpline

        if len(self.time) < 2:
            return dict.fromkeys(self.angles, np.zeros_like)
        each = self._rates.items()
        rates = {name: CubicHermiteSpline(self.time, r.rate, r.acceleration) for name, r in each}
        return {name: rate.derivative() for name, rate in rates.items()}

    @cached_property
    def standstills(self) -> Standstills:
        """When each standstill began and ended: to a part of a sample where the readout determines
        it.
        """
        read = self._read
        time = self.time[read].tobytes()
        moved = {} if self.rests_only else self.angles
        each_axis = [edges_of(time, angle[read].tobytes()) for angle in moved.values()]
        leaves, comes = (
            np.sort(np.concatenate([one[side] for one in each_axis])) if each_axis else np.zeros(0)
            for side in (0, 1)
        )
        return standstills_between(self.time, self.stop, leaves, comes)

    def standing(self, time: Array, axes: dict[str, Jet]) -> Drive:
        """A drive at these times whose axes are known already: nothing is differentiated. time: s,
        (n,).
        """
        nearest = nearest_rows(self.time, time)
        return Drive(
            time,
            axes,
            float(self.time[0]),
            np.interp(time, self.time, self.temperature),
            self.reference,
            self.stop[nearest],
            tuple((int(np.searchsorted(time, start)), R) for start, R in self.mounts),
            None,
            self.known[nearest],
            standstills=lambda: self.standstills,
        )


def numbered_stops(time: Array, angles: dict[str, Array]) -> Index:
    """Number of the stop of each row of a readout (rad, (n,) each), -1 while moving, (n,)."""
    still, parted = np.ones(len(time), bool), NOWHERE
    if angles:
        # counted the other way it stands still at the same rows
        each = np.column_stack([sign_of(angle) * angle for angle in angles.values()])
        still, parted = standstills_of(time.tobytes(), each.tobytes(), len(angles))
    begins = np.diff(still.astype(int), prepend=0) == 1
    begins[parted] = still[parted]
    starts = np.flatnonzero(begins)
    return np.where(still, np.searchsorted(starts, np.arange(len(time)), side="right") - 1, -1)


def replay(
    recording: Recording, setup: Setup, reference_temperature: float | None = None
) -> Replay:
    """The readout of ``recording`` as a Course on the table of ``setup``.

    Raises:
        TiltcalError: a table column is missing, or time does not increase.
    """
    recording.require_increasing()
    angles: dict[str, Array] = {}
    known = np.ones(len(recording), bool)
    for axis in setup.rig.axis_names:
        angle = recording.table(axis)
        if angle is None or np.isnan(angle).all():
            raise TiltcalError(
                f"{recording.source}",
                found=f"no column {angle_channel(axis)}_<unit>",
                need=f"the readout of the {setup.rig.table} table",
                do="record it (of labelled poses only `calibrate` knows the attitudes)"
                + other_tables(recording, setup.rig.table),
            )
        _require_unit(recording, setup, axis)
        read = ~np.isnan(angle)
        known &= _near(recording.time, recording.time[read])
        angles[axis] = np.interp(recording.time, recording.time[read], angle[read])
    temperature = recording.temperature()
    if temperature is None:
        temperature = np.full(len(recording), setup.site.temperature_degC)
    reference = (
        float(np.mean(temperature)) if reference_temperature is None else reference_temperature
    )
    mounts = tuple(_mounts(recording, setup))
    at_settings = dwells_at_settings(recording, angles.values())
    if at_settings:
        stop = np.full(len(recording), -1)
        for k, dwell in enumerate(at_settings):
            stop[dwell.first : dwell.last] = k
        known &= stop >= 0
    else:
        stop = numbered_stops(recording.time, angles)
    about = temperature, reference, mounts, stop, bool(at_settings)
    return Replay(recording.time, angles, known, *about)


def _mounts(recording: Recording, setup: Setup) -> list[tuple[float, Array]]:
    """(from time, R_mount), as the recording's metadata has them, or else the set-up."""
    try:
        return parse_mounts(recording.metadata.get("mount", setup.rig.mount))
    except TiltcalError as e:
        where = f"{recording.source}, {e.subject}" if "mount" in recording.metadata else e.subject
        raise TiltcalError(where, found=e.found, need=e.need, do=e.do) from None


def _require_unit(recording: Recording, setup: Setup, axis: str) -> None:
    """Refuse a readout in a unit of something else than its axis moves by."""
    column, table = str(recording.channel(angle_channel(axis))), setup.rig.kind
    unit, wanted = str(split_unit(column)[1]), COLUMN_UNITS[table.unit(axis)].quantity
    if COLUMN_UNITS[unit].quantity != wanted:
        raise TiltcalError(
            f"{recording.source}, column {column}",
            found=f"unit {unit}",
            need=f"a unit of {wanted}: axis {axis} {'slides' if wanted == 'length' else 'turns'}",
            do=f"rename it, such as {angle_channel(axis)}_{table.unit(axis)}",
        )


def _near(time: Array, read: Array) -> Mask:
    """Rows whose readout is known: read there, or between two readings at the table's ordinary
    cadence, (n,).
    """
    there = np.isin(time, read)
    if len(read) < 2:
        return there
    after = np.clip(np.searchsorted(read, time), 1, len(read) - 1)
    inside = (time > read[after - 1]) & (time < read[after])
    return there | (
        inside & (read[after] - read[after - 1] <= 1.5 * float(np.median(np.diff(read))))
    )


def nearest_rows(stamps: Array, time: Array) -> Index:
    """The row whose stamp is nearest to each time, (n,). stamps: increasing. Both in s."""
    between = (stamps[1:] + stamps[:-1]) / 2
    return np.searchsorted(between, time)


def standstills_between(time: Array, stop: Index, leaves: Array, comes: Array) -> Standstills:
    """The standstills of a readout.

    A stop has lost its ends to the margins that the search for it keeps; where an instant is not
    determined it is as far from the stop's end as usually.

    Args:
        time: s, (n,).
        stop: number of the stop of each row, -1 while moving, (n,).
        leaves, comes: instants at which an axis began a move, and ended one, s, sorted.
    """
    rows = Standstills.of_rows(time, stop)
    first, last = (side[np.isfinite(side)] for side in (rows.begin, rows.end))
    if not len(first):
        return rows
    begin = np.concatenate([[-np.inf], comes])[np.searchsorted(comes, last)]
    begin = np.where(begin > np.concatenate([[-np.inf], last[:-1]]), begin, -np.inf)
    end = np.concatenate([leaves, [np.inf]])[np.searchsorted(leaves, first)]
    end = np.where(end < np.concatenate([first[1:], [np.inf]]), end, np.inf)
    begin, end = _as_usual(begin, first), _as_usual(end, last)
    begin[0] = time[0] if stop[0] >= 0 else begin[0]
    end[-1] = np.inf if stop[-1] >= 0 else end[-1]
    return Standstills(begin, end).led_in(bool(stop[0] < 0))


def _as_usual(exact: Array, rough: Array) -> Array:
    """Instants, s, (k,): those that are not determined, infinite, as far from the rough ones as the
    others usually are.
    """
    there = np.isfinite(exact)
    usual = float(np.median(exact[there] - rough[there])) if there.any() else 0.0
    return np.where(there, exact, rough + usual)
