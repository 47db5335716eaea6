"""The block that tells rivals apart: the largest least separated non-centrality a minute of table
time (T-optimal design).

For a block, the recordings so far and an imagined recording of it are put together. Each rival in
turn is taken for the truth, at the size that the recordings give it; every other one is fitted to
what it would read, with the adjustable terms and the other findings, at the noise and by the
threshold of `diagnose`. What is left is the separated non-centrality of the pair; the difference of
their deviances is then N(lambda, 4 lambda). Source: Atkinson and Fedorov, "The design of
experiments for discriminating between two rival models", Biometrika 62 (1975).

What a block would record: the recording that a design is judged by.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import erf, sqrt

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.progress import Part, Progress, Rate, unmeasured
from tiltcal.core.units import ARCSEC, COLUMN_UNITS, DEG, split_unit
from tiltcal.design.identifiability import SEPARABLE
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.investigation.rival_hypotheses import Question
from tiltcal.diagnosis.model.block_matrix import basis_of, project
from tiltcal.diagnosis.model.fitted_model import whitened_of
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.candidates import coarsened
from tiltcal.diagnosis.search.explanation import Explanation
from tiltcal.effects.base import Effect
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario, fresh
from tiltcal.recordings.recording import Recording
from tiltcal.setup.reach import Ends
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.sequence import Step
from tiltcal.setup.tables import angle_key, axis_of

READOUT = 0.05 * ARCSEC / DEG  # deg, noise of an imagined readout


COMING = 5.0  # deg before the first pose of an imagined block


MOVED = 0.1  # of the largest step between samples: what is no noise of the readout


def imagined(block: Block, scenario: Scenario, question: Question) -> Recording:
    """What a block would read if nothing were wrong, in a room that goes back the way it came, with
    the white noise of the recordings so far: by it a row is seen to weigh as much as another.
    """
    last = question.observations.recordings[-1]
    recording = come_to(block, scenario, last_sides(last, scenario))
    rng = np.random.default_rng(0)
    columns = {n: recording.column(n) for n in recording.column_names}
    for (sensor, axis), noise in question.noise.items():
        if (name := recording.channel(f"{sensor}_{axis}")) is not None:
            unit = COLUMN_UNITS[split_unit(name)[1] or ""].factor
            white = noise.white * np.sqrt(question.block) / unit
            columns[name] = columns[name] + white * rng.standard_normal(len(recording))
    temperature = last.temperature()
    if temperature is not None:
        age = np.minimum(recording.time - recording.time[0], last.time[-1] - last.time[0])
        columns["temperature_degC"] = np.interp(last.time[-1] - age, last.time, temperature)
    return Recording.from_columns(
        recording.time, columns, metadata=recording.metadata, source="imagined block"
    )


def last_sides(recording: Recording, scenario: Scenario) -> dict[str, float]:
    """Which way each axis of the table moved last, +1 or -1."""
    found = {}
    for axis in scenario.rig.kind.turning:
        readout = recording.table(axis)
        steps = np.diff(readout[~np.isnan(readout)]) if readout is not None else np.zeros(0)
        moved = steps[np.abs(steps) > MOVED * np.abs(steps).max(initial=0.0)]
        found[axis] = float(np.sign(moved[-1])) if len(moved) else 1.0
    return found


def come_to(block: Block, scenario: Scenario, sides: Mapping[str, float]) -> Recording:
    """What a block would read without effects, its first pose come to as the table moved last.

    From which side a table will come to it nobody has said: a block must not promise what it would
        tell if that were new.
    After remounting the table has moved anyhow.
    """
    if block.remounts or not sides:
        return blank(block, scenario)
    rig = scenario.rig
    stands = dict(zip(rig.axis_names, rig.reach.start.tolist(), strict=True))
    first = {angle_key(axis): stands[axis] for axis in sides}
    for step in reversed(block.steps):
        stated = {angle_key(name): angle for name, angle in step.angles_deg.items()}
        first |= {key: angle for key, angle in stated.items() if key in first}
    away = Step(
        action="move",
        **{
            angle_key(axis): _from_side(first[angle_key(axis)], side, rig.reach.limits(axis))
            for axis, side in sides.items()
        },
    )
    steps = (away, Step(action="move", **first, dwell_s=1.0), *block.steps)
    recording = blank(replace(block, steps=steps), scenario)
    # how it got away is no part of the block
    moves = any(away.angles_deg[axis] != stands[axis] for axis in sides)
    known = recording.time >= (build_schedule((away,), rig).times[1] if moves else -np.inf)
    columns = {n: recording.column(n)[known] for n in recording.column_names}
    return Recording.from_columns(
        recording.time[known], columns, metadata=recording.metadata, source=recording.source
    )


def _from_side(angle: float, side: float, limits: Ends | None) -> float:
    """Where an axis comes from, deg: from the other side where a limit is in the way.

    Args:
        angle: that it goes to, deg.
        side: +1 or -1, the way that it moved last.
        limits: lowest and highest angle, deg.
    """
    low, high = limits or (-np.inf, np.inf)
    one, other = angle - side * COMING, angle + side * COMING
    return one if low <= one <= high else float(np.clip(other, low, high))


def blank(block: Block, scenario: Scenario) -> Recording:
    """A recording of a block without effects or noise, but for that of the readout: what rests is
    told by it.
    """
    recording = SimulatedLaboratory().record(
        fresh(scenario, sequence=block.steps, effect=(), grade=None, dynamics=None)
    )
    rng = np.random.default_rng(0)
    columns = {n: recording.column(n) for n in recording.column_names}
    for name in columns:
        if axis_of(name) is not None:
            columns[name] = columns[name] + READOUT * rng.standard_normal(len(recording))
    return Recording.from_columns(
        recording.time, columns, metadata=recording.metadata, source=f"block {block.name}"
    )


ENOUGH = 0.95  # chance of telling a pair apart at which a block is good enough
# best chance of any block below which a pair is said to be out of this table's reach
HOPELESS = 0.2
SHORT_LIST = 3  # blocks that are tried together when none is enough by itself


@dataclass(frozen=True)
class Pair:
    """One rival taken for the truth, another fitted to it.

    Args:
        truth, rival: ids.
        separation: what is left of the truth's signal, non-centrality; needed: at which the
            diagnosis calls them apart.
    """

    truth: str
    rival: str
    separation: float
    needed: float

    @property
    def chance(self) -> float:
        """Of being told apart: the difference of their deviances is N(separation, 4 separation)."""
        if self.separation <= 0:
            return 0.0
        return 0.5 * (
            1 + erf((self.separation - self.needed) / (2 * sqrt(self.separation)) / sqrt(2))
        )


@dataclass(frozen=True)
class BlockProposal:
    """A block with what it should bring.

    Args:
        block: what to record; minutes: of table time; pairs: that some block can tell apart, the
            hardest first.
    """

    block: Block
    minutes: float
    pairs: tuple[Pair, ...]

    @property
    def least(self) -> Pair | None:
        """The pair that is hardest to tell apart; None where there are no rivals."""
        return self.pairs[0] if self.pairs else None

    @property
    def chance(self) -> float:
        """Of telling the hardest pair apart."""
        return self.least.chance if self.least is not None else 0.0

    @property
    def rate(self) -> float:
        """Least separated non-centrality a minute."""
        return min((p.separation for p in self.pairs), default=0.0) / self.minutes

    @property
    def worth(self) -> tuple[int, float]:
        """Blocks that are enough first, by non-centrality a minute; then the others by the chances
        of all pairs.

        A remounted instrument does not sit as it did: only where nothing else is enough.
        """
        if self.chance >= ENOUGH:
            return (1 if self.block.remounts else 2), self.rate
        return 0, self.chance + float(np.mean([p.chance for p in self.pairs])) - 0.02 * self.minutes


Judge = Callable[[Sequence[Block], Part], list[list[Pair]]]
"""Says what each block would tell, and how many are judged."""


@dataclass(frozen=True)
class Design:
    """What to record next.

    Args:
        proposals: the best first; none when no block tells anything apart.
        twins: (truth, rival) that no block of this table tells apart.
    """

    proposals: tuple[BlockProposal, ...]
    twins: tuple[tuple[str, str], ...]

    @property
    def best(self) -> BlockProposal | None:
        """The block to record."""
        return self.proposals[0] if self.proposals else None


def propose(
    asked: Sequence[Question],
    blocks: Iterable[Block],
    scenario: Scenario,
    most_minutes: float,
    progress: Progress,
    judge: Judge | None = None,
) -> Design:
    """Blocks no longer than ``most_minutes``, the best first; two after one another too where none
    is enough by itself.

    Args:
        asked: what is to be told apart; blocks: to choose from; scenario: what is known.
        most_minutes: of one block; progress: is told how many blocks are judged.
        judge: what each block would tell; in this process, one after the other, if not given.
    """
    tried: dict[str, tuple[Block, list[Pair]]] = {}

    def evaluate(blocks: Iterable[Block]) -> None:
        named = {b.name: b for b in blocks if b.seconds(scenario.rig) <= 60 * most_minutes}
        short = [block for name, block in named.items() if name not in tried]
        rate = Rate(len(short), "blocks")

        def part(done: float) -> None:
            progress(f"evaluating blocks: {rate.after(round(done * len(short)))}")

        found = judge(short, part) if judge else judged_in_turn(short, asked, scenario, part)
        tried.update({b.name: (b, pairs) for b, pairs in zip(short, found, strict=True)})

    evaluate(blocks)
    design = _ranked(tried, scenario)
    if design.best is not None and design.best.chance < ENOUGH:
        best = [p.block for p in design.proposals[:SHORT_LIST]]
        evaluate(one + other for one, other in combinations(best, 2))
        design = _ranked(tried, scenario)
    return design


def _ranked(tried: Mapping[str, tuple[Block, Sequence[Pair]]], scenario: Scenario) -> Design:
    """Blocks in order of worth, pairs that no block can tell apart set aside."""
    top: dict[tuple[str, str], float] = {}
    for _, pairs in tried.values():
        for p in pairs:
            top[p.truth, p.rival] = max(top.get((p.truth, p.rival), 0.0), p.chance)
    twins = tuple(key for key, chance in top.items() if chance < HOPELESS)
    found = []
    for block, pairs in tried.values():
        left = sorted((p for p in pairs if (p.truth, p.rival) not in twins), key=lambda p: p.chance)
        if left:
            found.append(BlockProposal(block, block.seconds(scenario.rig) / 60, tuple(left)))
    return Design(tuple(sorted(found, key=lambda p: p.worth, reverse=True)), twins)


def judged_in_turn(
    blocks: Sequence[Block], asked: Sequence[Question], scenario: Scenario, part: Part = unmeasured
) -> list[list[Pair]]:
    """What each block would tell of every pair of every question; ``part`` is told how many are
    judged.
    """
    found = []
    for block in blocks:
        found.append(judged(block, asked, scenario))
        part(len(found) / len(blocks))
    return found


def judged(block: Block, asked: Sequence[Question], scenario: Scenario) -> list[Pair]:
    """What a block would tell of every pair of every question."""
    return [pair for q in asked for pair in separations(q, imagined(block, scenario, q))]


def separations(question: Question, more: Recording) -> list[Pair]:
    """Every pair of rivals, with this recording beside those so far."""
    both = question.joined(more)
    columns = HypothesisColumns(both)
    effects = question.fitted.effects
    for hypothesis in question.hypotheses:
        columns.add(hypothesis, effects)
    noise = [question.noise[c.sensor, c.axis] for c in both.channels]
    whitened = WhitenedModel.of(columns, noise)
    lengths = [len(c.values) for c in both.channels]
    every = [*question.fitted.nuisance, *question.fitted.terms]
    basis = basis_of(whitened_of(whitened, every, effects), lengths)
    found = []
    for truth in question.rivals:
        signal = project(basis, _signal(truth, both, whitened, effects, lengths))
        found += _against(truth, basis, signal, whitened, question)
    return found


def _signal(
    truth: Explanation,
    both: Observations,
    whitened: WhitenedModel,
    effects: Sequence[Effect],
    lengths: Sequence[int],
) -> list[Array]:
    """What a rival, at its own form only, would put into all readings, whitened."""
    total = [np.zeros(n) for n in lengths]
    for term in truth.terms[:1]:
        for name, value in zip(term.names, term.values, strict=True):
            for i, part in whitened.whiten(
                both.changes(term.hypothesis.alone(name), effects)
            ).items():
                total[i] += part * (value / term.hypothesis.size(name))
    return total


def _against(
    truth: Explanation,
    basis: Sequence[Array],
    signal: Sequence[Array],
    whitened: WhitenedModel,
    question: Question,
) -> list[Pair]:
    """The truth, whose signal is without its part in a basis, against every other name, each at its
    best shape and sizes.
    """
    energy = sum(float(s @ s) for s in signal)
    needed = SEPARABLE * coarsened(energy)
    best: dict[str, float] = {}
    for score in whitened.scores(basis, signal):
        best[score.hypothesis.id] = max(best.get(score.hypothesis.id, 0.0), score.gain()[0])
    id = truth.hypothesis.id
    return [
        Pair(id, name, max(energy - best.get(name, 0.0), 0.0), needed)
        for name in question.names
        if name != id
    ]
