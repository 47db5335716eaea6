"""The catalogue of effects: a page for each stage, with a picture of each residual."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from markdown.extensions.toc import slugify

from tiltcal.design.identifiability import reference_scenario
from tiltcal.effects import CATALOGUE, Effect, make_effect
from tiltcal.effects.base import FrameEffect
from tiltcal.effects.loads import LoadEffect
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario

SEED = 1
CHAPTER = "Physics: "
SHOWN = 7  # channels of a picture, at most


@dataclass(frozen=True)
class Residual:
    """What an effect changes in a recording.

    Args:
        time: s, (n,).
        channels: column name -> change, in its unit, (n,).
    """

    time: np.ndarray
    channels: Mapping[str, np.ndarray]


scenario_of = cache(reference_scenario)


def residual_of(id: str) -> Residual:
    """Difference of two recordings, with the effect alone and without, at the size of its
    scenario.
    """
    scenario = scenario_of(id)
    table = next(t for t in scenario.effect if t.id == id)
    values = dict(table.model_extra or {})
    if id == "data_unit":
        values["factor_unitless"] = 9.80665
    if id == "fog_fringe":
        values["max_rate_deg_s"] = 30.0
    if id in ("acc_saturation", "gyr_saturation"):
        values = {k: v * 0.2 for k, v in values.items()}
    effect = make_effect(id, values, scenario, sensor=table.sensor, axis=table.axis)
    vibration = (
        [e for e in scenario_of("base_vibration").effects if e.id == "base_vibration"]
        if id.endswith("vre")
        else []
    )
    on_noise = id in ("data_outlier", "emi_spike", "data_stuck", "data_duplicate")
    white = [e for e in scenario.effects if e.id.endswith("_noise")] if on_noise else []
    bends = [e for e in scenario.effects if isinstance(effect, LoadEffect) and _bends(e, scenario)]
    laboratory = SimulatedLaboratory()
    bare = scenario.model_copy(update={"effect": (), "grade": None, "seed": SEED})
    with_, without = (_with(bare, [*vibration, *bends, *white, *e]) for e in ([effect], []))
    one, other = laboratory.record(with_, SEED), laboratory.record(without, SEED)
    names = [n for n in one.column_names if not n.startswith("temperature")]
    changes = {n: one.column(n) - other.column(n) for n in names} | {
        "time_s": one.time - other.time
    }
    shown = {n: c for n, c in changes.items() if np.isnan(c).any() or np.nanmax(np.abs(c)) > 1e-13}
    return Residual(other.time, shown)


def _bends(effect: Effect, scenario: Scenario) -> bool:
    """Whether an effect shows what the links carry."""
    return isinstance(effect, FrameEffect) and bool(effect.compliances(scenario.rig))


def _with(scenario: Scenario, effects: list) -> Scenario:
    copy = scenario.model_copy()
    copy.__dict__["effects"] = tuple(effects)
    return copy


def picture(id: str) -> Any:
    """An effect's residual against time, as a figure."""
    from matplotlib import pyplot as plt

    residual = residual_of(id)
    figure, axes = plt.subplots(figsize=(7.2, 2.4), layout="constrained")
    for name, values in list(residual.channels.items())[:SHOWN]:
        axes.plot(residual.time, values, linewidth=0.8, label=name)
    axes.set_xlabel("time, s")
    axes.set_ylabel("change of the reading")
    axes.legend(fontsize=7, loc="upper right", frameon=False)
    return figure


def pictures() -> dict[str, Callable[[], Any]]:
    """What draws each picture, by the name of its file."""
    return {f"{id}.png": partial(picture, id) for id in CATALOGUE}


@cache
def pages() -> tuple[tuple[str, str], ...]:
    """(file, text) of a page for each stage."""
    stages = dict.fromkeys(cls.stage for cls in CATALOGUE.values())
    return tuple((f"effects_{stage}.md", "\n".join(_page(stage))) for stage in stages)


def _page(stage: str) -> Iterator[str]:
    yield f"# Effects: {stage}\n"
    yield (
        "After this page you know each effect of this stage: its equation, what excites it,"
        " how large it may be. The pictures show what each one changes in a recording of its own"
        " scenario.\n"
    )
    for id, cls in CATALOGUE.items():
        if cls.stage == stage:
            yield from _section(id, cls)


def linked(source: str) -> str:
    """An effect's source with its chapter of the physics page as a link."""
    text, found, chapter = source.rpartition(CHAPTER)
    return f"{text}[{found}{chapter}](physics.md#{slugify(chapter, '-')})" if found else source


def _section(id: str, cls: type[Effect]) -> Iterator[str]:
    yield f"## {id}\n\n{cls.title}. {cls.physics}\n\n`{cls.equation}`\n"
    yield f"Excited by {cls.excited_by}. Look: {cls.look}. Source: {linked(cls.source)}.\n"
    yield f"![residual of {id}](pictures/{id}.png){{ loading=lazy }}\n"
    yield "| largest plausible size | precision laboratory | mid MEMS | consumer |"
    yield "|---|---|---|---|"
    for p in cls.parameters:
        yield f"| `{p.name}{p.suffix}` | {' | '.join(f'{x:g}' for x in p.plausible)} |"
    yield ""
