"""The next pose: that which adds the most information, by the Jacobian of the calibration."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tiltcal.calibration.methods.known_attitude_model import DRIFT
from tiltcal.calibration.methods.norm_model import names_of, slopes_of_norm
from tiltcal.calibration.methods.terms import LINEAR, effect_of_term, term_columns
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import AXES
from tiltcal.core.units import DEG
from tiltcal.design.criteria import value
from tiltcal.design.model import Model
from tiltcal.design.pose_grids import grid, spread
from tiltcal.design.scenario_problem import clock_of
from tiltcal.design.static_instrument import Still
from tiltcal.design.terms import STEEPEST, Wanted
from tiltcal.forward.jacobian import sizes, white_noise
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.pose_schemes import directions, label_of
from tiltcal.setup.sensor import Sensor

CRITERION = "D"
# nats: a pose this near to the best is as good; one sigma in all is then 5 % larger
TIE = 0.05
NEAR = 20 * DEG  # of the last dwell: half way from a face to an edge
STEPS = {1: 15 * DEG, 2: 45 * DEG}  # of the angles that are proposed, by the number of axes
SPREAD = 128  # poses of tables with more axes
MOST = 60  # dwells that a forecast counts
# readings for each parameter, so that a third of them tests the fit: 6 faces for 12 parameters of
# a triad, 12 poses for the 9 of its norm
READINGS = 4 / 3


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose that may be proposed.

    Args:
        up: up in the body frame, (3,).
        angles_deg: of the table axes, by name; empty by hand.
        rank: the lower, the easier it is to set.
    """

    up: Array
    angles_deg: Mapping[str, float]
    rank: int

    @property
    def label(self) -> str:
        """The operator's label."""
        return label_of(self.up)

    @property
    def instruction(self) -> str:
        """What to do, as a sentence."""
        if self.angles_deg:
            return "set " + ", ".join(f"{a} {v:.6g} deg" for a, v in self.angles_deg.items())
        axes = [
            f"{'+' if v > 0 else '-'}{a}"
            for a, v in zip(AXES, self.up, strict=True)
            if abs(v) > 0.1
        ]
        if len(axes) == 1:
            return f"turn {axes[0]} up"
        part = "edge" if len(axes) == 2 else "corner"
        return f"turn the {part} between {', '.join(axes[:-1])} and {axes[-1]} up"


@dataclass(frozen=True)
class Planner:
    """Chooses poses for a fit.

    Args:
        model: of the fit; its poses are directions of up, (n, 3), instead of angles.
        candidates: poses that may be proposed.
        hold: length of a dwell, s.
    """

    model: Model
    candidates: tuple[Candidate, ...]
    hold: float

    @property
    def least(self) -> int:
        """Dwells that leave readings to test the fit by."""
        return int(np.ceil(READINGS * len(self.model.names) / len(self.model.white)))

    def with_noise(self, white: Array) -> "Planner":
        """The same with measured noise, per root hertz, (k,)."""
        return replace(self, model=replace(self.model, white=white))

    def information(self, up: Array, dwell: Array) -> Array:
        """Of some dwells and the prior, (p, p), in units of the prior.

        Args:
            up: up in the body frame, (n, 3).
            dwell: s, (n,).
        """
        return self.model.information(up.reshape(-1, 3), dwell, np.zeros(len(dwell)))

    def sigmas(self, information: Array) -> dict[str, float]:
        """Expected standard uncertainty of each parameter. information: (p, p)."""
        sigma = np.sqrt(np.diag(np.linalg.inv(information))) * self.model.prior
        return dict(zip(self.model.names, map(float, sigma), strict=True))

    @cached_property
    def _added(self) -> Array:
        """Information of one dwell at each candidate, (c, p, p)."""
        up = np.array([c.up for c in self.candidates])
        dwell = np.full(len(up), self.hold)
        rows = self.model.rows(up, np.zeros(len(up)))
        rows = rows * np.sqrt(self.model.weights(dwell))[:, :, None]
        return np.asarray(np.einsum("ckp,ckq->cpq", rows, rows))

    def best(
        self,
        information: Array,
        way: Callable[[Candidate], float] | None = None,
        proposed: Candidate | None = None,
        here: Array | None = None,
    ) -> tuple[Candidate, float]:
        """The pose that adds most, and what it adds, nats; among equals that which is proposed
        already, then the easiest, then the nearest.

        Args:
            information: of the dwells so far, (p, p).
            way: to a pose, rad.
            proposed: before.
            here: up in the body frame at the last dwell, (3,): to stay there is not proposed.
        """
        before = value(information, self.model, CRITERION)
        gains = [
            value(information + added, self.model, CRITERION) - before for added in self._added
        ]
        poses = self.candidates
        away = [here is None or c.up @ here < np.cos(NEAR) for c in poses]
        if any(away):
            gains = [g if far else -np.inf for g, far in zip(gains, away, strict=True)]
        good = [k for k, gain in enumerate(gains) if gain >= max(gains) - TIE]
        far = {k: 0.0 if way is None else round(way(poses[k]), 3) for k in good}
        k = min(good, key=lambda k: (poses[k] is not proposed, poses[k].rank, far[k], k))
        return poses[k], gains[k]

    def after(self, information: Array, number: int) -> Array:
        """Information after so many further dwells, each at the best pose. (p, p)."""
        for _ in range(number):
            pose, _ = self.best(information)
            information = information + self._added[self.candidates.index(pose)]
        return information

    def further(self, information: Array, goals: Mapping[str, float]) -> int | None:
        """How many further dwells at the best poses the goals need; None: more than can be
        expected of anyone.

        Args:
            information: of the dwells so far, (p, p).
            goals: sigma by parameter, in the units of CAL.json.
        """
        for number in range(MOST + 1):
            sigmas = self.sigmas(information)
            if all(sigmas[name] <= goal for name, goal in goals.items()):
                return number
            information = self.after(information, 1)
        return None

    def usual_goals(self) -> dict[str, float]:
        """What the fewest dwells are expected to bring, by parameter."""
        nothing = np.eye(len(self.model.names))
        return self.sigmas(self.after(nothing, self.least))


@dataclass(frozen=True)
class Fitted:
    """What a method fits.

    Args:
        scenario: site, rig and noise.
        sensor: accelerometer or inclinometer.
        terms: of poses of known attitude; without its drift, which no single pose shows.
        by_norm: 6 or 9 parameters of the norm of poses of unknown attitude; 0: they are known.
    """

    scenario: Scenario
    sensor: Sensor
    terms: tuple[str, ...]
    by_norm: int = 0

    def columns(self, up: Array) -> tuple[list[str], list[str], Array]:
        """Names and units of the parameters as in CAL.json, (p,), and the Jacobian of the fit at
        some directions of up (n, 3): of the readings in the sensing form, or of their norm, for
        one unit of each, (n, k, p).
        """
        g = self.scenario.site.gravity
        if self.by_norm:
            names = names_of(self.sensor.name, self.by_norm)
            units = ["m_s2" if ".bias_" in name else "1" for name in names]
            return names, units, slopes_of_norm(g * up, up, self.by_norm)[:, None, :]
        linear = [t for t in self.terms if t != DRIFT]
        names, units, columns = term_columns(linear, self.sensor, self.scenario, g * up)
        if self.sensor.kind == "inclinometer":  # its noise acts on the angle: df = g cos da
            across = np.sqrt(1 - np.minimum(up[:, list(self.sensor.axis_indices)] ** 2, 1.0))
            columns = columns / np.maximum(across, STEEPEST)
        return names, units, np.moveaxis(columns, 0, 2)

    @property
    def prior(self) -> Array:
        """Plausible size of each parameter, in its unit, (p,)."""
        if self.by_norm:
            per_term = [self._sizes(term)[0] for term in LINEAR]
            return np.repeat(per_term, 3)[: self.by_norm]
        return np.array([s for t in self.terms if t != DRIFT for s in self._sizes(t)])

    def _sizes(self, term: str) -> list[float]:
        """Plausible sizes of the parameters of a term, in the units of CAL.json."""
        return [
            sizes(p, Wanted(()).grade) * (p.factor if term in LINEAR else 1.0)
            for p in effect_of_term(term, self.sensor).parameters
            if not p.is_shape
            for _ in p.expand(self.sensor.axes)
        ]

    @property
    def model(self) -> Model:
        """The fit as a model of design; its poses are directions of up, (n, 3)."""
        names, units, columns = self.columns(np.eye(3))
        k, p = columns.shape[1:]
        white = white_noise(self.sensor, self.scenario.effects) / np.sqrt(self.sensor.rate_hz)
        white *= self.scenario.site.gravity if self.sensor.kind == "inclinometer" else 1.0
        prior = self.prior
        return Model(
            tuple(names),
            tuple(units),
            prior,
            np.ones(p, bool),
            lambda up, _: self.columns(up)[2] * prior,
            np.full(k, white),
            np.full(k, Wanted(()).floor),
            np.zeros((p, p)),
            timed=False,
            axes=3,
        )


def by_hand(faces_only: bool) -> tuple[Candidate, ...]:
    """Faces, edges and corners: the faces are the easiest to set. faces_only: without the others,
    whose attitude is not known by hand.
    """
    schemes = ("6",) if faces_only else ("6", "12", "8")
    return tuple(
        Candidate(up, {}, rank) for rank, scheme in enumerate(schemes) for up in directions(scheme)
    )


def on_table(scenario: Scenario, sensor: Sensor) -> tuple[Candidate, ...]:
    """Poses of a table within its limits, and of an inclinometer where its angle is not too steep.

    Args:
        scenario: with the instrument where the sensor sits.
        sensor: accelerometer or inclinometer.

    Raises:
        TiltcalError: the table cannot tilt, or not so.
    """
    still = Still(scenario, 1.0)
    limits = clock_of(scenario, 1.0).limits
    step = STEPS.get(len(still.axes))
    angles = spread(limits, SPREAD) if step is None else grid(limits, step)
    angles = np.round(angles / DEG, 6)
    angles = angles[np.argsort(np.abs(angles).sum(axis=1), kind="stable")]
    up = still.up(angles * DEG)
    good = np.ones(len(up), bool)
    if sensor.kind == "inclinometer":
        others = [k for k in range(3) if k not in sensor.axis_indices]
        good = np.asarray((up[:, others] >= STEEPEST).all(axis=1))
    if not good.any():
        raise TiltcalError(
            f"guide, table {scenario.rig.table}",
            found="no pose within its limits at which this sensor can be read",
            need="poses within 60 deg of level",
            do="correct the limits of the rig",
        )
    return tuple(
        Candidate(u, dict(zip(still.axes, (float(a) + 0.0 for a in row), strict=True)), 0)
        for row, u in zip(angles[good], up[good], strict=True)
    )
