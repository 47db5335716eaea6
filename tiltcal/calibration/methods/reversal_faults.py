"""Single faults that would explain why the dwells of a reversal do not agree."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.validity import SIGNIFICANCE, Test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import rotation
from tiltcal.core.units import DEG
from tiltcal.statistics.least_squares import Fit, linear_fit

MOVED = 1e-4  # significance of a base that moves during a dwell, over all dwells and channels
DIGITS = 9  # of a p-value


@dataclass(frozen=True)
class Reversal:
    """Dwells of two horizontal channels at known angles.

    Args:
        values: locations, m/s2, (m, 2).
        whiten: of each location, (m, 2, 2).
        angles: of the table, rad, (m,).
        mount: R_mount, (3, 3).
    """

    values: Array
    whiten: Array
    angles: Array
    mount: Array

    def turn(self, k: int, angle: float) -> Array:
        """Base-frame horizontal force to reading, (2, 2)."""
        return np.asarray((self.mount.T @ rotation("z", -angle))[:2, :2])

    def fit(
        self, angles: Array, extra: Array | None = None, keep: Sequence[int] | None = None
    ) -> Fit:
        """Least squares for the horizontal force and both constants; ``extra`` (m, 2, p): further
        columns.
        """
        rows, target = [], []
        for k in range(len(angles)) if keep is None else keep:
            columns = np.hstack([self.turn(k, float(angles[k])), np.eye(2)])
            if extra is not None:
                columns = np.hstack([columns, extra[k]])
            rows.append(self.whiten[k] @ columns)
            target.append(self.whiten[k] @ self.values[k])
        names = [f"p{i}" for i in range(rows[0].shape[1])]
        return linear_fit(names, np.vstack(rows), np.concatenate(target))


def solve(reversal: Reversal) -> Fit:
    """The fit with everything as it was read."""
    return reversal.fit(reversal.angles)


def explain(reversal: Reversal) -> str | None:
    """The fault that makes the dwells agree best, in words; None when none does. Of faults that
    agree alike rounding must not choose.
    """
    found = [(round(p, DIGITS), words) for p, words in _hypotheses(reversal) if p > SIGNIFICANCE]
    return max(found)[1] if found else None


def _hypotheses(r: Reversal) -> Iterator[tuple[float, str]]:
    m = len(r.angles)
    for k in range(m - 1):
        swapped = r.angles.copy()
        swapped[[k, k + 1]] = swapped[[k + 1, k]]
        if abs(np.angle(np.exp(1j * (swapped[k] - r.angles[k])))) > 1 * DEG:
            words = (
                f"positions {k + 1} and {k + 2} fit if their order is exchanged: check the angles,"
                " repeat them"
            )
            yield _p(r.fit(swapped)), words
    exchanged = Reversal(r.values[:, ::-1], r.whiten[:, ::-1, ::-1], r.angles, r.mount)
    swapped_columns = (
        "they fit if the columns x and y are swapped: check the wiring, or the names of the columns"
    )
    yield _p(exchanged.fit(r.angles)), swapped_columns
    for k in range(1, m):
        moved = np.zeros((m, 2, 2))
        for j in range(k, m):
            moved[j] = r.turn(j, float(r.angles[j]))
        yield (
            _p(r.fit(r.angles, moved)),
            f"the base moved between positions {k} and {k + 1}: repeat them",
        )
    for k in range(m):
        rest = r.fit(r.angles, keep=[j for j in range(m) if j != k])
        if len(rest.names) == 4:
            yield _p(rest), _wrong_angle(r, rest, k)


def _wrong_angle(r: Reversal, rest: Fit, k: int) -> str:
    """The angle of the table that fits the reading of one dwell best, with tilt and constants from
    the others.
    """
    seen = r.values[k] - rest.values[2:]
    trial = np.arange(-180.0, 180.0, 0.05) * DEG
    left = np.array([np.linalg.norm(seen - r.turn(k, float(a)) @ rest.values[:2]) for a in trial])
    angle = float(trial[int(np.argmin(left))]) / DEG
    return (
        f"position {k + 1} disagrees with the others: it reads as {angle:.4g} deg, not"
        f" {r.angles[k] / DEG:.4g}; repeat it"
    )


def _p(fit: Fit) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(fit.dof, fit.chi2)) if fit.dof > 0 and not fit.dropped else 0.0


def still_test(halves: Array, sigma: Array) -> Test:
    """Whether the base stood still during each dwell: means of its two halves agree.

    Args:
        halves: second half minus first of each dwell and channel, (m, k).
        sigma: standard deviation of each difference, (m, k).
    """
    from scipy.special import chdtrc

    z = halves / sigma
    worst = int(np.argmax(np.abs(z).max(axis=1)))
    p = float(chdtrc(1, float(np.abs(z[worst]).max()) ** 2))
    ok = p > MOVED / z.size
    largest = float(np.abs(z).max())
    words = f"the halves of each dwell agree (worst: {largest:.2g} sigma)"
    if not ok:
        words = (
            f"the base or the bias moved during position {worst + 1}: its halves differ by"
            f" {largest:.2g} sigma"
        )
    return Test("still while dwelling", largest, 0, p, ok, words)
