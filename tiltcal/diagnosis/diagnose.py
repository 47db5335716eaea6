"""From recordings and a scenario to a diagnosis: faults of the data, noise, search for effects,
conclusions.
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
from tiltcal.diagnosis.conclusions.fault_findings import finding_of
from tiltcal.diagnosis.conclusions.finding import Diagnosis, Finding, verdict_of
from tiltcal.diagnosis.conclusions.residual_plots import views_of
from tiltcal.diagnosis.conclusions.resimulation import resimulate
from tiltcal.diagnosis.conclusions.statements import summary
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.data_quality.prepare import (
    PreparedData,
    averaged_blocks,
    prepare,
    static_noise,
)
from tiltcal.diagnosis.data_quality.quantisation_limit import drop_below_code
from tiltcal.diagnosis.data_quality.setting_errors import (
    beside_stops,
    find_setting_error,
    lawful_part,
)
from tiltcal.diagnosis.hypotheses.block_averaging import block_of
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.model.channel_noise import noise_under, shift_bias_to_start
from tiltcal.diagnosis.model.cross_validation import drop_unpredictive
from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedModel, refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.backward_elimination import (
    backward_elimination,
    drop_below_bic,
    drop_implausible_sizes,
)
from tiltcal.diagnosis.search.dictionary import build_dictionary, extend_dictionary
from tiltcal.diagnosis.search.forward_selection import forward_selection
from tiltcal.diagnosis.search.merging import merge_small_findings
from tiltcal.diagnosis.search.predictive_parameters import add_predictive_parameters
from tiltcal.diagnosis.search.shape_refinement import normalise_tone_phase
from tiltcal.diagnosis.search.spectral_lines import spectral_lines_of
from tiltcal.diagnosis.search.swap_search import refine_all_shapes, swap_search
from tiltcal.diagnosis.search.unlisted_curves import drop_formless_names, prefer_unlisted_curve
from tiltcal.effects import CATALOGUE, Effect
from tiltcal.effects.data.faults import DataDrop
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.effects.spans import SpectralLines
from tiltcal.effects.table.readout import IndexError_
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel
from tiltcal.statistics.white_flicker_walk import WhiteFlickerWalk


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra on one thread: for thousands of small matrices threads cost more time than
    they save.
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
    noise: type[NoiseModel] = WhiteFlickerWalk,
) -> Diagnosis:
    """Why these recordings differ from the scenario.

    Args:
        scenario: what is known of the set-up.
        recordings: of one set-up, explained together; those that step or drift are told apart by
            their stamps.
        static: a record at rest, of the same sensors at the same rate, to take the noise from.
        laboratory: re-simulates the recording with the amended scenario in the end.
        progress: is told what is being done.
        noise: kind of noise model that is fitted to each channel.

    Raises:
        TiltcalError: a column is missing, or nothing in a recording has a model.
    """
    progress("reading")
    prepared = prepare(scenario, recordings, noise)
    if not prepared.observations.determines(prepared.start.columns):
        return _answer(prepared, prepared.start, prepared.whitened, (), (), False)
    progress("computing the signature of every effect")
    lines = spectral_lines_of(prepared.observations, prepared.start)
    whole = prepared.observations
    prepared = averaged_blocks(prepared, block_of(whole, lines))
    at_rest = None if static is None else static_noise(prepared.observations, static, noise)
    fitted, whitened, chance, gate = _explained(prepared, lines, at_rest, progress)
    progress("re-simulating")
    values: list[float] = []
    if fitted.terms:
        values, whitened = gate.log_p(fitted, whitened)
    found = findings_of(fitted, whitened, values)
    answer = _answer(prepared, fitted, whitened, found, chance, True, static is not None)
    return answer if laboratory is None else _simulated(answer, laboratory, whole, fitted)


def _explained(
    prepared: PreparedData,
    lines: SpectralLines,
    at_rest: tuple[NoiseFit, ...] | None,
    progress: Progress,
) -> tuple[FittedModel, WhitenedModel, list[Fault], NoiseGate]:
    """The fitted model of the recordings, the noise that it leaves, random effects, and the test
    that findings have passed.
    """
    start, whitened, floors = prepared.start, prepared.whitened, prepared.floors
    blurred = any(isinstance(f.effect, DataTruncation) for f in prepared.faults)
    build_dictionary(whitened.columns, start, lines, blurred)
    gate = NoiseGate(at_rest, len(whitened.hypotheses))
    progress("searching for effects")
    fitted, whitened = forward_selection(start, whitened, gate, _textbook)
    fitted, whitened = swap_search(fitted, start, whitened, gate, _textbook)
    if extend_dictionary(whitened.columns, fitted, lines):
        fitted, whitened = forward_selection(fitted, whitened, gate, _textbook)
    fitted = merge_small_findings(fitted, whitened)
    progress("fitting unlisted curves")
    fitted, whitened = prefer_unlisted_curve(fitted, whitened, gate)
    fitted, whitened = backward_elimination(fitted, whitened, gate)
    # under the noise that is left now
    fitted = add_predictive_parameters(refine_all_shapes(fitted, whitened), whitened)
    progress("comparing alternatives")
    chance: list[Fault] = []
    if floors:
        fitted = drop_below_code(fitted, whitened, floors, blurred)
    else:
        fitted, chance = _by_chance(fitted, start, whitened, gate)
    fitted = drop_implausible_sizes(drop_formless_names(fitted, whitened), whitened)
    fitted, whitened = drop_below_bic(drop_unpredictive(fitted, whitened), whitened, gate)
    if floors:  # under the noise that is left now its sizes have changed
        fitted = drop_below_code(fitted, whitened, floors, blurred)
    return normalise_tone_phase(fitted, prepared.observations), whitened, chance, gate


def _textbook(hypothesis: Hypothesis) -> bool:
    return hypothesis.textbook


def _by_chance(
    fitted: FittedModel, start: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, list[Fault]]:
    """Random effects last, because they explain anything that varies from stop to stop; other
    findings have to be significant beside them.

    Unlisted curves with as many parameters as there are stops are no law: they are left out of this
    test.
    """
    if any(isinstance(e, IndexError_) for e in whitened.observations.scenario.effects):
        return fitted, []
    lawful = lawful_part(fitted, whitened)
    setting = find_setting_error(lawful, start, whitened, gate.total)
    if setting is None:
        return fitted, []
    return beside_stops(lawful, setting[1], whitened, gate.total), [setting[0]]


def _answer(
    prepared: PreparedData,
    fitted: FittedModel,
    whitened: WhitenedModel,
    found: Sequence[Finding],
    chance: Sequence[Fault],
    told: bool,
    static: bool = False,
) -> Diagnosis:
    """Verdict and figures."""
    observations = prepared.observations
    before = refit(prepared.start, whitened)
    first, last = fitness_of(before, whitened), fitness_of(fitted, whitened)
    faults = [*prepared.faults, *chance]
    answer = (*(finding_of(f) for f in faults), *sorted(found, key=lambda f: f.delta_bic))
    verdict = verdict_of(answer, told)
    source = "taken from the static record" if static else "taken from the recording itself"
    statement = summary(answer, verdict, first.chi2_per_dof, last.chi2_per_dof, source)
    began = (
        shift_bias_to_start(
            fitted, whitened, noise_under(fitted, whitened.columns, law=whitened.law)
        )
        if told
        else fitted
    )
    amended = amended_of(began, observations, faults)
    notes = [*prepared.notes, f"the noise was {source}"]
    left = observations.residuals(fitted.effects)
    return Diagnosis(
        verdict,
        statement,
        answer,
        tuple(notes),
        undetectable_of(fitted, whitened) if told else (),
        first,
        last,
        amended,
        views_of(observations, observations.residuals(before.effects), left),
    )


def _simulated(
    answer: Diagnosis, laboratory: Laboratory, full: Observations, fitted: FittedModel
) -> Diagnosis:
    """The answer with the result of the re-simulation."""
    # lost samples that the scan found are not mended in the columns
    lost = any(isinstance(e, DataDrop) for e in fitted.effects)
    amended = _as_read(answer.amended, full.scenario, lost)
    again = resimulate(laboratory, amended, full, full.predict(fitted.effects))
    return answer if again is None else replace(answer, notes=(*answer.notes, again.words))


def _as_read(amended: Mapping[str, Any], scenario: Scenario, lost: bool) -> Scenario:
    """The amended scenario without data faults that were repaired in the columns."""

    def held(id: str) -> bool:
        cls = CATALOGUE.get(id, Effect)
        mended = cls.repair or cls.scatters or (id == DataDrop.id and not lost)
        return not mended

    return parse_scenario(
        {**amended, "effect": [e for e in amended["effect"] if held(e["id"])]}, scenario.name
    )
