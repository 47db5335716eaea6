"""What a sensor senses: the input of every effect on its signal."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.trajectory import Standstills

ACCELEROMETERS = frozenset({"accelerometer", "inclinometer"})
ENCODER = frozenset({"encoder"})


@dataclass(frozen=True)
class Sense:
    """What a sensor senses, and what its channels are.

    Args:
        time: s, (n,).
        elapsed: since the first stamp.
        force: specific force, body frame, m/s2, (n, 3).
        rate: angular rate against inertial space, body frame, rad/s, (n, 3).
        up, north: the world's up and table North in the body frame, (n, 3).
        angular_acceleration: rad/s2, (n, 3).
        temperature: minus T0, K, (n,).
        axes: body axis of each channel, (k,).
        kind: of the sensor.
        input_vector: of a FOG, (3,).
        gravity: stated, m/s2.
        rate_hz: nominal sample rate.
        full_scale: SI, or None.
        angles: readout of each table axis, rad, (n,).
        stop: number of the stop of each row, -1 while moving, (n,).
        standstills: when each standstill began and ended; None: with the first and the last row of
            a stop.
        turn_rates: of each table axis, rad/s, (n,).
        temperature_memory: what remains of earlier temperatures, (n,), where it was followed
            already; None: an effect follows it from ``temperature``.
        encoded: where the axis of an encoder stands, rad, (n,); None of any other kind.
    """

    time: Array
    elapsed: Array
    force: Array
    rate: Array
    up: Array
    north: Array
    angular_acceleration: Array
    temperature: Array
    axes: tuple[int, ...]
    kind: str
    input_vector: Array
    gravity: float
    rate_hz: float
    full_scale: float | None = None
    angles: Mapping[str, Array] = field(default_factory=dict)
    stop: "np.ndarray[tuple[int], np.dtype[np.intp]] | None" = None
    standstills: Callable[[], Standstills] | None = None
    turn_rates: Mapping[str, Array] = field(default_factory=dict)
    temperature_memory: Array | None = None
    encoded: Array | None = None

    @cached_property
    def coning(self) -> Array:
        """Rate times angular acceleration, body frame, rad2/s3, (n, 3): nothing while the axis of
        turn keeps its direction (Bortz, IEEE Trans. Aerosp. Electron. Syst. 7, 1971).
        """
        return np.cross(self.rate, self.angular_acceleration)

    @cached_property
    def since_move(self) -> Array:
        """Time since the last move ended, s, (n,); 0 while moving."""
        return self._standstills.since(self.time)

    @cached_property
    def since_start(self) -> Array:
        """Time since the last move began, s, (n,); 0 before the first."""
        return self._standstills.since_start(self.time)

    @cached_property
    def moves(self) -> Array:
        """How many moves have begun, (n,)."""
        return self._standstills.moves(self.time)

    @property
    def _standstills(self) -> Standstills:
        return Standstills.at(
            self.standstills,
            self.time,
            np.zeros(len(self.time), np.intp) if self.stop is None else self.stop,
        )

    @classmethod
    def at_rest(cls, sensor: Sensor, gravity: float, force: Array) -> "Sense":
        """What a sensor senses at standstill at T0 under given specific forces, (m, 3), one row a
        pose, ages apart.
        """
        still, zero = np.zeros(len(force)), np.zeros_like(force)
        ages = 1e9 * np.arange(len(force), dtype=float)
        return cls(
            ages,
            still,
            force,
            zero,
            force / gravity,
            zero,
            zero,
            still,
            sensor.axis_indices,
            sensor.kind,
            np.zeros(3),
            gravity,
            sensor.rate_hz,
            sensor.full_scale,
        )

    def rows(self, rows: Index) -> "Sense":
        """Some rows. rows: their numbers, (m,)."""
        n = len(self.time)
        arrays: dict[str, Any] = {
            name: value[rows]
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray) and len(value) == n and name != "input_vector"
        }
        angles, turning = (
            {name: value[rows] for name, value in each.items()}
            for each in (self.angles, self.turn_rates)
        )
        return replace(self, **arrays, angles=angles, turn_rates=turning)

    def vector_input(self) -> Array:
        """What the kind of sensor senses along all three body axes, force or rate, (n, 3)."""
        return self.force if self.kind in ACCELEROMETERS else self.rate

    def true_input(self) -> Array:
        """The ideal reading, (n, k): force or rate along each channel, or the angle of an axis,
        before any error.
        """
        if self.encoded is not None:
            return self.encoded[:, None].copy()
        if self.kind == "fog":
            return np.asarray(self.rate @ self.input_vector)[:, None]
        source = self.vector_input()
        return source.copy() if self.axes == (0, 1, 2) else np.array(source[:, list(self.axes)])
