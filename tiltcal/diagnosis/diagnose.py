"""From recordings and a scenario to a diagnosis: faults of the data, noise, search for effects,
conclusions.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tiltcal.core.numerical import determining, one_thread
from tiltcal.core.progress import Progress, Stages, silent
from tiltcal.diagnosis.conclusions.answering import answered, simulated, testable, untested
from tiltcal.diagnosis.conclusions.finding import Diagnosis
from tiltcal.diagnosis.data_quality.fault import Fault
from tiltcal.diagnosis.data_quality.heading import with_heading
from tiltcal.diagnosis.data_quality.long_recordings import (
    AVERAGES,
    LongRecording,
    read_beginning,
    read_long,
)
from tiltcal.diagnosis.data_quality.prepare import (
    PreparedData,
    averaged_blocks,
    prepare,
    static_noise,
)
from tiltcal.diagnosis.data_quality.quantisation_limit import drop_below_code
from tiltcal.diagnosis.data_quality.requirements import require_diagnosable
from tiltcal.diagnosis.data_quality.setting_errors import (
    beside_stops,
    find_setting_error,
    lawful_part,
)
from tiltcal.diagnosis.hypotheses.block_averaging import block_of, survives
from tiltcal.diagnosis.model.finding_tests import NoiseGate
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit_about_itself
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.claimed_causes import CLAIM, DOUBTED, believed
from tiltcal.diagnosis.search.curve_misfit import largest_misfit
from tiltcal.diagnosis.search.dictionary import build_dictionary, extend_dictionary
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.diagnosis.search.model_search import most_probable, settled
from tiltcal.diagnosis.search.moving_tones import MovingTone, moving_tones
from tiltcal.diagnosis.search.names import named, without_misfits
from tiltcal.diagnosis.search.narrow_bands import NarrowBand, narrow_bands
from tiltcal.diagnosis.search.random_motion import RandomMotion, random_motions
from tiltcal.diagnosis.search.random_settings import beside_random_settings, is_lawful
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.shape_refinement import normalise_tone_phase
from tiltcal.diagnosis.search.slow_variation import slow_variations
from tiltcal.diagnosis.search.spectral_lines import spectral_lines_of
from tiltcal.diagnosis.search.state import laws
from tiltcal.diagnosis.search.varying_noise import VaryingNoise, varying_noise
from tiltcal.effects.spans import SpectralLines
from tiltcal.effects.table.readout import IndexError_
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.pieces import estimated_rows
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.span_means import LONGEST, spans_of
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel
from tiltcal.statistics.white_flicker_walk import WhiteFlickerWalk

Search = Callable[[PreparedData], Explained]
"""From data, with the columns of all hypotheses, to the most probable explanation."""


READING, SIGNATURES, SEARCH, ALTERNATIVES, ANSWER = (
    "reading",
    "computing the signature of every effect",
    "searching for effects",
    "comparing alternatives",
    "re-simulating",
)
TIMES = {READING: 9, SIGNATURES: 34, SEARCH: 40, ALTERNATIVES: 7, ANSWER: 10}
"""Of the time, measured where one to five effects are found, per cent; the search takes between 15
and 60.
"""


@one_thread()
def diagnose(
    scenario: Scenario,
    recordings: Sequence[Recording | LongRecording],
    *,
    static: Recording | LongRecording | None = None,
    laboratory: Laboratory | None = None,
    progress: Progress = silent,
    noise: type[NoiseModel] = WhiteFlickerWalk,
    search: Search | None = None,
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
        search: another method than that of this project, to compare with.

    Raises:
        TiltcalError: a column is missing, a recording was given twice, or the record at rest is
            none.
    """
    stages = Stages(progress, TIMES)
    given = [_as_read(r) for r in recordings]
    still = None if static is None else _as_read(static)
    rest = None if still is None else still.recording
    require_diagnosable(scenario, [r.recording for r in given], rest)
    every = given if still is None else [*given, still]
    with determining(", ".join(r.recording.source for r in given), "how it differs"):
        stages.begin(READING)
        prepared = _prepared(scenario, given, noise)
        if not testable(prepared):
            return _saying(untested(prepared), every)
        stages.begin(SIGNATURES)
        lines = spectral_lines_of(prepared.observations, prepared.start)
        whole = prepared.observations
        prepared = averaged_blocks(prepared, block_of(whole, lines))
        at_rest = None
        if rest is not None:
            at_rest = static_noise(prepared.observations, rest, noise, prepared.faults)
        build_dictionary(prepared.whitened, prepared.start, lines, prepared.blurred, stages.part)
        if search is not None:
            said = search(prepared)
        else:
            said = _explained(prepared, lines, at_rest, stages)
        stages.begin(ANSWER)
        answer, amended = answered(prepared, said)
        answer = _saying(answer, every)
        return answer if laboratory is None else simulated(answer, laboratory, whole, amended)


def read_for_diagnosis(
    path: Path, scenario: Scenario, progress: Progress = silent
) -> Recording | LongRecording:
    """A recording; of a long one averages, what is in its samples being found before, or its
    beginning, where averages would not tell what its samples tell.

    Raises:
        TiltcalError: it is no recording, or a column is missing.
    """
    if estimated_rows(path) <= LONGEST:
        return read_recording(path)
    if not scenario.rig.axes:
        return read_beginning(path, "recordings by hand are not averaged")
    spans = spans_of(path, AVERAGES)
    if spans is None:
        return read_beginning(path, "coarse codes are not averaged")
    with one_thread(), determining(path.name, "how it differs"):
        return read_long(path, scenario, spans, _kept, progress)


def read_static(path: Path) -> Recording | LongRecording:
    """A record at rest, for its noise; of a long one the beginning.

    Raises:
        TiltcalError: it is no recording.
    """
    if estimated_rows(path) <= LONGEST:
        return read_recording(path)
    return read_beginning(path, "they are enough to tell the noise")


def _as_read(recording: Recording | LongRecording) -> LongRecording:
    return recording if isinstance(recording, LongRecording) else LongRecording(recording)


def _kept(prepared: PreparedData, samples: int) -> bool:
    """Whether averages over so many samples keep every spectral line of these data."""
    lines = spectral_lines_of(prepared.observations, prepared.start)
    return survives(prepared.observations, lines, samples)


def _prepared(
    scenario: Scenario, given: Sequence[LongRecording], noise: type[NoiseModel]
) -> PreparedData:
    """The recordings with their faults repaired, and those that were found when they were read."""
    seen = [fault for r in given for fault in r.faults]
    recordings = [r.recording for r in given]
    scenario, told = with_heading(scenario, recordings, noise)
    prepared = prepare(scenario, recordings, noise, seen)
    left_out = (*(rows for r in given for rows in r.left_out), *prepared.left_out)
    return replace(prepared, left_out=left_out, notes=(*prepared.notes, *told))


def _saying(answer: Diagnosis, given: Sequence[LongRecording]) -> Diagnosis:
    """The answer with how its recordings were read."""
    words = [f"{r.said[0].upper()}{r.said[1:]}." for r in given if r.said]
    return replace(answer, statement=" ".join([answer.statement, *words])) if words else answer


def _explained(
    prepared: PreparedData,
    lines: SpectralLines,
    at_rest: tuple[NoiseFit, ...] | None,
    stages: Stages,
) -> Explained:
    """The most probable model of the recordings, random effects beside it, and what each of its
    causes may be.
    """
    start, whitened, floors = prepared.start, prepared.whitened, prepared.floors
    gate = NoiseGate(at_rest, len(whitened.hypotheses))
    stages.begin(SEARCH)
    state = most_probable(start, whitened, gate, lambda n: stages.still(f"{n} in the model"))
    if extend_dictionary(state, lines):
        gate = replace(gate, total=len(whitened.columns.hypotheses))
        state = settled(state.over(whitened.columns), gate)
    stages.begin(ALTERNATIVES)
    random = False
    if not (floors or _knows_settings(start)):
        state, random = beside_random_settings(state, gate)
    state, chances, doubts = believed(state, gate)
    scan = Scan(state.whitened)
    if any(not law.listed for law in laws(state.fitted)):
        state, _ = named(state, scan, random)  # what has a name leaves less of its law
    state, kept = without_misfits(state, scan)
    chances = tuple(chances[k] for k in kept)
    state, names = named(state, scan, random)
    fitted, random_faults = state.fitted, list[Fault]()
    if floors:
        fitted = drop_below_code(fitted, state.whitened, floors, prepared.blurred)
    else:
        fitted, random_faults = _by_chance(fitted, start, state.whitened, gate)
    if fitted.terms:
        fitted = refit_about_itself(fitted, state.whitened)
    remaining = laws(fitted)
    held = [k for k, law in enumerate(laws(state.fitted)) if any(law is one for one in remaining)]
    left = gate.left_by(fitted, state.whitened)
    return Explained(
        normalise_tone_phase(fitted, prepared.observations),
        left,
        tuple(random_faults),
        gate,
        tuple(names[k] for k in held),
        tuple(chances[k] for k in held),
        slow_variations(left, DOUBTED, floors),
        *(((), (), ()) if held or doubts else _in_the_noise(left, fitted, floors)),
        () if held or random_faults or _knows_settings(start) else _motions(left, fitted, floors),
        doubts,
    )


def _in_the_noise(
    left: WhitenedModel, fitted: FittedModel, floors: Mapping[str, float]
) -> tuple[tuple[NarrowBand, ...], tuple[MovingTone, ...], tuple[VaryingNoise, ...]]:
    """Bands with more power than noise, tones whose frequency moves, and noise that follows an
    angle or a cycle, in what a model leaves.
    """
    rest = left.residual(fitted.effects)
    tones = moving_tones(left, rest, fitted.effects, DOUBTED, floors)
    varying = varying_noise(left, rest, fitted.effects, CLAIM, floors)
    return narrow_bands(left, rest, DOUBTED, floors), tones, varying


def _motions(
    left: WhitenedModel, fitted: FittedModel, floors: Mapping[str, float]
) -> tuple[RandomMotion, ...]:
    """Random motion in what a model leaves."""
    rest = left.residual(fitted.effects)
    return random_motions(left, rest, fitted.effects, DOUBTED, floors)


def _by_chance(
    fitted: FittedModel, start: FittedModel, whitened: WhitenedModel, gate: NoiseGate
) -> tuple[FittedModel, list[Fault]]:
    """Random effects last, because they explain anything that varies from stop to stop; other
    findings have to be significant beside them.

    Unlisted curves with as many parameters as there are stops are no law: they are left out of this
    test.
    """
    if _knows_settings(start):
        return fitted, []
    lawful = lawful_part(fitted, whitened)
    setting = find_setting_error(lawful, start, whitened, gate.total, largest_misfit(lawful))
    if setting is None or is_lawful(setting):
        return fitted, []
    return beside_stops(lawful, setting.stops, whitened, gate.total), [setting.fault]


def _knows_settings(start: FittedModel) -> bool:
    """Whether the scenario says that an axis stops at random."""
    return any(isinstance(e, IndexError_) for e in start.known)
