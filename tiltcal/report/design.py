"""The reports of designs: a sequence in addition to the classic ones, poses in which every effect
is visible, and a block that separates the alternatives of a diagnosis.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.core.units import DEG
from tiltcal.design.maxmin import REQUIRED, MaxMin
from tiltcal.design.plan import Forecast, Plan
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.investigation.discriminating_blocks import BlockProposal
from tiltcal.diagnosis.investigation.next_block import NextBlock
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import LOGARITHMIC, Plot, axes, colour, line, points
from tiltcal.report.poses import Pose, poses_at
from tiltcal.report.scenes import sphere_plot
from tiltcal.setup.schedule import build_schedule
from tiltcal.setup.setup import Setup

LEGEND = 16  # parameters whose names fit beside a plot; of more, the pointer shows them


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
        course=_course(plan),
        sigmas=_sigmas(plan),
        parameters=plan.to_json()["parameters"],
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
        steps=steps_of_plan(plan, poses),
        clock=clock_text(plan),
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
    text = ", ".join(f"{n} {t:.3g}" for n, t in zip(names, tilts, strict=True))
    layout = axes("", "arcsec, rms per axis", showlegend=False)
    layout["xaxis"]["type"] = "category"  # some schemes are called 8, 12, 24
    layout["yaxis"] |= LOGARITHMIC
    return Plot(
        [bars],
        "Expected tilt error with the same table time, arcsec rms per axis.",
        f"Expected tilt error in arcsec: {text}",
        layout,
    )


def _course(plan: Plan) -> Plot:
    """How the expected tilt error falls as poses are read."""
    course = plan.course
    times, tilts = [f.total_s for f in course], [f.tilt_arcsec for f in course]
    layout = axes("table time, s", "arcsec, rms per axis", showlegend=False)
    layout["yaxis"] |= LOGARITHMIC
    hover = "after %{x:.4g} s<br>%{y:.4g} arcsec rms per axis"
    return Plot(
        [line(times, tilts, "expected tilt error", 0, mode="lines+markers", hover=hover)],
        "Expected tilt error once each pose is read, arcsec rms per axis.",
        f"Expected tilt error from {tilts[0]:.3g} arcsec after one pose to {tilts[-1]:.3g}",
        layout,
    )


def _sigmas(plan: Plan) -> Plot:
    """How the uncertainty of each parameter of interest falls as poses are read."""
    course, model = plan.course, plan.problem.model
    times = [f.total_s for f in course]
    ratios = np.array([f.sigma for f in course]) / model.prior
    wanted = np.flatnonzero(model.interest)
    hover = "%{fullData.name}<br>after %{x:.4g} s<br>%{y:.4g} of the prior sigma"
    layout = axes("table time, s", "expected sigma / prior sigma", showlegend=len(wanted) <= LEGEND)
    layout["yaxis"] |= LOGARITHMIC
    last = ratios[-1, wanted]
    return Plot(
        [line(times, ratios[:, k], model.names[k], n, hover=hover) for n, k in enumerate(wanted)],
        "Expected standard uncertainty of each parameter over its prior, once each pose is read.",
        f"Ratio of expected to prior sigma at the end: from {last.min():.3g} to {last.max():.3g}",
        layout,
    )


def clock_text(plan: Plan) -> str:
    """Budget and rates of the table, as text."""
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
        lead=lead_of_visible_poses(found),
        clock=clock_text(plan),
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


def lead_of_visible_poses(found: MaxMin) -> str:
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
            position,
            hover="%{y}: %{x:.3f} of the best possible",
        )
        for position, way in enumerate(("the poses", "their order"))
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
        "Visibility of each effect in addition to bias, scale and cross-axis terms, as a share of"
        " the most"
        " that any poses could leave.",
        f"Share of each of {len(names)} effects, from {rows[0]['share']:.3f} to"
        f" {rows[-1]['share']:.3f}; bound on the least share {found.bounds[0]:.3f}",
        layout,
        height=140 + ROW * len(names),
    )


INSTANTS = 600  # of the motion that is drawn


def write_separating_block(
    plan: NextBlock,
    path: Path,
    setup: Setup,
    title: str,
    poses: Sequence[Pose] = (),
    table: Plot | None = None,
) -> None:
    """Write the report of a proposed block.

    Args:
        plan: the block, or why there is none.
        path: of the file.
        setup: that was diagnosed.
        title: its name.
        poses: of the block.
        table: in these poses.
    """
    best = plan.proposal
    write_page(
        path,
        "separating_block",
        title=title,
        lead=lead_of_block(plan),
        plan=plan,
        pairs=[] if best is None else best.pairs,
        considered=plan.considered,
        contents=sections(
            "Pairs" if best is not None and best.pairs else "",
            "Block" if best is not None else "",
            "Blocks compared" if plan.considered else "",
            "Record next",
            "Not separable" if plan.twins else "",
        ),
        comparison=None if not plan.considered else _pair_comparison(plan.considered),
        motion=None if best is None else _motion(best.block, setup),
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
    )


def lead_of_block(plan: NextBlock) -> str:
    """The result in one sentence."""
    best = plan.proposal
    if best is None:
        return "No block of this table separates the alternatives."
    what = f"Record '{best.block.name}', {best.minutes:.1f} min of table time"
    if best.least is None:
        return f"{what}: it adds poses of every kind."
    return (
        f"{what}: the verdict then is explained with a probability of {100 * best.chance:.0f} %;"
        f" the hardest pair is {best.least.truth} and {best.least.rival}."
    )


def _pair_comparison(considered: Sequence[BlockProposal]) -> Plot:
    """Probability of the verdict `explained`, over the table time of each block."""
    chosen, others = considered[:1], considered[1:]
    traces = [
        points(
            [p.minutes for p in some],
            [p.chance for p in some],
            name,
            position,
            text=[p.block.name for p in some],
            hover="%{x:.1f} min, probability %{y:.3f}",
        )
        for some, name, position in ((others, "other blocks", 5), (chosen, "proposed block", 0))
        if some
    ]
    layout = axes("table time, min", "probability of explained", showlegend=True)
    layout["yaxis"]["range"] = [-0.03, 1.03]
    return Plot(
        traces,
        "Probability that the verdict is explained once the block is recorded.",
        f"{len(considered)} blocks by table time and probability of the verdict explained;"
        f" the proposed one takes {chosen[0].minutes:.1f} min and has {chosen[0].chance:.3f}",
        layout,
    )


def _motion(block: Block, setup: Setup) -> Plot:
    """The angles of the table over time."""
    schedule = build_schedule(block.steps, setup.rig)
    time = np.linspace(*schedule.times, INSTANTS)
    drive = schedule.drive(time)
    traces = [
        line(time, np.asarray(jet.x) / DEG, name, k, hover="%{x:.1f} s: %{y:.2f}°")
        for k, (name, jet) in enumerate(drive.axes.items())
        if name in setup.rig.kind.turning
    ]
    return Plot(
        traces,
        "Angles of the table axes during the block, remounting left out.",
        f"Angles of {', '.join(drive.axes)} in deg over {time[-1] - time[0]:.0f} s",
        axes("time, s", "angle, °", showlegend=True),
    )
