"""Which sizes an effect may have."""

from collections.abc import Iterator

from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.effects.parameter import Parameter, by_name

HALF = 0.5  # of what comes in ones: less is none


def possible(term: FittedTerm) -> bool:
    """Whether a file may give an effect these sizes: no negative width, of what comes in ones no
    small part of one.
    """
    return not any(
        (p.positive and value < 0) or (p.whole and abs(value) < HALF) for p, value in _sizes(term)
    )


def _sizes(term: FittedTerm) -> Iterator[tuple[Parameter, float]]:
    """The sizes in use, SI, with what the catalogue says of each; a curve's coefficients are not in
    it.
    """
    known = by_name(term.hypothesis.effect.parameters)
    for name, value in zip(term.names, term.values, strict=True):
        if name in known:
            yield known[name], value
