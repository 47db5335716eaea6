"""What may explain the residual of a model: the hypotheses of the largest evidence, worked out."""

import numpy as np

from tiltcal.diagnosis.data_faults.quantisation_limit import above_codes
from tiltcal.diagnosis.hypotheses.priors import kind
from tiltcal.diagnosis.search.explanation import explained_by
from tiltcal.diagnosis.search.possible_sizes import possible
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import Proposal, State

LOOKED_AT = 14  # hypotheses of the largest evidence whose deviations are worked out


def proposals(state: State, scan: Scan) -> list[Proposal]:
    """What may explain the residual of a model, best first, each place at its best shape. It is
    kept with the state: several steps of a search ask for it.
    """
    if scan not in state.proposals:
        found = [
            p
            for p in looked_at(state, scan)
            if possible(p.explanation.terms[0])
            and above_codes(p.explanation.terms, state.fitted, state.whitened)
        ]
        state.proposals[scan] = sorted(found, key=lambda p: -p.score)
    return state.proposals[scan]


def looked_at(state: State, scan: Scan, *, listed_only: bool = False) -> list[Proposal]:
    """The hypotheses of the largest evidence, with sizes that cannot be among them.

    Args:
        state: the model.
        scan: under its noise.
        listed_only: whether curves are left out.
    """
    fitted, whitened = state.fitted, state.whitened
    score = scan.log_bayes_factors(fitted) + scan.log_odds
    seen: dict[object, int] = {}
    for k in np.argsort(-score):
        hypothesis = whitened.hypotheses[k]
        if listed_only and not hypothesis.listed:
            continue
        place = (hypothesis.place, hypothesis.alias) if hypothesis.listed else kind(hypothesis)
        seen.setdefault((place, 0 if hypothesis.listed else len(hypothesis.names)), int(k))
        if len(seen) == LOOKED_AT:
            break
    normals = [(k, scan.products.normal_equations(k, fitted)) for k in seen.values()]
    told = [(k, explained_by(normal, fitted, whitened)) for k, normal in normals]
    return [Proposal(t, float(scan.log_odds[k])) for k, t in told if t is not None]
