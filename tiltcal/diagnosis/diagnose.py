"""From recordings and a scenario to a diagnosis: faults of the data, noise, search for effects,
conclusions.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from tiltcal.core.numerical import determining, one_thread
from tiltcal.core.progress import Progress, Stages, silent
from tiltcal.diagnosis.conclusions.answering import answered, simulated, testable, untested
from tiltcal.diagnosis.conclusions.finding import Diagnosis
from tiltcal.diagnosis.data_faults.heading import with_heading
from tiltcal.diagnosis.data_faults.long_recordings import (
    AVERAGES,
    LongRecording,
    read_beginning,
    read_long,
)
from tiltcal.diagnosis.data_faults.prepare import (
    PreparedData,
    averaged_blocks,
    prepare,
    static_noise,
)
from tiltcal.diagnosis.data_faults.requirements import require_diagnosable
from tiltcal.diagnosis.hypotheses.block_averaging import block_of, survives
from tiltcal.diagnosis.lines.spectral_lines import spectral_lines_of
from tiltcal.diagnosis.search.dictionary import build_dictionary
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.diagnosis.search.whole_search import search_for_causes
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.pieces import estimated_rows
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.recordings.span_means import LONGEST, spans_of
from tiltcal.statistics.noise_spectrum import NoiseModel, WhiteFlickerWalk

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
            return _with_reading_notes(untested(prepared), every)
        stages.begin(SIGNATURES)
        lines = spectral_lines_of(prepared.observations, prepared.start)
        whole = prepared.observations
        prepared = averaged_blocks(prepared, block_of(whole, lines))
        at_rest = None
        if rest is not None:
            at_rest = static_noise(prepared.observations, rest, noise, prepared.faults)
        build_dictionary(prepared.whitened, prepared.start, lines, stages.part)
        if search is not None:
            said = search(prepared)
        else:
            stages.begin(SEARCH)
            said = search_for_causes(
                prepared,
                lines,
                at_rest,
                lambda n: stages.status(f"{n} in the model"),
                lambda: stages.begin(ALTERNATIVES),
            )
        stages.begin(ANSWER)
        answer, amended = answered(prepared, said)
        answer = _with_reading_notes(answer, every)
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
        return read_beginning(path, "hand-held recordings are not averaged")
    spans = spans_of(path, AVERAGES)
    if spans is None:
        return read_beginning(path, "coarsely quantised readings are not averaged")
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


def _with_reading_notes(answer: Diagnosis, given: Sequence[LongRecording]) -> Diagnosis:
    """The answer with how its recordings were read."""
    words = [f"{r.said[0].upper()}{r.said[1:]}." for r in given if r.said]
    return replace(answer, statement=" ".join([answer.statement, *words])) if words else answer
