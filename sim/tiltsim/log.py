"""The log of a run by time steps: joint states at rows of their own, read between the rows by one
smooth curve.
"""

from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array, Index
from tiltcal.setup.trajectory import Attitude, Jet


@dataclass(frozen=True)
class Log:
    """States of the joints at increasing times.

    Args:
        time: s, (n,).
        x: positions as in qpos, (n, nq); v, a: rates and accelerations as in qvel, (n, nv).
    """

    time: Array
    x: Array
    v: Array
    a: Array

    def _between(self, time: Array) -> tuple[Index, Array, Array]:
        """Row before each time, the interval it starts, and the time into it, (m, 1)."""
        inside = np.clip(time, self.time[0], self.time[-1])
        row = np.clip(np.searchsorted(self.time, inside, side="right") - 1, 0, len(self.time) - 2)
        start = self.time[row]
        return row, (self.time[row + 1] - start)[:, None], (inside - start)[:, None]

    def joints(self, time: Array) -> Jet:
        """All joints of a table at these times: a jet of shape (m, nq)."""
        i, h, t = self._between(time)
        k = i + 1
        return _quintic(
            Jet(self.x[i], self.v[i], self.a[i]), Jet(self.x[k], self.v[k], self.a[k]), h, t
        )

    def attitude(self, time: Array) -> Attitude:
        """Attitude of a free body at these times: that of the row before, then a small rotation
        vector u. time: s, (n,).

        Its body rate is w = u' - u x u' / 2 + u x (u x u') / 6 (Bortz), so that u' = w + u x w / 2
        + ...
        """
        from scipy.spatial.transform import Rotation

        i, h, t = self._between(time)
        here, there = (
            Rotation.from_quat(self.x[rows, 3:7], scalar_first=True) for rows in (i, i + 1)
        )
        w, a = self.v[:, 3:], self.a[:, 3:]
        step, rate, cross = (here.inv() * there).as_rotvec(), w[i + 1], np.cross
        du = rate + cross(step, rate) / 2 + cross(step, cross(step, rate)) / 12
        end = Jet(step, du, a[i + 1] + (cross(du, rate) + cross(step, a[i + 1])) / 2)
        u = _quintic(Jet(np.zeros_like(step), w[i], a[i]), end, h, t)
        swing, push = cross(u.x, u.v), cross(u.x, u.a)
        return Attitude(
            (here * Rotation.from_rotvec(np.asarray(u.x))).as_matrix(),
            u.v - swing / 2 + cross(u.x, swing) / 6,
            u.a - push / 2 + (cross(u.v, swing) + cross(u.x, push)) / 6,
        )


def _quintic(start: Jet, end: Jet, h: Array, t: Array) -> Jet:
    """The quintic through two jets (m, j) that are h (m, 1) apart, at t (m, 1): itself a jet."""
    d = (end.x - start.x) - h * (start.v + h / 2 * start.a)
    e, f = h * (end.v - start.v - h * start.a), h * h * (end.a - start.a)
    c3, c4, c5 = 10 * d - 4 * e + f / 2, -15 * d + 7 * e - f, 6 * d - 3 * e + f / 2
    s = t / h
    return Jet(
        start.x + t * (start.v + t / 2 * start.a) + s**3 * (c3 + s * (c4 + s * c5)),
        start.v + t * start.a + s**2 / h * (3 * c3 + s * (4 * c4 + s * 5 * c5)),
        start.a + s / h**2 * (6 * c3 + s * (12 * c4 + s * 20 * c5)),
    )
