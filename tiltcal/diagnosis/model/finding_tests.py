"""How significant each finding is, in the noisiest way that the recording allows.

A finding taken out of its fitted model: what has to be explained in its place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.hypotheses.hypothesis import Hypothesis
from tiltcal.diagnosis.hypotheses.instants import recording_of
from tiltcal.diagnosis.model.block_matrix import basis_of, project, projected
from tiltcal.diagnosis.model.channel_noise import models, noise_under
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, whitened_of
from tiltcal.diagnosis.model.noise_prior import with_probable_noise
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.learned import LearnedReading
from tiltcal.statistics.noise_spectrum import NoiseFit


@dataclass(frozen=True)
class RemovedFinding:
    """A finding taken out of its fitted model: what has to be explained.

    Args:
        basis: of nuisance and all other findings, by channel; target: what is left without the
            finding, whitened.
        signal: the finding's fitted signal without its part in the basis.
        gain: fall of the deviance by the finding's terms at their best sizes; rank: of these.
    """

    basis: list[Array]
    target: list[Array]
    signal: list[Array]
    gain: float
    rank: int


def remove_finding(
    fitted: FittedModel,
    whitened: WhitenedModel,
    places: Sequence[int],
    beside: Sequence[Columns] = (),
) -> RemovedFinding:
    """What the terms at these places explain, and the fitted model without them; ``beside``:
    further columns of any size.
    """
    effects, lengths = fitted.effects, [len(c.values) for c in whitened.observations.channels]
    inside = [fitted.terms[k] for k in places]
    others = [*fitted.nuisance, *(t for k, t in enumerate(fitted.terms) if k not in places)]
    basis = basis_of(
        [*whitened_of(whitened, others, effects), *(whitened.whiten(c) for c in beside)], lengths
    )
    signal = [np.zeros(n) for n in lengths]
    values = [
        v / t.hypothesis.size(n) for t in inside for n, v in zip(t.names, t.values, strict=True)
    ]
    columns = whitened_of(whitened, inside, effects)
    for value, column in zip(values, columns, strict=True):
        for i, part in column.items():
            signal[i] = signal[i] + value * part
    signal = project(basis, signal)
    residual = whitened.residual(effects)
    target = project(basis, [s + r for s, r in zip(signal, residual, strict=True)])
    mine = basis_of([projected(basis, c, lengths) for c in columns], lengths)
    along = np.sum([U.T @ r for U, r in zip(mine, target, strict=True)], axis=0)
    return RemovedFinding(basis, target, signal, float(along @ along), mine[0].shape[1])


ALPHA = 0.01  # level of a test

NEXT = 2.0  # samples to either side of a step's instant that it has to show without


def log_tail(gain: float, dof: int) -> float:
    """Natural logarithm of the chance that chi-square exceeds ``gain``."""
    from scipy.special import gammaincc, gammaln

    if dof <= 0:
        return 0.0
    p = float(gammaincc(dof / 2, gain / 2))
    if p > 1e-290:
        return float(np.log(p))
    x = gain / 2
    return float(-x + (dof / 2 - 1) * np.log(x) - gammaln(dof / 2))


def log_alternatives(hypothesis: Hypothesis, kept: int, total: int) -> float:
    """Logarithm of how many alternatives stood beside this choice: hypotheses, and subsets of its
    sizes.
    """
    from scipy.special import gammaln

    n = len(hypothesis.names)
    return float(np.log(max(total, 1)) + gammaln(n + 1) - gammaln(kept + 1) - gammaln(n - kept + 1))


@dataclass(frozen=True)
class NoiseSource:
    """Where the noise of a model is taken from: what it leaves, or a record at rest.

    Args:
        static: noise models of each channel from a record at rest, when there is one.
        total: number of hypotheses tried.
    """

    static: tuple[NoiseFit, ...] | None
    total: int

    @property
    def words(self) -> str:
        """Where the noise is taken from, in words."""
        return "the recording itself" if self.static is None else "the static record"

    def noise(self, fitted: FittedModel, whitened: WhitenedModel) -> list[NoiseFit]:
        """The noise when the whole fitted model may be true."""
        return (
            list(self.static)
            if self.static is not None
            else noise_under(fitted, whitened.columns, law=whitened.law)
        )

    def left_by(self, fitted: FittedModel, whitened: WhitenedModel) -> WhitenedModel:
        """The same columns under the noise that a fitted model leaves, the most probable one unless
        it was taken from a record at rest.
        """
        left = whitened.as_fitted(self.noise(fitted, whitened))
        if self.static is not None:
            return left
        return with_probable_noise(replace(left, curved=_curved(fitted, whitened)))

    def log_p(
        self, fitted: FittedModel, whitened: WhitenedModel
    ) -> tuple[list[float], WhitenedModel]:
        """Corrected log p-value of each finding under the noisiest models that the recording
        allows, and the columns under the most likely noise.
        """
        fits = self.noise(fitted, whitened)
        bounds = [f.bounds() for f in fits]
        sides = [
            finding_log_p_values(fitted, whitened.under([b[side] for b in bounds]), self.total)
            for side in range(2)
        ]
        worst = [max(pair) for pair in zip(*sides, strict=True)]
        return worst, whitened.under(models(fits))


def _curved(fitted: FittedModel, whitened: WhitenedModel) -> frozenset[int]:
    """Numbers of the channels to whose reading a nameless curve of the model adds."""
    readings = {
        (law.effect.sensor, law.effect.axis)
        for law in (t.hypothesis for t in fitted.terms)
        if not law.listed and isinstance(law.effect, LearnedReading)
    }
    channels = enumerate(whitened.observations.channels)
    return frozenset(i for i, c in channels if (c.sensor, c.axis) in readings)


def finding_log_p_values(
    fitted: FittedModel, whitened: WhitenedModel, total: int, beside: Sequence[Columns] = ()
) -> list[float]:
    """Corrected log p-value of each finding given all others, and columns ``beside`` them, under
    the whitened model's noise.

    That of a step is without the samples next to the instants of steps: what shows in them only is
        a gross error.
    """
    found = []
    near = [
        column
        for t in fitted.terms
        if t.host is None
        for column in _next_to_the_instant(t, whitened.observations)
    ]
    for places in fitted.findings():
        inside = [fitted.terms[k] for k in places]
        step = inside[0].hypothesis.is_step
        removed = remove_finding(fitted, whitened, places, [*beside, *(near if step else ())])
        tries = log_alternatives(inside[0].hypothesis, len(inside[0].names), total)
        found.append(log_tail(removed.gain, removed.rank) + tries)
    return found


def _next_to_the_instant(term: FittedTerm, observations: Observations) -> Iterator[Columns]:
    """Each sample next to the instant of a step, one column for each."""
    if not term.hypothesis.is_step:
        return
    number = recording_of(term.effect, observations.recordings)
    instant = observations.recordings[number].time[0] + term.effect.values["time"]
    for i, channel in enumerate(observations.channels):
        if channel.derived or channel.recording != number or len(channel.time) < 2:
            continue
        away = np.abs(channel.time - instant)
        for row in np.flatnonzero(away < NEXT * np.median(np.diff(channel.time))):
            yield {i: (np.arange(len(away)) == row).astype(float)}
