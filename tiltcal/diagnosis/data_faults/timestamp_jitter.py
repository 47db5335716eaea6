"""Random errors of the time stamps.

A wrong stamp is one error of time for its whole row: the residual of channel i in row k is s_ik d_k
+ e_ik, with s the change of the reading by a delay and d ~ N(0, tau2) the same for every channel.
Two channels then have the covariance tau2 s_ik s_jk, whose sign and size follow the motion (the
one-factor model of factor analysis, with known loadings; Lawley and Maxwell 1971). Noise that grows
with the rate or while moving makes the same variance and no covariance, so variances prove nothing:
where only one channel changes with time nothing is claimed.

Assumed of noise: each channel has any variance at rest, another while moving, and one more that
grows with the square of its rate; two channels may be correlated, by as much at all rests and by as
much in all moves. The slope of their normalised products on s_i s_j is tested after these two means
are taken out, by its heteroscedastic standard error (White 1980). Differences between neighbouring
rows are taken, because a misfit of physics is smooth.
"""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from tiltcal.core.arrays import Array, Index, Mask
from tiltcal.diagnosis.data.channels import changed
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.effects.timing.delays import DataJitter, DataLatency
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.dwell_noise import ARITHMETIC, robust_white

UNIT = 1e-3  # s, of the delay whose changes are taken
FALSE_ALARMS = 1e-3  # share of sound recordings, a tenth of what all findings together may have
# sigma. A sum of symmetric terms over the root of their squares exceeds x by a chance of exp(-x2/2)
# at most (Hoeffding 1963): as many for both scopes together
CERTAIN = float(np.sqrt(2 * np.log(2 / FALSE_ALARMS)))
FAR = 4.0  # sigma: what is farther out in a channel counts as that
WILD = 20.0  # times the noise of a channel: a gross value
LAGS = 8  # rows
IN_COMMON = 0.3  # share of the excess that a row may have in common with one of those before
MIN_PAIRS = 32  # pairs of rows
SPOILS = 0.3  # of the noise: a sample that a random stamp moves by more is left out


def find_stamp_jitter(fitted: FittedModel, observations: Observations) -> Fault | None:
    """Random errors of the time stamps: channels err together, as their rates say."""
    if not observations.courses:
        return None
    channels = observations.channels
    changes = observations.changes(
        DataLatency({"latency": UNIT}, None, None, "found"), fitted.effects
    )
    # what the motion leaves uncertain, as where a move begins between two rows, tells nothing
    slopes = {i: c / UNIT / channels[i].uncertainty for i, c in changes.items()}
    left = zip(observations.residuals(fitted.effects), channels, strict=True)
    residuals = [r / c.uncertainty for r, c in left]
    if _goes_on(observations, residuals, slopes):
        return None
    found = list(_evidence(observations, residuals, slopes))
    own = [e for e, same in found if same]
    # a recorder stamps all its sensors, or each its own
    told = max((_pooled(own), _pooled([e for e, _ in found])), key=lambda t: t[0] / (t[1] or 1.0))
    value, sigma = told
    if sigma == 0 or value < CERTAIN * sigma:
        return None
    energy = _energy(observations, residuals, slopes)
    return _jitter(float(np.sqrt(value)), float(sigma / (2 * np.sqrt(value))), energy)


def _evidence(
    observations: Observations, residuals: list[Array], slopes: Columns
) -> Iterator[tuple[tuple[float, float, float], bool]]:
    """Of every two channels with a slope what ``_covariance`` says, and whether they are of one
    sensor.
    """
    for i, j in combinations(sorted(slopes), 2):
        one, other = observations.channels[i], observations.channels[j]
        if one.recording != other.recording:
            continue
        rows, at, there = np.intersect1d(one.rows, other.rows, return_indices=True)
        if len(rows) < 2 * MIN_PAIRS:
            continue
        r = np.array([residuals[i][at], residuals[j][there]])
        s = np.array([slopes[i][at], slopes[j][there]])
        yield _covariance(r, s, one.stop[at] < 0), one.sensor == other.sensor


def _covariance(r: Array, s: Array, moving: Mask) -> tuple[float, float, float]:
    """Slope times information, information, and variance of the first, of what two channels have in
    common.

    Args:
        r: residuals, (2, n).
        s: their slopes, SI/s, (2, n).
        moving: (n,).
    """
    n = r.shape[1] // 2 * 2
    steps = np.diff(r[:, :n].reshape(2, -1, 2), axis=2)[:, :, 0]
    pairs = s[:, :n].reshape(2, -1, 2)
    moves: Mask = np.asarray(moving[:n].reshape(-1, 2).any(axis=1))
    kept = (steps != 0).all(axis=0)  # lost samples have no residual
    steps, pairs, moves = steps[:, kept], pairs[:, kept], moves[kept]
    if len(moves) < MIN_PAIRS:
        return 0.0, 0.0, 0.0
    means = (
        np.linalg.qr(np.column_stack([np.ones(len(moves)), moves]))[0]
        if (0 < moves.sum() < len(moves))
        else np.full((len(moves), 1), len(moves) ** -0.5)
    )
    spread = np.array(
        [_spread(d, (p**2).sum(axis=1), moves) for d, p in zip(steps, pairs, strict=True)]
    )
    product = np.prod(np.clip(steps / spread, -FAR, FAR), axis=0)
    loading = np.prod(pairs, axis=0).sum(axis=1) / np.prod(spread, axis=0)
    loading = loading - means @ (means.T @ loading)
    product = product - means @ (means.T @ product)
    top, bottom = float(loading @ product), float(loading @ loading)
    return top, bottom, float((loading**2) @ product**2)


def _spread(steps: Array, energy: Array, moves: Mask) -> Array:
    """Standard deviation of each step of a channel, (n,): one at rest, one while moving, and what
    grows with the slope. energy: sum of the squared slopes of both rows, (n,).
    """
    from scipy.optimize import nnls

    square = np.minimum(steps**2, (WILD * robust_white(steps)) ** 2)
    columns = np.column_stack([np.ones(len(steps)), moves, energy])
    size = np.maximum(columns.max(axis=0), 1e-300)
    weights, _ = nnls(columns / size, square / square.mean())
    variance = columns / size @ weights * square.mean()
    return np.sqrt(np.maximum(variance, 1e-6 * square.mean()))


def _pooled(found: list[tuple[float, float, float]]) -> tuple[float, float]:
    """Variance of the stamps, s2, and its standard deviation; zeros where no two channels tell."""
    top, bottom, variance = np.sum(found, axis=0) if found else (0.0, 0.0, 0.0)
    return (float(top / bottom), float(np.sqrt(variance) / bottom)) if bottom > 0 else (0.0, 0.0)


def _goes_on(observations: Observations, residuals: list[Array], slopes: Columns) -> bool:
    """Whether what grows with the slope goes with that of one of the LAGS rows before: a misfit of
    physics is much the same in neighbouring rows, as a constant delay makes it; packets and double
    buffers come in turn. A random error is a new one in each row.
    """
    top, common = 0.0, np.zeros(LAGS)
    for i, slope in slopes.items():
        noise = _quiet_noise(residuals[i], observations.channels[i].stop)
        r, s = residuals[i] / noise, slope / noise
        top += float((np.minimum(r**2, WILD**2) - 1) @ s**2)
        for lag in range(1, min(LAGS, len(r) - 1) + 1):
            product = np.clip(r[lag:] * r[:-lag], -(WILD**2), WILD**2)
            common[lag - 1] += float(product @ (s[lag:] * s[:-lag]))
    return bool(np.abs(common).max() > IN_COMMON * top)


def _energy(
    observations: Observations, residuals: list[Array], slopes: Columns
) -> dict[tuple[str, str], float]:
    """Squared slopes in units of the noise, summed, of each channel."""
    energy: dict[tuple[str, str], float] = {}
    for i, slope in slopes.items():
        c = observations.channels[i]
        noise = _quiet_noise(residuals[i], c.stop)
        key = (c.sensor, c.axis)
        energy[key] = energy.get(key, 0.0) + float(((slope / noise) ** 2).sum())
    return energy


def _jitter(size: float, sigma: float, energy: Mapping[tuple[str, str], float]) -> Fault:
    """Random stamps of this rms size, s, seen in channels by the energy of their slopes."""
    total = sum(energy.values())
    ordered = sorted(energy.items(), key=lambda item: -item[1])
    strong = [key for key, e in ordered if e > 0.05 * total]
    effect = DataJitter({"jitter": size}, strong[0][0], None, "found")
    words = (
        f"Time stamps scatter by {1e3 * size:.3g} ms rms: in each row the channels err together, as"
        " their rates say."
    )
    sensors, axes = (tuple(dict.fromkeys(column)) for column in zip(*strong, strict=True))
    return Fault(effect, sensors, axes, words, sigma={"jitter": sigma}, p_value=FALSE_ALARMS)


def _quiet_noise(residual: Array, stop: Index) -> float:
    """Standard deviation of a residual at rest; of its second differences where it never rests;
    never less than that of arithmetic.
    """
    still = stop >= 0
    if still.sum() <= 32:
        return robust_white(residual)
    return max(float(np.std(residual[still])), ARITHMETIC)


def at_rest_only(
    observations: Observations, fitted: FittedModel, jitter: float
) -> tuple[Recording, ...]:
    """The recordings without the samples that random stamps (s, rms) spoil."""
    late = DataLatency({"latency": UNIT}, None, None, "found")
    recordings = list(observations.recordings)
    residuals = observations.residuals(fitted.effects)
    for i, slope in observations.changes(late, fitted.effects).items():
        channel = observations.channels[i]
        spoiled = np.abs(slope) / UNIT * jitter > SPOILS * _quiet_noise(residuals[i], channel.stop)
        sensor = observations.scenario.named(channel.sensor)
        recordings[channel.recording] = changed(
            recordings[channel.recording], sensor, channel.axis, channel.rows[spoiled], np.nan
        )
    return tuple(recordings)
