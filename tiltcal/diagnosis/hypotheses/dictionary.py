"""Putting suspects on the ledger: all of them at first, then those whose lines stand out once the
first findings are away.
"""

from dataclasses import replace
from itertools import chain

import numpy as np

from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_quality.quantisation_limit import told_by_moves
from tiltcal.diagnosis.hypotheses.coordinate_ranges import Lines, span_of
from tiltcal.diagnosis.hypotheses.curves import curves
from tiltcal.diagnosis.hypotheses.hypothesis import OF_LINES, listed_suspects, step_suspects
from tiltcal.diagnosis.hypotheses.spectral_lines import lines_of, wandering_of
from tiltcal.diagnosis.model.fitted_model import Account
from tiltcal.diagnosis.model.hypothesis_columns import Ledger

MOST_STEPS = 120  # instants at which a step is looked for before the best one is moved row by row


def fill(ledger: Ledger, account: Account, lines: Lines, blurred: bool = False) -> None:
    """Put every suspect on the ledger; blurred: whether the table's angles are cut."""
    observations = ledger.observations
    effects = account.effects
    span = span_of(observations, lines)
    nuisance = [t.suspect for t in account.nuisance]
    steps = step_suspects(observations.scenario, instants(observations))
    for suspect in chain(
        listed_suspects(observations.scenario, span, nuisance), steps, curves(observations, span)
    ):
        if not (blurred and told_by_moves(suspect.effect)):
            ledger.add(suspect, effects)


def refill(ledger: Ledger, account: Account, known: Lines) -> bool:
    """Put on the ledger what beats in what an account leaves and did not stand out before; whether
    there is any.

    Where nothing was found, lines that wander too: beside a law that is some per cent off its form
        that scan finds the table's.
    """
    observations = ledger.observations
    width = 1 / float(np.ptp(observations.recordings[0].time))
    new = lines_of(ledger, account).beside(known, width)
    if not account.terms:
        new = replace(
            new,
            tones=(*new.tones, *Lines(wandering_of(ledger, account)).beside(known, width).tones),
        )
    before = len(ledger.suspects)
    for suspect in listed_suspects(
        observations.scenario, span_of(observations, new), [t.suspect for t in account.nuisance]
    ):
        lines = suspect.effect.values.get("lines")
        if suspect.id in OF_LINES and (lines is None or lines in new.ripples):
            ledger.add(suspect, account.effects)
    return len(ledger.suspects) > before


def instants(observations: Observations) -> list[float]:
    """When a step may have been: at the ends of moves, and all along, s from the first stamp."""
    first = observations.recordings[0]
    span = float(first.time[-1] - first.time[0])
    channel = observations.channels[0]
    edges = (
        channel.time[np.flatnonzero(np.diff((channel.stop >= 0).astype(int)) != 0)] - first.time[0]
    )
    if not 8 <= len(edges) <= MOST_STEPS:
        edges = np.linspace(0, span, 62)[1:-1]
    return [float(t) for t in edges if 0.01 * span < t < 0.99 * span]
