"""The report of poses in which every effect is visible: the share of each effect, the bounds on the
least one, the poses, and what no dwell shows.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tiltcal.design.maxmin import REQUIRED, MaxMin
from tiltcal.design.plan import Plan
from tiltcal.report.design import clock_words, steps_of_plan
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import Plot, axes, line, points
from tiltcal.report.poses import Pose
from tiltcal.report.scenes import sphere_plot

ROW = 18  # px of an effect


def write_visible_poses(
    found: MaxMin,
    plan: Plan,
    path: Path,
    title: str,
    poses: Sequence[Pose],
    table: Plot | None,
    unseen: Mapping[str, Sequence[str]],
) -> None:
    """Write the report of poses in which every effect is visible.

    Args:
        found: the poses and the share of each effect.
        plan: the same poses with their times.
        path: of the file.
        title: name of the scenario.
        poses: of the plan.
        table: in these poses.
        unseen: effects that no dwell shows, by what excites them.
    """
    write_page(
        path,
        "visible_poses",
        title=title,
        lead=lead(found),
        clock=clock_words(plan),
        contents=sections("Visibility", "Poses", "Record next", "Not visible"),
        shares=_shares(found),
        visibility=_visibility(found),
        efficiency=100 * found.efficiency,
        bounds=found.bounds,
        required=100 * REQUIRED,
        gap=100 * found.reference_gap,
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
        steps=steps_of_plan(plan, poses),
        absorbed=found.seen.ordinary,
        unseen=unseen,
    )


def lead(found: MaxMin) -> str:
    """The result in one sentence."""
    least = int(found.shares.argmin())
    return (
        f"{len(found.angles)} poses leave at least {found.shares[least]:.3f} of the best possible"
        f" visibility of every effect that poses show; {found.seen.names[least]} is the least"
        f" visible, and no design exceeds {found.bounds[0]:.3f}."
    )


def _shares(found: MaxMin) -> list[dict[str, Any]]:
    """Rows: effect, share, what shows it; the least visible first."""
    by_poses = zip(found.seen.names, map(float, found.shares), strict=True)
    rows = [
        *({"effect": n, "share": s, "shown_by": "the poses"} for n, s in by_poses),
        *({"effect": n, "share": s, "shown_by": "their order"} for n, s in found.in_order.items()),
    ]
    return sorted(rows, key=lambda row: float(str(row["share"])))


def _visibility(found: MaxMin) -> Plot:
    """Share of each effect, with the bounds on the least share."""
    rows = _shares(found)
    names = [row["effect"] for row in rows]
    traces = [
        points(
            [row["share"] for row in rows if row["shown_by"] == way],
            [row["effect"] for row in rows if row["shown_by"] == way],
            f"shown by {way}",
            place,
            hover="%{y}: %{x:.3f} of the best possible",
        )
        for place, way in enumerate(("the poses", "their order"))
    ]
    hover = "no design has a larger least share: %{x:.3f}"
    bound = [found.bounds[0]] * len(names)
    traces.append(line(bound, names, "bound on the least share", 5, hover=hover))
    layout = axes("share of the best possible", "", showlegend=True)
    order = {"categoryorder": "array", "categoryarray": names[::-1], "dtick": 1}
    layout["yaxis"] |= {"type": "category", "automargin": True} | order
    layout["xaxis"]["range"] = [0, 1.05]
    return Plot(
        [trace for trace in traces if len(trace["x"])],
        "Visibility of each effect beside bias, scale and cross-axis terms, as a share of the most"
        " that any poses could leave.",
        f"Share of each of {len(names)} effects, from {rows[0]['share']:.3f} to"
        f" {rows[-1]['share']:.3f}; bound on the least share {found.bounds[0]:.3f}",
        layout,
        height=140 + ROW * len(names),
    )
