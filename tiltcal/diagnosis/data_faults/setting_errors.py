"""Random setting of an axis: each stop has its own rotation, beyond what the scenario states."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data.observations import Columns, Observations
from tiltcal.diagnosis.data.stop_rotations import stated_scatter, stop_rotations
from tiltcal.diagnosis.data_faults.fault import Fault
from tiltcal.diagnosis.model.block_matrix import BlockDesignMatrix, columns_of, project
from tiltcal.diagnosis.model.channel_noise import models, noise_under, noise_within_stops
from tiltcal.diagnosis.model.finding_tests import ALPHA, finding_log_p_values, log_tail
from tiltcal.diagnosis.model.fitted_model import FittedModel
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.score_test import SURVIVES
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.effects.table.readout import SettingScatter
from tiltcal.statistics.noise_spectrum import NoiseFit

MIN_STOPS = 8  # stops of an axis


@dataclass(frozen=True)
class Stop:
    """A stop of the table.

    Args:
        columns: change of the readings per radian of one axis at this stop, interpolated between
            stops.
        angles: of each axis, rad.
    """

    columns: Columns
    angles: Mapping[str, float]


@dataclass(frozen=True)
class Rotations:
    """What a recording says of the rotations of n stops beside all that is fitted: of k
    combinations of them, each with standard normal noise.

    Args:
        projections: the estimated combinations, (k,).
        root: projections = root @ rotations, 1/rad, (k, n); its rows are orthogonal.
    """

    projections: Array
    root: Array

    def spread(self) -> tuple[float, float]:
        """The standard deviation of the rotations, rad, of the largest restricted likelihood
        (Patterson and Thompson, Biometrika 58, 1971), and its standard uncertainty; nothing where
        that is at zero.
        """
        from scipy.optimize import minimize_scalar

        information = (self.root**2).sum(axis=1)

        def cost(log_variance: float) -> float:
            ratio = np.exp(log_variance) * information
            return float((np.log1p(ratio) + self.projections**2 / (1 + ratio)).sum())

        if not (information * (self.projections**2 - 1)).sum() > 0:  # the slope at zero
            return 0.0, 0.0
        largest = float((self.projections**2 / information).max())
        bounds = float(np.log(1e-3 / information.max())), float(np.log(largest))
        variance = float(np.exp(minimize_scalar(cost, bounds=bounds, method="bounded").x))
        ratio = information / (1 + variance * information)
        return float(np.sqrt(variance)), float(1 / np.sqrt(2 * variance * (ratio**2).sum()))


@dataclass(frozen=True)
class SettingError:
    """Random settings of an axis.

    Args:
        fault: what is said of them.
        stops: that they were seen at; rotations: at each.
    """

    fault: Fault
    stops: Sequence[Stop]
    rotations: Rotations


def find_setting_error(
    fitted: FittedModel, start: FittedModel, whitened: WhitenedModel, total: int, share: float
) -> SettingError | None:
    """Random setting of an axis: each stop has its own rotation, beyond what the scenario states.

    Args:
        fitted: the model with its causes; start: without them.
        whitened: the noise by which readings are weighed.
        total: number of hypotheses.
        share: of the rotations that the causes explain, what their forms may leave.

    Returns:
        The rotations; None when the stops agree.
    """
    observations = whitened.observations
    noise = noise_within_stops(fitted, whitened)
    if noise is None:
        return None
    limit = float(np.log(ALPHA) - np.log(max(total, 1)))
    axis, stops, chance = _least_probable(fitted, whitened, noise, limit)
    if not stops:
        return None
    within = whitened.under(models(noise))
    beside = refit(fitted, within)
    gain = explained_by_stops(stops, beside, within)
    first = explained_by_stops(stops, refit(start, within), within)
    # so many sizes take their share of chance as well
    free = max(len(stops) - sum(len(t.names) for t in fitted.terms), 1)
    if gain / free < share * first / len(stops):
        return None
    rotations = rotations_of_stops(stops, beside, within)
    sigma, error = rotations.spread()
    if not sigma > 0:
        return None
    p_value = float(np.exp(chance)) * max(total, 1)
    fault = _fault_of(observations, axis, sigma, error)
    return SettingError(replace(fault, p_value=p_value), stops, rotations)


def _fault_of(observations: Observations, axis: str, sigma: float, error: float) -> Fault:
    """What is said of random settings of an axis.

    Args:
        observations: whose scenario may state some.
        axis: which.
        sigma: of the settings beyond what is stated, rad.
        error: standard uncertainty of it, rad.
    """
    names = tuple(dict.fromkeys(c.sensor for c in observations.channels))
    axes = tuple(dict.fromkeys(c.axis for c in observations.channels))
    stated = stated_scatter(observations, axis)
    whole = float(np.hypot(sigma, stated))
    effect = SettingScatter({"sigma": whole}, None, axis, "found")
    words = f"The {axis} axis stops at random about its setting, {_arcsec(whole)} rms"
    words += f", where the scenario states {_arcsec(stated)}" if stated else ""
    words += ": each stop has its own rotation."
    return Fault(effect, names, axes, words, sigma={"sigma": error * sigma / whole})


def _arcsec(angle: float) -> str:
    return f"{np.degrees(angle) * 3600:.3g} arcsec"


def _least_probable(
    fitted: FittedModel, whitened: WhitenedModel, noise: Sequence[NoiseFit], limit: float
) -> tuple[str, list[Stop], float]:
    """The axis whose stops would agree with the least probability, these, and its logarithm; none
    above the limit.
    """
    found = "", list[Stop](), limit
    for axis, stops in stops_by_axis(whitened.observations, fitted):
        chance = _chance(stops, fitted, whitened, noise, limit)
        if chance < found[2] or (chance == found[2] and not found[1]):
            found = axis, stops, chance
    return found


def _chance(
    stops: Sequence[Stop],
    fitted: FittedModel,
    whitened: WhitenedModel,
    noise: Sequence[NoiseFit],
    limit: float,
) -> float:
    """Log probability of what the rotations of the stops explain, under the noisiest model that the
    stops allow. Not worked out further above the limit.

    Differences between stops that are no rotation about the axis show how much noise there is
    between stops: the rotations have to be significant beyond that too.
    """
    levels = [
        Stop({i: np.asarray(column != 0, float)}, stop.angles)
        for stop in stops
        for i, column in stop.columns.items()
    ]
    worst = -np.inf
    for side in (0, 1):
        bound = whitened.under([fit.bounds()[side] for fit in noise])
        at_this = refit(fitted, bound)
        gain = explained_by_stops(stops, at_this, bound)
        worst = max(worst, log_tail(gain, len(stops)))
        if worst > limit:
            break
        other = explained_by_stops([*stops, *levels], at_this, bound) - gain
        free = len(levels) - len(stops) - at_this.basis[0].shape[1]
        worst = max(worst, log_ratio(gain, len(stops), other, free) if free > 0 else -np.inf)
    return worst


def log_ratio(gain: float, dof: int, other: float, free: int) -> float:
    """Log probability that a ratio of mean squares exceeds that of ``gain`` over ``other`` (F
    test).
    """
    from scipy.special import fdtrc

    return float(np.log(max(float(fdtrc(dof, free, gain / dof / max(other / free, 1.0))), 1e-300)))


def lawful_part(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """The fitted model without its unlisted curves, where these have as many parameters as there
    are stops.
    """
    named = tuple(t for t in fitted.terms if (t.host or t.hypothesis).listed)
    sizes = sum(len(t.names) for t in fitted.terms) - sum(len(t.names) for t in named)
    few = sizes < sum(int(stop.max(initial=-1)) + 1 for stop in whitened.observations.stops)
    return fitted if few else refit(replace(fitted, terms=named), whitened)


def beside_stops(
    fitted: FittedModel, stops: Sequence[Stop], whitened: WhitenedModel, total: int
) -> FittedModel:
    """The fitted model without the findings that rotations of every stop explain as well."""
    extra = {
        i: np.column_stack([c.waves(s.columns.get(i, np.zeros(len(c.values)))) for s in stops])
        for i, c in enumerate(whitened.observations.channels)
    }
    beside = whitened.under(models(noise_under(fitted, whitened.columns, extra, whitened.law)))
    values = finding_log_p_values(fitted, beside, total, [s.columns for s in stops])
    kept = [
        k
        for places, value in zip(fitted.findings(), values, strict=True)
        if value < np.log(ALPHA)
        for k in places
    ]
    return refit(replace(fitted, terms=tuple(fitted.terms[k] for k in kept)), whitened)


def stops_by_axis(
    observations: Observations, fitted: FittedModel
) -> Iterator[tuple[str, list[Stop]]]:
    """The stops of each axis that stops often enough; one axis at a time, as there may be hundreds
    of stops.
    """
    for axis in observations.scenario.rig.kind.turning:
        stops = _stops(observations, axis, fitted)
        if len(stops) >= MIN_STOPS:
            yield axis, stops


def _stops(observations: Observations, axis: str, fitted: FittedModel) -> list[Stop]:
    """The stops at which a rotation of one axis shows."""
    found = []
    for one in stop_rotations(observations, axis, fitted.effects):
        course = observations.courses[one.recording]
        here = course.stop == one.stop
        angles = {name: float(np.mean(a[here])) for name, a in course.angles.items()}
        found.append(Stop(one.columns, angles))
    return found


def explained_by_stops(
    stops: Sequence[Stop], fitted: FittedModel, whitened: WhitenedModel
) -> float:
    """Fall of the deviance by a free angle at each stop."""
    left, matrix = _beside(stops, fitted, whitened)
    # with the model's own columns, which explain nothing of what they leave: a stop's column is
    # not projected, because it would change every channel then
    return matrix.explained(left)


def rotations_of_stops(
    stops: Sequence[Stop], fitted: FittedModel, whitened: WhitenedModel
) -> Rotations:
    """What a recording says of a rotation at each stop, whatever the fitted terms are."""
    left, matrix = _beside(stops, fitted, whitened)
    fixed = matrix.count - len(stops)
    cross = matrix.gram[fixed:, :fixed]
    information, turn = np.linalg.eigh(matrix.gram[fixed:, fixed:] - cross @ cross.T)
    told = information > SURVIVES * np.diag(matrix.gram)[fixed:].max(initial=0.0)
    root = np.sqrt(information[told])[:, None] * turn[:, told].T
    along = turn[:, told].T @ matrix.along(left)[fixed:]
    return Rotations(along / np.sqrt(information[told]), root)


def _beside(
    stops: Sequence[Stop], fitted: FittedModel, whitened: WhitenedModel
) -> tuple[list[Array], BlockDesignMatrix]:
    """What a model leaves, whitened, by channel, (n,) each, and an orthonormal basis of what it
    fits, with the columns of the stops behind.
    """
    lengths = [len(c.values) for c in whitened.observations.channels]
    left = project(fitted.basis, whitened.residual(fitted.effects))
    columns = (whitened.whiten(stop.columns) for stop in stops)
    return left, BlockDesignMatrix([*columns_of(fitted.basis), *columns], lengths)
