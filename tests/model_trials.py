"""Blind trials on users' own models: the physics is built into the model by plain MuJoCo, the
product gets the model without it.

    python -m model_trials --count 6 --seed 1          from the folder tests
    python -m model_trials --robots "pan-tilt head" "four-axis table" --oracle

With --oracle each answer predicts a second recording, and so does a fit of the true law alone.
"""

import argparse
import tempfile
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from model_oracle import calibration, effect, fitted_error, predicted_error
from model_rig import (
    FOUR_AXES,
    HEXAPOD,
    PAN_TILT,
    Mapped,
    PlainModel,
    poses_and_moves,
    scenario_text,
    stated,
)

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
    """A model, the joints that are read, and where the instrument sits.

    Args:
        springs: joints that may give way; bends: one whose link may, where its load lies across it.
    """

    file: str
    text: bytes
    joints: tuple[str, ...]
    site: str
    springs: tuple[str, ...]
    bends: str = ""


def of_file(path: Path, *rest: Any) -> Robot:
    """A robot of a model's file."""
    return Robot(path.name, path.read_bytes(), *rest)


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
    "arm": of_file(ARM, ("pan", "lift", "elbow", "wrist"), "tool", ("lift",), "pan"),
    "base of the arm": of_file(ARM, ("pan", "lift", "elbow", "wrist"), "base_imu", ()),
    "pusher": of_file(ASSETS / "pusher_v5.xml", PUSHER, "tips_arm", PUSHER[1:2], PUSHER[0]),
    "leg of the humanoid": of_file(
        ASSETS / "humanoid.xml",
        ("abdomen_y", "abdomen_x", "right_hip_x", "right_hip_z", "right_hip_y", "right_knee"),
        "right_shin",
        ("right_hip_y",),
    ),
    "leg of the cheetah": of_file(
        ASSETS / "half_cheetah.xml", ("bthigh", "bshin", "bfoot"), "bfoot", ("bthigh",)
    ),
    "leg of a hexapod": Robot(
        "hexapod.xml",
        HEXAPOD.encode(),
        ("coxa_0", "femur_0", "tibia_0"),
        "shin",
        ("femur_0",),
        "coxa_0",
    ),
    "pan-tilt head": Robot(
        "head.xml", PAN_TILT.encode(), ("pan", "tilt", "roll"), "imu", ("tilt", "roll"), "pan"
    ),
    "four-axis table": Robot(
        "table.xml",
        FOUR_AXES.encode(),
        ("outer", "middle", "inner", "head"),
        "imu",
        ("middle", "inner"),
        "outer",
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
    "payload": "payload",
    "link spring": "link_compliance",
}


def possible(robot, physics):
    """Whether a robot can show it."""
    moves = robot.site != "base_imu"
    return {
        "null": True,
        "joint spring": bool(robot.springs),
        "base spring": not moves,
        "payload": bool(robot.springs) or not moves,
        "K2": moves,
        "link spring": bool(robot.bends),
    }.get(physics, moves)


@dataclass(frozen=True)
class Truth:
    """What is concealed.

    Args:
        built: keywords of the plain model; law: the `[[effect]]` tables that are the truth.
        known: those that the honest scenario states too.
        late: samples; k2: of the x axis, 1/g.
        eccentric: axis, and its errors with the cosine and sine of the angle, rad.
        gain, bias: of the sensor's axes, what calibration may take.
    """

    built: dict[str, Any]
    law: str
    gain: Any
    bias: Any
    late: int = 0
    k2: float = 0.0
    eccentric: tuple[str, float, float] | None = None
    known: str = ""


def concealed(robot: Robot, physics: str, rng: Any, path: Path, axes: Any) -> Truth:
    """One physics at a random size."""
    named = {m.joint: a for a, m in axes.items()}
    honest = {"gain": 1 + rng.normal(0, 1e-3, 3), "bias": rng.normal(0, 0.02, 3)}
    if physics == "joint spring":
        joint = str(rng.choice(robot.springs))
        _, jets = poses_and_moves(rng, list(axes), 20)
        load = PlainModel(path, axes, robot.site).load(
            {a: j[:, ::50] for a, j in jets.items()}, joint
        )
        stiffness = np.ptp(load) / (rng.uniform(60, 200) * ARCSEC)
        law = effect("joint_compliance", "bend_z_arcsec_N_m", axis=named[joint])
        return Truth({"joint_stiffness": {joint: stiffness}}, law, **honest)
    if physics == "base spring":
        law = effect("base_load_compliance", "bend_east_arcsec_N_m", "bend_north_arcsec_N_m")
        return Truth({"base_stiffness": rng.uniform(1e5, 4e5, 2)}, law, **honest)
    if physics == "axis tilt":
        tilt = rng.choice([-1, 1], 2) * rng.uniform(150, 400, 2) * ARCSEC
        sizes = ("tilt_x_arcsec", "tilt_y_arcsec")
        law = effect("joint_axis_tilt", *sizes, axis=named[robot.joints[-2]])
        return Truth({"axis_tilt": {robot.joints[-2]: tilt}}, law, **honest)
    if physics == "K2":
        k2 = rng.uniform(300, 900) * 1e-6
        return Truth({}, effect("acc_K2", "k2_x_ug_g2"), **honest, k2=k2)
    if physics == "eccentricity":
        c, s = rng.choice([-1, 1], 2) * rng.uniform(100, 300, 2) * ARCSEC
        axis = list(axes)[-2]
        law = effect("table_encoder_eccentricity", "cos_arcsec", "sin_arcsec", axis=axis)
        return Truth({}, law, **honest, eccentric=(axis, c, s))
    if physics == "latency":
        late = int(rng.integers(1, 3))
        return Truth({}, effect("data_latency", "latency_ms"), **honest, late=late)
    if physics == "payload":
        return loaded(robot, rng, path, axes, honest)
    if physics == "link spring":
        return bending(robot, rng, path, axes, honest)
    return Truth({}, "", **honest)


def bending(robot: Robot, rng: Any, path: Path, axes: Any, honest: Any) -> Truth:
    """Springs behind a joint, across its axis."""
    joint = robot.bends
    (axis,) = (a for a, m in axes.items() if m.joint == joint)
    _, jets = poses_and_moves(rng, list(axes), 20)
    jets = {a: j[:, ::50] for a, j in jets.items()}
    moment = PlainModel(path, axes, robot.site).moments(jets, joint)[1]
    stiffness = np.ptp(moment, axis=0).max() / (rng.uniform(60, 200, 2) * ARCSEC)
    law = effect("link_compliance", "bend_x_arcsec_N_m", "bend_y_arcsec_N_m", axis=axis)
    return Truth({"link_stiffness": {joint: stiffness}}, law, **honest)


def loaded(robot: Robot, rng: Any, path: Path, axes: Any, honest: Any) -> Truth:
    """A payload on the last link, and a known spring that it bends."""
    last, named = robot.joints[-1], {m.joint: a for a, m in axes.items()}
    _, jets = poses_and_moves(rng, list(axes), 20)
    jets = {a: j[:, ::50] for a, j in jets.items()}
    joint = str(rng.choice(robot.springs)) if robot.springs else robot.joints[1]
    plain = PlainModel(path, axes, robot.site)
    carried = plain.model.body_subtreemass[plain.model.joint(joint).bodyid[0]]
    payload = {last: (rng.uniform(0.1, 0.4) * carried, rng.uniform(-0.1, 0.1, 3))}
    more = PlainModel(path, axes, robot.site, payload=payload).load(jets, joint)
    stiffness = np.ptp(more - plain.load(jets, joint)) / (rng.uniform(60, 200) * ARCSEC)
    built: dict[str, Any] = {"payload": payload}
    if robot.springs:
        built["joint_stiffness"] = {joint: stiffness}
        known = stated("joint_compliance", axis=named[joint], bend_z=1 / stiffness)
    else:
        built["base_stiffness"] = (stiffness, 1.3 * stiffness)
        bends = {"bend_east": 1 / stiffness, "bend_north": 1 / (1.3 * stiffness)}
        known = stated("base_load_compliance", **bends)
    sizes = ("mass_kg", *(f"com_{a}_mm" for a in "xyz"))
    law = effect("payload", *sizes, axis=named[last])
    return Truth(built, law, **honest, known=known)


def recorded(truth: Truth, path: Path, axes: Any, site: str, rng: Any, white: float) -> Recording:
    """What the concealed model reads on random poses and moves."""
    time, jets = poses_and_moves(rng, list(axes), 20)
    force, _ = PlainModel(path, axes, site, **truth.built).readings(time, jets)
    if truth.late:
        force = np.concatenate([np.repeat(force[:1], truth.late, axis=0), force[: -truth.late]])
    force[:, 0] += truth.k2 * force[:, 0] ** 2 / STANDARD_G
    force = force * truth.gain + truth.bias + white * rng.normal(0, 1, force.shape)
    columns = {}
    for a, jet in jets.items():
        x = jet[0] + (white > 0) * rng.normal(0, 0.05 * ARCSEC, len(time))
        if truth.eccentric is not None and truth.eccentric[0] == a:
            x = x + truth.eccentric[1] * np.cos(jet[0]) + truth.eccentric[2] * np.sin(jet[0])
        columns[f"table_{a}_deg"] = np.degrees(x)
    columns |= {f"accelerometer_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")}
    return Recording.from_columns(time, columns)


@dataclass(frozen=True)
class Outcome:
    """What came of a case; errors of prediction, rms, m/s2, None without an oracle."""

    found: bool
    held: bool
    alone: bool
    error: float | None = None
    oracle: float | None = None


def trial(name: str, physics: str, rng: Any, place: Path, oracle: bool) -> Outcome:
    """One case, concealed and diagnosed."""
    robot, id = ROBOTS[name], PHYSICS[physics]
    path = place / robot.file
    path.write_bytes(robot.text)
    axes = {
        f"j{k}": Mapped(n, int(rng.choice([-1, 1])), float(rng.uniform(-1, 1)))
        for k, n in enumerate(robot.joints)
    }
    truth = concealed(robot, physics, rng, path, axes)
    terms = ("bias", "scale", "cross_axis") if robot.site != "base_imu" else ("bias",)
    honest = scenario_text(path, axes, robot.site, adjustable=terms) + truth.known
    file, right = place / "scenario.toml", place / "right.toml"
    file.write_text(honest)
    right.write_text(honest + calibration(*terms) + truth.law)
    recording = recorded(truth, path, axes, robot.site, rng, WHITE)
    answer = diagnose(load_scenario(file), [recording])
    names = [n for f in answer.findings for n in f.names]
    held = id in names
    outcome = Outcome(bool(answer.findings), held, held and len(answer.findings) == 1)
    if oracle and physics != "payload":  # a mass is no parameter of the oracle's
        second = recorded(truth, path, axes, robot.site, rng, 0.0)
        error = predicted_error(load_scenario(file), answer.amended, second)
        best = fitted_error(right, path, recording, second)
        outcome = replace(outcome, error=error, oracle=best)
    ratio = "" if outcome.error is None else f"{outcome.error / outcome.oracle:6.2f}"
    print(f"{name:20s} {physics:13s} {answer.verdict:11s} {ratio} {' '.join(names)}", flush=True)
    return outcome


def main():
    """Run the trials and print what came of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--physics", nargs="+", choices=PHYSICS, default=list(PHYSICS))
    parser.add_argument("--oracle", action="store_true")
    words = parser.parse_args()
    tally = defaultdict(list)
    for name in words.robots:
        for physics in words.physics:
            number = list(PHYSICS).index(physics)
            for k in range(words.count if possible(ROBOTS[name], physics) else 0):
                rng = np.random.default_rng([words.seed, number, k, len(name)])
                with tempfile.TemporaryDirectory() as place:
                    tally[physics].append(trial(name, physics, rng, Path(place), words.oracle))
    print_table(tally)


def print_table(tally):
    """The outcomes by physics; the error is the median of its ratio to the oracle's."""
    print(f"\n{'physics':14s}cases  found  in the class  alone  error / oracle's")
    for physics, outcomes in tally.items():
        counts = [sum(getattr(o, k) for o in outcomes) for k in ("found", "held", "alone")]
        ratios = [o.error / o.oracle for o in outcomes if o.oracle]
        shown = f"{np.median(ratios):18.2f}" if ratios else ""
        print(f"{physics:14s}{len(outcomes):5d}{counts[0]:7d}{counts[1]:14d}{counts[2]:7d}{shown}")


if __name__ == "__main__":
    main()
