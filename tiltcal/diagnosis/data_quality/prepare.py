"""Recordings on the bench: what is wrong with their data mended, layer by layer, and the adjustable
terms fitted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.channels import MASKED, MEANINGS, as_meant, written
from tiltcal.diagnosis.data.handheld_channels import HandObservations
from tiltcal.diagnosis.data.observations import Observations, TableObservations, observe
from tiltcal.diagnosis.data_quality.flat_and_repeated import Fault, inspect
from tiltcal.diagnosis.data_quality.lost_samples import lost_samples
from tiltcal.diagnosis.data_quality.outliers import gross_errors
from tiltcal.diagnosis.data_quality.quantisation_limit import code_floors
from tiltcal.diagnosis.data_quality.readout_jumps import jumps
from tiltcal.diagnosis.data_quality.stop_errors import (
    at_rest_only,
    random_stamps,
    stands_alone,
    wrong_stop,
)
from tiltcal.diagnosis.data_quality.stuck_bit import with_bits
from tiltcal.diagnosis.data_quality.units_signs_axes import meaning
from tiltcal.diagnosis.hypotheses.hypothesis import adjustable
from tiltcal.diagnosis.model.fitted_model import Account, Term, settle
from tiltcal.diagnosis.model.hypothesis_columns import Ledger, cosines
from tiltcal.effects.base import Effect
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import group_directions
from tiltcal.statistics.noise_spectrum import NoiseFit, NoiseModel, estimate_noise, robust_white

PASSES = 5  # of putting missing bits back


@dataclass(frozen=True)
class Bench:
    """Recordings whose data faults are mended, and the adjustable terms fitted to them.

    Args:
        faults: found in the data; notes: what is no mismatch.
        floors: size, SI, of what coarse codes do to a sensor's misfit, by sensor.
    """

    observations: Observations
    ledger: Ledger
    start: Account
    faults: tuple[Fault, ...]
    notes: tuple[str, ...]
    floors: Mapping[str, float] = field(default_factory=dict)

    def over(self, observations: Observations, *faults: Fault) -> "Bench":
        """The same over other observations, the adjustable terms fitted again, with further
        faults.
        """
        ledger = Ledger(observations)
        return replace(
            self,
            observations=observations,
            ledger=ledger,
            start=calibrated(observations, ledger),
            faults=(*self.faults, *faults),
        )


def prepare(scenario: Scenario, recordings: Sequence[Recording]) -> Bench:
    """Mend what is wrong with the data, layer by layer, and fit the adjustable terms."""
    sound, faults, notes = _sound(scenario, recordings)
    known = [
        e
        for e in (*scenario.effects, *(f.effect for f in faults))
        if e.id not in (*MEANINGS, *MASKED)
    ]
    stated = {e.id for e in scenario.effects}
    floors = code_floors(scenario, faults)
    observations = observe(scenario, sound, known)
    ledger = Ledger(observations)
    bench = Bench(
        observations, ledger, calibrated(observations, ledger), tuple(faults), tuple(notes), floors
    )
    bench = _with_bits(bench, known)
    if not floors:  # first: a jump of the readout is a rate that no sensor had
        slips, level = jumps(bench.observations, bench.start)
        said = () if "data_pose_label" in stated else slips
        bench = bench.over(observe(scenario, level, known), *said) if slips else bench
    if not floors and "data_drop" not in stated:
        losses, moved = lost_samples(bench.observations, bench.start)
        bench = bench.over(observe(scenario, moved, known), *losses) if losses else bench
    if (
        not floors
        and "data_jitter" not in stated
        and (stamps := random_stamps(bench.start, bench.observations)) is not None
    ):
        quiet = at_rest_only(bench.observations, bench.start, stamps.effect.value("jitter"))
        bench = bench.over(observe(scenario, quiet, known), stamps)
    wild, mended = gross_errors(bench.observations, bench.start, floors)
    if any(a is not b for a, b in zip(mended, bench.observations.sources, strict=True)):
        bench = bench.over(observe(scenario, mended, known), *wild)
    return bench if floors else _with_right_stops(bench, known, "data_pose_label" in stated)


def _with_bits(bench: Bench, known: Sequence[Effect]) -> Bench:
    """Bits that are never set put back, again and again as long as a better fit, which they spoil,
    moves some.
    """
    bits = {
        (f.sensors[0], f.axes[0]): f.effect.value("bit_value")
        for f in bench.faults
        if f.effect.id == "adc_stuck_bit"
    }
    as_came, scenario = bench.observations.sources, bench.observations.scenario
    columns = [(scenario.named(name), axis) for name, axis in bits]
    for _ in range(PASSES if bits else 0):
        before, whole = (
            bench.observations.sources,
            with_bits(as_came, bench.observations, bench.start, bits),
        )
        if all(
            np.array_equal(written(a, *c), written(b, *c), True)
            for a, b in zip(before, whole, strict=True)
            for c in columns
        ):
            break
        bench = bench.over(observe(scenario, whole, known))
    return bench


def _with_right_stops(bench: Bench, known: Sequence[Effect], stated: bool) -> Bench:
    """One stop whose written angle is wrong put right; stated: whether the scenario says so
    already.
    """
    slip = wrong_stop(bench.observations, bench.start)
    if slip is None:
        return bench
    mended = bench.over(observe(bench.observations.scenario, slip[1], known))
    if not stands_alone(
        bench.observations, mended.observations, mended.start
    ):  # a law that is strongest there
        return bench
    fault, _ = (
        wrong_stop(bench.observations, mended.start) or slip
    )  # sized again, by a calibration that it has not spoiled
    return mended if stated else replace(mended, faults=(*mended.faults, fault))


def _sound(
    scenario: Scenario, recordings: Sequence[Recording]
) -> tuple[tuple[Recording, ...], list[Fault], list[str]]:
    """The recordings with the faults of their data mended, and those faults."""
    inspected = inspect(scenario, recordings)
    faults = list(inspected.faults)
    meant = meaning(scenario, inspected.recordings[0])
    other_unit = {
        f.effect.sensor for f in meant if f.effect.id == "data_unit"
    }  # its digits were meant for another size
    faults = [
        f
        for f in faults
        if f.effect.id not in ("adc_quantisation", "gyr_quantisation")
        or f.effect.sensor not in other_unit
    ]
    effects = [*scenario.effects, *(f.effect for f in meant)]
    sound = tuple(as_meant(r, scenario, effects) for r in inspected.recordings)
    return sound, [*meant, *faults], list(inspected.notes)


def thinned(bench: Bench, block: int) -> Bench:
    """The same with so many samples of a long record averaged into one."""
    old = bench.observations
    return (
        bench.over(old.averaged(block))
        if block > 1 and isinstance(old, TableObservations)
        else bench
    )


def static_noise(observations: Observations, static: Recording) -> tuple[NoiseFit, ...]:
    """The noise of each channel from a record at rest.

    Raises:
        TiltcalError: it lacks a sensor.
    """
    found = []
    for channel in observations.channels:
        sensor = observations.scenario.named(channel.sensor)
        if channel.white:  # no record at rest holds a turn
            found.append(
                NoiseFit.whole(NoiseModel(max(channel.white, robust_white(channel.values))))
            )
            continue
        samples = static.sensor(sensor)
        values = (
            samples.values[:, channel.column]
            if channel.axis != "norm"
            else np.linalg.norm(samples.values, axis=1)
        )
        values = values[~np.isnan(values)]
        found.append(
            estimate_noise(cosines(values - values.mean()), cosines(np.ones(len(values)))[:, None])
        )
    return tuple(found)


def calibrated(observations: Observations, ledger: Ledger) -> Account:
    """The adjustable terms fitted to the readings, with white noise."""
    scenario = observations.scenario
    terms = [Term.start(s) for s in adjustable(scenario)]
    known: list[Effect] = []
    for (
        effect
    ) in observations.known:  # an amended scenario brings its calibration: go on from there
        k = next(
            (
                k
                for k, t in enumerate(terms)
                if t.suspect.place == (effect.id, effect.sensor, effect.axis)
            ),
            None,
        )
        if k is None or effect.role != "calibration":
            known.append(effect)
        else:
            terms[k] = replace(terms[k], values=tuple(effect.value(n) for n in terms[k].names))
    account = Account(tuple(known), tuple(terms))
    ledger.under([NoiseModel(robust_white(r)) for r in observations.residuals(account.effects)])
    account = settle(account, ledger)
    if not isinstance(observations, TableObservations) or observations.block < 2:
        return account
    observations.bend_at(account.effects)
    return settle(account, ledger)


def enough(observations: Observations, account: Account) -> bool:
    """Whether there are more poses than the adjustable terms need."""
    if not observations.channels:
        return False
    if not isinstance(observations, HandObservations):
        return True
    if any(c.axis != "norm" for c in observations.channels):
        return True
    up: list[Array] = []
    for channel in observations.channels:
        recording = observations.recordings[channel.recording]
        sensor = observations.scenario.named(channel.sensor)
        samples = recording.sensor(sensor)
        values = samples.values[np.isin(samples.rows, channel.rows)]
        up += [
            values[channel.stop == k].mean(axis=0)
            for k in range(channel.stop.max() + 1)
            if (channel.stop == k).any()
        ]
    directions = int(group_directions(np.array(up)).max()) + 1 if up else 0
    return directions > account.basis[0].shape[1]
