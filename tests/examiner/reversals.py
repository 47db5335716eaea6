"""A vertical table: tilt by reversal (two_position), azimuth by a FOG (north)."""

import numpy as np

from examiner.case import (
    ARCSEC,
    DEG,
    DEG_H,
    OMEGA,
    UG,
    Case,
    Course,
    G,
    rotation,
    system,
    to_codes,
)

TWO = {
    "dead": r"dead|constant|disconnect",
    "clipped": r"saturat|clip|range",
    "frozen": r"frozen|constant|stuck|repeat",
    "unit_mg": r"unit",
    "moved_base": r"moved|base",
    "exchanged": r"order|exchang|swap|angle",
    "flipped_y": r"sign|flip|sense|revers",
    "reversed_sense": r"sense|revers|sign|flip",
    "swapped_columns": r"column|swap",
    "wrong_angle": r"angle|position|reads as",
    "drift": r"drift",
    "codes": "",
}


def attitude(roll, pitch, angle):
    base = rotation("x", roll) @ rotation("y", pitch)
    return base @ rotation("z", angle)


@system("two_position", TWO)
def two_position(rng: np.random.Generator, fault: str) -> Case:
    angles = [0.0, 180.0, 0.0]
    if fault not in ("clean", "codes", "dead", "clipped") or rng.random() < 0.5:
        angles = [0.0, 90.0, 180.0, 270.0, 0.0] if rng.random() < 0.6 else [0.0, 180.0, 0.0, 180.0]
    if fault in ("flipped_y", "reversed_sense", "swapped_columns", "wrong_angle", "exchanged"):
        angles = [0.0, 90.0, 180.0, 270.0, 0.0]
    angles = np.array(angles) + rng.normal(0, 0.02, len(angles))
    roll, pitch = rng.choice([-1, 1], 2) * rng.uniform(0.05, 2, 2) * DEG
    mount = rotation("x", rng.normal(0, 0.3) * DEG) @ rotation("y", rng.normal(0, 0.3) * DEG)
    sigma = 10 ** rng.uniform(1.3, 2.7) * UG
    bias = rng.normal(0, 5000 * UG, 3)
    n = len(angles)
    course = Course.of(n, rng.uniform(10, 30), 4.0, 20.0)
    turned = course.follow(angles)
    rolls = np.full(len(turned), roll)
    if fault == "moved_base":
        k = rng.integers(1, n)
        rolls[course.fraction > k - 0.5] += rng.uniform(20, 200) * sigma / G
    shown = turned.copy()
    if fault == "wrong_angle":
        k = rng.integers(1, n - 1)
        turned = turned + np.where(np.abs(course.fraction - k) < 0.5, 30.0, 0.0)
    if fault == "exchanged":
        true = np.array(angles)
        true[[1, 2]] = true[[2, 1]]
        turned = course.follow(true)
    if fault == "reversed_sense":
        shown = -shown
    R = np.array([attitude(r, pitch, a * DEG) for r, a in zip(rolls, turned)])
    body = np.einsum("nij,j->ni", np.swapaxes(R @ mount, 1, 2), np.array([0, 0, G]))
    values = body + bias + rng.normal(0, sigma, body.shape)
    if fault == "drift":
        values[:, :2] += (30 * sigma * course.time / course.time[-1])[:, None]
    if fault == "codes":
        values = to_codes(values, sigma * rng.uniform(2, 6))
    if fault == "dead":
        values[:, 1] = 0.0
    if fault == "clipped":
        values[:, 0] = np.clip(values[:, 0], None, np.quantile(values[:, 0], 0.3))
    if fault == "frozen":
        start = int(len(values) * rng.uniform(0.3, 0.7))
        values[start:, 1] = values[start, 1]
    if fault == "unit_mg":
        values *= 1000 / 9.80665
    if fault == "flipped_y":
        values[:, 1] *= -1
    if fault == "swapped_columns":
        values[:, [0, 1]] = values[:, [1, 0]]
    both = {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")}
    return Case(
        "two_position",
        "vertical",
        [{"name": "accel", "kind": "accelerometer", "rate_hz": 20.0}],
        course.time,
        {"table_outer_deg": shown, **both},
        {"base.roll": roll, "base.pitch": pitch},
        fault,
        TWO.get(fault, ""),
    )


NORTH = {
    "dead": r"dead|constant|disconnect",
    "frozen": r"frozen|constant|stuck|repeat",
    "instability": "",
    "latitude": r"latitude|FOG.*scale|scale.*FOG|Earth rate",
    "fog_scale": r"latitude|FOG.*scale|scale.*FOG|Earth rate",
    "wrong_angle": r"angle|position",
    "unit": r"unit",
    "compass_30": "",
    "compass_55": "",
    "moved_base": r"moved|base",
}


@system("north", NORTH)
def north(rng: np.random.Generator, fault: str) -> Case:
    latitude = rng.uniform(20, 60)
    heading = rng.uniform(0, 2 * np.pi)
    two = fault.startswith("compass")
    stops = [0.0, 180.0, 0.0] if two else [0.0, 90.0, 180.0, 270.0, 0.0, 90.0, 180.0, 270.0]
    if fault in ("clean", "dead", "frozen") and rng.random() < 0.3:
        stops = [0.0, 90.0, 180.0, 270.0]
    angles = np.array(stops) + rng.normal(0, 0.01, len(stops))
    if two:  # away from north and south, where two positions tell nothing
        heading = rng.choice([-1, 1]) * rng.uniform(25, 155) * DEG
    roll, pitch = rng.choice([-1, 1], 2) * rng.uniform(0.02, 1, 2) * DEG
    random_walk = 10 ** rng.uniform(-3.3, -2.3) * DEG / 60  # rad/sqrt(s)
    rate = 20.0
    course = Course.of(len(angles), rng.uniform(40, 80), 4.0, rate)
    turned = course.follow(angles)
    shown = turned.copy()
    if fault == "wrong_angle":
        k = rng.integers(1, len(angles) - 1)
        turned = turned + np.where(np.abs(course.fraction - k) < 0.5, 20.0, 0.0)
    rolls = np.full(len(turned), roll)
    sigma_a = 100 * UG
    if fault == "moved_base":
        rolls[course.fraction > 2.5] += 200 * ARCSEC
    moving = np.gradient(turned * DEG, course.time)
    R = np.array([attitude(r, pitch, a * DEG) for r, a in zip(rolls, turned)])
    # the table's world: x East', y North' turned by the heading (clockwise from true north)
    across, up = OMEGA * np.cos(latitude * DEG), OMEGA * np.sin(latitude * DEG)
    earth = np.array([-across * np.sin(heading), across * np.cos(heading), up])
    body = np.einsum("nij,j->ni", np.swapaxes(R, 1, 2), earth)
    fog = body[:, 0] + 0.0 * moving
    fog_bias = rng.normal(0, 0.5) * DEG_H
    sigma = random_walk * np.sqrt(rate)
    reading = fog_bias + fog + rng.normal(0, sigma, len(fog))
    if fault == "instability":
        step = 10 ** rng.uniform(0.7, 1.3) * random_walk / np.sqrt(course.time[-1] / len(angles))
        step /= np.sqrt(course.time[-1])
        reading += np.cumsum(rng.normal(0, step * np.sqrt(1 / rate), len(fog)))
    stated = latitude
    if fault == "latitude":
        stated = latitude + rng.choice([-1, 1]) * rng.uniform(8, 15)
    if fault == "fog_scale":
        reading = reading * (1 + rng.choice([-1, 1]) * rng.uniform(0.1, 0.2))
    if fault == "dead":
        reading = np.zeros(len(fog))
    if fault == "frozen":
        start = int(len(reading) * rng.uniform(0.3, 0.7))
        reading[start:] = reading[start]
    shown_rate = reading / DEG_H
    if fault == "unit":
        shown_rate = reading / DEG  # deg/s in a column of deg/h
    force = np.einsum("nij,j->ni", np.swapaxes(R, 1, 2), np.array([0, 0, G]))
    force = force + rng.normal(0, 2000 * UG, 3) + rng.normal(0, sigma_a, force.shape)
    # body x at outer = 0: its horizontal direction
    x = attitude(roll, pitch, 0.0)[:, 0]
    azimuth = (heading + np.arctan2(x[0], x[1])) % (2 * np.pi)
    options = {}
    if two:
        error = float(fault.split("_")[1])
        options = {"near_deg": float(azimuth / DEG + rng.uniform(-error, error))}
    return Case(
        "north",
        "vertical",
        [
            {"name": "fog", "kind": "fog", "axes": ["a"], "input_axis": [1, 0, 0], "rate_hz": rate},
            {"name": "accel", "kind": "accelerometer", "rate_hz": rate},
        ],
        course.time,
        {
            "table_outer_deg": shown,
            "fog_a_deg_h": shown_rate,
            **{f"accel_{a}_m_s2": force[:, i] for i, a in enumerate("xyz")},
        },
        {"base.azimuth": azimuth, "base.roll": roll, "base.pitch": pitch},
        fault,
        NORTH.get(fault, ""),
        options=options,
        latitude=float(stated),
    )
