"""Build the documentation: the API reference by pdoc, and the catalogue of effects with a picture
of each residual.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import tiltcal
from tiltcal.design.identifiability import reference_scenario
from tiltcal.effects import CATALOGUE, make_effect
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import Scenario

HERE = Path(__file__).parent
OUT = HERE / "api"
SEED = 1


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
    laboratory = SimulatedLaboratory()
    bare = scenario.model_copy(update={"effect": (), "grade": None, "seed": SEED})
    with_, without = (_with(bare, [*vibration, *white, *e]) for e in ([effect], []))
    one, other = laboratory.record(with_, SEED), laboratory.record(without, SEED)
    names = [n for n in one.column_names if not n.startswith("temperature")]
    changes = {n: one.column(n) - other.column(n) for n in names} | {
        "time_s": one.time - other.time
    }
    shown = {n: c for n, c in changes.items() if np.isnan(c).any() or np.nanmax(np.abs(c)) > 1e-13}
    return Residual(other.time, shown)


def _with(scenario: Scenario, effects: list) -> Scenario:
    copy = scenario.model_copy()
    copy.__dict__["effects"] = tuple(effects)
    return copy


def picture(id: str, path: Path) -> None:
    """Draw an effect's residual against time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    residual = residual_of(id)
    figure, axes = plt.subplots(figsize=(7.2, 2.4), layout="constrained")
    for name, values in list(residual.channels.items())[:7]:
        axes.plot(residual.time, values, linewidth=0.8, label=name)
    axes.set_xlabel("time, s")
    axes.set_ylabel("change of the reading")
    axes.legend(fontsize=7, loc="upper right", frameon=False)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def catalogue_page() -> str:
    """The catalogue as Markdown, one section an effect."""
    lines = ["# Catalogue of effects", ""]
    for id, cls in CATALOGUE.items():
        lines += [
            f"## {id}",
            "",
            f"*{cls.stage}*: {cls.title}. {cls.physics}",
            "",
            f"`{cls.equation}`",
            "",
        ]
        lines += [f"Excited by {cls.excited_by}. Look: {cls.look}. Source: {cls.source}.", ""]
        lines += [f"![residual of {id}](residuals/{id}.png)", ""]
        lines += ["| parameter | precision laboratory | mid MEMS | consumer |", "|---|---|---|---|"]
        for p in cls.parameters:
            lines.append(f"| `{p.name}{p.suffix}` | {' | '.join(f'{x:g}' for x in p.plausible)} |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    """Write docs/api."""
    import pdoc

    for name in tiltcal.__all__:
        getattr(tiltcal, name)  # loaded when asked for: pdoc shows what is there
    tiltcal.__all__ += [room.name for room in pkgutil.iter_modules(tiltcal.__path__) if room.ispkg]
    importlib.import_module("tiltsim.laboratory")  # before pdoc forbids what importing MuJoCo runs
    (OUT / "residuals").mkdir(parents=True, exist_ok=True)
    (OUT / "catalogue.md").write_text(catalogue_page(), encoding="utf-8")
    for k, id in enumerate(CATALOGUE, start=1):
        picture(id, OUT / "residuals" / f"{id}.png")
        print(f"\r{k} of {len(CATALOGUE)} pictures", end="", flush=True)
    print()
    pdoc.render.configure(docformat="google")
    pdoc.pdoc("tiltcal", "tiltsim", output_directory=OUT)
    print(
        f"documentation: {OUT / 'index.html'} and {OUT / 'catalogue.md'}; the guide is"
        f" {HERE / 'guide.md'}"
    )


if __name__ == "__main__":
    main()
