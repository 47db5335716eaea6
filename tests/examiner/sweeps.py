"""A placing table: zero bias against the placing angle (placing_table)."""

import numpy as np

from examiner.case import ARCSEC, DEG, UG, Case, Course, G, decaying, system, to_codes

PLACING = {
    "dead": r"dead|constant|disconnect",
    "coarse": r"interpolat|step",
    "warm_up": r"warm|drift",
    "hysteresis": r"hysteresis",
    "moved_base": r"base|moved",
    "bump": r"bump|base|moved|dwell",
    "fixture": r"fixture|scale|level|index",
    "scale": r"fixture|scale",
    "one_way": r"one-way|one direction",
    "codes": "",
}


@system("placing_table", PLACING)
def placing_table(rng: np.random.Generator, fault: str) -> Case:
    step = 30.0 if fault == "coarse" else float(rng.choice([2.0, 3.0, 5.0]))
    if fault != "coarse" and rng.random() < 0.3:
        step = 1.0
    up = np.arange(0.0, 90.0 + step / 2, step)
    angles = up if fault == "one_way" else np.concatenate([up, up[::-1][1:]])
    angles = (
        np.concatenate([angles, angles[1:]]) if fault == "clean" and rng.random() < 0.3 else angles
    )
    course = Course.of(len(angles), 3.0, 1.0, 20.0)
    shown = course.follow(angles + rng.normal(0, 2 * ARCSEC / DEG, len(angles)))
    beta = shown * DEG
    sigma = 10 ** rng.uniform(1.7, 2.6) * UG
    amplitude = (rng.uniform(300, 3000) if fault != "coarse" else rng.uniform(2000, 4000)) * UG
    phase = rng.uniform(0, 6.28, 3)

    def law(b):
        waves = sum(amplitude / (n * n) * np.cos(n * b + phase[n - 1]) for n in (1, 2, 3))
        return 2 * amplitude + waves

    force = np.column_stack([-G * np.sin(beta), np.zeros(len(beta)), G * np.cos(beta)])
    values = force + rng.normal(0, sigma, force.shape)
    values[:, 1] += law(beta)
    t = course.time / course.time[-1]
    rising = np.gradient(course.follow(angles)) > 0
    if fault == "warm_up":
        values[:, 1] += decaying(course.time, rng.uniform(20, 80) * sigma, course.time[-1] / 6)
    if fault == "hysteresis":
        half = np.where(t < 0.5, 1.0, -1.0)
        values[:, 1] += half * rng.uniform(3, 10) * sigma * np.sin(np.pi * beta / (90 * DEG))
    if fault == "moved_base":
        values[:, 1] += np.where(t > rng.uniform(0.2, 0.8), rng.uniform(5, 30) * sigma, 0.0)
    if fault == "bump":
        where = rng.uniform(0.1, 0.8)
        values[:, 1] += np.where((t > where) & (t < where + 0.1), rng.uniform(5, 30) * sigma, 0.0)
    if fault == "fixture":
        lean = rng.uniform(500, 2000) * ARCSEC
        values[:, [0, 2]] = values[:, [0, 2]] + lean * np.column_stack(
            [values[:, 2], -values[:, 0]]
        )
    if fault == "scale":
        values[:, 0] *= 1 + rng.choice([-1, 1]) * rng.uniform(0.01, 0.05)
    if fault == "codes":
        values = to_codes(values, sigma * rng.uniform(2, 5))
    if fault == "dead":
        values[:, 1] = 0.0
    assert rising.any()
    grid = np.arange(0.0, 91.0, 1.0)
    return Case(
        "placing_table",
        "placing",
        [{"name": "accel", "kind": "accelerometer", "rate_hz": 20.0}],
        course.time,
        {
            "table_outer_deg": shown,
            **{f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")},
        },
        {f"table accel.y {a:g}": float(v) for a, v in zip(grid, law(grid * DEG))},
        fault,
        PLACING.get(fault, ""),
    )
