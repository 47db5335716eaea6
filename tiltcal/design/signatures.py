"""What the effects of the catalogue leave in the readings at poses, for designs that show all of
them.

An effect (of one table axis, where it has one) acts with all its parameters at their plausible
sizes; its energy at a pose is the sum over parameters and channels of what bias, scale and
cross-axis terms, re-fitted, leave. Smooth effects are expanded in harmonics of the table angles
once; kinks keep their own form, the sign of f smoothed over 5 deg: what no table could set apart is
no pose.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.units import DEG
from tiltcal.design.static_instrument import Still, pointwise
from tiltcal.design.tabulated import PoseColumns, changes_of, tabulate
from tiltcal.design.terms import STEEPEST, Parameter, direct_columns
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.effects.base import Effect
from tiltcal.effects.sensor.accelerometer import AccBiasAsym
from tiltcal.forward.jacobian import candidates
from tiltcal.setup.sensor import Sensor

SOFT_SIGN = np.sin(5 * DEG)
ORDINARY = 1e-6  # share of an effect's energy below which the ordinary terms take all of it
# needs of effects that the order of poses may show
IN_ORDER = (
    "pose",
    "time",
    "direction",
    "temperature",
)


@dataclass(frozen=True)
class Signatures:
    """Columns of the effects that poses show.

    Args:
        still: the table at rest.
        sensor: sensor of the readings.
        names: of the effects.
        member: (columns, effects), 1 where a column is an effect's.
        smooth: columns as harmonics.
        kinks: parameters after them whose columns are exact.
        ordinary: effects that bias, scale and cross-axis terms take up entirely.
        ordered: effects that only the order of visiting can show.
        unseen: those that no sequence of dwells shows.
    """

    still: Still
    sensor: Sensor
    names: tuple[str, ...]
    member: Array
    smooth: PoseColumns
    kinks: tuple[Parameter, ...]
    ordinary: tuple[str, ...]
    ordered: tuple[Effect, ...]
    unseen: tuple[str, ...]

    def columns(self, angles: Array) -> Array:
        """What each column adds at poses, (n, channels, columns), in plausible sizes.

        Args:
            angles: rad, (n, axes).
        """
        kinks = direct_columns(self.still, self.sensor, self.kinks, angles, np.zeros(len(angles)))
        up = self.still.up(angles)[:, list(self.sensor.axis_indices)]
        for j, p in enumerate(self.kinks):
            if isinstance(p.effect, AccBiasAsym):  # it follows the sign of f
                kinks[:, :, j] = (
                    np.abs(kinks[:, :, j]).max()
                    * np.tanh(up / SOFT_SIGN)
                    * (kinks[:, :, j] != 0).any(axis=0)
                )
        return self._read(np.concatenate([self.smooth.at(angles), kinks], axis=2), up)

    def linear(self, angles: Array) -> Array:
        """What bias, scale and cross-axis terms add at poses, (n, channels, terms): 1 and the
        independent parts of up.

        Args:
            angles: rad, (n, axes).
        """
        up = self.still.up(angles)
        parts = np.column_stack([np.ones(len(up)), up @ self.spanned])
        return self._read(
            np.repeat(parts[:, None, :], len(self.sensor.axes), axis=1),
            up[:, list(self.sensor.axis_indices)],
        )

    @property
    def in_order(self) -> tuple[str, ...]:
        """Names of the effects that only the order may show."""
        return tuple(dict.fromkeys(name_of(e) for e in self.ordered))

    @property
    def spanned(self) -> Array:
        """Directions that this table's poses take up through, (3, 2 or 3)."""
        angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (40, len(self.still.axes)))
        _, size, across = np.linalg.svd(
            self.still.up(angles) - self.still.up(angles).mean(axis=0), full_matrices=False
        )
        return np.asarray(across[size > 1e-9 * size[0]].T)

    def _read(self, columns: Array, up: Array) -> Array:
        """An inclinometer's noise acts on the angle: d asin(f/g) = df / (g cos), steep near 90
        deg.
        """
        if self.sensor.kind != "inclinometer":
            return columns
        return np.asarray(columns / np.maximum(np.sqrt(1 - up**2 + 1e-15), STEEPEST)[:, :, None])


class Field:
    """Signatures at some poses, worked out once.

    Args:
        seen: the effects.
        angles: of the poses, rad, (n, axes).
    """

    def __init__(self, seen: Signatures, angles: Array) -> None:
        self.F, self.E, self.member = seen.linear(angles), seen.columns(angles), seen.member

    def only(self, effect: int) -> "Field":
        """The same of one effect alone."""
        one = copy(self)
        used = self.member[:, effect] > 0
        one.E, one.member = self.E[:, :, used], self.member[used][:, [effect]]
        return one

    def fitted(self, weight: Array) -> list[Array]:
        """Linear terms that take up each column in each channel, fitted with these weights,
        [(terms, columns)].
        """
        found = []
        for k in range(self.F.shape[1]):
            weighed = weight[:, None] * self.F[:, k]
            M = weighed.T @ self.F[:, k] + 1e-9 * np.eye(self.F.shape[2])
            found.append(np.asarray(np.linalg.solve(M, weighed.T @ self.E[:, k])))
        return found

    def energy(self, terms: Sequence[Array]) -> Array:
        """Energy of each effect that such terms leave at each pose, (n, effects)."""
        standstill = sum(
            (self.E[:, k] - self.F[:, k] @ terms[k]) ** 2 for k in range(self.F.shape[1])
        )
        return np.asarray(standstill @ self.member)

    def left_over(self, weight: Array) -> Array:
        """The same with the terms fitted with these weights to these poses.

        Args:
            weight: (n,); the energies, (n, effects).
        """
        return self.energy(self.fitted(weight))

    def log_det(self, weight: Array) -> tuple[float, Array]:
        """Log determinant of the linear terms per term, mean of the channels, and its derivative by
        each weight, (n,).
        """
        _, channels, terms = self.F.shape
        total, slope = 0.0, np.zeros(len(self.F))
        for k in range(channels):
            M = self.F[:, k].T @ (weight[:, None] * self.F[:, k]) + 1e-12 * np.eye(terms)
            total += float(np.linalg.slogdet(M)[1])
            slope += np.einsum("ni,ij,nj->n", self.F[:, k], np.linalg.inv(M), self.F[:, k])
        return total / (terms * channels), slope / (terms * channels)


def catalogue_signatures(
    still: Still, sensor: Sensor, allowed: Array, grade: str = "mid_mems", only: Sequence[str] = ()
) -> Signatures:
    """All effects that this table and sensor can have, or those of some ids, sorted by what shows
    them.

    Args:
        still: the table.
        sensor: sensor of the readings.
        grade: grade of the plausible sizes.
        allowed: poses that stand for all allowed ones, rad, (n, axes).
        only: ids to keep; all unless given.

    Raises:
        TiltcalError: the allowed poses show none in addition to the ordinary terms.
    """
    wanted = [one_of(id, CATALOGUE, "design, effect") for id in only]
    shown, ordered, unseen = _sorted(still, sensor, grade, wanted)
    table, smooth = tabulate(still, sensor, [p.effect for p in shown])
    names = [name_of(p.effect) for p in shown]
    direct = [is_smooth or p.direct for is_smooth, p in zip(smooth, shown, strict=True)]
    fine_effects = [p.effect for p, is_direct in zip(shown, direct, strict=True) if not is_direct]
    winding = _winding(still, sensor, fine_effects)
    fine = {name_of(e) for e in fine_effects}
    fine -= {name for name, is_direct in zip(names, direct, strict=True) if is_direct}

    def without(left_out: set[str]) -> Signatures:
        kept = [k for k, name in enumerate(names) if direct[k] and name not in left_out]
        harmonics = [k for k in kept if smooth[k]]
        kinks = [k for k in kept if not smooth[k]]
        owners = [names[k] for k in [*harmonics, *kinks]]
        effects = tuple(dict.fromkeys(owners))
        ordinary = [name for name in dict.fromkeys(names) if name in left_out - fine]
        return Signatures(
            still,
            sensor,
            effects,
            np.array([[float(owner == e) for e in effects] for owner in owners]),
            table.only(harmonics),
            tuple(shown[k] for k in kinks),
            tuple(ordinary),
            tuple(ordered + winding),
            tuple(sorted({*unseen, *fine} - {name_of(e) for e in winding})),
        )

    every = without(fine)
    ordinary = _taken(every, allowed)
    if len(ordinary) == len(every.names):
        raise TiltcalError(
            f"design --all-effects-observable, table {still.scenario.rig.table}",
            found="no effect that these poses show in addition to bias, scale and cross-axis terms",
            need="at least one",
            do="name others as --terms, or widen --angles",
        )
    return without(fine | ordinary)


def _winding(still: Still, sensor: Sensor, effects: Sequence[Effect]) -> list[Effect]:
    """Those that are not the same a turn further on: what they show depends on which way round the
    table goes.
    """
    angles = np.random.default_rng(2).uniform(-np.pi, np.pi, (20, len(still.axes)))
    here, further = (changes_of(still, sensor, effects, angles + turn) for turn in (0.0, 2 * np.pi))
    differs = np.abs(further - here).max(axis=(0, 1), initial=0.0) > 1e-6 * np.abs(here).max(
        axis=(0, 1), initial=0.0
    )
    return [e for e, is_other in zip(effects, differs, strict=True) if is_other]


def _taken(every: Signatures, allowed: Array) -> set[str]:
    """Effects of which bias, scale and cross-axis terms leave nothing at the allowed poses."""
    n = len(allowed)
    field = Field(every, allowed)
    left = field.left_over(np.full(n, 1 / n)).mean(axis=0)
    whole = (field.E**2).sum(axis=1).mean(axis=0) @ every.member
    return {
        name
        for name, standstill, all_ in zip(every.names, left, whole, strict=True)
        if standstill <= ORDINARY * all_
    }


def name_of(effect: Effect) -> str:
    """An effect, with the table axis it sits on."""
    return f"{effect.id} {effect.axis}" if effect.axis else effect.id


def _sorted(
    still: Still, sensor: Sensor, grade: str, only: Sequence[str]
) -> tuple[list[Parameter], list[Effect], set[str]]:
    """Parameters that poses show, effects that their order shows, names of those that neither
    does.
    """
    shown: list[Parameter] = []
    ordered: list[Effect] = []
    unseen: set[str] = set()
    for id, owner, axis, name, p, size in candidates(still.scenario, grade):
        if owner not in (None, sensor.name) or (only and id not in only):
            continue
        middle = {
            f"{q.name}{q.suffix}": still.horizon / 2
            for q in CATALOGUE[id].parameters
            if q.name in ("time", "start")
        }
        effect = make_effect(
            id, {f"{name}{p.suffix}": size, **middle}, still.scenario, sensor=owner, axis=axis
        )
        if effect.needs == "pose" and pointwise(still, sensor, effect):
            shown.append(Parameter(effect, name, p.unit, size, "", True))
        elif effect.needs in IN_ORDER:
            ordered.append(effect)
        else:
            unseen.add(name_of(effect))
    return shown, ordered, unseen - {name_of(p.effect) for p in shown}
