"""A gyro triad beside a FOG, turned by hand (fog_scale)."""

import numpy as np

from examiner.case import DEG, DEG_H, UG, Case, G, system

FOG = {
    "dead_gyro": r"dead|constant|disconnect",
    "dead_fog": r"dead|constant|disconnect",
    "latency": r"latency|delay|late",
    "axis": r"axis",
    "unit": r"unit",
    "columns": r"column|swap|sign",
    "sign": r"column|swap|sign",
    "moved_in_rest": r"moved|motion|rest",
    "short_turns": r"turned|360|turn again",
    "saturated": r"saturat",
}
INPUT = np.array([1.0, 1.0, 1.0]) / np.sqrt(3)


@system("fog_scale", FOG)
def fog_scale(rng: np.random.Generator, fault: str) -> Case:
    rate = 100.0
    turn = rng.uniform(380, 430) if fault != "short_turns" else rng.uniform(60, 120)
    speed = rng.uniform(60, 120) * DEG
    w = [np.zeros((round(rng.uniform(22, 30) * rate), 3))]
    for axis in range(3):
        for way in (1, -1):
            n = round(turn * DEG / speed * rate)
            s = (np.arange(n) + 0.5) / n
            profile = np.clip(np.minimum(s, 1 - s) * 8, 0, 1)
            profile *= turn * DEG / (profile.sum() / rate)
            part = np.zeros((n, 3))
            part[:, axis] = way * profile
            wobble = rng.normal(0, 0.08, 3) * speed
            part += wobble * (profile / profile.max())[:, None]
            w += [part, np.zeros((round(rng.uniform(5, 8) * rate), 3))]
    w = np.vstack(w)
    n = len(w)
    time = np.arange(n) / rate
    if fault == "moved_in_rest":
        mine = (time > 8) & (time < 12)
        w[mine, 2] += 2.0 * DEG * np.sin((time[mine] - 8) / 4 * np.pi)
    up, force, earth = np.array([0.0, 0.0, 1.0]), np.empty((n, 3)), np.empty((n, 3))
    latitude = 39.9
    north = np.array([0.0, 1.0, 0.0])
    for k in range(n):
        force[k], earth[k] = G * up, north
        angle = np.linalg.norm(w[k]) / rate
        if angle > 0:
            axis = w[k] / np.linalg.norm(w[k])
            c, s = np.cos(angle), np.sin(angle)
            for vector in (up, north):
                vector[:] = (
                    c * vector - s * np.cross(axis, vector) + (1 - c) * (axis @ vector) * axis
                )
    omega = 7.292115e-5
    total = w + omega * (np.cos(latitude * DEG) * earth + np.sin(latitude * DEG) * force / G)
    scale = rng.uniform(-0.02, 0.02, 3)
    bias = rng.normal(0, 200, 3) * DEG_H
    sigma_g = rng.uniform(0.02, 0.1) * DEG
    gyro = bias + total * (1 + scale) + rng.normal(0, sigma_g, (n, 3))
    true_axis = INPUT
    if fault == "axis":
        across = np.cross(INPUT, rng.normal(size=3))
        angle = rng.uniform(1, 3) * DEG
        true_axis = np.cos(angle) * INPUT + np.sin(angle) * across / np.linalg.norm(across)
    fog = total @ true_axis + rng.normal(0, 2) * DEG_H + rng.normal(0, 5 * DEG_H, n)
    if fault == "latency":
        late = rng.uniform(0.02, 0.06) * rng.choice([1, -1])
        fog = np.interp(time - late, time, fog)
    if fault == "dead_gyro":
        gyro[:, rng.integers(3)] = 0.0
    if fault == "dead_fog":
        fog = np.zeros(n)
    if fault == "unit":
        gyro = gyro / DEG
    if fault == "columns":
        gyro = gyro[:, [1, 0, 2]]
    if fault == "sign":
        gyro[:, 1] *= -1
    if fault == "saturated":
        limit = 0.7 * np.abs(gyro).max()
        gyro = np.clip(gyro, -limit, limit)
    accel = force + rng.normal(0, 500 * UG, (n, 3))
    return Case(
        "fog_scale",
        "handheld",
        [
            {"name": "gyro", "kind": "gyro", "rate_hz": rate},
            {"name": "fog", "kind": "fog", "axes": ["a"], "input_axis": [1, 1, 1], "rate_hz": rate},
            {"name": "accel", "kind": "accelerometer", "rate_hz": rate},
        ],
        time,
        {
            **{f"gyro_{a}_rad_s": gyro[:, i] for i, a in enumerate("xyz")},
            "fog_a_rad_s": fog,
            **{f"accel_{a}_m_s2": accel[:, i] for i, a in enumerate("xyz")},
        },
        {f"gyro.scale_{a}": scale[i] for i, a in enumerate("xyz")},
        fault,
        FOG.get(fault, ""),
        latitude=latitude,
    )
