"""What the readings of many rigs tell of the terms that a calibration may adjust."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.methods.terms import effect_of_term
from tiltcal.core.arrays import Array, Mask
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.design.terms import STEEPEST
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import TermEffect
from tiltcal.effects.sense import Sense
from tiltcal.forward.jacobian import candidates, white_noise
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor

GRADE = "mid_mems"  # whose plausible sizes are the prior


@dataclass(frozen=True)
class AdjustableTerm:
    """One number that a calibration re-tunes.

    Args:
        effect: whose term it is; name: bare; size: prior standard deviation, SI.
    """

    effect: TermEffect
    name: str
    size: float


def adjustable_terms(scenario: Scenario, sensor: Sensor) -> list[AdjustableTerm]:
    """The numbers of a sensor's ``adjustable`` list that are linear terms of the sensor; effects of
    table and electronics that stand there are not among them.
    """
    ids = set()
    for term in sensor.adjustable:
        if term not in CATALOGUE:
            ids.add(effect_of_term(term, sensor).id)
        elif issubclass(CATALOGUE[term], TermEffect) and CATALOGUE[term].stage == "sensor":
            ids.add(term)
    found = []
    for id, owner, _, name, parameter, size in candidates(scenario, GRADE):
        if id in ids and owner == sensor.name:
            effect = CATALOGUE[id](sensor=owner)
            assert isinstance(effect, TermEffect)
            si = size * PARAMETER_UNITS[parameter.unit].factor
            found.append(AdjustableTerm(effect, name, si))
    return found


class SensorInformation:
    """Information of many rigs on the adjustable terms of one sensor, sample by sample.

    The noise of a sample is the white noise that the scenario states, or a usual one. The
    covariance takes a sample in by a rank-one update (Sherman and Morrison 1950).

    Args:
        scenario: noise and terms; sensor: whose; count: rigs.
    """

    def __init__(self, scenario: Scenario, sensor: Sensor, count: int) -> None:
        self.sensor = sensor
        self.terms = adjustable_terms(scenario, sensor)
        self.sigma = white_noise(sensor, scenario.effects)
        size = len(self.terms)
        self.covariance = np.tile(np.eye(size), (count, 1, 1))

    def restart(self, rows: Mask) -> None:
        """These rigs know the prior. rows: (rigs,)."""
        self.covariance[rows] = np.eye(len(self.terms))

    def add(self, sense: Sense, rows: Mask) -> Array:
        """Nats that a sample of these rigs brings, (rigs,): the rise of half the log determinant of
        the information over the prior. rows: (rigs,).
        """
        nats = np.zeros(len(rows))
        if not self.terms:
            return nats
        columns = self.columns(sense) / self.sigma
        columns[~rows] = 0.0
        C = self.covariance
        for channel in range(columns.shape[1]):
            row = columns[:, channel]
            Cr = np.matmul(C, row[..., None])[..., 0]
            grown = 1 + np.einsum("ni,ni->n", row, Cr)
            C -= Cr[..., :, None] * Cr[..., None, :] / grown[:, None, None]
            nats += np.log(grown) / 2
        return nats

    def columns(self, sense: Sense) -> Array:
        """Change of the readings per prior standard deviation, SI, (rigs, channels, terms)."""
        columns = np.zeros((len(sense.time), len(self.sensor.axes), len(self.terms)))
        for j, term in enumerate(self.terms):
            channel, column = term.effect.term(term.name, sense)
            if channel >= 0:
                columns[:, channel, j] = term.size * column
        if self.sensor.kind == "inclinometer":  # its terms act on the force: d asin = df/(g cos)
            share = sense.force[:, list(self.sensor.axis_indices)] / sense.gravity
            across = np.sqrt(np.maximum(1 - share**2, STEEPEST**2))
            columns /= (sense.gravity * across)[:, :, None]
        return columns


def information_of(scenario: Scenario, count: int) -> Mapping[str, SensorInformation]:
    """That of all sensors, by name."""
    return {s.name: SensorInformation(scenario, s, count) for s in scenario.sensor}
