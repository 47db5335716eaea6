"""A recorded readout played again: the Course that a model needs to predict what a recording should read."""

from dataclasses import dataclass

import numpy as np

from tiltcal.errors import TiltcalError
from tiltcal.frames import Array, parse_mounts
from tiltcal.motion import Drive, Index, Jet
from tiltcal.recording import Recording
from tiltcal.segments import resting_rows
from tiltcal.setup import Setup

SMOOTHING = 0.1  # s, half-width of the local polynomial that differentiates a readout


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
        nearest = np.clip(np.searchsorted(self.time, time), 0, len(self.time) - 1)
        for name, angle in self.angles.items():
            v, a = differentiate(self.time, angle, self.stop >= 0)
            if len(time) == len(self.time) and np.array_equal(time, self.time):
                axes[name] = Jet(angle, v, a)
                continue
            shift = time - self.time[nearest]  # a short step along the nearest stamp's own motion
            axes[name] = Jet(
                angle[nearest] + v[nearest] * shift + a[nearest] * shift**2 / 2,
                v[nearest] + a[nearest] * shift,
                a[nearest],
            )
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
        known &= read
        angles[axis] = np.interp(recording.time, recording.time[read], angle[read])
    temperature = recording.temperature()
    if temperature is None:
        temperature = np.full(len(recording), setup.site.temperature_degC)
    reference = float(np.mean(temperature)) if reference_temperature is None else reference_temperature
    mounts = tuple(parse_mounts(recording.metadata.get("mount", setup.rig.mount)))
    resting = resting_rows(recording.time, np.column_stack(list(angles.values()))) if angles else np.ones(len(recording), bool)
    starts = np.flatnonzero(np.diff(resting.astype(int), prepend=0) == 1)
    stop = np.where(resting, np.searchsorted(starts, np.arange(len(recording)), side="right") - 1, -1)
    return Replay(recording.time, angles, known, temperature, reference, mounts, stop)


def differentiate(time: Array, angle: Array, resting: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> tuple[Array, Array]:
    """Rate and acceleration of a readout by a local quartic on a uniform grid; exactly zero at rest. All (n,)."""
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
    width = max(7, 2 * round(SMOOTHING / dt) + 1)
    if n <= width:
        return zero, zero
    step = grid[1] - grid[0]
    v = np.interp(time, grid, _local_quartic(uniform, width, 1) / step)
    a = np.interp(time, grid, _local_quartic(uniform, width, 2) / step**2)
    return np.where(resting, 0.0, v), np.where(resting, 0.0, a)


def _local_quartic(u: Array, width: int, derivative: int) -> Array:
    """First or second derivative, per sample, of the quartic fitted to each window (Savitzky and Golay 1964); ends held."""
    k = np.arange(width) - width // 2
    weights = np.linalg.pinv(np.vander(k, 5, increasing=True))[derivative] * derivative
    return np.convolve(np.pad(u, width // 2, mode="reflect", reflect_type="odd"), weights[::-1], mode="valid")
