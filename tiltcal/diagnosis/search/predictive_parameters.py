"""Which parameters of an accepted finding are used: those that improve the prediction, not only
those that are significant.
"""

from dataclasses import replace

from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, refit
from tiltcal.diagnosis.model.normal_equations import normal_equations
from tiltcal.diagnosis.model.removed_finding import remove_finding
from tiltcal.diagnosis.model.whitened_model import WhitenedModel

# deviance: a further size costs a prediction the variance of one; what brings twice that pays
# (Akaike)
BETTER = 2.0


def add_predictive_parameters(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model with all parameters of its findings that improve the prediction (Akaike),
    whether or not each is significant by itself.
    """
    terms = list(fitted.terms)
    for k in range(len(terms)):
        terms[k] = _in_full(replace(fitted, terms=tuple(terms)), k, whitened)
    return (
        fitted
        if terms == list(fitted.terms)
        else refit(replace(fitted, terms=tuple(terms)), whitened)
    )


def _in_full(fitted: FittedModel, place: int, whitened: WhitenedModel) -> FittedTerm:
    """One term with further sizes of its hypothesis."""
    term = fitted.terms[place]
    if len(term.names) == len(term.hypothesis.names):
        return term
    own = whitened.alone([term.hypothesis], fitted.effects)
    if not own.hypotheses:
        return term
    removed = remove_finding(fitted, whitened, [place])
    normal = normal_equations([0], removed.basis, removed.target, removed.signal, own)
    start = [normal.names.index(name) for name in term.names if name in normal.names]
    chosen = sorted(normal.greedy(range(len(normal.names)), BETTER, start))
    values = dict(zip(term.names, term.values, strict=True))
    names = tuple(normal.names[i] for i in chosen)
    return replace(term, names=names, values=tuple(values.get(name, 0.0) for name in names))
