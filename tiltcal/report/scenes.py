"""Three-dimensional plots: poses on the sphere, and the table in its poses."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.core.arrays import Array
from tiltcal.laboratory.scene import Scene
from tiltcal.report.plots import Plot, Trace, colour
from tiltcal.report.poses import Pose

MOST_POSES = 30  # of a table that is drawn in each of them
MOST_POINTS = 300  # of a recording on the sphere
HIDDEN = {"showticklabels": False, "title": {"text": ""}, "showspikes": False, "visible": False}
ORIGIN = np.zeros(3)
NO_MARGIN = {"l": 0, "r": 0, "t": 0, "b": 0}


def sphere_plot(poses: Sequence[Pose]) -> Plot | None:
    """Directions of gravity in the body frame, a point for each pose; None without any. The page
    draws the sphere and the body axes.
    """
    if not poses:
        return None
    traces: list[Trace] = []
    groups = list(dict.fromkeys(p.group for p in poses))
    for k, group in enumerate(groups):
        mine = [(n, p) for n, p in enumerate(poses, 1) if p.group == group]
        mine = [mine[i] for i in np.unique(np.linspace(0, len(mine) - 1, MOST_POINTS).astype(int))]
        down = -np.array([p.up for _, p in mine])
        traces.append(
            _spatial("scatter3d", down)
            | {
                "mode": "markers",
                "name": group,
                "text": [f"pose {n}: {p.label}" for n, p in mine],
                "marker": {"size": 6, "color": colour(k)},
                "hovertemplate": "%{fullData.name}<br>%{text}<extra></extra>",
            }
        )
    return Plot(
        traces,
        f"Directions of gravity in the body frame, {len(poses)} poses; x, y and z are the axes of"
        " the body. Drag to turn.",
        f"Unit sphere with the direction of gravity in the body frame at {len(poses)} poses of"
        f" {', '.join(groups)}",
        {"sphere": True, "scene": _space(1.25), "margin": NO_MARGIN, "showlegend": True},
        height=420,
    )


def table_plot(scene: Scene, labels: Sequence[str]) -> Plot | None:
    """The table in its poses, one at a time, with a slider; None without any.

    Args:
        scene: the table's solids at each pose.
        labels: of the poses.
    """
    count = len(labels)
    if not count or not scene.solids:
        return None
    shown = np.unique(np.linspace(0, count - 1, MOST_POSES).astype(int))
    corners = [scene.corners(k) for k in range(len(scene.solids))]
    first = [_mesh(scene, k, c[shown[0]]) for k, c in enumerate(corners)]
    frames = [
        {
            "name": str(n),
            "data": [dict(zip("xyz", np.round(c[n].T, 4), strict=True)) for c in corners],
            "traces": list(range(len(corners))),
        }
        for n in shown
    ]
    everywhere = np.concatenate([c.reshape(-1, 3) for c in corners])
    low, high = everywhere.min(axis=0), everywhere.max(axis=0)
    reach = 0.78 * float((high - low).max())
    return Plot(
        first,
        f"The table in {len(shown)} of {count} poses; choose one with the slider, drag to turn."
        " x is East, z is up.",
        f"The table with the instrument in its poses: {labels[shown[0]]} and others",
        {
            "scene": _space(reach, (low + high) / 2),
            "margin": NO_MARGIN,
            "showlegend": False,
            "sliders": [_slider({str(n): labels[n] for n in shown})],
        },
        height=460,
        frames=frames,
    )


def _slider(frames: Mapping[str, str]) -> dict[str, Any]:
    """A slider over frames. frames: name -> label."""
    move = {"mode": "immediate", "frame": {"duration": 0}, "transition": {"duration": 0}}
    return {
        "steps": [
            {"label": label, "method": "animate", "args": [[name], move]}
            for name, label in frames.items()
        ],
        "pad": {"t": 6, "l": 10, "r": 10},
        "currentvalue": {"font": {"color": "var(--ink)", "size": 12}},
        "ticklen": 0,
        "minorticklen": 0,
        "font": {"color": "rgba(0,0,0,0)", "size": 1},
    }


def _mesh(scene: Scene, k: int, corners: Array) -> Trace:
    solid = scene.solids[k]
    parts = list(dict.fromkeys(s.part for s in scene.solids))
    i, j, m = solid.faces().T.tolist()
    own = {"i": i, "j": j, "k": m, "name": solid.part, "color": colour(parts.index(solid.part))}
    light = {"flatshading": True, "lighting": {"ambient": 0.6, "diffuse": 0.7}}
    return (
        _spatial("mesh3d", corners)
        | own
        | light
        | {"hovertemplate": "%{fullData.name}<extra></extra>"}
    )


def _spatial(kind: str, xyz: Array) -> Trace:
    return {"type": kind, **dict(zip("xyz", np.asarray(xyz).T, strict=True))}


def _space(reach: float, centre: Array = ORIGIN) -> dict[str, Any]:
    """A scene of equal scales that reaches so far from its centre, without axes."""
    own = [HIDDEN | {"range": [c - reach, c + reach]} for c in centre.tolist()]
    eye = {"x": 0.95, "y": -0.95, "z": 0.6}
    named = dict(zip(("xaxis", "yaxis", "zaxis"), own, strict=True))
    return named | {"aspectmode": "cube", "camera": {"eye": eye}}
