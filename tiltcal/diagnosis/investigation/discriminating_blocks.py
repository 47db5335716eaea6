"""The block after which a diagnosis most probably is `explained`.

For a block, the recordings so far and an imagined recording of it are put together. Each rival in
turn is taken for the truth. What the block would then read is drawn from what is known: sizes and
calibration from their posterior by the recordings so far, and noise as these have it. Of each draw
the probabilities of all names are those that the diagnosis itself would state
(``candidates_in_place``, ``name_probabilities``): the same priors, the same deviations of a form,
the same class. How often that class is the truth alone, by the probabilities that the rivals have
now, is the probability that the block ends in `explained`.

What a block would record: the recording that a design is judged by.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.progress import Part, Progress, Rate, unmeasured
from tiltcal.core.units import ARCSEC, COLUMN_UNITS, DEG, split_unit
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.investigation.rival_hypotheses import Question, Rival
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix
from tiltcal.diagnosis.model.fitted_model import FittedModel, Vector, stored_of, vectors_of
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.candidates import Names, candidates_in_place, name_probabilities
from tiltcal.diagnosis.search.scan import Scan
from tiltcal.diagnosis.search.state import State
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
    """What a block would read if nothing were wrong, with the white noise of the recordings so far:
    by it a row is seen to weigh as much as another.

    Time since switch-on begins anew with each recording, and the temperature with it, as it went in
    the last one: a block must not promise what another course would tell, which nobody commands.
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
    if (course := question.course) is not None:
        columns["temperature_degC"] = course(recording.time - recording.time[0])
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


# best chance of any block below which a pair is said to be out of this table's reach
HOPELESS = 0.2
SHORT_LIST = 4  # blocks of the best first impression that are judged again
DRAWS = 32
"""Recordings of a block that are imagined, shared by the rivals as probable as they are: the
standard error of the stated probability is 0.09 at most. The first impression has one of each
rival, as it is expected.
"""
LEAST = 4  # of them for each rival


@dataclass(frozen=True)
class Pair:
    """One rival taken for the truth, another in its place.

    Args:
        truth, rival: ids.
        separation: twice the nats by which the rival's textbook form has less evidence, as
            expected.
        chance: that the class of the finding then lacks the rival.
    """

    truth: str
    rival: str
    separation: float
    chance: float


@dataclass(frozen=True)
class Forecast:
    """What a diagnosis should say once a block is recorded too.

    Args:
        explained: probability that the true names are stated alone.
        pairs: of rivals.
    """

    explained: float
    pairs: tuple[Pair, ...] = ()


@dataclass(frozen=True)
class BlockProposal:
    """A block with what it should bring.

    Args:
        block: what to record; minutes: of table time; chance: that the verdict then is `explained`;
            pairs: that some block can tell apart, the hardest first.
    """

    block: Block
    minutes: float
    chance: float = 0.0
    pairs: tuple[Pair, ...] = ()

    @property
    def least(self) -> Pair | None:
        """The pair that is hardest to tell apart; None where there are no rivals."""
        return self.pairs[0] if self.pairs else None

    @property
    def rate(self) -> float:
        """Least separation a minute."""
        return min((p.separation for p in self.pairs), default=0.0) / self.minutes

    @property
    def worth(self) -> tuple[float, float]:
        """Probability of `explained` and share of the pairs told apart; of those that differ by
        less than its standard error the shortest, which a remounting makes longer.
        """
        told = float(np.mean([p.chance for p in self.pairs])) if self.pairs else 0.0
        return round(self.chance + told, 1), -self.minutes


Judge = Callable[[Sequence[Block], int, Part], list[Forecast]]
"""Says what each block would tell, from so many imagined recordings or, with 0, from what is
expected, and how many are judged.
"""


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
    """Blocks no longer than ``most_minutes``, the best first: those of the best first impression
    are judged again.

    Args:
        asked: what is to be told apart; blocks: to choose from; scenario: what is known.
        most_minutes: of one block; progress: is told how many blocks are judged.
        judge: what each block would tell; in this process, one after the other, if not given.
    """
    judge = judge or partial(judged_in_turn, asked, scenario)

    def forecasts(blocks: Sequence[Block], draws: int) -> list[tuple[Block, Forecast]]:
        rate = Rate(len(blocks), "blocks")

        def part(done: float) -> None:
            progress(f"evaluating blocks: {rate.after(round(done * len(blocks)))}")

        return list(zip(blocks, judge(blocks, draws, part), strict=True))

    short = [b for b in blocks if b.seconds(scenario.rig) <= 60 * most_minutes]
    first = forecasts(short, 0)
    ranked = _ranked(first, (), scenario)
    again = forecasts([p.block for p in ranked[:SHORT_LIST]], DRAWS)
    top: dict[tuple[str, str], float] = {}
    for p in (pair for _, told in (*first, *again) for pair in told.pairs):
        top[p.truth, p.rival] = max(top.get((p.truth, p.rival), 0.0), p.chance)
    twins = tuple(key for key, chance in top.items() if chance < HOPELESS)
    judged_again = {block.name for block, _ in again}
    others = [told for told in first if told[0].name not in judged_again]
    best = _ranked(again, twins, scenario)
    return Design((*best, *_ranked(others, twins, scenario)), twins)


def _ranked(
    told: Iterable[tuple[Block, Forecast]], twins: Collection[tuple[str, str]], scenario: Scenario
) -> list[BlockProposal]:
    """Blocks that tell a pair apart which is no twin, in order of worth."""
    found = []
    for block, one in told:
        left = [p for p in one.pairs if (p.truth, p.rival) not in twins]
        left.sort(key=lambda p: (p.chance, p.separation))
        if left:
            minutes = block.seconds(scenario.rig) / 60
            found.append(BlockProposal(block, minutes, one.explained, tuple(left)))
    return sorted(found, key=lambda p: p.worth, reverse=True)


def judged_in_turn(
    asked: Sequence[Question],
    scenario: Scenario,
    blocks: Sequence[Block],
    draws: int = DRAWS,
    part: Part = unmeasured,
) -> list[Forecast]:
    """What a diagnosis should say after each block; ``part`` is told how many are judged."""
    found = []
    for block in blocks:
        found.append(judged(block, asked, scenario, draws))
        part(len(found) / len(blocks))
    return found


def judged(
    block: Block, asked: Sequence[Question], scenario: Scenario, draws: int = DRAWS
) -> Forecast:
    """What a diagnosis should say after a block: all questions have to be answered."""
    found = [forecast(q, imagined(block, scenario, q), draws) for q in asked]
    explained = float(np.prod([one.explained for one in found]))
    return Forecast(explained, tuple(pair for one in found for pair in one.pairs))


def forecast(question: Question, more: Recording, draws: int = DRAWS) -> Forecast:
    """What a diagnosis should say of a finding with this recording beside those so far."""
    coming = _Coming.of(question, more)
    rng = np.random.default_rng(0)
    pairs, alone, known = list[Pair](), 0.0, sum(r.probability for r in question.rivals)
    for truth in question.rivals:
        id, share = truth.name, truth.probability / known if known else 0.0
        count = max(round(draws * share), LEAST) if draws else 0
        told = [coming.told_of(model) for model in coming.drawn(truth, count, rng)]
        alone += share * float(np.mean([n.members == (id,) for n, _ in told]))
        for rival in question.names:
            if rival != id:
                behind = [2 * (e.get(id, 0.0) - e.get(rival, 0.0)) for _, e in told]
                gone = [id in n.members and rival not in n.members for n, _ in told]
                separation = max(float(np.mean(behind)), 0.0)
                pairs.append(Pair(id, rival, separation, float(np.mean(gone))))
    return Forecast((1 - question.unlisted) * alone, tuple(pairs))


@dataclass(frozen=True)
class _Coming:
    """The recordings so far with an imagined one.

    Args:
        question: what is asked; scan: of what may stand in the finding's place.
        whitened: the columns; rest: the model without the finding, without a residual.
    """

    question: Question
    whitened: WhitenedModel
    scan: Scan
    rest: FittedModel

    @classmethod
    def of(cls, question: Question, more: Recording) -> "_Coming":
        """With this recording."""
        both, rest = question.joined(more), question.rest
        columns = HypothesisColumns(both)
        for hypothesis in question.hypotheses:
            columns.add(hypothesis, rest.effects)
        noise = [question.noise[c.sensor, c.axis] for c in both.channels]
        whitened = WhitenedModel.of(columns, noise)
        odds = dict(zip(map(id, question.hypotheses), question.log_odds, strict=True))
        kept = np.array([odds[id(h)] for h in columns.hypotheses])
        vectors = vectors_of(whitened, [*rest.nuisance, *rest.terms], rest.effects)
        design = BlockDesignMatrix(
            [v.parts for v in vectors], [len(c.values) for c in both.channels]
        )
        rest = replace(rest, columns=tuple(vectors), design=design, moved=(), reached=None)
        return cls(question, whitened, Scan(whitened, (kept, question.width)), rest)

    def drawn(self, truth: Rival, draws: int, rng: np.random.Generator) -> list[FittedModel]:
        """The model without the finding, with what it leaves if a rival is the truth: of the
        recordings so far what they have, of the new one as it may come; with 0 as it is expected.
        """
        old, lengths = truth.fitted.residual, self.rest.design.lengths
        values = [*truth.fitted.nuisance, *truth.fitted.terms]
        units = np.array([t.hypothesis.size(n) for t in values for n in t.names])
        own = stored_of(self.whitened, truth.terms)
        design = BlockDesignMatrix([*(v.parts for v in self.rest.columns), *own], lengths)
        sizes = np.zeros(len(units))
        sizes[len(units) - len(own) :] = truth.terms[0].values
        sizes /= units
        assert truth.fitted.covariance is not None
        spread = _root(truth.fitted.covariance / np.outer(units, units))
        found, scatter = [], float(draws > 0)
        for _ in range(max(draws, 1)):
            at = sizes + scatter * (spread @ rng.standard_normal(len(units)))
            signal = [
                block @ (sizes if i < len(old) else at)[numbers]
                for i, (numbers, block) in enumerate(zip(design.where, design.blocks, strict=True))
            ]
            noise = [*old, *(scatter * rng.standard_normal(n) for n in lengths[len(old) :])]
            left = [s + e for s, e in zip(signal, noise, strict=True)]
            left = self.rest.design.explain(left)[1]
            reference = Vector(object(), "left", dict(enumerate(left)))
            found.append(replace(self.rest, residual=tuple(left), reference=reference))
        self.scan.products.prepare(found)
        return found

    def told_of(self, rest: FittedModel) -> tuple[Names, dict[str, float]]:
        """What a diagnosis says of the finding that a model leaves, and the evidence for the
        textbook form of each name, nats.
        """
        rows = candidates_in_place(State(rest, self.whitened), self.scan)
        evidence: dict[str, float] = {}
        for row in rows:
            evidence[row.name] = max(row.plain_evidence, evidence.get(row.name, -np.inf))
        return name_probabilities(rows), evidence


def _root(covariance: Array) -> Array:
    """A square root of a covariance, (p, p)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
