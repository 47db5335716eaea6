"""The report of a block that separates the alternatives of a diagnosis: what to record, how surely
it separates each pair, and the blocks that were compared.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tiltcal.core.units import DEG
from tiltcal.design.recording_blocks import Block
from tiltcal.diagnosis.investigation.discriminating_blocks import ENOUGH, Proposal
from tiltcal.diagnosis.investigation.next_block import NextBlock
from tiltcal.report.page import sections, write_page
from tiltcal.report.plots import Plot, axes, line, points
from tiltcal.report.poses import Pose
from tiltcal.report.scenes import sphere_plot
from tiltcal.setup.schedule_builder import build_schedule
from tiltcal.setup.setup import Setup

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
        lead=lead(plan),
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
        comparison=None if not plan.considered else _comparison(plan.considered),
        motion=None if best is None else _motion(best.block, setup),
        scenes=[p for p in (sphere_plot(poses), table) if p is not None],
    )


def lead(plan: NextBlock) -> str:
    """The result in one sentence."""
    best = plan.proposal
    if best is None:
        return "No block of this table separates the alternatives."
    what = f"Record '{best.block.name}', {best.minutes:.1f} min of table time"
    if best.least is None:
        return f"{what}: it adds poses of every kind."
    return (
        f"{what}: it separates {best.least.truth} from {best.least.rival}, the hardest pair, with"
        f" a probability of {100 * best.chance:.0f} %."
    )


def _comparison(considered: Sequence[Proposal]) -> Plot:
    """Probability of separating the hardest pair, over the table time of each block."""
    chosen, others = considered[:1], considered[1:]
    traces = [
        points(
            [p.minutes for p in some],
            [p.chance for p in some],
            name,
            place,
            text=[p.block.name for p in some],
            hover="%{x:.1f} min, probability %{y:.3f}",
        )
        for some, name, place in ((others, "other blocks", 5), (chosen, "proposed block", 0))
        if some
    ]
    layout = axes("table time, min", "probability for the hardest pair", showlegend=True)
    layout["yaxis"]["range"] = [-0.03, 1.03]
    return Plot(
        traces,
        f"Probability to separate the hardest pair; {100 * ENOUGH:.0f} % is enough.",
        f"{len(considered)} blocks by table time and probability to separate the hardest pair;"
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
