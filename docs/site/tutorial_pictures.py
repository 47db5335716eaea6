"""Pictures of the tutorials, each drawn from a run of the product."""

import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as parquet
from matplotlib import pyplot as plt

import tiltcal as tc
from tiltcal.core.units import G0
from tiltcal.design.classic import baseline
from tiltcal.design.plan import forecast
from tiltcal.design.scenario_problem import clock_of, scenario_problem, sensor_of
from tiltcal.design.terms import Wanted
from tiltcal.recordings.static_poses import find_poses

ROOT = Path(__file__).parents[2]
SCENARIOS = ROOT / "scenarios"
SIZE = (7.2, 2.8)
UG = G0 * 1e-6


def start() -> Any:
    """Readings over six faces, with the dwells that are found."""
    recording = tc.load_scenario(SCENARIOS / "six_faces_dual.toml").simulate(seed=7)
    _, axes = plt.subplots(figsize=SIZE, layout="constrained")
    for axis in "xyz":
        axes.plot(recording.time, recording.column(f"accel_{axis}_m_s2"), label=axis)
    for segment in tc.find_segments(recording):
        if segment.kind == "dwell":
            axes.axvspan(segment.start, segment.end, alpha=0.15, color="grey", linewidth=0)
    return _named(axes, "time, s", "reading, m/s2 (dwells are grey)")


def tilt() -> Any:
    """The two positions of a reversal: half the sum is the bias."""
    scenario = tc.load_scenario(SCENARIOS / "two_position_level.toml")
    recording = scenario.simulate()
    dwells = [s for s in tc.find_segments(recording) if s.kind == "dwell"]
    _, axes = plt.subplots(figsize=SIZE, layout="constrained")
    for axis in "xy":
        reading = recording.column(f"incl_{axis}_deg") * 3600
        line = axes.plot(recording.time, reading, linewidth=0.8, label=axis)[0]
        means = [
            reading[(recording.time >= d.start) & (recording.time <= d.end)].mean() for d in dwells
        ]
        middle, colour = sum(means) / 2, line.get_color()
        axes.axhline(middle, linestyle="--", color=colour, label=f"half the sum of {axis}")
    return _named(axes, "time, s", "reading, arcsec")


def positions() -> Any:
    """The expected tilt error of classic sequences over the table time."""
    scenario = tc.load_scenario(SCENARIOS / "six_faces_dual.toml")
    budgets = np.geomspace(150, 1200, 10)
    wanted = Wanted(("bias", "scale"), ("drift",), "mid_mems", None, 20 * UG, np.pi)
    _, axes = plt.subplots(figsize=SIZE, layout="constrained")
    for name in ("six", "8", "12", "24"):
        errors = []
        for budget in budgets:
            clock = clock_of(scenario, budget, 20.0, 5.0, (5.0, 60.0), None, 0.0)
            problem, _ = scenario_problem(
                scenario, sensor_of(scenario, None), wanted, clock, "both"
            )
            draft = baseline(problem, name)
            errors.append(
                forecast(problem, draft.angles, problem.dwells(draft.angles, draft.z)).tilt_arcsec
            )
        axes.loglog(budgets, errors, "o-", markersize=3, label=f"{name} positions")
    return _named(axes, "table time, s", "expected tilt error, arcsec")


def good() -> Any:
    """The tilt error at the poses of another recording, before and after."""
    scenario = tc.load_scenario(SCENARIOS / "six_faces_dual.toml")
    calibration = scenario.calibrate(scenario.simulate(), "six_position")
    other = tc.correct(calibration, scenario.simulate(seed=12))
    figure, panels = plt.subplots(1, 2, figsize=SIZE, layout="constrained")
    for axes, title, end in zip(
        panels, ("before", "after"), ("m_s2", "corrected_m_s2"), strict=True
    ):
        error = _residuals(scenario, other, end)
        for k, axis in enumerate("xyz"):
            axes.plot(range(1, len(error) + 1), error[:, k], "o", label=axis)
        axes.set_title(title)
        _named(axes, "position", "residual, ug")
    return figure


def differ() -> Any:
    """Residuals of x on the tutorial's two days, with one bias for both and with a step between."""
    files = _files("tutorial_differ.md")
    bench = tc.parse_scenario(tomllib.loads(files["bench.toml"]))
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        days = _days(files["differ.py"], folder)
    residuals = [_residuals(bench, recording, "m_s2")[:, 0] for recording in days]
    both = np.concatenate(residuals)
    _, axes = plt.subplots(figsize=SIZE, layout="constrained")
    place = np.arange(1, len(both) + 1)
    stepped = np.concatenate([r - r.mean() for r in residuals])
    axes.plot(place, both - both.mean(), "o", label="one bias for both days")
    axes.plot(place, stepped, "s", markerfacecolor="none", label="a step between the days")
    axes.axvline(len(residuals[0]) + 0.5, color="grey", linewidth=0.8)
    return _named(axes, "dwell, Monday and Tuesday", "residual of x, ug")


def algorithm() -> Any:
    """How the method of the tutorial degrades with an effect that it does not model."""
    files = _files("tutorial_algorithm.md")
    files["claim.toml"] = files["claim.toml"].partition("[[method]]\ncommand")[0]
    field = "acc_K2.k2_x_ug_g2"
    words = ("sweep", "claim.toml", "--effect", f"{field}=0:160:5", "--seeds", "8")
    rows = _rows(files, words)
    _, axes = plt.subplots(figsize=SIZE, layout="constrained")
    _curve(axes, rows, field, "mine:opposite_faces")
    return _named(axes, "K2 of x, ug/g2", "rms tilt error, arcsec")


def campaign() -> Any:
    """The tilt error over dwell and noise, by the tutorial's campaign with more levels."""
    files = _files("tutorial_campaign.md")
    grid = (
        files["grid.toml"].replace("[20, 100]", "[20, 50, 100]").replace("[2, 8]", "[2, 4, 8, 16]")
    )
    files["grid.toml"] = grid.replace("runs = 3", "runs = 4")
    rows = _rows(files, ("campaign", "grid.toml"))
    _, axes = plt.subplots(figsize=SIZE, layout="constrained")
    noise = "acc_noise.white_ug_rthz"
    for size in np.unique(rows[noise]):
        own = {name: values[rows[noise] == size] for name, values in rows.items()}
        _curve(axes, own, "sequence.1.dwell_s", f"noise {size:g} ug/rtHz")
    axes.set_xscale("log")
    axes.set_yscale("log")
    return _named(axes, "dwell, s", "rms tilt error, arcsec")


def _files(page: str) -> dict[str, str]:
    """The blocks of a page that are files, by name."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return dict(re.findall(r"^```\w+ (\S+)\n(.*?)^```$", text, re.M | re.S))


def _days(program: str, folder: str) -> tuple[Any, Any]:
    """The two recordings that the tutorial's program makes."""
    beginning = program.partition("# %% does")[0].replace('"bench.toml"', f'"{folder}/bench.toml"')
    names: dict[str, Any] = {}
    exec(compile(beginning, "tutorial_differ.md", "exec"), names)
    return names["monday"], names["tuesday"]


def _rows(files: dict[str, str], words: tuple[str, ...]) -> dict[str, Any]:
    """Columns of the runs that a command makes of these files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        out = "out.parquet" if words[0] == "sweep" else "out"
        program = [sys.executable, "-m", "tiltcal", *words, "-o", out, "-j", "2"]
        subprocess.run(program, cwd=folder, check=True, capture_output=True)
        table = parquet.read_table(
            folder / out if words[0] == "sweep" else folder / "out/results.parquet"
        )
    return {name: np.array(table[name]) for name in table.column_names}


def _curve(axes: Any, rows: dict[str, Any], field: str, label: str) -> None:
    """The rms tilt error over a field, with the standard uncertainty of the rms."""
    squares = rows["tilt_after_arcsec"].astype(float) ** 2
    values = np.unique(rows[field])
    groups = [squares[rows[field] == value] for value in values]
    rms = np.array([np.sqrt(group.mean()) for group in groups])
    sigma = [g.std(ddof=1) / np.sqrt(len(g)) / 2 / r for g, r in zip(groups, rms, strict=True)]
    axes.errorbar(values, rms, yerr=sigma, marker="o", markersize=4, capsize=3, label=label)


def _residuals(scenario: tc.Scenario, recording: tc.Recording, end: str) -> Any:
    """Mean reading less the nominal one of each dwell, ug, (dwells, 3).

    Args:
        end: of the names of the columns, after ``accel_x_``.
    """
    poses = find_poses(recording, scenario, scenario.named("accel"))
    readings = np.column_stack([recording.column(f"accel_{a}_{end}") for a in "xyz"])
    inside = [(recording.time >= s.start_s) & (recording.time <= s.end_s) for s in poses.spans]
    means = np.array([np.nanmean(readings[rows], axis=0) for rows in inside])
    return (means - scenario.site.gravity_m_s2 * poses.up) / UG


def _named(axes: Any, x: str, y: str) -> Any:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3, linewidth=0.5)
    axes.legend(fontsize=8, frameon=False)
    return axes.figure


PICTURES: dict[str, Callable[[], Any]] = {
    f"{draw.__name__}.svg": draw
    for draw in (start, tilt, positions, good, algorithm, differ, campaign)
}
