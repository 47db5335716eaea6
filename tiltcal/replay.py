"""A recorded readout played again: the Course that a model needs to predict what a recording should read."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from tiltcal.codes import code_width
from tiltcal.errors import TiltcalError
from tiltcal.frames import Array, parse_mounts
from tiltcal.motion import Drive, Index, Jet
from tiltcal.recording import Recording
from tiltcal.segments import resting_rows
from tiltcal.setup import Setup

EDGE = 2  # samples beside a move that are left to the polynomial
WANDER = 2e-3  # rad: what a readout covers within a stop; more is a slow move, or the turning point of an oscillation
WIDTHS = (5, 7, 9, 11, 15, 19, 25, 33, 41)  # samples of the local quartics: those that leave no more than the readout's own noise
AROUND = (0.2, 0.35, 0.5, 0.65, 0.8)  # in a window, of the sample whose rate it tells
BESIDE = (0.0, 1.0)  # where no window around a sample fits: next to a corner


@dataclass(frozen=True)
class Replay:
    """The readout of a recording as a Course.

    Args:
        time: the recording's stamps, s, (n,).
        angles: of each axis, rad, (n,), gaps interpolated.
        known: rows where every axis was read, (n,).
        temperature: degC, (n,); reference: T0.
        mounts: (from time, R_mount).
        stop: number of the stop of each row, -1 while moving, (n,).
    """

    time: Array
    angles: dict[str, Array]
    known: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
    temperature: Array
    reference: float
    mounts: tuple[tuple[float, Array], ...]
    stop: Index

    @property
    def times(self) -> tuple[float, float]:
        """First and last instant, s."""
        return float(self.time[0]), float(self.time[-1])

    def drive(self, time: Array) -> Drive:
        """The drive at these times; between the stamps by interpolation."""
        axes = {}
        nearest = nearest_rows(self.time, time)
        for name, angle in self.angles.items():
            v, a = self._rates[name]
            if len(time) == len(self.time) and np.array_equal(time, self.time):
                axes[name] = Jet(angle, v, a)
                continue
            shift = time - self.time[nearest]  # a short step along the nearest stamp's own motion
            axes[name] = Jet(
                angle[nearest] + v[nearest] * shift + a[nearest] * shift**2 / 2,
                v[nearest] + a[nearest] * shift,
                a[nearest],
            )
        return self.standing(time, axes)

    @cached_property
    def _rates(self) -> dict[str, tuple[Array, Array]]:
        """Rate and acceleration of each axis, rad/s and rad/s2, (n,) each: the drive is asked for many times."""
        time, resting = self.time.tobytes(), (self.stop >= 0).tobytes()
        found = {}
        for name, angle in self.angles.items():
            sign = -1.0 if angle[np.argmax(np.abs(angle))] < 0 else 1.0  # counted the other way it has the same rates, turned
            v, a = _differentiated(time, (sign * angle).tobytes(), resting)
            found[name] = (sign * v, sign * a)
        return found

    def standing(self, time: Array, axes: dict[str, Jet]) -> Drive:
        """A drive at these times whose axes are known already: nothing is differentiated."""
        nearest = nearest_rows(self.time, time)
        return Drive(
            time, axes, float(self.time[0]), np.interp(time, self.time, self.temperature), self.reference,
            self.stop[nearest], tuple((int(np.searchsorted(time, start)), R) for start, R in self.mounts), None,
            self.known[nearest],
        )  # fmt: skip


def replay(recording: Recording, setup: Setup, reference_temperature: float | None = None) -> Replay:
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
                f"{recording.source}", found=f"no column table_{axis}_<unit>", need=f"the readout of the {setup.rig.table} table",
                do="record it, or label the poses",
            )  # fmt: skip
        read = ~np.isnan(angle)
        known &= _near(recording.time, recording.time[read])
        angles[axis] = np.interp(recording.time, recording.time[read], angle[read])
    temperature = recording.temperature()
    if temperature is None:
        temperature = np.full(len(recording), setup.site.temperature_degC)
    reference = float(np.mean(temperature)) if reference_temperature is None else reference_temperature
    mounts = tuple(parse_mounts(recording.metadata.get("mount", setup.rig.mount)))
    resting = np.ones(len(recording), bool)
    if angles:
        stacked = np.column_stack(list(angles.values()))
        resting = still_rows(stacked, resting_rows(recording.time, stacked))
    starts = np.flatnonzero(np.diff(resting.astype(int), prepend=0) == 1)
    stop = np.where(resting, np.searchsorted(starts, np.arange(len(recording)), side="right") - 1, -1)
    return Replay(recording.time, angles, known, temperature, reference, mounts, stop)


def _near(time: Array, read: Array) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Rows whose readout is known: read there, or between two readings at the table's ordinary cadence, (n,)."""
    there = np.isin(time, read)
    if len(read) < 2:
        return there
    after = np.clip(np.searchsorted(read, time), 1, len(read) - 1)
    inside = (time > read[after - 1]) & (time < read[after])
    return there | (inside & (read[after] - read[after - 1] <= 1.5 * float(np.median(np.diff(read)))))


def nearest_rows(stamps: Array, time: Array) -> Index:
    """The row whose stamp is nearest to each time, (n,). stamps: increasing."""
    between = (stamps[1:] + stamps[:-1]) / 2
    return np.searchsorted(between, time)


def still_rows(
    angles: Array, resting: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Of the rows at rest those whose readout has not moved, (n,): within six deviations, or one code, of the dwell's level.

    The search for dwells takes the very start and end of a move for rest, and the slow parts of a table that never rests; a
    rate of zero there would be wrong.
    """
    still = resting.copy()
    codes = 1.01 * np.array([code_width(column) for column in angles.T])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        part = angles[first:last]
        level = np.median(part, axis=0)
        off = np.abs(part - level)
        half, most = np.quantile(off, (0.5, 0.8), axis=0)  # where half of the readings have one code the rest tell the spread
        spread = 6 * np.maximum(1.4826 * half, most / 1.2816)
        quiet = np.asarray((off <= np.maximum(np.maximum(spread, codes), 1e-12)).all(axis=1))
        for _ in range(EDGE):  # the first samples of a move hide in the noise
            quiet[1:-1] &= quiet[:-2] & quiet[2:]
            quiet[0] &= first == 0
            quiet[-1] &= last == len(angles)
        still[first:last] = quiet & bool((np.ptp(part[quiet], axis=0) <= WANDER).all() if quiet.any() else False)
    return still


def differentiate(time: Array, angle: Array, resting: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> tuple[Array, Array]:
    """Rate and acceleration of a readout by local quartics on a uniform grid; exactly zero at rest. All (n,).

    Each sample has the window, around it or to one side of it, whose quartic leaves no more than the readout's noise and tells
    the rate best: long in steady turns, short where moves bend, and on its own side of a corner.
    """
    from scipy.interpolate import CubicSpline

    zero = np.zeros_like(angle)
    if len(time) < 9 or np.ptp(angle) == 0:
        return zero, zero
    dt = float(np.median(np.diff(time)))
    n = round(float(time[-1] - time[0]) / dt) + 1
    if n > 4 * len(time):  # a log of dwells with nothing between them
        return zero, zero
    grid = np.linspace(time[0], time[-1], n)
    uniform = CubicSpline(time, angle)(grid)
    step = grid[1] - grid[0]
    v, a = _by_best_windows(uniform, _readout_noise(angle, resting))
    v, a = v / step, a / step**2
    v, a = np.interp(time, grid, v), np.interp(time, grid, a)
    return np.where(resting, 0.0, v), np.where(resting, 0.0, a)


@lru_cache(maxsize=24)
def _differentiated(time: bytes, angle: bytes, resting: bytes) -> tuple[Array, Array]:
    """The same of the contents of arrays: one recording is replayed many times, under every reading of its columns."""
    return differentiate(np.frombuffer(time), np.frombuffer(angle), np.frombuffer(resting, dtype=bool))


def _by_best_windows(u: Array, level: float) -> tuple[Array, Array]:
    """First and second derivative, per sample, of the quartics of the best windows, (n,): the narrowest one when none fits."""
    n = len(u)
    first, second = _weights(WIDTHS[0], WIDTHS[0] // 2)
    v, a, narrowest = _centred(u, first), _centred(u, second), float(first @ first)
    variance = np.full(n, narrowest)
    fits = {w: _misfit_of_quartics(u, w) <= level * (1 + 1 / np.sqrt(2 * (w - 5))) for w in WIDTHS[1:] if w < n}
    for places in (AROUND, BESIDE):
        wanted = np.ones(n, bool) if places is AROUND else variance == narrowest
        for (width, fit), share in product(fits.items(), places):
            place = round(share * (width - 1))
            first, second = _weights(width, place)
            rows = slice(place, n - width + 1 + place)
            better = fit & wanted[rows] & (first @ first < variance[rows])
            v[rows] = np.where(better, np.convolve(u, first[::-1], mode="valid"), v[rows])
            a[rows] = np.where(better, np.convolve(u, second[::-1], mode="valid"), a[rows])
            variance[rows] = np.where(better, first @ first, variance[rows])
    return v, a


def _weights(width: int, place: int) -> tuple[Array, Array]:
    """What takes the first and the second derivative at one sample of a window from its quartic, (width,) each."""
    fitted = np.linalg.pinv(np.vander(np.arange(width) - float(place), 5, increasing=True))
    return fitted[1], 2 * fitted[2]


def _readout_noise(angle: Array, resting: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> float:
    """Standard deviation of a readout from row to row where it rests, at least that of its codes; 0 when it never rests, rad."""
    steps = np.diff(angle)[resting[1:] & resting[:-1]]
    return float(max(np.sqrt(np.mean(steps**2) / 2), code_width(angle) / np.sqrt(12))) if len(steps) > 32 else 0.0


def _misfit_of_quartics(u: Array, width: int) -> Array:
    """What the quartic fitted to each full window leaves, rms per degree of freedom, (n - width + 1,)."""
    k = np.arange(width) - width // 2
    basis = np.linalg.qr(np.vander(k / width, 5, increasing=True))[0]
    windows = np.lib.stride_tricks.sliding_window_view(u - u.mean(), width)
    centred = windows - windows[:, width // 2 : width // 2 + 1]  # of the angle itself nothing is left to cancel
    left = (centred**2).sum(axis=1) - ((centred @ basis) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(left, 0.0) / (width - 5)))


def _centred(u: Array, weights: Array) -> Array:
    """Weighted sums of the windows around every sample, (n,); the ends held (Savitzky and Golay 1964)."""
    return np.convolve(np.pad(u, len(weights) // 2, mode="reflect", reflect_type="odd"), weights[::-1], mode="valid")
