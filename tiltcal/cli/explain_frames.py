"""``tiltcal explain-frames``."""

import numpy as np

from tiltcal.cli.options import Json, ScenarioFile
from tiltcal.cli.output import paragraph, print_json, print_table
from tiltcal.core.arrays import Array
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.laboratory.laboratory import true_readings
from tiltcal.laboratory.scenario import Scenario, load_scenario


def explain_frames(scenario_file: ScenarioFile, /, *, as_json: Json = False) -> int:
    """Show what each channel reads at the six faces and after small turns.

    Compare these signs with a real set-up first.
    """
    scenario = load_scenario(scenario_file)
    faces = frame_table(scenario)
    turns = turn_table(scenario)
    if as_json:
        print_json({"schema": 1, "faces": faces, "small_turns": turns})
        return 0
    for title, rows in (
        ("body axis up", faces),
        ("after +10 deg about a body axis, from level", turns),
    ):
        if rows:
            header = list(rows[0])
            print_table(header, [[r[h].partition(" (")[0] for h in header] for r in rows], title)
    paragraph(
        "World: x East, y North, z Up; a level accelerometer at rest reads (0, 0, +g). Compare"
        " these signs with your set-up first."
    )
    return 0


def frame_table(scenario: Scenario) -> list[dict[str, str]]:
    """Readings at the six faces, by channel."""
    up = np.vstack([np.eye(3), -np.eye(3)])
    names = ["+x up", "+y up", "+z up", "-x up", "-y up", "-z up"]
    return [{"attitude": name} | _shown(scenario, up[k : k + 1]) for k, name in enumerate(names)]


def turn_table(scenario: Scenario) -> list[dict[str, str]]:
    """Readings after a small right-handed turn about each body axis, and the rates during a turn
    at 10 deg/s.
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


def _shown(scenario: Scenario, up: Array) -> dict[str, str]:
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
