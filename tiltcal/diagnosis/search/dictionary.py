"""The hypotheses that are searched: all of them at first, then those whose spectral lines appear
once the first findings are in the model.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from tiltcal.core.progress import Part, unmeasured
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_faults.quantisation_limit import needs_motion
from tiltcal.diagnosis.hypotheses.coordinate_ranges import ranges_of
from tiltcal.diagnosis.hypotheses.curve_forms import steps_beside
from tiltcal.diagnosis.hypotheses.curves import curves, periodic_curves, read_sensors
from tiltcal.diagnosis.hypotheses.hypothesis import (
    Hypothesis,
    listed_hypotheses,
    step_hypotheses,
)
from tiltcal.diagnosis.hypotheses.instants import in_each, instants
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of, wandering_of
from tiltcal.diagnosis.lines.transients import transients
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.state import State
from tiltcal.effects.learned import Learned
from tiltcal.effects.spans import SpectralLines

OFTEN = 50  # hypotheses between words on progress


def build_dictionary(
    whitened: WhitenedModel,
    fitted: FittedModel,
    lines: SpectralLines,
    part: Part = unmeasured,
) -> None:
    """Add the columns of every hypothesis.

    Args:
        whitened: what they are added to, under the noise of the calibrated scenario.
        fitted: the calibrated scenario.
        lines: spectral lines of what it leaves.
        part: is told what part of the hypotheses is done.
    """
    columns, observations = whitened.columns, whitened.observations
    effects = fitted.effects
    span = ranges_of(observations, lines)
    nuisance = [t.hypothesis for t in fitted.nuisance]
    steps = step_hypotheses(observations.scenario, instants(observations))
    every_curve = _equal_together(steps_beside(curves(observations, span)))
    listed = listed_hypotheses(observations.scenario, span, nuisance)
    passing = transients(fitted, whitened)
    every = list(_by_recording(chain(listed, steps, every_curve, passing), observations))
    for k, hypothesis in enumerate(every, 1):
        if not (observations.cut and needs_motion(hypothesis.effect)):
            columns.add(hypothesis, effects)
        if k % OFTEN == 0:
            part(k / len(every))


def _by_recording(
    hypotheses: Iterable[Hypothesis], observations: Observations
) -> Iterator[Hypothesis]:
    """Hypotheses, a line in time once for each recording."""
    for hypothesis in hypotheses:
        if hypothesis.line_hz:
            for effect in in_each(hypothesis.effect, observations.recordings):
                yield replace(hypothesis, effect=effect)
        else:
            yield hypothesis


def _equal_together(curves: Iterable[Hypothesis]) -> Iterator[Hypothesis]:
    """Curves, equal ones together: in whatever places they act, they are worked out once."""
    alike: dict[tuple[object, ...], list[Hypothesis]] = {}
    for curve in curves:
        assert isinstance(curve.effect, Learned)
        alike.setdefault(curve.effect.curve_id, []).append(curve)
    return chain.from_iterable(alike.values())


def extend_dictionary(state: State, known: SpectralLines) -> bool:
    """Add hypotheses for spectral lines of the residual that were not visible before, and for
    transients; returns whether there are any.

    Where nothing was found, wandering lines are looked for too. Beside a law that deviates from its
    textbook form that scan would find lines of the table.

    Args:
        state: the model after the first search; its hypotheses are added to.
        known: lines that have hypotheses.
    """
    fitted, whitened = state.fitted, state.whitened
    columns, observations = whitened.columns, whitened.observations
    width = 1 / float(np.ptp(observations.recordings[0].time))
    new = spectral_lines_of(observations, fitted).without(known, width)
    if not fitted.terms:
        new = replace(
            new,
            tones=(
                *new.tones,
                *SpectralLines(wandering_of(observations, fitted)).without(known, width).tones,
            ),
        )
    before = len(columns.hypotheses)
    nuisance = [t.hypothesis for t in fitted.nuisance]
    listed = listed_hypotheses(observations.scenario, ranges_of(observations, new), nuisance)
    cycles = _equal_together(periodic_curves(observations, new, sorted(read_sensors(observations))))
    named = filter(lambda h: _is_line(h, new), listed)
    for hypothesis in _by_recording(chain(named, cycles), observations):
        columns.add(hypothesis, fitted.effects)
    there = [h.effect for h in columns.hypotheses if getattr(h.effect, "instants", ())]
    for hypothesis in transients(fitted, whitened):
        if hypothesis.effect not in there:
            columns.add(hypothesis, fitted.effects)
    return len(columns.hypotheses) > before


def _is_line(hypothesis: Hypothesis, lines: SpectralLines) -> bool:
    """Whether a listed hypothesis is one of these lines, in time or over an angle."""
    ripple = hypothesis.effect.values.get("lines")
    return bool(hypothesis.law.spectral_line) and (ripple is None or ripple in lines.ripples)
