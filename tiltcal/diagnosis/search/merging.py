"""Findings that are one: a small one of the same kind as a large one, or one cause at two
shapes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, refit
from tiltcal.diagnosis.model.removed_finding import remove_finding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.alternatives import (
    LOOSE,
    OWN,
)
from tiltcal.effects.base import Effect
from tiltcal.effects.electronics.mains import WANDER
from tiltcal.effects.table.readout import ReadoutError


def merge_small_findings(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model with small findings made part of a much larger one in the same channels that
    the same kind of motion excites.

    A law that deviates by some per cent from its textbook form leaves a residual of its own kind,
    and a related effect absorbs it. The share is counted of what the law explains without that
    effect, because both may explain nearly the same.
    """
    groups = fitted.findings()

    def power_of(places: Sequence[int]) -> Array:
        return np.array([float(s @ s) for s in remove_finding(fitted, whitened, places).signal])

    power = [power_of(places) for places in groups]
    hosts = {}
    for j, small in enumerate(groups):
        mine = fitted.terms[small[0]].hypothesis.effect
        for k, large in enumerate(groups):
            other = fitted.terms[large[0]].hypothesis.effect
            share = _left_over(mine, other) if j != k else 0.0
            if not share or k in hosts:
                continue
            alone = power_of(sorted([*small, *large])) - power[j]
            inside = (
                share == 1
                or np.minimum(power[j], share * np.maximum(alone, 0.0)).sum() > OWN * power[j].sum()
            )
            if inside and power[j].sum() < min(share * alone.sum(), power[k].sum()):
                hosts[j] = k
    if not hosts:
        return fitted
    terms: list[FittedTerm] = []
    for k, places in enumerate(groups):
        if k in hosts:
            continue
        terms += [fitted.terms[i] for i in places]
        host = fitted.terms[places[0]].hypothesis
        terms += [
            replace(fitted.terms[i], host=host)
            for j, large in hosts.items()
            if large == k
            for i in groups[j]
        ]
    return refit(replace(fitted, terms=tuple(terms)), whitened)


def _left_over(small: Effect, large: Effect) -> float:
    """Share of the energy of a large effect that may remain in the form of a small one.

    All of it where a line wanders: it leaves lines beside it. Effects of the same motion, or
    harmonics of one encoder, deviate from their textbook form. Laws of one sensor's own input are
    separated to a thousandth.
    """
    both = (small, large)
    if all(e.spectral_line == "time" for e in both):
        near = abs(small.value("frequency") - large.value("frequency")) < WANDER
        return 1.0 if near else 1 - OWN
    readouts = all(isinstance(e, ReadoutError) for e in both) and small.axis == large.axis
    if small.needs == large.needs in KINDS or readouts:
        return 1 - OWN
    of_input = all(e.nonlinear_in_input for e in both) and small.sensor == large.sensor
    return LOOSE if of_input else 0.0


def merge_same_cause(fitted: FittedModel) -> FittedModel:
    """The fitted model with a second finding of the same name and place made part of the first: one
    law at a further shape.
    """
    groups = fitted.findings()
    order: list[list[FittedTerm]] = []
    for places in groups:
        inside = [fitted.terms[k] for k in places]
        mine = inside[0].hypothesis
        first = next(
            (
                g
                for g in order
                if g[0].hypothesis.place == mine.place and _one_event(g[0].hypothesis, mine)
            ),
            None,
        )
        if first is None:
            order.append(inside)
        else:
            first += [replace(t, host=first[0].hypothesis) for t in inside]
    return (
        fitted
        if len(order) == len(groups)
        else replace(fitted, terms=tuple(t for g in order for t in g))
    )


def _one_event(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two findings of one name are one event: steps, one of which creeps, within its time
    constant of each other.
    """
    if not one.has_instant:
        return True
    creeps = [s.effect.values.get("creep", 0.0) for s in (one, other)]
    apart = abs(one.effect.values["time"] - other.effect.values["time"])
    return min(creeps) == 0 and apart < max(creeps)


KINDS = ("motion", "direction", "vibration")  # of excitation, whose laws are alike
