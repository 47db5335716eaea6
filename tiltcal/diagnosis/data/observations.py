"""What was read and what a model says should have been read, channel by channel; and how readings
change with an effect.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tiltcal.core.arrays import Array, Index, Single
from tiltcal.core.units import DEG
from tiltcal.diagnosis.data.block_grid import Sampling, blocks_of, mean_times
from tiltcal.effects.base import Effect
from tiltcal.effects.data.labelling_faults import DataTruncation
from tiltcal.forward.nominal_motion import NominalMotion
from tiltcal.laboratory.scenario import Scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import Replay
from tiltcal.statistics.cosine_transform import cosines, inverse_cosines
from tiltcal.statistics.noise_spectrum import NoiseFit

Columns = dict[int, Array]
"""Change of each channel that changes, by the channel's number, (n,) each, SI."""


@dataclass(frozen=True)
class Channel:
    """One column of readings whose model is known.

    Args:
        recording: number of the recording.
        sensor, axis: whose; the axis ``norm`` is the length of an accelerometer's reading at rest,
            ``turn`` gravity's direction after a turn against the one carried there.
        column: of the sensor's readings.
        rows: of the recording, (n,).
        time: s, (n,).
        values: SI, (n,).
        stop: number of the stop of each row, -1 while moving, (n,).
        derived: whether it was worked out from several readings, and no column of a recording is
            like it.
        white: standard deviation, SI, that its noise has at least, where that is white and known to
            be; 0 elsewhere.
        spread: standard deviation of each row in units of that at rest, at least 1, (n,): a rate
            that is told from a readout is less certain where the table is fast, and the noise may
            grow with the motion; None where all rows are alike.
        growth: the part of the spread that is the channel's own noise, at least 1, (n,); None where
            it does not grow with the motion.
    """

    recording: int
    sensor: str
    axis: str
    column: int
    rows: Index
    time: Array
    values: Array
    stop: Index
    derived: bool = False
    white: float = 0.0
    spread: Array | None = None
    growth: Array | None = None

    @property
    def uncertainty(self) -> Array | float:
        """How uncertain the prediction makes each row, in units of the noise at rest, at least 1,
        (n,).
        """
        if self.spread is None:
            return 1.0
        return self.spread if self.growth is None else self.spread / self.growth

    def weighed(self, column: Array) -> Array:
        """A column with every row in units of its spread, (..., n)."""
        return column if self.spread is None else column / self.spread

    def waves(self, column: Array) -> Array:
        """Cosine coefficients of a column whose rows are weighed, (..., n)."""
        return cosines(self.weighed(column))

    def of_waves(self, waves: Array) -> Array:
        """The column that has these cosine coefficients, (..., n)."""
        column = inverse_cosines(waves)
        return column if self.spread is None else column * self.spread

    @property
    def name(self) -> str:
        """``accel.x``."""
        return f"{self.sensor}.{self.axis}"

    @cached_property
    def rate_hz(self) -> float:
        """Samples a second; 0 of sums over a recording, several at one instant: they run in no
        time.
        """
        gaps = np.diff(self.time)
        gap = float(np.median(gaps)) if len(gaps) else 0.0
        return 1 / gap if gap > 0 else 0.0


class Signal(NamedTuple):
    """Values of one axis of a sensor on some rows of a recording, weighed, (n,)."""

    recording: int
    sensor: str
    axis: str
    rows: Index
    values: Array


@dataclass(frozen=True, eq=False)
class SharedCurve:
    """A curve that acts at many places, for each coefficient alone at its plausible size.

    Args:
        parts: its value, rate and acceleration where a model is asked, (p, m) each; those at the
            end that are zero are left out.
    """

    parts: tuple[Single, ...]


@dataclass(frozen=True)
class CurveFactors:
    """Change of a channel by each coefficient of a curve alone.

    Args:
        curve: of p coefficients.
        answers: of the channel to each part of the curve where a model is asked, SI, (m,) each;
            None where there is none.
        sampling: from there to the samples of the channel.
        spread: of the samples, by which they are divided, (n,); None where all are alike.
    """

    curve: SharedCurve
    answers: tuple[Single | None, ...]
    sampling: Sampling
    spread: Single | None = None

    def columns(self, which: slice = slice(None)) -> Single:
        """The changes by some coefficients, SI, (p, n)."""
        parts = zip(self.answers, self.curve.parts, strict=True)
        known = [(answer, part[which]) for answer, part in parts if answer is not None]
        total = known[0][0] * known[0][1]
        more = np.empty_like(total)
        for answer, part in known[1:]:
            total += np.multiply(answer, part, out=more)
        found = np.ascontiguousarray(self.sampling.of(total.T).T)
        return found if self.spread is None else found / self.spread

    def adjoint(self, vectors: Single) -> Single:
        """What has the inner products with changes where a model is asked that vectors have with
        those at the samples, (n, q) -> (m, q).
        """
        weighed = vectors if self.spread is None else vectors / self.spread[:, None]
        return self.sampling.adjoint(weighed)


COARSE = 0.002 * DEG  # of an angle's steps: finer ones spoil nothing that noise does not
KEPT = 4  # residuals: a step and the one before it, and the models that these are compared with


@dataclass(frozen=True)
class _Left:
    """What a model leaves.

    Args:
        effects: of the model; channels: that are predicted; values: residual of each, SI, (n,).
    """

    effects: tuple[Effect, ...]
    channels: tuple[Channel, ...]
    values: list[Array]

    @cached_property
    def waves(self) -> list[Array]:
        """Cosine coefficients of the residuals, their rows weighed, (n,) each."""
        found = [c.waves(r) for c, r in zip(self.channels, self.values, strict=True)]
        for wave in found:
            wave.flags.writeable = False
        return found


class Observations(ABC):
    """Recordings of one set-up, explained together."""

    scenario: Scenario
    recordings: tuple[Recording, ...]
    known: tuple[Effect, ...]
    channels: tuple[Channel, ...]
    stops: list[Index]
    """Number of the stop of each row of each recording, -1 while moving, (n,)."""
    courses: Sequence[Replay] = ()
    """The motion that a table's readout says, of each recording; none where there is no table."""
    block = 1
    """Samples that are averaged into one."""

    @property
    def cut(self) -> dict[str, float]:
        """Steps that readouts are cut to, of the axes where they are coarse, rad."""
        cuts = [e for e in self.known if isinstance(e, DataTruncation)]
        cuts = [e for e in cuts if e.value("step") >= COARSE]
        axes = self.scenario.rig.axis_names
        return {a: e.value("step") for e in cuts for a in axes if e.axis in (None, a)}

    @abstractmethod
    def predict(self, effects: Sequence[Effect]) -> list[Array]:
        """What each channel should have read with these effects, SI, (n,) each."""

    @abstractmethod
    def changes(self, effect: Effect, around: Sequence[Effect]) -> Columns:
        """How readings change with a small effect, the others being there, SI."""

    def depends_on(self, around: Sequence[Effect]) -> object:
        """What of these effects the change by a term of calibration depends on: where it is equal,
        so is the change. Unless more is known, all of them.
        """
        return tuple(around)

    def settings(self, around: Sequence[Effect]) -> list[list[Columns]]:
        """What one standard deviation of each random rotation that the scenario states does to the
        readings, SI: of an axis at each stop, and of the instrument about x, y and z at each
        mounting, those of each recording together; none where it states none.
        """
        return []

    def columns(
        self, effect: Effect, names: Sequence[str], around: Sequence[Effect]
    ) -> dict[int, tuple[list[int], Array]]:
        """Change of each channel by each of these sizes alone: their numbers, and the changes,
        (numbers, n). SI.
        """
        found: dict[int, tuple[list[int], list[Array]]] = {}
        for k, name in enumerate(names):
            alone = {n: v for n, v in effect.values.items() if n not in names} | {
                name: effect.values[name]
            }
            for i, column in self.changes(replace(effect, values=alone), around).items():
                numbers, rows = found.setdefault(i, ([], []))
                numbers.append(k)
                rows.append(column)
        return {i: (numbers, np.array(rows)) for i, (numbers, rows) in found.items()}

    def factors(
        self, effect: Effect, names: Sequence[str], around: Sequence[Effect]
    ) -> dict[int, CurveFactors] | None:
        """What ``columns`` says, its rows weighed, as factors by channel; None where an effect is
        better kept as columns. SI.
        """
        return None

    @property
    def sources(self) -> tuple[Recording, ...]:
        """The recordings sample by sample, as they came."""
        return self.recordings

    def saturating(self, number: int) -> list[Array]:
        """Columns that no noise of a channel is estimated from, (n,) each: what may follow the
        pose, and is no drift.
        """
        return []

    def as_unsteady(self, number: int, residual: Array, mean: Array, fit: NoiseFit) -> NoiseFit:
        """The noise of a channel, no less than its rests are apart.

        Args:
            number: of the channel.
            residual: SI, (n,).
            mean: cosine coefficients of what may be in it at any size, (n, p).
            fit: white, flicker and walk as its spectrum has them.
        """
        return fit

    def residuals(self, effects: Sequence[Effect]) -> list[Array]:
        """Measured minus predicted, (n,) each; 0 where a loss of samples leaves nothing to
        predict. Fits and their noise ask for the same again.
        """
        return list(self._left_by(effects).values)

    def residual_waves(self, effects: Sequence[Effect]) -> list[Array]:
        """Cosine coefficients of the residuals, their rows weighed, (n,) each."""
        return list(self._left_by(effects).waves)

    def _left_by(self, effects: Sequence[Effect]) -> "_Left":
        """What a model with these effects leaves: one of those that were asked for last, or new."""
        asked = tuple(effects)
        found = next((one for one in self._recent if one.effects == asked), None)
        if found is None:
            pairs = zip(self.channels, self.predict(effects), strict=True)
            found = _Left(asked, self.channels, [np.nan_to_num(c.values - p) for c, p in pairs])
            for r in found.values:
                r.flags.writeable = False
        others = [one for one in self._recent if one is not found]
        self._recent[:] = [found, *others[: KEPT - 1]]
        return found

    @cached_property
    def _recent(self) -> "list[_Left]":
        """What was asked for last, first."""
        return []

    def averaged(self, block: int) -> "Observations":
        """The same with so many samples averaged into one, where that is known to keep what they
        tell; else these.
        """
        return self

    def bend_at(self, effects: Sequence[Effect]) -> bool:
        """Linearise about a model with these effects; whether that changes any prediction."""
        return False

    def watches(self, effects: Sequence[Effect]) -> Sequence[NominalMotion]:
        """The motion of each recording with these effects; none where no table says it."""
        return ()

    def at_samples(self, number: int, values: Array) -> Array:
        """Values at the samples of a channel, (k, ...) -> (n, ...): what is given at the instants
        of ``watches``.
        """
        return np.asarray(values[self.channels[number].rows])

    def blocks(self, number: int) -> Index:
        """Number of the block in which each sample of a channel is, (n,)."""
        return self.channels[number].rows // self.block

    def block_times(self, recording: int) -> Array:
        """Time of each block of a recording, s, (blocks,)."""
        time = self.recordings[recording].time
        count = blocks_of(len(time), self.block)
        return mean_times(time[: count * self.block], np.arange(count) * self.block)

    def determines(self, parameters: int) -> bool:
        """Whether there are more poses than so many adjustable parameters need."""
        return bool(self.channels)

    def outlier_signals(
        self, effects: Sequence[Effect], stops: Sequence[Index]
    ) -> Iterator[Signal]:
        """Everything in which a single value may be far off. stops: (m,) each.

        Args:
            effects: of the model.
            stops: of each source, as in ``stops``.
        """
        for c, r in zip(self.channels, self.residuals(effects), strict=True):
            yield Signal(c.recording, c.sensor, c.axis, c.rows, c.weighed(r))

    @property
    def samples(self) -> int:
        """Number of readings in all channels."""
        return sum(len(c.values) for c in self.channels)
