"""The scenario file: set-up, effects, sequence, methods and limits. All errors at once, each with
its path.
"""

import tomllib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, field_validator

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import require_document
from tiltcal.effects import CATALOGUE, Effect, make_effect
from tiltcal.laboratory.own_model import ModelReference, with_links
from tiltcal.laboratory.random_instrument import draw_instrument
from tiltcal.laboratory.scenario_tables import (
    Dynamics,
    EffectTable,
    EstimatorTable,
    MethodTable,
)
from tiltcal.setup.part import StrictTable
from tiltcal.setup.reach import Ends
from tiltcal.setup.schedule import Schedule, build_schedule
from tiltcal.setup.sequence import Climate, Step
from tiltcal.setup.setup import Setup

HERE = Path()
CALIBRATION_TERMS = ("bias", "scale", "cross_axis")


class Scenario(Setup):
    """A whole scenario."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    """Version of the file's keys."""
    name: str = "scenario"
    """Title, as reports show it."""
    role: Literal["concealed"] | None = None
    """"concealed": the file holds the truth of a blind trial, and `diagnose` refuses it."""
    about: str = ""
    """What the scenario is for, in a sentence or two."""
    seed: int = 0
    """Seed of all random effects; a run adds its number to it."""
    grade: Literal["precision", "mid_mems", "consumer"] | None = None
    """Draw an effect of plausible size, of every ordinary kind that no `[[effect]]` names."""
    grade_seed: int = 0
    """Seed of the instrument that `grade` draws."""
    climate: Climate = Climate()
    """Temperature against time."""
    effect: tuple[EffectTable, ...] = ()
    """Known physics, injected by `simulate` and part of the model elsewhere."""
    sequence: tuple[Step, ...] = ()
    """What the table does, step by step."""
    dynamics: Dynamics | None = None
    """Run by time steps instead of prescribed motion."""
    method: tuple[MethodTable, ...] = ()
    """Calibration methods that `run` and `verify` judge."""
    estimator: tuple[EstimatorTable, ...] = ()
    """Estimators, fed sample by sample, that `run` and `verify` judge."""

    @field_validator("sensor")
    @classmethod
    def _distinct(cls, sensors: tuple[Any, ...]) -> tuple[Any, ...]:
        names = [s.name for s in sensors]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two sensors are named '{name}'")
        for s in sensors:
            for term in s.adjustable:
                if term not in CALIBRATION_TERMS and term not in CATALOGUE:
                    hint = nearest(term, [*CALIBRATION_TERMS, *CATALOGUE])
                    raise ValueError(
                        f"sensor {s.name}: adjustable '{term}' is neither a calibration term nor an"
                        f" effect; {hint}"
                    )
        return sensors

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that are named, and with a grade those of a plausible instrument for which
        none is named.

        Raises:
            TiltcalError: one of them is wrong.
        """
        named = tuple(
            make_effect(
                t.id,
                t.model_extra or {},
                self,
                sensor=t.sensor,
                axis=t.axis,
                role=t.role,
                fit=t.fit,
                seen_in=t.seen_in,
                earlier=t.earlier,
                lasts=t.lasts,
                subject=f"effect {k}",
            )
            for k, t in enumerate(self.effect, start=1)
        )
        drawn = [] if self.grade is None else draw_instrument(self, self.grade, self.grade_seed)
        return named + tuple(
            e for e in drawn if all((e.id, e.sensor) != (n.id, n.sensor) for n in named)
        )

    @cached_property
    def schedule(self) -> Schedule:
        """The sequence as angles against time.

        Raises:
            TiltcalError: there is none, or a step does not fit the table.
        """
        return build_schedule(self.sequence, self.rig, self.climate)


Kind = TypeVar("Kind", bound=Scenario)


def load_scenario(path: Path | str) -> Scenario:
    """Read a scenario file.

    Raises:
        TiltcalError: naming every wrong key, with the nearest valid one, in one message.
    """
    return load_as(Scenario, path)


def parse_scenario(
    table: dict[str, Any], source: str = "scenario", folder: Path = HERE
) -> Scenario:
    """A scenario from a table, with all errors at once.

    Args:
        table: as its file would hold it.
        source: what it is called in messages.
        folder: in which, or below, the model lies that ``[rig] mjcf`` names.

    Raises:
        TiltcalError: naming every wrong key.
    """
    return parse_as(Scenario, table, source, folder)


def load_as(kind: type[Kind], path: Path | str) -> Kind:
    """``load_scenario`` for a subclass of Scenario.

    Raises:
        TiltcalError: as ``parse_as`` does, or the file is no text.
    """
    path = require_document(Path(path), "scenario")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise TiltcalError(
            f"scenario {path.name}",
            found="bytes that are no text",
            need="TOML in UTF-8",
            do="check the file",
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise TiltcalError(
            f"scenario {path.name}", found=str(error), need="valid TOML", do="correct that line"
        ) from error
    return parse_as(kind, table, path.name, path.parent)


def _with_links(table: dict[str, Any], source: str, folder: Path) -> dict[str, Any]:
    """A scenario's table with the links of its own model, where it names one.

    Raises:
        TiltcalError: the keys of the model are wrong, or it cannot be read.
    """
    rig = table.get("rig")
    if not isinstance(rig, dict) or "mjcf" not in rig:
        return table
    known = ModelReference.keys()
    try:
        model = ModelReference.model_validate({k: v for k, v in rig.items() if k in known})
    except ValidationError as error:
        raise TiltcalError(
            f"scenario {source}, rig",
            found="; ".join(_problem(e) for e in error.errors()),
            need="mjcf, axes and site",
            do="see the guide's page on own models",
        ) from error
    return with_links(table, model, folder)


def parse_as(kind: type[Kind], table: dict[str, Any], source: str, folder: Path = HERE) -> Kind:
    """``parse_scenario`` for a subclass of Scenario.

    Raises:
        TiltcalError: as ``parse_scenario`` does.
    """
    table = _with_links(table, source, folder)
    problems: list[str] = []
    scenario = None
    try:
        scenario = kind.model_validate(table)
    except ValidationError as error:
        problems = [_problem(e) for e in error.errors()]
    if scenario is not None:
        problems += _problems_of_links(scenario)
        for k, t in enumerate(scenario.effect, start=1):
            try:
                make_effect(
                    t.id,
                    t.model_extra or {},
                    scenario,
                    sensor=t.sensor,
                    axis=t.axis,
                    subject=f"effect {k}",
                )
            except TiltcalError as error:
                problems.append(str(error))
        if scenario.sequence:
            try:
                build_schedule(scenario.sequence, scenario.rig)
            except TiltcalError as error:
                problems.append(str(error))
    if scenario is None or problems:
        count = "1 error" if len(problems) == 1 else f"{len(problems)} errors"
        raise TiltcalError(
            f"scenario {source}",
            found=count + ":\n  " + "\n  ".join(problems) + "\n",
            need="a valid scenario",
            do="see `tiltcal init` for a commented one",
        )
    return scenario


def _problems_of_links(scenario: Scenario) -> list[str]:
    """What needs links of a model that are not there, or say too little."""
    unmoved = [k.axis for k in scenario.rig.link if not k.servo_N_m_rad]
    found = [
        f"dynamics: link '{axis}' has no servo; state its servo_N_m_rad"
        for axis in (unmoved if scenario.dynamics is not None else ())
    ]
    for k, t in enumerate(scenario.effect, start=1):
        of_model = t.id in CATALOGUE and CATALOGUE[t.id].of_model
        if of_model and scenario.rig.kind.chain is None:
            found.append(f"effect {k} {t.id}: needs the links of a model; state it as [rig] mjcf")
    return found


def _problem(error: Any) -> str:
    """Message of one pydantic error, with its path and the nearest valid key."""
    path = ".".join(str(part + 1) if isinstance(part, int) else str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return (
            f"{path}: unknown key; {nearest(str(error['loc'][-1]), _fields_at(error['loc'][:-1]))}"
        )
    if error["type"] == "missing":
        return f"{path}: missing; add it"
    found = error.get("input")
    shown = f"found {found!r}; " if isinstance(found, str | int | float | bool) else ""
    return f"{path}: {shown}{error['msg'].removeprefix('Value error, ')}"


def _fields_at(location: tuple[Any, ...]) -> list[str]:
    """Valid keys of the part of a scenario at a path."""
    model: Any = Scenario
    for part in location:
        if isinstance(part, int):
            continue
        annotation = (
            model.model_fields[part].annotation
            if part in getattr(model, "model_fields", {})
            else None
        )
        models = [
            a for a in _arguments(annotation) if isinstance(a, type) and issubclass(a, BaseModel)
        ]
        if not models:
            return []
        model = models[0]
    return model.keys() if issubclass(model, StrictTable) else list(model.model_fields)


def _arguments(annotation: Any) -> list[Any]:
    from typing import get_args

    inner = get_args(annotation)
    return [annotation, *(a for part in inner for a in _arguments(part))] if inner else [annotation]


def fresh(scenario: Scenario, **changes: Any) -> Scenario:
    """A copy with some fields changed, without cached values."""
    copy = scenario.model_copy(update=changes)
    for name in ("effects", "schedule"):
        copy.__dict__.pop(name, None)
    return copy


def narrowed(
    scenario: Scenario, limits: Mapping[str, Ends], start: Mapping[str, float] | None = None
) -> Scenario:
    """The scenario whose rig keeps to further limits, or starts elsewhere.

    Args:
        scenario: with the rig.
        limits: lowest and highest readout by axis, deg or mm.
        start: readout before the first move by axis, deg or mm.

    Raises:
        TiltcalError: there is no such axis, or a joint or a limit rules them out.
    """
    return fresh(scenario, rig=scenario.rig.narrowed(limits, start or {}))


def scenario_schema() -> dict[str, Any]:
    """JSON Schema of a scenario file, for editors."""
    return Scenario.model_json_schema(by_alias=True)
