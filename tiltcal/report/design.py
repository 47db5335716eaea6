"""The report of a design: what it is expected to bring, beside the classic sequences, its poses and
what they cannot show.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.design.plan import Forecast, Plan
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import LOGARITHMIC, Plot, axes, colour, points
from tiltcal.report.poses import Pose, poses_at
from tiltcal.report.scenes import sphere_plot
from tiltcal.setup.setup import Setup


def write_design(
    plan: Plan,
    path: Path,
    title: str,
    poses: Sequence[Pose],
    table: Plot | None,
    missing: Sequence[str],
) -> None:
    """Write the report of a design.

    Args:
        plan: the design.
        path: of the file.
        title: name of its scenario.
        poses: of the plan.
        table: in these poses.
        missing: what no pose of the plan shows or separates, a sentence each.
    """
    write_page(
        path,
        "design",
        title=title,
        lead=lead(plan),
        contents=sections("Expected result", "Poses", "Record next", "Not visible"),
        forecasts=[("this design", plan.forecast), *plan.baselines.items()],
        comparison=_comparison(plan),
        gains=_gains(plan),
        parameters=plan.to_json()["parameters"],
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
        steps=steps_of_plan(plan, poses),
        clock=clock_words(plan),
        missing=missing,
    )


def poses_of_plan(plan: Plan, up: Array, setup: Setup) -> list[Pose]:
    """The poses of a plan. up: in the body frame, (n, 3)."""
    starts = plan.problem.clock.middles(plan.angles, plan.dwell) - plan.dwell / 2
    return poses_at(setup, up, plan.angles, plan.axes, starts, "designed poses")


def lead(plan: Plan) -> str:
    """The result in one sentence."""
    what = plan.forecast
    first = (
        f"{what.poses} poses in {what.total_s:.0f} s are expected to leave a tilt error of"
        f" {what.tilt_arcsec:.3g} arcsec rms per axis"
    )
    if not plan.baselines:
        return f"{first}; no classic sequence fits the same table time."
    name, best = min(plan.baselines.items(), key=lambda item: item[1].tilt_arcsec)
    return f"{first}; the best classic sequence ({name}) leaves {best.tilt_arcsec:.3g} arcsec."


def _comparison(plan: Plan) -> Plot:
    """Tilt error of this design and of the classic sequences."""
    known: list[tuple[str, Forecast]] = [("this design", plan.forecast), *plan.baselines.items()]
    names, tilts = [n for n, _ in known], [f.tilt_arcsec for _, f in known]
    colours = [colour(0)] + [colour(5)] * len(plan.baselines)
    bars: dict[str, Any] = {
        "type": "bar",
        "x": names,
        "y": tilts,
        "name": "expected tilt error",
        "marker": {"color": colours},
        "hovertemplate": "%{x}<br>%{y:.4g} arcsec rms per axis<extra></extra>",
    }
    words = ", ".join(f"{n} {t:.3g}" for n, t in zip(names, tilts, strict=True))
    layout = axes("", "arcsec, rms per axis", showlegend=False)
    layout["xaxis"]["type"] = "category"  # some schemes are called 8, 12, 24
    layout["yaxis"] |= LOGARITHMIC
    return Plot(
        [bars],
        "Expected tilt error with the same table time, arcsec rms per axis.",
        f"Expected tilt error in arcsec: {words}",
        layout,
    )


def _gains(plan: Plan) -> Plot:
    """How far each parameter's uncertainty falls."""
    model, sigma = plan.problem.model, plan.forecast.sigma
    ratio = model.prior / sigma
    hover = "%{x}<br>%{y:.4g} times smaller"
    layout = axes("", "prior sigma / expected sigma", showlegend=False)
    layout["yaxis"] |= LOGARITHMIC
    return Plot(
        [points(list(model.names), ratio, "parameters", 0, hover=hover)],
        "By how much the standard uncertainty of each parameter falls.",
        f"Ratio of prior to expected sigma, from {ratio.min():.3g} to {ratio.max():.3g}",
        layout,
    )


def clock_words(plan: Plan) -> str:
    """What the table allowed, in words."""
    clock = plan.problem.clock
    return (
        f"{clock.budget:g} s of table time, moves at {clock.rate / DEG:g} °/s, {clock.settle:g} s"
        " to settle"
    )


def steps_of_plan(plan: Plan, poses: Sequence[Pose]) -> list[dict[str, str]]:
    """Rows of the list of poses."""
    return [
        {
            "angles": ", ".join(f"{name} {angle:.3f}°" for name, angle in pose.angles.items()),
            "from": f"{pose.start_s:.2f}",
            "read": f"{dwell:.2f}",
            "up": ", ".join(f"{u:+.3f}" for u in pose.up),
        }
        for pose, dwell in zip(poses, plan.dwell, strict=True)
    ]
