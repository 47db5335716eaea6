"""Prior probabilities of hypotheses: equal for every place of a named effect, a quarter of all for
curves; shared by the shapes of each. An event of several recordings is as probable between two of
them as within them, and a named effect that has a textbook form in it as in all others together.
"""

from collections.abc import Collection, Sequence

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.effects.learned import Learned

UNLISTED = "unlisted"
"""The name of a cause that no list has."""
UNLISTED_SHARE = 0.25
"""Of what differs from a model, the share that no list has."""
EXPECTED_CAUSES = 0.5
"""Causes that are expected: their number is Poisson, each being there or not by itself at odds of
this times its share.
"""
UNLISTED_ODDS = float(np.log(UNLISTED_SHARE / (1 - UNLISTED_SHARE)))
"""Log odds of a cause that no list has to one that a list has, nats."""
NAMELESS, NAMED = (
    float(np.log(EXPECTED_CAUSES * share)) for share in (UNLISTED_SHARE, 1 - UNLISTED_SHARE)
)
"""Log prior odds that a cause that no list has is there, and one that a list has, nats: shared by
all places and forms of it. Each kind of cause that is looked for only in the noise that is left has
those of NAMELESS again.
"""


def log_priors(hypotheses: Sequence[Hypothesis]) -> Array:
    """Natural logarithm of the prior probability of each hypothesis, (n,): they sum to one but for
    the odds of the shapes of some.
    """
    members: dict[tuple[object, ...], list[int]] = {}
    for k, hypothesis in enumerate(hypotheses):
        members.setdefault(kind(hypothesis), []).append(k)
    curves, of_name = sum(key[0] is None for key in members), share_of_name(members)
    found = np.zeros(len(hypotheses))
    for key, which in members.items():
        share = UNLISTED_SHARE / curves if key[0] is None else of_name
        parts = [_part(hypotheses[k]) for k in which]
        for k, part in zip(which, parts, strict=True):
            found[k] = np.log(share / len(set(parts)) / parts.count(part))
    return found + np.array([h.log_odds for h in hypotheses])


def share_of_name(kinds: Collection[tuple[object, ...]]) -> float:
    """Prior probability of a named effect in one place. kinds: of all hypotheses."""
    return (1 - UNLISTED_SHARE) / max(sum(key[0] is not None for key in kinds), 1)


def _part(hypothesis: Hypothesis) -> tuple[bool, bool]:
    """Which of the hypotheses of a kind are as probable together as the others."""
    instant = hypothesis.instant
    other_form = hypothesis.alias is not None and hypothesis.law.form == "law"
    return instant is not None and instant.in_pause, other_form


def kind(hypothesis: Hypothesis) -> tuple[object, ...]:
    """What shares one prior: an id on a sensor; of curves a place, what they follow, and whether
    they are steps or transients; of coefficients of a reading that vary a place, and what with.
    """
    effect = hypothesis.effect
    if hypothesis.listed:
        return hypothesis.id, effect.sensor, None if hypothesis.alias else effect.axis
    assert isinstance(effect, Learned)
    place = getattr(effect, "slot", ""), getattr(effect, "turn", "")
    return (
        None,
        type(effect),
        effect.sensor,
        effect.axis,
        "" if effect.times and effect.power else effect.coordinate,
        effect.beside,
        effect.times,
        effect.is_step,
        effect.play > 0,
        bool(effect.instants),
        *place,
    )
