"""Names of calibration terms, ``<sensor>.<term>``, and the effects that have them."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import PARAMETER_UNITS
from tiltcal.effects import CATALOGUE
from tiltcal.effects.base import Effect, TermEffect
from tiltcal.effects.parameter import by_name
from tiltcal.effects.table.geometry import TableLevelling
from tiltcal.instrument.model import InstrumentModel, ModelParameter
from tiltcal.instrument.temperature import TemperatureTerms
from tiltcal.setup.sensor import Sensor

SHARED = "temperature"  # owner of what all terms over temperature follow
BASE = {"base.roll": "tilt_east", "base.pitch": "tilt_north"}
"""Parameters of the set-up: those of ``table_levelling``."""
Key = tuple[type[Effect], str | None]
"""An effect, and the sensor it acts on."""


def term_name(parameter: str) -> str:
    """Name of a term as CAL.json has it, from that of the effect's parameter: ``k2_x`` is
    ``K2_x``.
    """
    return parameter[0].upper() + parameter[1:] if parameter[:1] == "k" else parameter


@lru_cache(maxsize=64)
def terms_of(kind: str, axes: tuple[str, ...]) -> Mapping[str, tuple[type[TermEffect], str]]:
    """Every term of a sensor: its effect, and the parameter's name there.

    Args:
        kind: of the sensor.
        axes: of the sensor.
    """
    found: dict[str, tuple[type[TermEffect], str]] = {}
    effects: tuple[type[Effect], ...] = (TemperatureTerms, *CATALOGUE.values())
    for cls in effects:
        if issubclass(cls, TermEffect) and kind in cls.kinds:
            for parameter in cls.parameters:
                if not parameter.is_shape:
                    for name in parameter.expand(axes):
                        found.setdefault(term_name(name), (cls, name))
    return found


def si_factor(unit: str) -> float | None:
    """SI value of one unit of a parameter, per whatever power of degC; None of an unknown unit."""
    stem, _, _ = unit.partition("_degC")
    if stem in ("1", ""):
        return 1.0
    return PARAMETER_UNITS[stem].factor if stem in PARAMETER_UNITS else None


def model_of(
    sensors: Sequence[Sensor],
    gravity: float,
    values: Mapping[str, tuple[float, str]],
    covariance: Array,
    others: Sequence[Effect] = (),
) -> InstrumentModel:
    """The model of an instrument by the names of its terms.

    Args:
        sensors: that the names may belong to; others, terms that no effect has, and unknown units
            are left out.
        gravity: m/s2.
        values: of each parameter, with its unit.
        covariance: in the order and the units of the values, (p, p).
        others: effects in addition, such as placing-angle tables.
    """
    known_sensors = {s.name: s for s in sensors}
    shapes = {n: v for n, (v, _) in values.items() if n.startswith(f"{SHARED}.")}
    groups: dict[Key, dict[str, float]] = {}
    keys: list[tuple[str, Key, str, float]] = []
    for name, (value, unit) in values.items():
        owner, _, term = name.partition(".")
        factor = si_factor(unit)
        if factor is None:
            continue
        if name in BASE:
            key: Key = (TableLevelling, None)
            parameter = BASE[name]
        elif owner in known_sensors and term in (
            terms := terms_of(known_sensors[owner].kind, known_sensors[owner].axes)
        ):
            effect, parameter = terms[term]
            key = (effect, owner)
        else:
            continue
        groups.setdefault(key, {})[parameter] = value * factor
        keys.append((name, key, parameter, factor))
    order = list(groups)
    memory = {n.partition(".")[2]: v for n, v in shapes.items()}
    known_shapes = {p.name for p in TemperatureTerms.parameters if p.is_shape}
    effects = []
    for cls, owner_name in order:
        added = memory if cls is TemperatureTerms else {}
        shape = {n: v for n, v in added.items() if n in known_shapes}
        effects.append(cls({**groups[cls, owner_name], **shape}, owner_name, role="calibration"))
    names = list(values)
    rows = [names.index(name) for name, *_ in keys]
    factors = np.array([factor for *_, factor in keys])
    return InstrumentModel(
        tuple(sensors),
        gravity,
        (*effects, *others),
        tuple(ModelParameter(name, order.index(key), p) for name, key, p, _ in keys),
        np.asarray(covariance)[np.ix_(rows, rows)] * np.outer(factors, factors),
        memory.get("T0"),
    )


def terms_table(model: InstrumentModel) -> list[dict[str, Any]]:
    """The parameters of a model as CAL.json states them: effects of the catalogue, each with its
    parameters as a scenario's file names them.
    """
    sigmas = np.sqrt(np.maximum(np.diag(model.covariance), 0.0)).tolist()
    found: dict[int, dict[str, Any]] = {}
    for parameter, sigma in zip(model.parameters, sigmas, strict=True):
        effect = model.effects[parameter.effect]
        stated = by_name(effect.parameters)[parameter.key]
        own: dict[str, Any] = {"effect": effect.id}
        if effect.sensor is not None:
            own["sensor"] = effect.sensor
        table = found.setdefault(parameter.effect, own | {"parameters": {}})
        table["parameters"][f"{parameter.key}{stated.suffix}"] = {
            "value": effect.value(parameter.key) / stated.factor,
            "sigma": sigma / stated.factor,
        }
    return list(found.values())
