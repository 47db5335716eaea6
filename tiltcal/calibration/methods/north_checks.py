"""What the positions of a north-seeker say of their own result: tests and notes.

Random walk of a FOG's bias over a turn of the table, from what repeats and what dwells show.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from tiltcal.calibration.methods.reversal_faults import Reversal, explain
from tiltcal.calibration.methods.reversal_faults import solve as reversal_fit
from tiltcal.calibration.methods.turntable import Turntable, start_of
from tiltcal.calibration.screen.columns import unit_test
from tiltcal.calibration.validity import Test, chi2_test, threshold_test
from tiltcal.core.arrays import Array
from tiltcal.core.units import ARCSEC, DEG, DEG_H, EARTH_RATE
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.least_squares import Fit

PARTS = 4  # of each dwell
# of the walk's variance over the log, in units of the white variance of a part
RATIOS = np.concatenate([[0.0], np.logspace(-2, 6, 33)])


def split_dwells(segments: Sequence[Segment]) -> list[Segment]:
    """Each dwell in PARTS of equal numbers of samples."""
    found = []
    for s in segments:
        rows = np.linspace(s.first, s.last, PARTS + 1).round().astype(int)
        times = np.linspace(s.start, s.end, PARTS + 1)
        for k in range(PARTS):
            part = replace(s, start=float(times[k]), end=float(times[k + 1]))
            found.append(replace(part, first=int(rows[k]), last=int(rows[k + 1])))
    return found


def walk_density(rate: Array, variance: Array, time: Array, columns: Array) -> float:
    """Variance that the bias gains a second, (rad/s)^2/s: its posterior mean.

    The restricted likelihood of the parts' means, with the regression on the columns integrated
    out; prior: no walk or one of any size, with equal odds, its logarithm uniform.

    Args:
        rate: mean of each part, rad/s, (n,).
        variance: of it by white noise, (n,).
        time: of the middle of each part, s, (n,).
        columns: what else the parts respond to, (n, p): a constant and the Earth's rate.

    Source: Patterson and Thompson, Biometrika 58 (1971).
    """
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    basis = u[:, s > 1e-8 * s[0]]
    elapsed = time - time[0]
    walk = np.minimum(elapsed[:, None], elapsed[None, :]) / max(float(elapsed[-1]), 1e-9)
    white = float(np.mean(variance))
    score = np.array(
        [_restricted(rate, np.diag(variance) + r * white * walk, basis) for r in RATIOS]
    )
    prior = np.full(len(RATIOS), 0.5 / (len(RATIOS) - 1))
    prior[0] = 0.5
    weight = prior * np.exp(score - score.max())
    ratio = float(weight @ RATIOS / weight.sum())
    return ratio * white / max(float(elapsed[-1]), 1e-9)


def _restricted(y: Array, C: Array, X: Array) -> float:
    """Restricted log-likelihood of y with covariance C after regression on X."""
    factor = np.linalg.cholesky(C)
    a = np.linalg.solve(factor, np.column_stack([y, X]))
    z, A = a[:, 0], a[:, 1:]
    q, r = np.linalg.qr(A)
    left = z - q @ (q.T @ z)
    log_det = 2 * np.log(np.diag(factor)).sum() + 2 * np.log(np.abs(np.diag(r))).sum()
    return float(-(log_det + left @ left) / 2)


def walk_covariance(start: Array, end: Array, density: float) -> Array:
    """Covariance of the means of a random walk over dwells, (m, m).

    Args:
        start, end: of each dwell, s, (m,).
        density: variance gained a second.
    """
    middle = (start + end) / 2 - start[0]
    C = np.minimum(middle[:, None], middle[None, :])
    C[np.diag_indices(len(middle))] -= (end - start) / 6
    return np.asarray(density * C)


REPEATED = 5 * DEG
SEEN = 5.0  # sigmas of the horizontal Earth rate, from which its size says what the unit is


def north_tests(
    table: Turntable,
    fit: Fit,
    rivals: list[float],
    tilt: tuple[float, float],
    fog: Sensor,
    unit: str,
) -> list[Test]:
    """Consistency of the positions, size of the horizontal Earth rate, resolution.

    Args:
        table, fit: of the positions.
        rivals: headings that the FOG cannot distinguish, rad.
        tilt: roll and pitch, rad.
        fog, unit: the FOG and the unit of its column.
    """
    tests = []
    if fit.dof > 0:
        tests.append(_fit_test(table, fit))
    tests += _earth_rate_test(table, tilt, fog, unit)
    tests.append(_resolution_test(fit, rivals))
    return tests


def _fit_test(table: Turntable, fit: Fit) -> Test:
    positions = f"{len(table.angles)} positions"
    test = chi2_test("fit", fit.chi2, fit.dof, f"{positions} agree within their noise")
    if test.passed or table.force is None:
        return test
    level = Reversal(*table.force, table.angles, table.mount, table.references[1])
    tilts = reversal_fit(level)
    words = f"{positions} do not agree within their noise; "
    if chi2_test("", tilts.chi2, tilts.dof, "").passed:
        words += "the tilts agree: the FOG's bias or scale, or an angle that the tilts cannot see"
    else:
        words += explain(level)
    return replace(test, statement=words)


def _earth_rate_test(
    table: Turntable, tilt: tuple[float, float], fog: Sensor, unit: str
) -> list[Test]:
    """Is the horizontal Earth rate what the latitude says? None where the positions cannot
    determine it.
    """
    axes = table.input_axes(*tilt)
    columns = np.column_stack([np.ones(len(axes)), axes[:, 0], axes[:, 1]])
    design = table.fog_whiten @ columns
    if len(axes) <= 2 or np.linalg.cond(design / np.linalg.norm(design, axis=0)) >= 30:
        return []
    vertical = axes[:, 2] * EARTH_RATE * np.sin(table.latitude)
    x = np.linalg.lstsq(design, table.fog_whiten @ (table.fog - vertical), rcond=None)[0]
    C = np.linalg.inv(design.T @ design)[1:, 1:]
    size = float(np.hypot(x[1], x[2]))
    sigma = float(np.sqrt(x[1:] @ C @ x[1:])) / size
    expected = EARTH_RATE * np.cos(table.latitude)
    words = (
        f"the horizontal Earth rate is {size / expected:.4f} +- {sigma / expected:.4f} of what"
        " the latitude says"
    )
    test = chi2_test("horizontal Earth rate", ((size - expected) / sigma) ** 2, 1, words)
    if test.passed:
        return [test]
    causes = ": the latitude, the FOG's scale factor, its input_axis or its unit is another"
    found = [replace(test, statement=words + causes)]
    if size > SEEN * sigma:
        found.append(unit_test(fog, size / expected, unit))
    return found


def _resolution_test(fit: Fit, rivals: list[float]) -> Test:
    """Is the azimuth known well enough? Near north the two headings of one cosine coincide."""
    determined = fit.names[:1] == ("base.azimuth",)
    sigma = float(np.sqrt(fit.covariance[0, 0])) if determined else np.inf
    gaps = [abs(wrapped(h - k)) for h, k in combinations(rivals, 2)]
    enough = sigma < min([5 * DEG, *(gap / 6 for gap in gaps)])
    words = f"azimuth known to {sigma / DEG:.2g} deg"
    if not enough:
        words += ": stay longer, or turn the FOG's axis off north"
    return threshold_test("resolution", min(sigma / DEG, 1e6), enough, words)


def north_notes(
    table: Turntable, fit: Fit, rivals: list[float], sure: bool, roll: float, pitch: float
) -> list[str]:
    """Ambiguity of the azimuth, and the effect of the tilt correction. roll, pitch: of the base,
    rad.
    """
    notes = []
    if not sure:
        others = " or ".join(f"{table.azimuth(h, roll, pitch) / DEG:.4g} deg" for h in rivals)
        notes.append(
            f"the sign cannot be determined: azimuth {others}. Two positions give its cosine only:"
            " record at 90 and 270 deg too, or state --option near_deg=... and near_error_deg=..."
        )
    if table.force is None:
        worst = np.tan(abs(table.latitude))
        notes.append(
            "no tilt correction: each arcsec of tilt along the FOG's axis changes the azimuth by up"
            f" to {worst:.2g}/|sin psi| arcsec"
        )
        return notes
    flat = replace(table, force=None)
    azimuths = [flat.azimuth(h, 0.0, 0.0) for h in start_of(flat)[3]]
    difference = min((wrapped(a - float(fit.values[0])) for a in azimuths), key=abs)
    notes += [
        f"without the tilt correction the azimuth would be {difference / ARCSEC:.4g} arcsec"
        f" ({difference / DEG:.3g} deg) off",
        "base.* is the tilt of the table's rotation axis; bias_x and bias_y of the accelerometers"
        " are bias plus mounting",
    ]
    return notes


def walk_note(density: float, angles: Array) -> str:
    """The random walk of the FOG's bias in words, and whether a position was repeated. angles: of
    the positions, rad, (n,).
    """
    words = (
        f"random walk of the FOG's bias: {np.sqrt(density * 3600) / DEG_H:.3g} deg/h per square"
        " root of an hour; its share is in the azimuth's sigma"
    )
    apart = np.abs(np.angle(np.exp(1j * (angles[:, None] - angles[None, :]))))
    if not np.any(np.triu(apart < REPEATED, 1)):
        words += "; no position was repeated (A-B-A), so it is seen inside the dwells only"
    return words


def wrapped(angle: float) -> float:
    """An angle in -pi ... pi. angle: rad."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
