"""The product's own model equation as a design Model: calibration terms and effects of the
catalogue, seen from poses.

A term of the sensor has its exact column at any angle and time. Every other effect that shows in a
pose (table, mount, environment, converter) is differenced through the closed form on a grid of
table angles once, and expanded in their harmonics. An effect whose change at a pose depends on how
the pose was reached (memory, motion, vibration, remounting) cannot be designed for by poses alone
and is named as such.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.methods.terms import effect_of_term
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.frames import sphere
from tiltcal.core.units import G0, PARAMETER_UNITS
from tiltcal.design.model import Model
from tiltcal.design.polynomial import tilt_loss
from tiltcal.design.static_instrument import Still, pointwise, still_sense
from tiltcal.design.tabulated import PoseColumns, tabulate
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import Effect, TermEffect
from tiltcal.effects.sensor.noise import Noise
from tiltcal.forward.jacobian import candidates, white_noise
from tiltcal.laboratory.scenario import Scenario
from tiltcal.setup.sensor import Sensor

DIRECTIONS = 400  # of the working range
STEEPEST = (
    0.5  # cosine of the steepest tilt at which an inclinometer's angle counts for its slope: 60 deg
)
EVENTS = ("time", "start")  # parameters of an effect that happens once


@dataclass(frozen=True)
class Wanted:
    """What the design is about.

    Args:
        interest: terms (bias, scale, cross_axis, K2 ...), catalogue ids, or ``all``.
        nuisance: terms and ids that are fitted too but are not of interest.
        grade: grade of the plausible sizes that are the prior.
        prior: relative size that replaces them (g, or g per power of g), or None.
        floor: what no averaging removes from a pose mean, m/s2.
        range: half-angle of the working range about level, rad; pi: all directions.
    """

    interest: tuple[str, ...]
    nuisance: tuple[str, ...] = ("drift",)
    grade: str = "mid_mems"
    prior: float | None = None
    floor: float = 2e-5 * G0
    range: float = np.pi


@dataclass(frozen=True)
class Parameter:
    """One parameter of the design: an effect with this one value at its prior size."""

    effect: Effect
    name: str
    unit: str
    size: float
    label: str
    interest: bool

    @property
    def direct(self) -> bool:
        """Whether its column is exact at any pose and time."""
        return isinstance(self.effect, TermEffect) and self.effect.stage == "sensor"


def scenario_model(
    scenario: Scenario, sensor: Sensor, wanted: Wanted, horizon: float
) -> tuple[Model, tuple[str, ...]]:
    """The Model of a scenario's sensor, and the ids of effects that poses alone do not determine.

    Raises:
        TiltcalError: a term is unknown, or asked for by name though poses cannot show it.
    """
    still = Still(scenario, horizon)
    parameters, unseen = wanted_parameters(scenario, sensor, wanted, still)
    direct = [p for p in parameters if p.direct]
    indirect = [p for p in parameters if not p.direct]
    table, held = tabulate(still, sensor, [p.effect for p in indirect])
    fine = [p.label for p, is_held in zip(indirect, held, strict=True) if not is_held]
    indirect = [p for p in indirect if p.label not in fine]
    table = table.only([j for j, is_held in enumerate(held) if is_held])
    ordered = direct + indirect
    rows = _Rows(still, sensor, direct, table)
    k = len(sensor.axes)
    known = [e for e in scenario.effects if isinstance(e, Noise)]
    white = np.full(k, white_noise(sensor, known) / np.sqrt(sensor.rate_hz))
    floor = np.full(k, wanted.floor / (G0 if sensor.kind == "inclinometer" else 1.0))
    timed = any(p.effect.needs in ("time", "temperature") for p in direct)
    loss = _loss(still, sensor, ordered, wanted)
    return Model(
        tuple(p.label for p in ordered),
        tuple(p.unit for p in ordered),
        np.array([p.size for p in ordered]),
        np.array([p.interest for p in ordered]),
        rows,
        white,
        floor,
        loss,
        timed,
        len(still.axes),
    ), tuple(sorted({*unseen, *fine}))


def wanted_parameters(
    scenario: Scenario, sensor: Sensor, wanted: Wanted, still: Still
) -> tuple[list[Parameter], tuple[str, ...]]:
    """Parameters that poses can show, those of interest first, and the ids of the effects that
    they cannot, or where an effect does not show.
    """
    everything = "all" in wanted.interest
    nuisance = {_id_of(t, sensor) for t in wanted.nuisance}
    named = {_id_of(t, sensor) for t in wanted.interest if t != "all"}
    found: list[Parameter] = []
    hidden: dict[str, set[str]] = {}  # id -> addresses
    for id, owner, axis, name, p, size in candidates(scenario, wanted.grade):
        asked = id in named or id in nuisance
        if not (asked or everything) or (owner is not None and owner != sensor.name):
            continue
        effect = make_effect(id, {f"{name}{p.suffix}": size}, scenario, sensor=owner, axis=axis)
        if any(q.name in EVENTS for q in effect.parameters) or not pointwise(still, sensor, effect):
            hidden.setdefault(id, set()).add(effect.address)
            continue
        scaled = (
            size
            if wanted.prior is None
            else wanted.prior * _unity(p.unit) / PARAMETER_UNITS[p.unit].factor
        )
        effect = make_effect(id, {f"{name}{p.suffix}": scaled}, scenario, sensor=owner, axis=axis)
        label = f"{sensor.name}.{name}" if owner else f"{effect.address}.{name}"
        found.append(Parameter(effect, name, p.unit, scaled, label, id not in nuisance))
    shown = {p.effect.id for p in found}
    unseen = set(hidden) - shown
    _refuse_unseen(named & unseen, found, named, sensor)
    # of an effect that shows on some joints only: those on which it does not
    at_shown = {p.effect.address for p in found}
    parts = set().union(*(hidden[id] - at_shown for id in shown & set(hidden)))
    return sorted(found, key=lambda p: not p.interest), tuple(sorted(unseen | parts))


def _refuse_unseen(
    hidden: set[str], found: Sequence[Parameter], named: set[str], sensor: Sensor
) -> None:
    for id in sorted(hidden):
        raise TiltcalError(
            f"design, {id}",
            found=f"an effect that no pose can see: it shows in {CATALOGUE[id].excited_by}",
            need="terms that show at rest",
            do="leave it out, and record what excites it",
        )
    if not any(p.interest for p in found):
        text = ", ".join(sorted(named)) or "nothing"
        raise TiltcalError(
            f"design, terms of {sensor.name}",
            found=f"{text}: no parameter that this table's poses show",
            need="at least one",
            do="name terms of this sensor (`tiltcal effects` lists them)",
        )


def _id_of(term: str, sensor: Sensor) -> str:
    """Catalogue id of a term.

    Raises:
        TiltcalError: there is none of that name.
    """
    if term in CATALOGUE:
        return term
    if term.startswith(("table_", "mount_", "acc_", "gyr_", "fog_", "adc_", "data_")):
        raise TiltcalError(
            f"design, term '{term}'",
            found="no such effect",
            need="an id of the catalogue",
            do=nearest(term, list(CATALOGUE)),
        )
    return effect_of_term(term, sensor).id


def _unity(unit: str) -> float:
    """SI size of 1 g, 1 g per power of g, or a plain 1, whatever the parameter's unit counts."""
    return G0 if unit.startswith("ug") else 1.0


@dataclass(frozen=True)
class _Rows:
    """Columns of all parameters at poses: exact ones, then tabulated ones."""

    still: Still
    sensor: Sensor
    direct: Sequence[Parameter]
    table: PoseColumns

    def __call__(self, angles: Array, time: Array) -> Array:
        exact = direct_columns(self.still, self.sensor, self.direct, angles, time)
        columns = (
            np.concatenate([exact, self.table.at(angles)], axis=2) if self.table.columns else exact
        )
        # its noise acts on the angle: d asin(f/g) = df / (g cos)
        if self.sensor.kind == "inclinometer":
            g = self.still.scenario.site.gravity
            across = np.sqrt(
                1 - self.still.up(angles)[:, list(self.sensor.axis_indices)] ** 2 + 1e-15
            )
            columns /= (g * np.maximum(across, STEEPEST))[:, :, None]
        return columns


def direct_columns(
    still: Still, sensor: Sensor, parameters: Sequence[Parameter], angles: Array, time: Array
) -> Array:
    """Change of the channels per prior size in the sensing form (force), (n, k, p), SI."""
    sense = still_sense(still, sensor, angles, time)
    columns = np.zeros((len(angles), len(sensor.axes), len(parameters)))
    for j, p in enumerate(parameters):
        if isinstance(p.effect, TermEffect):
            channel, column = p.effect.term(p.name, sense)
            if channel >= 0:
                columns[:, channel, j] = p.effect.value(p.name) * column[: len(angles)]
    return columns


def _loss(still: Still, sensor: Sensor, ordered: Sequence[Parameter], wanted: Wanted) -> Array:
    """Mean square tilt error over the working range, per axis, as a quadratic form of the sensor's
    own parameters.
    """
    from tiltcal.design.static_instrument import sense_of

    g = still.scenario.site.gravity
    cone = min(wanted.range, np.pi / 4) if sensor.kind == "inclinometer" else wanted.range
    up = sphere(int(np.ceil(DIRECTIONS * 2 / max(1 - np.cos(cone), 1e-4))))
    up = up[up[:, 2] >= np.cos(cone) - 1e-12][:DIRECTIONS]
    sense = sense_of(still, sensor, up, np.zeros(len(up)))
    columns = np.zeros((len(up), len(sensor.axes), len(ordered)))
    for j, p in enumerate(ordered):
        if p.interest and p.direct and isinstance(p.effect, TermEffect):
            channel, column = p.effect.term(p.name, sense)
            if channel >= 0:
                columns[:, channel, j] = p.effect.value(p.name) * column[: len(up)] / g
    if len(sensor.axes) == 3:
        return tilt_loss(up, columns)
    flat = columns.reshape(-1, len(ordered))
    return np.asarray(flat.T @ flat / (len(up) * len(sensor.axes)))
