"""Which sizes an effect may have."""

from collections.abc import Iterator

from tiltcal.diagnosis.model.fitted_model import FittedTerm
from tiltcal.effects.parameter import Parameter

HALF = 0.5


def possible(term: FittedTerm) -> bool:
    """Whether a file may give an effect these sizes: no negative width, of what comes in ones no
    small part of one.
    """
    return not any(
        (p.positive and value < 0) or (p.whole and abs(value) < HALF) for p, value in _sizes(term)
    )


def _sizes(term: FittedTerm) -> Iterator[tuple[Parameter, float]]:
    """The sizes in use, SI, with what the catalogue says of each."""
    for parameter in term.hypothesis.effect.parameters:
        stem = parameter.name.split("{")[0].rstrip("_")
        for name, value in zip(term.names, term.values, strict=True):
            if name == parameter.name or ("{" in parameter.name and name.startswith(stem)):
                yield parameter, value
