"""Which sizes of a finding are in use once it is accepted: those that make a prediction better, not
only those that stand out.
"""

from dataclasses import replace

from tiltcal.diagnosis.model.fitted_model import Account, Term, settle
from tiltcal.diagnosis.model.hypothesis_columns import Ledger
from tiltcal.diagnosis.model.normal_equations import normal_equations
from tiltcal.diagnosis.search.alternatives import case_of

# deviance: a further size costs a prediction the variance of one; what brings twice that pays
# (Akaike)
BETTER = 2.0


def in_full(account: Account, ledger: Ledger) -> Account:
    """The account with all sizes of its findings that a prediction is better with, whether or not
    each stands out by itself.
    """
    terms = list(account.terms)
    for k in range(len(terms)):
        terms[k] = _in_full(replace(account, terms=tuple(terms)), k, ledger)
    return (
        account
        if terms == list(account.terms)
        else settle(replace(account, terms=tuple(terms)), ledger)
    )


def _in_full(account: Account, place: int, ledger: Ledger) -> Term:
    """One term with further sizes of its suspect."""
    term = account.terms[place]
    if len(term.names) == len(term.suspect.names):
        return term
    own = Ledger(ledger.observations)
    own.add(term.suspect, account.effects)
    if not own.suspects:
        return term
    own.roots = ledger.roots
    case = case_of(account, ledger, [place])
    normal = normal_equations([0], case.basis, case.target, case.signal, own)
    start = [normal.names.index(name) for name in term.names if name in normal.names]
    chosen = sorted(normal.greedy(range(len(normal.names)), BETTER, start))
    values = dict(zip(term.names, term.values, strict=True))
    names = tuple(normal.names[i] for i in chosen)
    return replace(term, names=names, values=tuple(values.get(name, 0.0) for name in names))
