"""Single faults that would explain why the dwells of a reversal do not agree."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tiltcal.calibration.screen.explanations import Explanation, explanation, in_words
from tiltcal.calibration.validity import Test
from tiltcal.core.arrays import Array
from tiltcal.core.frames import rotation
from tiltcal.core.units import DEG
from tiltcal.recordings.references import NO_REFERENCES, References
from tiltcal.statistics.least_squares import Fit, linear_fit

STEP = 0.05  # deg, of the angles that are tried for a position that disagrees
MOVED = 1e-4  # significance of a base that moves during a dwell, over all dwells and channels


@dataclass(frozen=True)
class Reversal:
    """Dwells of two horizontal channels at known angles.

    Args:
        values: locations, m/s2, (m, 2).
        whiten: of each location, (m, 2, 2).
        angles: of the table, rad, (m,).
        mount: R_mount, (3, 3).
        references: what uncertain references add to the locations, of these two channels.
    """

    values: Array
    whiten: Array
    angles: Array
    mount: Array
    references: References = NO_REFERENCES

    def turn(self, k: int, angle: float) -> Array:
        """Base-frame horizontal force to reading, (2, 2). angle: of the table at the dwell k,
        rad.
        """
        return np.asarray((self.mount.T @ rotation("z", -angle))[:2, :2])

    def fit(
        self, angles: Array, extra: Array | None = None, keep: Sequence[int] | None = None
    ) -> Fit:
        """Least squares for the horizontal force and both constants; ``extra`` (m, 2, p): further
        columns.
        """
        rows, target = [], []
        kept = list(range(len(angles)) if keep is None else keep)
        for k in kept:
            columns = np.hstack([self.turn(k, float(angles[k])), np.eye(2)])
            if extra is not None:
                columns = np.hstack([columns, extra[k]])
            rows.append(self.whiten[k] @ columns)
            target.append(self.whiten[k] @ self.values[k])
        names = [f"p{i}" for i in range(rows[0].shape[1])]
        common = self.references.at(np.array(kept)).whitened(self.whiten[kept])
        return linear_fit(names, np.vstack(rows), np.concatenate(target), common)


def solve(reversal: Reversal) -> Fit:
    """The fit with everything as it was read."""
    return reversal.fit(reversal.angles)


def explain(reversal: Reversal, time: Array | None = None) -> str:
    """The single faults that make the dwells agree, those that fit alike as one class, in words.
    time: (n,).

    Args:
        reversal: that does not fit.
        time: of each dwell, s; their number unless given.
    """
    when = np.arange(len(reversal.angles), dtype=float) if time is None else time
    tried = [*_swaps(reversal), *_columns(reversal), *_changes(reversal, when)]
    return in_words(tried, "no single fault explains it")


def _swaps(r: Reversal) -> Iterator[Explanation]:
    """Two dwells exchanged; one dwell at another angle."""
    m = len(r.angles)
    n = 2 * m
    pairs = [(i, j) for i, j in combinations(range(m), 2) if _apart(r.angles[i], r.angles[j])]
    for i, j in pairs:
        swapped = r.angles.copy()
        swapped[[i, j]] = swapped[[j, i]]
        words = f"positions {i + 1} and {j + 1} are in another order: check the angles, repeat them"
        yield explanation(words, r.fit(swapped), len(pairs))
    for k in range(m):
        rest = r.fit(r.angles, keep=[j for j in range(m) if j != k])
        if len(rest.names) == 4:
            yield explanation(_wrong_angle(r, rest, k), rest, m, readings=n)


def _apart(a: float, b: float) -> bool:
    return bool(abs(np.angle(np.exp(1j * (a - b)))) > 1 * DEG)


def _columns(r: Reversal) -> Iterator[Explanation]:
    """Columns swapped, a sign reversed, the angle counted the other way."""
    swapped = r.references.of([1, 0])
    exchanged = Reversal(r.values[:, ::-1], r.whiten[:, ::-1, ::-1], r.angles, r.mount, swapped)
    words = "the columns x and y are swapped: check the wiring, or the names of the columns"
    yield explanation(words, exchanged.fit(r.angles), 4)
    for i, axis in enumerate("xy"):
        sign = np.where(np.arange(2) == i, -1.0, 1.0)
        turned = r.references.of([0, 1], sign)
        whiten = r.whiten * sign * sign[:, None]
        flipped = Reversal(r.values * sign, whiten, r.angles, r.mount, turned)
        words = f"the sign of {axis} is reversed"
        yield explanation(words, flipped.fit(r.angles), 4)
    words = "the table turns in the other sense than its readout: the sign of the angle is reversed"
    yield explanation(words, r.fit(-r.angles), 4)


def _changes(r: Reversal, time: Array) -> Iterator[Explanation]:
    """The base moved between two dwells; both constants drift; they jumped between two dwells."""
    m = len(r.angles)
    for k in range(1, m):
        after = (np.arange(m) >= k)[:, None, None]
        turned = np.array([r.turn(j, float(a)) for j, a in enumerate(r.angles)])
        between = f"between positions {k} and {k + 1}: repeat them"
        yield explanation(f"the base moved {between}", r.fit(r.angles, after * turned), m - 1)
        jumped = r.fit(r.angles, after * np.eye(2))
        yield explanation(f"the bias or the mounting changed {between}", jumped, m - 1)
    elapsed = (time - time[0])[:, None, None] / max(float(np.ptp(time)), 1e-9)
    words = "the bias drifts: repeat the first position at the end (A-B-A)"
    yield explanation(words, r.fit(r.angles, elapsed * np.eye(2)))


def _wrong_angle(r: Reversal, rest: Fit, k: int) -> str:
    """The angle of the table that fits the reading of one dwell best, with tilt and constants from
    the others.
    """
    seen = r.values[k] - rest.values[2:]
    trial = np.arange(-180.0, 180.0, STEP) * DEG
    east, north = rest.values[:2]
    cos, sin = np.cos(trial), np.sin(trial)
    turned = r.mount.T[:2, :2] @ np.array([cos * east + sin * north, cos * north - sin * east])
    left = np.linalg.norm(seen[:, None] - turned, axis=0)
    angle = float(trial[int(np.argmin(left))])
    off = float(np.angle(np.exp(1j * (angle - r.angles[k])))) / DEG
    what = (
        f"it fits {off:+.2f} deg off its angle"
        if abs(off) > STEP
        else "and no other angle fits it better"
    )
    return f"position {k + 1} disagrees with the others, {what}; repeat it"


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
