"""Whether a law of temperature is lagged: a curve over temperature alone has no separate branches
for warming and cooling.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.design.identifiability import SEPARABLE
from tiltcal.diagnosis.model.cosine_basis import project
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.removed_finding import RemovedFinding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import LOOSE
from tiltcal.effects.base import Effect
from tiltcal.effects.learned import LearnedReading
from tiltcal.statistics.noise_spectrum import cosines
from tiltcal.statistics.projection import column_space

KNOTS = 5  # of a curve over temperature: bends as a quartic does
BRANCHES = {"temperature", "warming"}  # coordinates of laws in which warming and cooling differ


def thermal_lag_findings(
    inside: Sequence[FittedTerm],
    removed: RemovedFinding,
    fitted: FittedModel,
    whitened: WhitenedModel,
) -> tuple[str, tuple[str, ...]]:
    """What is said of a finding that follows a lagged temperature, and the named laws that explain
    as much where no single lag does.

    Curves over temperature without lag are fitted in its place first; what the finding explains
    beyond them is the difference between warming and cooling. Each law of such a difference is then
    fitted beside these curves.

    Args:
        inside: the terms of the finding.
        case: the finding taken out of its fitted model.
    """
    late = [
        e
        for t in inside
        if isinstance(e := t.hypothesis.effect, LearnedReading)
        and e.coordinate == "temperature"
        and e.lag
    ]
    if not late:
        return "", ()
    target = np.concatenate(removed.target)
    left = np.concatenate([t - s for t, s in zip(removed.target, removed.signal, strict=True)])
    gain = float(target @ target - left @ left)
    still = _block(_curves(late[0], whitened), removed, fitted, whitened)
    beyond = gain - _gain(still, target)
    if beyond < SEPARABLE + LOOSE * gain:
        return "", ()
    shares: dict[str, float] = {}
    for h in whitened.hypotheses:
        branches = set(h.law.family.reading) >= BRANCHES
        if branches and h.effect.sensor == late[0].sensor:
            own = _block([(h.effect, h.names)], removed, fitted, whitened)
            more = _gain(np.column_stack([still, own]), target) - _gain(still, target)
            shares[h.id] = max(shares.get(h.id, 0.0), more / beyond)
    ordered = sorted(shares.items(), key=lambda item: -item[1])
    told = ", ".join(f"{id} {min(share, 1.0):.0%}" for id, share in ordered)
    words = (
        " No curve over temperature alone explains it: warming and cooling differ, as with a"
        " thermal lag or hysteresis"
    )
    words += f" (beside such a curve, {told} of the difference)." if told else "."
    if all(getattr(t.hypothesis.effect, "lag", 0.0) == late[0].lag for t in inside):
        return words, ()  # one lag explains it: no other law is needed
    least = SEPARABLE + LOOSE * gain
    return words, tuple(id for id, share in sorted(shares.items()) if (1 - share) * beyond < least)


def _curves(
    late: LearnedReading, whitened: WhitenedModel
) -> Iterator[tuple[Effect, Sequence[str]]]:
    """Curves over temperature without lag, on all axes of the sensor."""
    curves = (
        s.effect
        for s in whitened.hypotheses
        if isinstance(s.effect, LearnedReading) and s.effect.knots
    )
    # a law with one number has no knots of its own
    over = next(e.knots for e in curves if e.coordinate == late.coordinate)
    names = [f"c{k}" for k in range(KNOTS)]
    still = replace(
        late,
        lag=0.0,
        per_input=False,
        power=0.0,
        odd=False,
        knots=tuple(map(float, np.linspace(over[0], over[-1], KNOTS))),
        values=dict.fromkeys(names, 1e-6),
    )
    for axis in whitened.observations.scenario.named(str(late.sensor)).axes:
        yield replace(still, axis=axis), names


def _block(
    effects: Iterable[tuple[Effect, Sequence[str]]],
    removed: RemovedFinding,
    fitted: FittedModel,
    whitened: WhitenedModel,
) -> Array:
    """Whitened columns of some sizes without their part in the basis, (n, p)."""
    found = []
    for effect, names in effects:
        total = [np.zeros((len(names), len(s))) for s in removed.signal]
        for i, (which, block) in whitened.observations.columns(
            effect, names, fitted.effects
        ).items():
            total[i][which] = cosines(block) / whitened.roots[i]
        found += [
            np.concatenate(project(removed.basis, [part[k] for part in total]))
            for k in range(len(names))
        ]
    return np.column_stack(found)


def _gain(columns: Array, target: Array) -> float:
    return float(np.sum((column_space(columns).T @ target) ** 2))
