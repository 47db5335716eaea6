"""The answer: findings, verdict, statement and figures of a fitted model, and of recordings in
which nothing can be tested.

The amended scenario is simulated again and compared with the fit and with the recording.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.diagnosis.conclusions.concluding import amended_of, findings_of, undetectable_of
from tiltcal.diagnosis.conclusions.finding import Diagnosis, Finding, Fitness, verdict_of
from tiltcal.diagnosis.conclusions.fit_figures import (
    MIN_SAMPLES,
    fitness_of,
    rms_of,
    under_fixed_white,
)
from tiltcal.diagnosis.conclusions.noise_figures import NoiseReport, noise_report
from tiltcal.diagnosis.conclusions.other_findings import (
    finding_of,
    nameless_doubts,
    nameless_findings,
    not_noise,
    readings_near_pole,
    repeated_stamps,
    rows_out_of_order,
)
from tiltcal.diagnosis.conclusions.residual_plots import laws_of, spectra_of, views_of
from tiltcal.diagnosis.conclusions.statements import (
    doubted,
    implausible,
    law_name,
    not_reproduced,
    summary,
    untested_of,
    untold,
)
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.data_faults.prepare import PreparedData
from tiltcal.diagnosis.model.channel_noise import shift_bias_to_start
from tiltcal.diagnosis.model.cross_validation import heldout_residuals
from tiltcal.diagnosis.model.finding_tests import ALPHA, NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.effects import CATALOGUE, Effect
from tiltcal.effects.data.faults import DataDrop
from tiltcal.laboratory.laboratory import Laboratory
from tiltcal.laboratory.scenario import Scenario, parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import robust_white

LIMIT = 2 * float(np.log(1 / ALPHA))  # of chi-square


@dataclass(frozen=True)
class Resimulation:
    """How far the simulator's run of the amended scenario is from the recording.

    Args:
        rms: of measured minus simulated, in standard deviations of a sample's noise, all channels
            together.
        algebra: largest distance of the simulator from the closed form that was fitted, in the same
            unit.
        rise: sum of squares of measured minus simulated, less that of measured minus fitted, in
            squares of that unit.
        samples: how many there are; 0 where nothing was simulated.
        refused: why the simulator did not run.
    """

    rms: float = 0.0
    algebra: float = 0.0
    rise: float = 0.0
    samples: int = 0
    refused: str = ""

    @property
    def failed(self) -> bool:
        """Whether the recording is less probable by the simulator's run than by the fit, 1 / ALPHA
        times and more.
        """
        return not self.rise <= LIMIT

    @property
    def words(self) -> str:
        """As a note."""
        if self.refused:
            return f"not re-simulated: {self.refused}"
        if not self.samples:
            return "not re-simulated: the simulator predicts none of the channels that were fitted"
        return (
            f"re-simulated with the amended scenario: residual {self.rms:.3f} of a sample's noise"
            f" rms; the simulator and the fitted algebra differ by {self.algebra:.2g} at most"
        )

    @property
    def failure(self) -> str:
        """How much worse it is than the fit."""
        return (
            f"it differs by up to {self.algebra:.3g} of a sample's noise, which adds"
            f" {self.rise:.3g} to chi-square; from {LIMIT:.3g} the recording is {1 / ALPHA:.0f}"
            " times less probable"
        )


def resimulate(
    laboratory: Laboratory, amended: Scenario, observations: Observations, fitted: list[Array]
) -> Resimulation:
    """Run the amended scenario along every recording.

    Args:
        laboratory: the simulator.
        amended: what it runs.
        observations: what was read; its columns mean what they say, so that faults of meaning are
            left out of the run.
        fitted: what the closed form says each channel should have read, (n,).
    """
    try:
        runs = [laboratory.predict(amended, r, by_others=True) for r in observations.recordings]
    except TiltcalError as refusal:
        return Resimulation(refused=str(refusal))
    left, rise, furthest, count = 0.0, 0.0, 0.0, 0
    for channel, algebra in zip(observations.channels, fitted, strict=True):
        if channel.derived:
            continue
        run = _as_simulated(channel, runs[channel.recording], amended)
        there = ~np.isnan(run) & ~np.isnan(algebra)
        if there.sum() < MIN_SAMPLES:
            continue
        read, fit, again = (channel.weighed(v)[there] for v in (channel.values, algebra, run))
        noise = robust_white(read - fit)
        error, of_fit, beside = (read - again) / noise, (read - fit) / noise, (fit - again) / noise
        left += float(error @ error)
        rise += float(error @ error - of_fit @ of_fit)
        count += int(there.sum())
        furthest = max(furthest, float(np.abs(beside).max()))
    rms = float(np.sqrt(left / count)) if count else 0.0
    return Resimulation(rms, furthest, rise, count)


def _as_simulated(channel: Channel, run: Recording, amended: Scenario) -> Array:
    """What the simulator reads in the rows of a channel, SI, (n,); NaN where it reads nothing."""
    samples = run.sensor(amended.named(channel.sensor))
    full = np.full(len(run), np.nan)
    full[samples.rows] = samples.values[:, channel.column]
    return np.asarray(full[channel.rows])


def testable(prepared: PreparedData) -> bool:
    """Whether the readings leave anything to test the calibrated scenario with."""
    observations, rank = prepared.observations, prepared.start.rank
    return observations.determines(rank) and observations.samples > rank


def untested(prepared: PreparedData) -> Diagnosis:
    """The answer where nothing can be tested: faults of the data, and what to record."""
    observations, start = prepared.observations, prepared.start
    faults = (*(finding_of(f) for f in prepared.faults), *_out_of_order(prepared))
    reason = untold(observations.scenario.rig, observations.samples, start.rank)
    figures = Fitness(None, rms_of(observations, start.effects))
    left = observations.residuals(start.effects)
    return Diagnosis(
        verdict_of(faults, False),
        summary(faults, "cannot_tell", reason),
        faults,
        _notes_of(prepared),
        before=figures,
        after=figures,
        amended=amended_of(start, observations, prepared.faults, {}),
        views=views_of(observations, left, left),
        spectra=spectra_of(observations, left, left),
    )


def answered(prepared: PreparedData, said: Explained) -> tuple[Diagnosis, FittedModel]:
    """The answer, and the model that its amended scenario holds.

    Args:
        prepared: what was fitted to.
        said: what the search came to.
    """
    fitted, whitened, noise_source = said.fitted, said.whitened, said.noise_source
    log_p: list[float] = []
    if fitted.terms:
        log_p, whitened = noise_source.log_p(fitted, whitened)
    observations, faults = prepared.observations, [*prepared.faults, *said.random_settings]
    before = refit(prepared.start, whitened) if fitted.terms else fitted
    white = under_fixed_white(prepared.start, whitened)
    first, last = _fits(before, fitted, white, said.whitened, noise_source)
    left = whitened.less_settings(fitted.effects)
    groups, laws = fitted.findings(), laws_of(fitted, observations, left)
    found = findings_of(said, whitened, log_p)
    order = sorted(range(len(found)), key=lambda k: found[k].delta_bic or 0.0)
    lawful = (replace(found[k], laws=laws[k]) for k in order)
    nameless = (*nameless_findings(said), *_out_of_order(prepared))
    findings = (*(finding_of(f) for f in faults), *lawful, *nameless)
    numbers = {place: len(faults) + rank for rank, k in enumerate(order, 1) for place in groups[k]}
    doubt = _doubts_of(said, () if findings else untested_of(observations, prepared.start.rank))
    verdict = verdict_of(findings, tested := last.chi2_per_dof is not None, bool(doubt))
    fits = noise_source.noise(fitted, whitened)
    noise = noise_report(observations, left, fits, noise_source.words, said.in_noise)
    rig, samples = observations.scenario.rig, observations.samples
    reason = " ".join(doubt) if tested else untold(rig, samples, fitted.rank)
    told = summary(findings, verdict, reason, first, last, noise)
    began = shift_bias_to_start(fitted, whitened, fits)
    answer = Diagnosis(
        verdict,
        told,
        findings,
        (*_notes_of(prepared), *_noise_notes(noise, said), *implausible(fitted), *doubt),
        undetectable_of(fitted, said.whitened),
        first,
        last,
        noise,
        amended_of(began, observations, faults, numbers),
        views_of(observations, *(_held_out(m, white) for m in (before, fitted))),
        spectra_of(observations, whitened.less_settings(before.effects), left),
    )
    return answer, began


def _doubts_of(said: Explained, untested: Sequence[str]) -> list[str]:
    """What is more probable than not, and not probable enough to be claimed, and what was not
    tested; nothing without.
    """
    channels, slow = said.whitened.observations.channels, not_noise(said)
    named = {s.law.place for s in said.in_noise if slow.keys() & set(s.channels)}
    doubts = (d for d in said.doubts if d.law.place not in named)
    causes = [(law_name(d.law.effect), d.probability) for d in doubts]
    hidden = [
        (f"a listed effect in the slow noise of {channels[n].sensor} {channels[n].axis}", chance)
        for n, chance in slow.items()
    ]
    told = [*causes, *nameless_doubts(said), *hidden]
    return [*([doubted(told)] if told else []), *untested]


def _out_of_order(prepared: PreparedData) -> list[Finding]:
    """Rows of the recordings whose time is out of order."""
    return rows_out_of_order(prepared.left_out, prepared.observations.scenario.sensor)


def _notes_of(prepared: PreparedData) -> tuple[str, ...]:
    """What is no mismatch of the recordings."""
    sensors, sources = prepared.observations.scenario.sensor, prepared.observations.sources
    unused = readings_near_pole(sensors, sources)
    return (*prepared.notes, *repeated_stamps(prepared.left_out), *unused)


def _noise_notes(noise: NoiseReport, said: Explained) -> list[str]:
    """Where the noise was taken from, and what it follows."""
    source = f"the noise was taken from {noise.source}"
    return [source, *noise.notes, *(v.words for v in said.varying)]


def _held_out(model: FittedModel, white: WhitenedModel) -> list[Array]:
    """Residuals of the blocks that the sizes were not fitted to, by channel, SI, (n,)."""
    channels, left = white.observations.channels, heldout_residuals(model, white)
    return [
        noise.white * (r if c.spread is None else c.spread * r)
        for c, noise, r in zip(channels, white.noise, left, strict=True)
    ]


def simulated(
    answer: Diagnosis, laboratory: Laboratory, full: Observations, amended: FittedModel
) -> Diagnosis:
    """The answer with the result of the re-simulation, which it has to survive.

    Args:
        answer: so far.
        laboratory: the simulator.
        full: what was read, sample by sample.
        amended: the model that the amended scenario holds.
    """
    # lost samples that the scan found are not mended in the columns
    lost = any(isinstance(e, DataDrop) for e in amended.effects)
    scenario = _as_read(answer.amended, full.scenario, lost)
    again = resimulate(laboratory, scenario, full, full.predict(amended.effects))
    noted = replace(answer, notes=(*answer.notes, again.words))
    if not again.failed:
        return noted
    return replace(
        noted,
        verdict="unlisted" if answer.verdict == "unlisted" else "cannot_tell",
        statement=not_reproduced(answer.statement, again.failure),
    )


def _fits(
    before: FittedModel,
    fitted: FittedModel,
    white: WhitenedModel,
    whitened: WhitenedModel,
    noise_source: NoiseSource,
) -> tuple[Fitness, Fitness]:
    """The figures of the scenario as it is and of the amended one, by one measure; the likelihood
    of each is under the most probable noise that it leaves.
    """
    own = noise_source.left_by(before, whitened)
    first = fitness_of(before, white, own.noise)
    alone = refit(before, own)
    if first.log_likelihood is not None:
        at = fitness_of(alone, white, own.noise).log_likelihood
        first = replace(first, log_likelihood=at)
    return first, fitness_of(fitted, white, whitened.noise)


def _as_read(amended: Mapping[str, Any], scenario: Scenario, lost: bool) -> Scenario:
    """The amended scenario without data faults that were repaired in the columns."""

    def held(id: str) -> bool:
        cls = CATALOGUE.get(id, Effect)
        mended = cls.repair or cls.scatters or (id == DataDrop.id and not lost)
        return not mended

    return parse_scenario(
        {**amended, "effect": [e for e in amended["effect"] if held(e["id"])]}, scenario.name
    )
