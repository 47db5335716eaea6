"""MuJoCo's system identification beside the diagnosis, on the same concealed cases.

    python -m tests.sysid_comparison

Plain MuJoCo builds each case and conceals it (`model_rig.py`). Three answers to each:
`mujoco.sysid` given the right parameter, given a wrong one, and tiltcal given nothing but the
honest scenario. Beside the physics all three fit bias, scale and cross-axis terms. A figure is the
error of the prediction of a second recording without noise, rms over its rows, in units of the
white noise of one sample.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from model_oracle import TERMS, calibration, effect, fitted_error, predicted_error
from model_rig import Mapped, PlainModel, poses_and_moves, scenario_text

from tiltcal.core.assets import folder
from tiltcal.core.units import ARCSEC, G0
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording

ARM = folder("scenarios") / "arm" / "arm.xml"
AXES = {n: Mapped(n) for n in ("pan", "lift", "elbow", "wrist")}
WHITE = 60e-6 * G0 * np.sqrt(50)  # m/s2 a sample
POSES = 12


@dataclass(frozen=True)
class Case:
    """What is concealed, and what an expert who is right, or wrong, would fit.

    Args:
        built: keywords of the plain model.
        right, wrong: `[[effect]]` tables with the names of their free numbers at zero.
        sensed: what the sensor makes of the force; read: what is read of an angle.
    """

    name: str
    right: str
    wrong: str
    built: dict[str, Any]
    sensed: Callable[[Any], Any] = lambda force: force
    read: Callable[[str, Any], Any] = lambda _, angle: angle


def _k2(force: Any) -> Any:
    return force + 600e-6 * np.array([1, 0, 0]) * force**2 / G0


def _late(force: Any) -> Any:
    return np.concatenate([force[:1], force[:-1]])  # by one sample, 20 ms


def _eccentric(axis: str, x: Any) -> Any:
    return x + 200 * ARCSEC * (np.cos(x) - np.sin(x)) if axis == "elbow" else x


SPRING = effect("joint_compliance", "bend_z_arcsec_N_m", axis="lift")
TILT = effect("joint_axis_tilt", "tilt_x_arcsec", "tilt_y_arcsec", axis="elbow")
ECCENTRIC = effect("table_encoder_eccentricity", "cos_arcsec", "sin_arcsec", axis="elbow")
CASES = [
    Case("spring in the lift", SPRING, TILT, {"joint_stiffness": {"lift": 1 / (4 * ARCSEC)}}),
    Case("late stamps", effect("data_latency", "latency_ms"), SPRING, {}, sensed=_late),
    Case(
        "axis of the elbow",
        TILT,
        ECCENTRIC,
        {"axis_tilt": {"elbow": (300 * ARCSEC, -200 * ARCSEC)}},
    ),
    Case("eccentric readout", ECCENTRIC, SPRING, {}, read=_eccentric),
    Case("quadratic sensor", effect("acc_K2", "k2_x_ug_g2"), SPRING, {}, sensed=_k2),
]


def recorded(case: Case, rng: Any, white: float) -> Recording:
    """A recording of random poses and moves of the concealed model."""
    time, jets = poses_and_moves(rng, list(AXES), POSES)
    force, _ = PlainModel(ARM, AXES, "tool", **case.built).readings(time, jets)
    force = case.sensed(force) * [1.0008, 0.9993, 1.0011] + [0.02, -0.01, 0.015]
    force = force + rng.normal(0, white, force.shape) if white else force
    columns = {f"table_{a}_rad": case.read(a, j[0]) for a, j in jets.items()}
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    return Recording.from_columns(time, columns)


def by_tiltcal(file: Path, recording: Recording, held_out: Recording) -> tuple[str, float]:
    """The findings' names, and what the amended scenario leaves of the held-out recording."""
    scenario = load_scenario(file)
    answer = diagnose(scenario, [recording])
    names = [n for f in answer.findings for n in (f.names or ("unlisted",))]
    error = predicted_error(scenario, answer.amended, held_out)
    return ", ".join(dict.fromkeys(names)) or "nothing", error


def main() -> None:
    """Run the cases and print the table."""
    print("| concealed | sysid, right | sysid, wrong | tiltcal | tiltcal names |")
    print("|---|---|---|---|---|")
    for number, case in enumerate(CASES):
        rng = np.random.default_rng([22, number])
        seen, held_out = recorded(case, rng, WHITE), recorded(case, rng, 0.0)
        with tempfile.TemporaryDirectory() as name:
            place = Path(name)
            (place / ARM.name).write_bytes(ARM.read_bytes())
            honest = scenario_text(ARM, AXES, "tool", adjustable=tuple(TERMS))
            left = []
            for label, extra in (("right", case.right), ("wrong", case.wrong)):
                file = place / f"{label}.toml"
                file.write_text(honest + calibration(*TERMS) + extra)
                left.append(fitted_error(file, ARM, seen, held_out))
            (place / "honest.toml").write_text(honest)
            names, ours = by_tiltcal(place / "honest.toml", seen, held_out)
        figures = " | ".join(f"{error / WHITE:.3f}" for error in (*left, ours))
        print(f"| {case.name} | {figures} | {names} |", flush=True)


if __name__ == "__main__":
    main()
