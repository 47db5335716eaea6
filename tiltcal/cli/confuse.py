"""``tiltcal confuse`` and ``explain-frames``."""

import argparse

import numpy as np

from tiltcal.cli.output import print_json, print_table
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.design.identifiability import classes, confuse, tie_breaker
from tiltcal.laboratory.laboratory import true_readings
from tiltcal.laboratory.scenario import Scenario, load_scenario


def confuse_(args: argparse.Namespace) -> int:
    """What the recording of a scenario can and cannot tell apart."""
    scenario = load_scenario(args.scenario)
    found = confuse(scenario, args.grade)
    groups = classes(found)
    if args.json:
        print_json(
            {
                "schema": 1,
                "scenario": scenario.name,
                "grade": args.grade,
                "rank": found.rank,
                "visible": found.visible,
                "classes": [list(g) for g in groups],
                "parameters": [
                    {
                        "effect": s.column.effect,
                        "sensor": s.column.sensor,
                        "axis": s.column.axis,
                        "parameter": f"{s.column.name}_{s.column.unit}",
                        "plausible": s.column.size,
                        "absorbed": s.absorbed,
                        "detectable": s.detectable if np.isfinite(s.detectable) else None,
                        "unique": s.unique,
                        "rivals": [{"parameter": r, "cosine": c} for r, c in s.rivals],
                    }
                    for s in found.sights
                ],
            }
        )
        return 0
    rows = []
    for s in sorted(found.sights, key=lambda s: (s.column.effect, s.column.label)):
        size = f"{s.detectable:.3g} {s.column.unit}" if np.isfinite(s.detectable) else "never"
        rivals = ", ".join(f"{label} {cosine:+.3f}" for label, cosine in s.rivals[:2])
        rivals += f" and {len(s.rivals) - 2} more" if len(s.rivals) > 2 else ""
        rows.append(
            [
                s.column.label,
                f"{100 * s.absorbed:.1f} %",
                size,
                f"{s.column.size:g}",
                f"{s.unique:.2f}",
                rivals,
            ]
        )
    print_table(
        ["parameter", "absorbed", "detectable", "plausible", "unique", "cannot be told from"], rows
    )
    print(
        f"{found.visible} signatures are visible, {found.rank} of them independent, in"
        f" {found.samples:.0f} samples of each sensor"
    )
    for group in groups[:12]:
        print(
            f"one class: {', '.join(group)}; to split {group[0]} from {group[1]}:"
            f" {tie_breaker(group[0], group[1])}"
        )
    return 0


def explain_frames(args: argparse.Namespace) -> int:
    """What each channel should read at the six faces and at small turns."""
    scenario = load_scenario(args.scenario)
    faces = frame_table(scenario)
    turns = turn_table(scenario)
    if args.json:
        print_json({"schema": 1, "faces": faces, "small_turns": turns})
        return 0
    for title, rows in (
        ("body axis up", faces),
        ("after +10 deg about a body axis, from level", turns),
    ):
        if rows:
            header = list(rows[0])
            print_table(header, [[str(r[h]) for h in header] for r in rows], title)
    print(
        "World: x East, y North, z Up; an accelerometer level at rest reads (0, 0, +g). Compare"
        " these signs with yours first."
    )
    return 0


def frame_table(scenario: Scenario) -> list[dict[str, str]]:
    """Readings at the six faces, by channel."""
    up = np.vstack([np.eye(3), -np.eye(3)])
    names = ["+x up", "+y up", "+z up", "-x up", "-y up", "-z up"]
    return [{"attitude": name} | _shown(scenario, up[k : k + 1]) for k, name in enumerate(names)]


def turn_table(scenario: Scenario) -> list[dict[str, str]]:
    """Readings after a small right-handed turn about each body axis, and the rate that a turn at 10
    deg/s gives.
    """
    rows = []
    for i, axis in enumerate("xyz"):
        up = (rotation(axis, 10 * DEG).T @ [0.0, 0.0, 1.0])[None]
        row = {"turn": f"about +{axis}"} | _shown(scenario, up)
        for s in scenario.sensors("gyro"):
            row |= {
                f"{s.name}_{a}": f"{10.0 if s.axis_indices[k] == i else 0.0:+.0f} deg/s"
                for k, a in enumerate(s.axes)
            }
        for s in scenario.sensors("fog"):
            row[f"{s.name}_a"] = f"{10 * s.input_vector[i]:+.3f} deg/s"
        rows.append(row)
    return rows


def _shown(
    scenario: Scenario, up: "np.ndarray[tuple[int, int], np.dtype[np.float64]]"
) -> dict[str, str]:
    g = scenario.site.gravity
    shown = {}
    for name, values in true_readings(scenario, up, ()).items():
        sensor = scenario.named(name)
        for k, axis in enumerate(sensor.axes):
            if sensor.kind == "inclinometer":
                angle = np.arcsin(np.clip(values[0, k] / g, -1, 1))
                shown[f"{name}_{axis}"] = f"{angle / DEG:+.4f} deg ({angle / ARCSEC:+.0f} arcsec)"
            else:
                shown[f"{name}_{axis}"] = f"{values[0, k]:+.5f} m/s2 ({values[0, k] / g:+.4f} g)"
    return shown
