"""The noise of each channel that a fitted model leaves, and the biases that a recording began
with.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Observations
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm, waves_of
from tiltcal.diagnosis.model.hypothesis_columns import HypothesisColumns
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.statistics.cosine_transform import cosines
from tiltcal.statistics.dwell_noise import robust_white
from tiltcal.statistics.least_squares import column_space
from tiltcal.statistics.noise_spectrum import (
    NoiseFit,
    NoiseModel,
    WhiteFlickerWalk,
    estimate_noise,
    white_noise,
)

ENOUGH = 100  # coefficients to fit three variances to


def noise_under(
    fitted: FittedModel,
    columns: HypothesisColumns,
    extra: Mapping[int, Array] | None = None,
    law: type[NoiseModel] = WhiteFlickerWalk,
) -> list[NoiseFit]:
    """The noise of each channel when all fitted columns (and ``extra`` cosine coefficients) may
    hold any size in it, and stated random settings as much as is stated. extra: by channel, (m, n).
    """
    observations = columns.observations
    about = columns.shared_about or fitted.effects
    waves, found = waves_of(columns, (*fitted.nuisance, *fitted.terms), about), []
    for i, (channel, r) in enumerate(
        zip(observations.channels, observations.residuals(fitted.effects), strict=True)
    ):
        mine, left = [w[i] for w in waves if i in w], channel.waves(r)
        if least := channel.white:
            found.append(NoiseFit.known(white_noise(max(least, _spread(left, mine)))))
            continue
        mean = np.column_stack(
            [*mine, *(channel.waves(c) for c in observations.saturating(i))]
            or [np.zeros((len(r), 0))]
        )
        if extra is not None and i in extra:
            mean = np.column_stack([mean, extra[i]])
        random = [part for one in columns.settings for part in one.of(i)]
        fit = estimate_noise(left, mean, law, random=np.column_stack([*random, mean[:, :0]]))
        found.append(observations.as_unsteady(i, r, mean, fit))
    return found


def white_of_differences(fitted: FittedModel, observations: Observations) -> list[NoiseModel]:
    """White noise alone of each channel, as second differences of what a model leaves tell it."""
    left = zip(observations.channels, observations.residuals(fitted.effects), strict=True)
    return [white_noise(robust_white(c.weighed(r))) for c, r in left]


def noise_within_stops(fitted: FittedModel, whitened: WhitenedModel) -> list[NoiseFit] | None:
    """The noise of each channel from what is left within its stops, each at a level of its own;
    None where one has no stops.

    By hand this is known of a FOG beside a gyro triad only: of all else a stop is what makes a
        level.
    """
    observations = whitened.observations
    by_hand = None
    if not observations.courses:
        by_hand = noise_under(fitted, whitened.columns, law=whitened.law)
    found = []
    for i, (channel, r) in enumerate(
        zip(observations.channels, observations.residuals(fitted.effects), strict=True)
    ):
        cuts = np.flatnonzero(np.diff(channel.stop)) + 1
        weighed = channel.weighed(r)
        parts = [
            cosines(weighed[rows])
            for rows in np.split(np.arange(len(r)), cuts)
            if channel.stop[rows[0]] >= 0 and len(rows) > 2
        ]
        few = sum(len(part) - 1 for part in parts) < ENOUGH
        if by_hand is not None and (
            few or observations.scenario.named(channel.sensor).kind != "fog"
        ):
            found.append(by_hand[i])
        elif few:
            return None
        else:
            found.append(NoiseFit.within(parts, whitened.law))
    return found


def _spread(residual: Array, columns: Sequence[Array]) -> float:
    """Standard deviation of white noise behind a residual with these columns in its mean; of all
    there is where they take it.
    """
    Q = column_space(np.column_stack(columns)) if columns else np.zeros((len(residual), 0))
    left = residual - Q @ (Q.T @ residual)
    dof = len(residual) - Q.shape[1]
    return float(np.linalg.norm(left) / np.sqrt(dof)) if dof > 0 else float(np.std(residual))


def shift_bias_to_start(
    fitted: FittedModel, whitened: WhitenedModel, fits: Sequence[NoiseFit]
) -> FittedModel:
    """The fitted model with the biases that the first recording began with.

    A random walk starts anew with each recording; the fit has its mean over the record, a new
    recording begins where this one did. The walk in what is left, told from flicker and white noise
    by the spectrum that the channels of a sensor share, says by how much they differ.
    """
    from scipy.fft import idct

    observations = whitened.observations
    first = [
        (channel, r, fit)
        for channel, r, fit in zip(
            observations.channels, whitened.less_settings(fitted.effects), fits, strict=True
        )
        if channel.recording == 0 and not channel.derived
    ]
    shared = {
        name: NoiseFit.alike([f for c, _, f in first if c.sensor == name], whitened.law)
        for name in {c.sensor for c, *_ in first}
    }
    shift: dict[tuple[str, str], float] = {}
    for channel, r, _ in first:
        model = shared[channel.sensor].model
        level = idct(
            channel.waves(r) * model.drift_spectrum(len(r)) / model.spectrum(len(r)), norm="ortho"
        )
        shift.setdefault((channel.sensor, channel.axis), float(level[0]))
    return replace(
        fitted, nuisance=tuple(_shifted(t, shift, observations, fitted) for t in fitted.nuisance)
    )


def _shifted(
    term: FittedTerm,
    shift: Mapping[tuple[str, str], float],
    observations: Observations,
    fitted: FittedModel,
) -> FittedTerm:
    """A bias term moved by a shift of its channel's reading."""
    values = list(term.values)
    for k, name in enumerate(term.names):
        stem, _, axis = name.rpartition("_")
        by = shift.get((str(term.hypothesis.effect.sensor), axis), 0.0)
        if stem == "bias" and by:
            columns = observations.changes(term.hypothesis.alone(name), fitted.effects)
            first = next(
                (c[0] for i, c in columns.items() if observations.channels[i].axis == axis), 0.0
            )
            values[k] += by * term.hypothesis.size(name) / first if first else 0.0
    return replace(term, values=tuple(values))


def models(fits: Sequence[NoiseFit]) -> list[NoiseModel]:
    """The most likely model of each channel."""
    return [f.model for f in fits]
