"""Blind trials on users' own models: the physics is built into the model by plain MuJoCo, the
product gets the model without it.

    python -m model_trials --count 6 --seed 1          from the folder tests
"""

import argparse
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from model_rig import Mapped, PlainModel, poses_and_moves, scenario_text

from tiltcal.core.assets import folder
from tiltcal.core.units import ARCSEC
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
ARM = folder("scenarios") / "arm" / "arm.xml"
WHITE = 60e-6 * 9.80665 * np.sqrt(50)  # m/s2 a sample
STANDARD_G = 9.80665


@dataclass(frozen=True)
class Robot:
    """A model, the joints that are read, and where the instrument sits."""

    path: Path
    joints: tuple[str, ...]
    site: str
    springs: tuple[str, ...]


PUSHER = tuple(
    f"r_{n}_joint"
    for n in (
        "shoulder_pan",
        "shoulder_lift",
        "upper_arm_roll",
        "elbow_flex",
        "forearm_roll",
        "wrist_flex",
        "wrist_roll",
    )
)
ROBOTS = {
    "arm": Robot(ARM, ("pan", "lift", "elbow", "wrist"), "tool", ("lift",)),
    "base of the arm": Robot(ARM, ("pan", "lift", "elbow", "wrist"), "base_imu", ()),
    "pusher": Robot(ASSETS / "pusher_v5.xml", PUSHER, "tips_arm", PUSHER[1:2]),
    "leg of the humanoid": Robot(
        ASSETS / "humanoid.xml",
        ("abdomen_y", "abdomen_x", "right_hip_x", "right_hip_z", "right_hip_y", "right_knee"),
        "right_shin",
        ("right_hip_y",),
    ),
}
PHYSICS = {
    "null": "",
    "joint spring": "joint_compliance",
    "base spring": "base_load_compliance",
    "axis tilt": "joint_axis_tilt",
    "K2": "acc_K2",
    "eccentricity": "table_encoder_eccentricity",
    "latency": "data_latency",
}


def possible(robot, physics):
    """Whether a robot can show it."""
    moves = robot.site != "base_imu"
    return {
        "null": True,
        "joint spring": bool(robot.springs),
        "base spring": not moves,
        "K2": moves,
    }.get(physics, moves)


def case(robot, physics, rng, place):
    """A scenario's path and a recording."""
    axes = {
        f"j{k}": Mapped(n, int(rng.choice([-1, 1])), float(rng.uniform(-1, 1)))
        for k, n in enumerate(robot.joints)
    }
    time, jets = poses_and_moves(rng, list(axes), 20)
    built = {}
    if physics == "joint spring":
        axis = str(rng.choice(robot.springs))
        probe = PlainModel(robot.path, axes, robot.site)
        load = np.ptp(probe.load({a: j[0][::50] for a, j in jets.items()}, axis))
        built["joint_stiffness"] = {axis: load / (rng.uniform(60, 200) * ARCSEC)}
    if physics == "base spring":
        built["base_stiffness"] = rng.uniform(1e5, 4e5, 2)
    if physics == "axis tilt":
        # the last joint's tilt is a part of the mounting
        built["axis_tilt"] = {
            robot.joints[-2]: rng.choice([-1, 1], 2) * rng.uniform(150, 400, 2) * ARCSEC
        }
    late = int(rng.integers(1, 3)) if physics == "latency" else 0  # samples
    force, _ = PlainModel(robot.path, axes, robot.site, **built).readings(time, jets)
    if late:
        force = np.concatenate([np.repeat(force[:1], late, axis=0), force[:-late]])
    if physics == "K2":
        force[:, 0] += rng.uniform(300, 900) * 1e-6 * force[:, 0] ** 2 / STANDARD_G
    readouts = {a: j[0].copy() for a, j in jets.items()}
    if physics == "eccentricity":
        axis = list(axes)[-2]
        x, (c, s) = readouts[axis], rng.choice([-1, 1], 2) * rng.uniform(100, 300, 2) * ARCSEC
        readouts[axis] = x + c * np.cos(x) + s * np.sin(x)
    force = force * (1 + rng.normal(0, 1e-3, 3)) + rng.normal(0, 0.02, 3)
    force = force + rng.normal(0, WHITE, force.shape)
    columns = {
        f"table_{a}_deg": np.degrees(x + rng.normal(0, 0.05 * ARCSEC, len(x)))
        for a, x in readouts.items()
    }
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    (place / robot.path.name).write_bytes(robot.path.read_bytes())
    moves = robot.site != "base_imu"
    terms = ("bias", "scale", "cross_axis") if moves else ("bias",)
    file = place / "scenario.toml"
    file.write_text(scenario_text(robot.path, axes, robot.site, adjustable=terms))
    return file, Recording.from_columns(time, columns)


def main():
    """Run the trials and print what came of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    words = parser.parse_args()
    tally = defaultdict(lambda: np.zeros(4, int))
    for name, robot in ROBOTS.items():
        for number, (physics, id) in enumerate(PHYSICS.items()):
            for k in range(words.count if possible(robot, physics) else 0):
                rng = np.random.default_rng([words.seed, number, k, len(name)])
                with tempfile.TemporaryDirectory() as folder_name:
                    file, recording = case(robot, physics, rng, Path(folder_name))
                    answer = diagnose(load_scenario(file), [recording])
                names = [n for f in answer.findings for n in f.names]
                found, held = bool(answer.findings), id in names
                exact = held and len(answer.findings) == 1
                tally[physics] += [1, found, held, exact]
                print(
                    f"{name:16s} {physics:13s} {answer.verdict:11s} {' '.join(names)}", flush=True
                )
    print(f"\n{'physics':14s}cases  found  in the class  alone")
    for physics, (n, found, held, exact) in tally.items():
        print(f"{physics:14s}{n:5d}{found:7d}{held:14d}{exact:7d}")


if __name__ == "__main__":
    main()
