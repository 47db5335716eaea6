"""Poses of known attitude that do not fit: the single causes that would explain them, compared."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from tiltcal.calibration.methods.common import fitted_sensitivity
from tiltcal.calibration.methods.known_attitude_model import DRIFT, Model, solve
from tiltcal.calibration.screen.columns import column_orders, columns_in_words
from tiltcal.calibration.screen.explanations import Explanation, explanation
from tiltcal.core.arrays import Array
from tiltcal.core.frames import AXES, angle_between
from tiltcal.core.units import DEG
from tiltcal.recordings.static_poses import Poses
from tiltcal.statistics.least_squares import Fit

SUSPECTS = 8  # dwells that are tried at other attitudes: those that spoil the fit most
OTHER = 10 * DEG  # from the stated direction: another face
PLAUSIBLE = 0.5  # a sensitivity matrix further from its gain times 1 is that of other columns
FACES = {
    f"{'+' if s > 0 else '-'}{a}": s * np.eye(3)[i] for i, a in enumerate(AXES) for s in (1, -1)
}


def gain(M: Array) -> float:
    """The common gain of a sensitivity matrix: cube root of its determinant's size. M: (3, 3)."""
    return float(max(abs(np.linalg.det(M)), 1e-300) ** (1 / 3))


def is_plausible(M: Array) -> bool:
    """Whether every channel of a triad senses its own axis, whatever the unit. M: (3, 3)."""
    return bool(np.abs(M / gain(M) - np.eye(3)).max() < PLAUSIBLE)


def causes(poses: Poses, model: Model, fit: Fit) -> list[Explanation]:
    """Every single cause that was tried: attitudes, columns, drift, second order.

    Those that leave an implausible sensitivity are left out.
    """
    tried = [*_attitudes(poses, model, fit), *_columns(poses, model), *_terms(poses, model)]
    return [e for e, part in tried if is_plausible(fitted_sensitivity(part, poses.sensor.name))]


def _attitudes(poses: Poses, model: Model, fit: Fit) -> Iterator[tuple[Explanation, Fit]]:
    """Two dwells exchanged; one dwell at another face; one dwell off its attitude."""
    suspects = _suspects(poses, model)
    pairs = list(combinations(suspects, 2))
    n = len(fit.residuals)
    for i, j in pairs:
        if angle_between(poses.up[i], poses.up[j]) > OTHER:
            up = poses.up.copy()
            up[[i, j]] = up[[j, i]]
            part, _ = solve(replace(poses, up=up), model)
            first, second = sorted(poses.spans[k].start_s for k in (i, j))
            times = f"{first:.6g} s and {second:.6g} s"
            yield explanation(f"these two are swapped: {times}", part, len(pairs)), part
    for k in suspects:
        span, stated = poses.spans[k], poses.spans[k].label or "by the readout"
        others = [f for f, e in FACES.items() if angle_between(e, poses.up[k]) > OTHER]
        for face in others:
            up = poses.up.copy()
            up[k] = FACES[face]
            part, _ = solve(replace(poses, up=up), model)
            words = f"the dwell at {span.start_s:.6g} s is stated {stated} but reads {face}"
            yield explanation(words, part, len(poses) * len(others)), part
        rest = np.arange(len(poses)) != k
        part, _ = solve(poses.subset(rest), model)
        words = f"the dwell at {span.start_s:.6g} s is off its stated attitude ({stated})"
        yield explanation(words, part, len(poses), readings=n), part


def _suspects(poses: Poses, model: Model) -> list[int]:
    """The dwells without which the others fit best."""
    left = []
    for k in range(len(poses)):
        rest, _ = solve(poses.subset(np.arange(len(poses)) != k), model)
        left.append(rest.chi2)
    return [int(k) for k in np.argsort(left)[:SUSPECTS]]


def _columns(poses: Poses, model: Model) -> Iterator[tuple[Explanation, Fit]]:
    """Columns in another order, or with another sign."""
    for order, signs in column_orders():
        if order == (0, 1, 2) and signs == (1, 1, 1):
            continue
        columns = list(order)
        other = replace(
            poses,
            means=poses.means[:, columns] * np.array(signs),
            noise=poses.noise[np.ix_(columns, columns)] * np.outer(signs, signs),
            rounding=poses.rounding[:, columns],
        )
        part, _ = solve(other, model)
        named = columns_in_words(order, signs)
        words = f"the columns x, y, z hold the axes {named}: swapped, or of another sign"
        yield explanation(words, part, 47), part


def _terms(poses: Poses, model: Model) -> Iterator[tuple[Explanation, Fit]]:
    """Terms that the model lacks."""
    further = {
        DRIFT: "the bias drifts over the recording (--option terms with drift fits it)",
        "K2": "a quadratic term K2",
        "K3": "a cubic term K3",
    }
    for term, words in further.items():
        if term not in model.terms:
            part, _ = solve(poses, replace(model, terms=[*model.terms, term]))
            if not part.dropped:
                yield explanation(words, part), part
