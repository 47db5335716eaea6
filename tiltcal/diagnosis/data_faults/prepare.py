"""Recordings with their data faults repaired, step by step, and the adjustable terms fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.numerical import undetermined
from tiltcal.diagnosis.data.channels import undo_labelling_faults, written
from tiltcal.diagnosis.data.observations import Channel, Observations
from tiltcal.diagnosis.data.observe import observe
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.data_faults.inspection import Inspected, LeftOut, inspect, once
from tiltcal.diagnosis.data_faults.lost_samples import find_lost_samples
from tiltcal.diagnosis.data_faults.outliers import find_outliers
from tiltcal.diagnosis.data_faults.quantisation_limit import code_floors
from tiltcal.diagnosis.data_faults.readout_jumps import find_readout_jumps
from tiltcal.diagnosis.data_faults.restored_bits import with_bits
from tiltcal.diagnosis.data_faults.stop_errors import find_wrong_stop, stands_alone
from tiltcal.diagnosis.data_faults.timestamp_jitter import at_rest_only, find_stamp_jitter
from tiltcal.diagnosis.data_faults.units_signs_axes import (
    find_labelling_faults,
    require_labelled_alike,
)
from tiltcal.diagnosis.hypotheses.hypothesis import adjustable
from tiltcal.diagnosis.model.channel_noise import white_of_differences
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.refitting import refit, refit_about_itself
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.base import Effect
from tiltcal.effects.data.faults import DataDrop
from tiltcal.effects.data.labelling_faults import DataPoseLabel, DataUnit
from tiltcal.effects.electronics.converter import AdcQuantisation, AdcStuckBit
from tiltcal.effects.timing.delays import DataJitter
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.dwell_noise import robust_white
from tiltcal.statistics.noise_spectrum import (
    NoiseFit,
    NoiseModel,
    WhiteFlickerWalk,
    estimate_noise,
    white_noise,
)

PASSES = 5  # of putting missing bits back

FEWEST_AT_REST = 16  # readings that noise is told from


@dataclass(frozen=True)
class PreparedData:
    """Recordings whose data faults are repaired, and the adjustable terms fitted to them.

    Args:
        faults: found in the data; notes: what is no mismatch.
        left_out: rows that were left out because their stamps do not increase.
    """

    observations: Observations
    whitened: WhitenedModel
    start: FittedModel
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    left_out: tuple[LeftOut, ...] = ()

    def over(self, observations: Observations, *faults: Fault) -> "PreparedData":
        """The same for other observations, with the adjustable terms re-fitted and further
        faults.
        """
        start, whitened = calibrated(observations, self.whitened.law, self.whitened.floors)
        every = (*self.faults, *faults)
        return replace(
            self, observations=observations, whitened=whitened, start=start, faults=every
        )


def prepare(
    scenario: Scenario,
    recordings: Sequence[Recording],
    law: type[NoiseModel] = WhiteFlickerWalk,
    seen: Sequence[Fault] = (),
) -> PreparedData:
    """Repair the faults of the data step by step, and fit the adjustable terms.

    Args:
        scenario: what is known of the set-up.
        recordings: of it, as they were read.
        law: kind of noise model that is fitted to each channel.
        seen: faults that were found in the data and repaired before.
    """
    sound, faults, inspected = _sound(scenario, recordings)
    faults = once([*seen, *faults])
    known = [e for e in (*scenario.effects, *(f.effect for f in faults)) if not e.repair]
    stated = {e.id for e in scenario.effects}
    seen_in_columns = [*faults, *inspected.stated]
    floors = code_floors(scenario, seen_in_columns)
    observations = observe(scenario, sound, known)
    start, whitened = calibrated(observations, law, floors)
    said = tuple(faults), inspected.notes, inspected.left_out
    prepared = PreparedData(observations, whitened, start, *said)
    prepared = _with_bits(prepared, known, seen_in_columns)
    if not floors:  # first: a jump of the readout is a rate that no sensor had
        slips, level = find_readout_jumps(prepared.observations, prepared.start)
        new = () if DataPoseLabel.id in stated else slips
        prepared = prepared.over(observe(scenario, level, known), *new) if slips else prepared
    if not floors and DataDrop.id not in stated:
        losses, moved = find_lost_samples(prepared.observations, prepared.start)
        prepared = prepared.over(observe(scenario, moved, known), *losses) if losses else prepared
    stamps = None if floors else find_stamp_jitter(prepared.start, prepared.observations)
    if stamps is not None:
        quiet = at_rest_only(prepared.observations, prepared.start, stamps.effect.value("jitter"))
        scattered = () if DataJitter.id in stated else (stamps,)
        prepared = prepared.over(observe(scenario, quiet, known), *scattered)
    wild, mended = find_outliers(prepared.observations, prepared.start, floors)
    if any(a is not b for a, b in zip(mended, prepared.observations.sources, strict=True)):
        prepared = prepared.over(observe(scenario, mended, known), *wild)
    return prepared if floors else _with_right_stops(prepared, known, DataPoseLabel.id in stated)


def _with_bits(
    prepared: PreparedData, known: Sequence[Effect], faults: Sequence[Fault]
) -> PreparedData:
    """Missing bits put back, repeatedly as long as the better fit changes some.

    Args:
        prepared: readings that lack them.
        known: effects that act.
        faults: seen in the columns, those that the scenario states among them.
    """
    bits = {
        (f.sensors[0], f.axes[0]): f.effect.value("bit_value")
        for f in faults
        if isinstance(f.effect, AdcStuckBit)
    }
    as_came, scenario = prepared.observations.sources, prepared.observations.scenario
    columns = [(scenario.named(name), axis) for name, axis in bits]
    for _ in range(PASSES if bits else 0):
        before, whole = (
            prepared.observations.sources,
            with_bits(as_came, prepared.observations, prepared.start, bits),
        )
        if all(
            np.array_equal(written(a, *c), written(b, *c), True)
            for a, b in zip(before, whole, strict=True)
            for c in columns
        ):
            break
        prepared = prepared.over(observe(scenario, whole, known))
    return prepared


def _with_right_stops(
    prepared: PreparedData, known: Sequence[Effect], stated: bool
) -> PreparedData:
    """One stop with a wrong written angle repaired; stated: whether the scenario states it
    already.
    """
    slip = find_wrong_stop(prepared.observations, prepared.start)
    if slip is None:
        return prepared
    mended = prepared.over(observe(prepared.observations.scenario, slip[1], known))
    # a law that is strongest there
    if not stands_alone(prepared.observations, mended.observations, mended.start):
        return prepared
    # sized again, by a calibration that it has not spoiled
    fault, _ = find_wrong_stop(prepared.observations, mended.start) or slip
    return mended if stated else replace(mended, faults=(*mended.faults, fault))


def _sound(
    scenario: Scenario, recordings: Sequence[Recording]
) -> tuple[tuple[Recording, ...], list[Fault], Inspected]:
    """The recordings with faults of their columns repaired, those faults, and what their inspection
    said.
    """
    inspected = inspect(scenario, recordings)
    faults = list(inspected.faults)
    meant = find_labelling_faults(scenario, inspected.recordings[0])
    # its digits were meant for another size
    other_unit = {f.effect.sensor for f in meant if isinstance(f.effect, DataUnit)}
    faults = [
        f
        for f in faults
        if not isinstance(f.effect, AdcQuantisation) or f.effect.sensor not in other_unit
    ]
    effects = [*scenario.effects, *(f.effect for f in meant)]
    sound = tuple(undo_labelling_faults(r, scenario, effects) for r in inspected.recordings)
    require_labelled_alike(scenario, inspected.recordings, sound, meant)
    return sound, [*meant, *faults], inspected


def averaged_blocks(prepared: PreparedData, block: int) -> PreparedData:
    """The same with this number of samples of a long record averaged into one."""
    averaged = prepared.observations.averaged(block)
    return prepared if averaged is prepared.observations else prepared.over(averaged)


def static_noise(
    observations: Observations,
    static: Recording,
    law: type[NoiseModel],
    faults: Sequence[Fault] = (),
) -> tuple[NoiseFit, ...]:
    """The noise of each channel from a record at rest, averaged over as many samples as the
    channel's values are.

    Args:
        observations: whose channels.
        static: the record, as it was read.
        law: kind of noise model.
        faults: of the recordings: its columns are labelled as theirs are.

    Raises:
        TiltcalError: it lacks a sensor, or readings of it.
    """
    scenario, found = observations.scenario, []
    effects = [*scenario.effects, *(f.effect for f in faults)]
    (sound,) = inspect(scenario, [static]).recordings
    static = undo_labelling_faults(sound, scenario, effects)
    for channel in observations.channels:
        sensor = scenario.named(channel.sensor)
        if channel.white:  # no record at rest holds a turn
            found.append(
                NoiseFit.known(white_noise(max(channel.white, robust_white(channel.values))))
            )
            continue
        samples = static.sensor(sensor)
        values = (
            samples.values[:, channel.column]
            if channel.axis != "norm"
            else np.linalg.norm(samples.values, axis=1)
        )
        known = ~np.isnan(values)
        values = _at_the_step(values[known], static.time[samples.rows][known], channel)
        if len(values) < FEWEST_AT_REST:
            raise undetermined(
                static.source,
                f"the noise of {channel.sensor} {channel.axis}",
                f"{len(values)} readings, need at least {FEWEST_AT_REST}",
            )
        level = cosines(np.ones(len(values)))[:, None]
        found.append(estimate_noise(cosines(values - values.mean()), level, law))
    return tuple(found)


def _at_the_step(values: Array, time: Array, channel: Channel) -> Array:
    """Means of consecutive values, one for each step of a channel, (m,).

    Args:
        values: SI, (n,); time: of these, s, (n,).
    """
    steps = [float(np.median(np.diff(t))) if len(t) > 1 else 1.0 for t in (channel.time, time)]
    block = max(round(steps[0] / steps[1]), 1)
    return values[: len(values) // block * block].reshape(-1, block).mean(axis=1)


def calibrated(
    observations: Observations,
    law: type[NoiseModel],
    floors: Mapping[str, float] | None = None,
) -> tuple[FittedModel, WhitenedModel]:
    """The adjustable terms fitted to the readings under white noise, and that noise.

    Args:
        observations: what was read.
        law: kind of noise model that is fitted later.
        floors: of the sensors with coarse codes, as ``WhitenedModel`` has them.
    """
    scenario = observations.scenario
    terms = [FittedTerm.start(s) for s in adjustable(scenario)]
    places = [t.hypothesis.place for t in terms]
    known: list[Effect] = []
    for effect in observations.known:
        place = (effect.id, effect.sensor, effect.axis)
        # what is to be fitted, and the calibration of an amended scenario, goes on from there
        if place in places and (effect.fit or effect.role == "calibration"):
            k = places.index(place)
            terms[k] = replace(terms[k], values=tuple(effect.value(n) for n in terms[k].names))
        else:
            known.append(effect)
    fitted = FittedModel(tuple(known), tuple(terms))
    noise = white_of_differences(fitted, observations)
    whitened = WhitenedModel.of(HypothesisColumns(observations), noise, law)
    whitened = replace(whitened, floors=floors or {})
    fitted = refit(fitted, whitened)
    return refit_about_itself(fitted, whitened) if observations.block > 1 else fitted, whitened
