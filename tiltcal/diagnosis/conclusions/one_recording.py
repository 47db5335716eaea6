"""What a curve without a cause says of other recordings.

A curve over time, or over how many moves there were, is the history of one recording. Another one
begins with the instrument in a state that is not known: it keeps the mean of the curve over the
recording, which is what a model without the curve predicts. Several recordings that one such curve
fits do say that it repeats.

In which of several recordings an event happened or a line in time is, and what else may differ
between two.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.families import completes
from tiltcal.diagnosis.hypotheses.instants import Instant, recording_of
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.search.candidates import Names
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect
from tiltcal.effects.curve_coordinates import coordinate_named
from tiltcal.effects.learned import Learned
from tiltcal.recordings.recording import Recording, stem
from tiltcal.statistics.dwell_noise import second_difference_noise


def place_of(effects: Sequence[Effect], recordings: Sequence[Recording]) -> str | None:
    """The recording that an event happened in, or the two that it happened between; those that hold
    a line in time. None where there is one recording only, or where all hold it.

    Args:
        effects: of one finding, the leading one first.
        recordings: that were diagnosed.
    """
    if len(recordings) == 1 or effects[0].seen_in is None:
        return None
    names = [stem(r.source) for r in recordings]
    number = recording_of(effects[0], recordings)
    if "time" in effects[0].values:
        pause = Instant.of(effects[0]).in_pause
        return (
            f"between {names[number - 1]} and {names[number]}" if pause else f"in {names[number]}"
        )
    held = sorted({recording_of(e, recordings) for e in effects if e.seen_in is not None})
    return f"in {' and '.join(names[k] for k in held)}" if len(held) < len(names) else None


def beside_drawn_anew(names: Names, effect: Effect) -> Names:
    """The names of an event; where it lies between two recordings, each with those of effects that
    are drawn anew for each recording: they look alike and are as probable.
    """
    if "time" not in effect.values or not Instant.of(effect).in_pause:
        return names
    probability: dict[str, float] = {}
    for name, chance in names.probability.items():
        same = _drawn_anew(name)
        probability |= dict.fromkeys(same, chance / len(same))
    alike = dict.fromkeys(other for name in names.alike for other in _drawn_anew(name))
    return replace(names, alike=tuple(alike), probability=probability)


def _drawn_anew(name: str) -> tuple[str, ...]:
    """An event and the effects that look like it between two recordings."""
    return name, *(id for id, cls in CATALOGUE.items() if cls.like_event == name)


def is_history(effect: Effect, observations: Observations) -> bool:
    """Whether a curve tells the history of the only recording there is: a cycle, whose phase
    another one does not have, among them.
    """
    if not isinstance(effect, Learned) or len(observations.recordings) > 1:
        return False
    once = bool(effect.knots or effect.power) and not effect.period
    unique = coordinate_named(effect.coordinate).is_history
    return unique and (once or effect.coordinate == "time")


def mean_and_deviations(
    fitted: FittedModel,
    places: Sequence[int],
    effects: Sequence[Effect],
    observations: Observations,
) -> list[Effect]:
    """The effects of a finding, as the amended scenario would hold them; of those that are the
    history of one recording their mean over it, which lasts, and what is left of them, which does
    not.

    Of a finding without a name that a history leads, what completes its form is one, too; of any,
    further histories and events. Of a listed law the histories that are no form of its own are.

    Args:
        fitted: the whole model.
        places: of the finding's terms in it.
        effects: of those terms.
        observations: the recordings.
    """
    told = [k for k in range(len(places)) if _ends(k, fitted, places, effects, observations)]
    if not told:
        return list(effects)
    levels = [_level(effects[k]) for k in told]
    own = [fitted.terms[places[k]].effect for k in told]
    changes = [
        [_stacked(observations.changes(e, fitted.effects), observations) for e in group]
        for group in (levels, own)
    ]
    shares = np.linalg.lstsq(np.column_stack(changes[0]), sum(changes[1]), rcond=None)[0]
    means = [_times(level, share) for level, share in zip(levels, shares, strict=True)]
    first = observations.recordings[0].fingerprint
    rest = [*(effects[k] for k in told), *(_times(mean, -1.0) for mean in means)]
    lasting = [e for k, e in enumerate(effects) if k not in told]
    return [*lasting, *means, *(replace(e, seen_in=first, lasts=False) for e in rest)]


def _ends(
    k: int,
    fitted: FittedModel,
    places: Sequence[int],
    effects: Sequence[Effect],
    observations: Observations,
) -> bool:
    """Whether the k-th term of a finding ends with the only recording there is."""
    lead, term = (fitted.terms[places[i]].hypothesis for i in (0, k))
    own = k == 0 or completes(term, lead)
    history = is_history(effects[k], observations)
    if lead.listed:
        return history and not own
    led = own and is_history(effects[0], observations)
    return history or led or _is_event(effects[k], observations)


def _is_event(effect: Effect, observations: Observations) -> bool:
    """Whether an effect began at an instant of the only recording there is."""
    event = effect.acts_from_an_instant and effect.stage != "data"
    return event and len(observations.recordings) == 1


def _times(effect: Effect, factor: float) -> Effect:
    sizes = {n: factor * v for n, v in effect.sizes.items()}
    return replace(effect, values={**effect.values, **sizes})


def _level(effect: Effect) -> Effect:
    """A constant in the place of a curve, of the curve's size; an event that began with the first
    sample, at once.
    """
    if not isinstance(effect, Learned):
        at_once = {**effect.values, **{n: 0.0 for n in ("time", "creep") if n in effect.values}}
        return replace(effect, values=at_once, sigmas={}, seen_in=None)
    size = float(np.abs(effect.coefficients).max()) or 1.0
    ends = (0.0, 1.0)
    return replace(
        effect,
        values={"c0": size, "c1": size},
        sigmas={},
        knots=ends,
        period=0.0,
        power=0.0,
        odd=False,
        instants=(),
    )


def _stacked(columns: Columns, observations: Observations) -> Array:
    """The changes of all channels, each in units of its white noise, (n,)."""
    return np.concatenate(
        [
            columns.get(i, np.zeros(len(c.values))) / (second_difference_noise(c.values) or 1.0)
            for i, c in enumerate(observations.channels)
        ]
    )
