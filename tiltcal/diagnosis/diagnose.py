"""From recordings and a scenario to a diagnosis: faults of the data first, then the noise, then who
is to blame.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from tiltcal.core.progress import Progress, silent
from tiltcal.diagnosis.conclusions.concluding import (
    amended_of,
    findings_of,
    fitness_of,
    undetectable_of,
)
from tiltcal.diagnosis.conclusions.finding import Diagnosis, Finding, verdict_of
from tiltcal.diagnosis.conclusions.residual_plots import views_of
from tiltcal.diagnosis.conclusions.resimulation import resimulate
from tiltcal.diagnosis.conclusions.statements import summary
from tiltcal.diagnosis.data.block_averaging import block_of
from tiltcal.diagnosis.data.channels import MASKED, MEANINGS
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_quality.flat_and_repeated import Fault
from tiltcal.diagnosis.data_quality.prepare import Bench, enough, prepare, static_noise, thinned
from tiltcal.diagnosis.data_quality.quantisation_limit import above
from tiltcal.diagnosis.data_quality.stop_errors import beside_stops, lawful_part, setting_error
from tiltcal.diagnosis.hypotheses.dictionary import fill, refill
from tiltcal.diagnosis.hypotheses.hypothesis import Suspect
from tiltcal.diagnosis.hypotheses.spectral_lines import lines_of
from tiltcal.diagnosis.model.cross_validation import borne_out
from tiltcal.diagnosis.model.fitted_model import Account, as_it_began, noise_under, settle
from tiltcal.diagnosis.model.hypothesis_columns import Ledger
from tiltcal.diagnosis.search.forward_selection import (
    Gate,
    absorbed,
    backward,
    plausible,
    select,
    worth_their_numbers,
)
from tiltcal.diagnosis.search.predictive_parameters import in_full
from tiltcal.diagnosis.search.shape_refinement import upright
from tiltcal.diagnosis.search.swap_search import plainer, reshaped
from tiltcal.diagnosis.search.unlisted_curves import nameless, without_a_form
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra on one thread: of thousands of small matrices threads spend more time on
    waiting for each other.
    """
    import scipy.linalg  # noqa: F401  # so that there is a library to tell
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


@one_thread()
def diagnose(
    scenario: Scenario,
    recordings: Sequence[Recording],
    *,
    static: Recording | None = None,
    laboratory: Laboratory | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Why these recordings differ from the scenario.

    Args:
        scenario: what is known of the set-up.
        recordings: of one set-up, explained together; those that step or drift are told apart by
            their stamps.
        static: a record at rest, of the same sensors at the same rate, to take the noise from.
        laboratory: re-simulates the recording with the amended scenario in the end.
        progress: is told what is being done.

    Raises:
        TiltcalError: a column is missing, or nothing in a recording has a model.
    """
    progress("reading")
    bench = prepare(scenario, recordings)
    if not enough(bench.observations, bench.start):
        return _answer(bench, bench.start, (), (), False)
    progress("what every effect would do")
    lines = lines_of(bench.ledger, bench.start)
    full, bench = bench.observations, thinned(bench, block_of(bench.observations, lines))
    ledger = bench.ledger
    blurred = any(f.effect.id == "data_truncation" for f in bench.faults)
    fill(ledger, bench.start, lines, blurred)
    gate = Gate(
        None if static is None else static_noise(bench.observations, static), len(ledger.suspects)
    )
    progress("who is to blame")
    account = select(bench.start, ledger, gate, _textbook)
    account = plainer(account, bench.start, ledger, gate, _textbook)
    if refill(ledger, account, lines):
        account = select(account, ledger, gate, _textbook)
    account = absorbed(account, ledger)
    progress("what no name fits")
    account = backward(nameless(account, ledger, gate), ledger, gate)
    account = in_full(reshaped(account, ledger), ledger)  # in the noise that is left now
    progress("rivals")
    chance: list[Fault] = []
    if bench.floors:
        account = above(account, ledger, bench.floors, blurred)
    else:
        account, chance = _by_chance(account, bench.start, ledger, gate)
    account = borne_out(
        plausible(without_a_form(account, ledger), ledger), ledger
    )  # its sizes have been fitted again since
    account = worth_their_numbers(account, ledger, gate)
    if bench.floors:  # in the noise that is left now its sizes are others
        account = above(account, ledger, bench.floors, blurred)
    account = upright(account, bench.observations)
    progress("re-simulating")
    answer = _answer(
        bench, account, findings_of(account, ledger, gate), chance, True, static is not None
    )
    return answer if laboratory is None else _simulated(answer, laboratory, full, account)


def _textbook(suspect: Suspect) -> bool:
    return suspect.textbook


def _by_chance(
    account: Account, start: Account, ledger: Ledger, gate: Gate
) -> tuple[Account, list[Fault]]:
    """A random effect last: it explains anything that varies from stop to stop; what else was found
    stands beside it, or falls.

    Nameless curves with as many numbers as there are stops are no law: it is asked without them.
    """
    if "table_index_error" in {e.id for e in ledger.observations.scenario.effects}:
        return account, []
    lawful = lawful_part(account, ledger)
    setting = setting_error(lawful, start, ledger, gate.total)
    if setting is None:
        return account, []
    return beside_stops(lawful, setting[1], ledger, gate.total), [setting[0]]


def _answer(
    bench: Bench,
    account: Account,
    found: Sequence[Finding],
    chance: Sequence[Fault],
    told: bool,
    static: bool = False,
) -> Diagnosis:
    """Verdict and figures."""
    ledger, observations = bench.ledger, bench.observations
    before = settle(bench.start, ledger)
    first, last = fitness_of(before, ledger), fitness_of(account, ledger)
    faults = [*bench.faults, *chance]
    answer = (*(f.finding() for f in faults), *sorted(found, key=lambda f: f.delta_bic))
    verdict = verdict_of(answer, told)
    source = "taken from the static record" if static else "taken from the recording itself"
    statement = summary(answer, verdict, first.chi2_per_dof, last.chi2_per_dof, source)
    began = as_it_began(account, ledger, noise_under(account, ledger)) if told else account
    amended = amended_of(began, observations, faults)
    notes = [*bench.notes, f"the noise was {source}"]
    left = observations.residuals(account.effects)
    return Diagnosis(
        verdict,
        statement,
        answer,
        tuple(notes),
        undetectable_of(account, ledger) if told else (),
        first,
        last,
        amended,
        views_of(observations, observations.residuals(before.effects), left),
    )


def _simulated(
    answer: Diagnosis, laboratory: Laboratory, full: Observations, account: Account
) -> Diagnosis:
    """The answer with the simulator's word on it."""
    lost = any(
        e.id == "data_drop" for e in account.effects
    )  # found by the scan, not mended in the columns
    amended = _as_read(answer.amended, full.scenario, () if lost else ("data_drop",))
    again = resimulate(laboratory, amended, full, full.predict(account.effects))
    return answer if again is None else replace(answer, notes=(*answer.notes, again.words))


def _as_read(amended: Mapping[str, Any], scenario: Scenario, more: Sequence[str]) -> Scenario:
    """The amended scenario without the data faults that were mended in the columns."""
    mended = (*MEANINGS, *MASKED, "data_outlier", "table_index_error", "data_jitter", *more)
    return parse_scenario(
        {**amended, "effect": [e for e in amended["effect"] if e["id"] not in mended]},
        scenario.name,
    )
