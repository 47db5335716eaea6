"""The catalogue: every effect under its id, and the making of one from the keys of a file."""

import importlib
import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import ModuleType
from typing import Any

from tiltcal.core.errors import TiltcalError, nearest, one_of
from tiltcal.core.extensions import members
from tiltcal.effects.base import Effect
from tiltcal.effects.file_values import check_allowed, file_names, number_of, parameter_of
from tiltcal.effects.learned import Learned
from tiltcal.effects.learned_files import learned_table, make_learned
from tiltcal.effects.parameter import STAGES, by_name
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup

FAMILIES = (
    "environment.world",
    "environment.ground",
    "table.readout",
    "table.geometry",
    "table.drive",
    "table.ringing",
    "table.joint",
    "table.load",
    "mount.mounting",
    "mount.lever",
    "mount.triad",
    "sensor.accelerometer",
    "sensor.environmental",
    "sensor.temporal",
    "sensor.gyro",
    "sensor.dynamics",
    "sensor.noise",
    "sensor.encoder",
    "electronics.converter",
    "electronics.mains",
    "electronics.supply",
    "timing.delays",
    "timing.readout_timing",
    "data.faults",
    "data.labelling_faults",
)


GROUP = "tiltcal.effects"
STATED = (
    "stage",
    "title",
    "parameters",
    "physics",
    "equation",
    "source",
    "excited_by",
    "look",
)
"""What a class has to say of its effect."""


def _is_effect(item: Any) -> bool:
    return (
        inspect.isclass(item)
        and issubclass(item, Effect)
        and bool(item.id)
        and not inspect.isabstract(item)
    )


def _defined_in(module: ModuleType) -> list[type[Effect]]:
    own = [item for item in vars(module).values() if _is_effect(item)]
    return [cls for cls in own if cls.__module__ == module.__name__]


def _built_in() -> dict[str, type[Effect]]:
    modules = (importlib.import_module(f"tiltcal.effects.{family}") for family in FAMILIES)
    return {cls.id: cls for module in modules for cls in _defined_in(module)}


def _with_installed() -> dict[str, type[Effect]]:
    """The built-in effects and those of installed packages.

    Raises:
        TiltcalError: an entry point names no effect, an unfinished one, or one whose id is taken.
    """
    found = _built_in()
    for subject, cls in members(GROUP, _is_effect, "an Effect with an id", _defined_in):
        missing = [name for name in STATED if not hasattr(cls, name)]
        if missing:
            raise TiltcalError(
                subject,
                found=f"{cls.__name__} without {', '.join(missing)}",
                need="a class that describes its effect",
                do="state them",
            )
        if cls.id in (*found, Learned.id):
            raise TiltcalError(
                subject,
                found=f"effect '{cls.id}', which exists already",
                need="an id of its own",
                do="rename it",
            )
        found[cls.id] = cls
    return found


class Catalogue(Mapping[str, type[Effect]]):
    """Effect class of each id, in the order of the chain; installed packages are asked for theirs
    when it is first used.
    """

    @cached_property
    def _classes(self) -> dict[str, type[Effect]]:
        rank = {stage: k for k, stage in enumerate(STAGES)}
        found = _with_installed().items()
        return dict(sorted(found, key=lambda item: (rank[item[1].stage], item[0])))

    def __getitem__(self, id: str) -> type[Effect]:
        return self._classes[id]

    def __iter__(self) -> Iterator[str]:
        return iter(self._classes)

    def __len__(self) -> int:
        return len(self._classes)


CATALOGUE = Catalogue()
"""Every effect there is."""


def make_effect(
    id: str,
    values: Mapping[str, Any],
    setup: Setup,
    *,
    sensor: str | None = None,
    axis: str | None = None,
    role: str | None = None,
    fit: bool = False,
    seen_in: str | None = None,
    earlier: Sequence[str] = (),
    lasts: bool = True,
    subject: str = "effect",
) -> Effect:
    """An effect from the keys of a file: ``make_effect("acc_K2", {"k2_x_ug_g2": 120}, setup,
    sensor="accel")``.

    Raises:
        TiltcalError: unknown id, sensor, axis or parameter, or a unit that does not fit; with the
            nearest valid key.
    """
    if id == Learned.id:
        return replace(
            make_learned(values, setup, sensor=sensor, axis=axis, role=role, subject=subject),
            seen_in=seen_in,
            earlier=tuple(earlier),
            lasts=lasts,
        )
    if id not in CATALOGUE:
        raise TiltcalError(
            subject,
            found=f"unknown effect '{id}'",
            need="an id of `tiltcal effects`",
            do=nearest(id, list(CATALOGUE)),
        )
    cls = CATALOGUE[id]
    subject = f"{subject} {id}"
    bound = _bound_to(cls, setup, sensor, axis, subject)
    known = {name: p for p in cls.parameters for name in p.expand(bound.axes if bound else ())}
    numbers: dict[str, float] = {}
    sigmas: dict[str, float] = {}
    for key, value in values.items():
        target = sigmas if key.startswith("sigma_") and key not in file_names(known) else numbers
        name, factor = parameter_of(
            key if target is numbers else key[len("sigma_") :], known, subject
        )
        target[name] = number_of(value, f"{subject}, key {key}") * factor
        if target is numbers:
            check_allowed(known[name], numbers[name], value, f"{subject}, key {key}")
    where = bound.name if bound else None
    return cls(numbers, where, axis, role, sigmas, fit, seen_in, tuple(earlier), lasts)


def _bound_to(
    cls: type[Effect], setup: Setup, sensor: str | None, axis: str | None, subject: str
) -> Sensor | None:
    """The sensor that an effect acts on.

    Raises:
        TiltcalError: the rig has no such table, sensor or axis.
    """
    if (cls.stage == "table" or cls.on_table) and not setup.rig.axes:
        raise TiltcalError(
            subject,
            found="a hand-held instrument",
            need="a table for it to act on",
            do="remove the effect",
        )
    bound = _sensor_of(cls, setup, sensor, subject)
    first = None if cls.axis_by_gravity else next(iter(setup.rig.axis_names), None)
    acting = axis or first
    if cls.axis_wise and acting is not None and acting not in cls.axes_on(setup.rig):
        able, slides = cls.axes_on(setup.rig), acting in setup.rig.kind.sliding
        raise TiltcalError(
            subject,
            found=f"axis '{acting}'" + (", which slides" if slides else ""),
            need=f"an axis of this table{' that turns' if slides else ''}: "
            + (", ".join(map(str, able)) or "none"),
            do="correct it",
        )
    if axis is not None and cls.channel_wise and bound is not None:
        one_of(axis, bound.axes, subject, "axis")
    elif axis is not None and not cls.axis_wise:
        raise TiltcalError(
            subject, found="axis", need="no axis: it acts on the whole", do="remove that key"
        )
    return bound


def _sensor_of(cls: type[Effect], setup: Setup, sensor: str | None, subject: str) -> Sensor | None:
    if not cls.kinds:
        if sensor is not None:
            raise TiltcalError(
                subject, found="sensor", need="no sensor: it acts on the rig", do="remove that key"
            )
        return None
    if sensor is not None:
        bound = setup.named(sensor)
        if bound.kind not in cls.kinds:
            raise TiltcalError(
                subject,
                found=f"sensor '{sensor}' of kind {bound.kind}",
                need=" or ".join(sorted(cls.kinds)),
                do="choose another",
            )
        return bound
    fitting = setup.sensors(*cls.kinds)
    if cls.stage == "timing" and fitting:
        return None  # the recorder's own: all sensors alike
    if len(fitting) != 1:
        names = ", ".join(s.name for s in fitting) or "none in this scenario"
        raise TiltcalError(
            subject,
            found=f"no sensor named, {len(fitting)} that fit",
            need=f"sensor = one of {names}",
            do="add it",
        )
    return fitting[0]


def to_file(effect: Effect) -> dict[str, Any]:
    """An effect as the table of a scenario file: the inverse of ``make_effect``."""
    if isinstance(effect, Learned):
        return learned_table(effect)
    table: dict[str, Any] = {"id": effect.id}
    for key in ("sensor", "axis", "role", "seen_in"):
        if getattr(effect, key) is not None:
            table[key] = getattr(effect, key)
    if effect.earlier:
        table["earlier"] = list(effect.earlier)
    if not effect.lasts:
        table["lasts"] = False
    if effect.fit:
        table["fit"] = True
    parameters = by_name(effect.parameters)
    for values, prefix in ((effect.values, ""), (effect.sigmas, "sigma_")):
        for name, value in values.items():
            table[f"{prefix}{name}{parameters[name].suffix}"] = value / parameters[name].factor
    return table
