"""Accelerometer triads: faces of a cube with labels (six_position), free attitudes (norm)."""

import numpy as np

from examiner.case import DEG, UG, Case, Course, G, decaying, rotation, system, to_codes

FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]
UNITS = {"unit_g": 1 / 9.80665, "unit_mg": 1000 / 9.80665, "unit_counts": 16384 / 9.80665}

COMMON = {
    "dead": r"dead|constant|disconnect",
    "clipped": r"saturat|clip|range",
    "frozen": r"frozen|repeat|constant|stuck|saturat|stays",
    "unit_g": r"unit.*\bg\b|in g\b",
    "unit_mg": r"unit.*\bmg\b|in mg",
    "unit_counts": r"unit.*(count|LSB)",
    "drift": r"drift|warm",
    "codes": "",
}


def up_of(label: str) -> np.ndarray:
    up = np.zeros(3)
    up["xyz".index(label[1])] = 1 if label[0] == "+" else -1
    return up


def read(rng, course, up, bias, M, fault, k2=None):
    """Readings of a triad in SI, with the fault; and what the file calls them."""
    force = G * course.turned(up)
    sigma = 10 ** rng.uniform(np.log10(50), np.log10(2000)) * UG
    values = bias + force @ M.T + rng.normal(0, sigma, (len(force), 3))
    if k2 is not None:
        values[:, :] += k2 * (force / 9.80665) ** 2
    if fault == "drift":
        total = (10 ** rng.uniform(1.2, 2)) * sigma  # over the log
        axis = rng.integers(3)
        slope = total * (course.time - course.time[0]) / np.ptp(course.time)
        values[:, axis] += slope * rng.choice([-1, 1])
    if fault == "warm_up":
        values += decaying(course.time, 40 * sigma, np.ptp(course.time) / 3)[:, None]
    if fault == "codes":
        values = to_codes(values, sigma * rng.uniform(2, 6))
    axis = rng.integers(3)
    if fault == "dead":
        values[:, axis] = rng.choice([0.0, 0.0, 3.7])
    if fault == "clipped":
        values[:, axis] = np.clip(values[:, axis], -0.8 * G, 0.8 * G)
    if fault == "frozen":
        start = int(len(values) * rng.uniform(0.3, 0.8))
        values[start:, axis] = values[start, axis]
    if fault in UNITS:
        values = values * UNITS[fault]
        if fault == "unit_counts":
            values = np.round(values)
    return values, sigma


def matrix(rng, scale=0.3, cross=0.03):
    return (
        np.eye(3)
        + np.diag(rng.uniform(-scale, scale, 3))
        + rng.uniform(-cross, cross, (3, 3)) * (1 - np.eye(3))
    )


def truth_of(name, bias, M):
    found = {f"{name}.bias_{a}": bias[i] for i, a in enumerate("xyz")}
    found |= {f"{name}.scale_{a}": M[i, i] - 1 for i, a in enumerate("xyz")}
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            if i != j:
                found[f"{name}.cross_{a}{b}"] = M[i, j]
    return found


SIX = COMMON | {
    "sign": r"sign|column",
    "columns": r"column|swap",
    "swapped_faces": r"swap|exchang|label|stated",
    "wrong_face": r"stated|label|reads",
    "one_face_missing": r"no pose within|missing|cannot|single",
    "K2": r"quadratic|second order|K2",
    "one_face_tilted": r"dwell|face|pose|level",
}


@system("six_position", SIX)
def six_position(rng: np.random.Generator, fault: str) -> Case:
    names = FACES * rng.integers(1, 3)
    if rng.random() < 0.5:
        names = list(rng.permutation(names))
    if fault == "drift":
        names = names + names[:1]
    if fault == "one_face_missing":
        missing = rng.choice(FACES)
        names = [n for n in names if n != missing] * 2
    large = fault in ("clean", "codes") or rng.random() < 0.5
    bias = rng.uniform(-1, 1, 3) * (G if large else 0.05)
    M = matrix(rng, 0.3 if large else 0.02, 0.02)
    if fault in UNITS:
        M = matrix(rng, 0.1, 0.01)
        bias = rng.uniform(-0.5, 0.5, 3)
    up = np.array([up_of(n) for n in names])
    if fault == "one_face_tilted":
        k = rng.integers(len(up))
        up[k] = rotation("xyz"[rng.integers(3)], rng.uniform(0.5, 3) * DEG) @ up[k]
        if np.allclose(up[k], up_of(names[k])):
            up[k] = rotation("xyz"[("xyz".index(names[k][1]) + 1) % 3], 2 * DEG) @ up_of(names[k])
    k2 = np.array([rng.uniform(1000, 5000) * UG, 0, 0]) if fault == "K2" else None
    if k2 is not None:
        names, up = [*names, "+x", "-x"], np.vstack([up, up_of("+x"), up_of("-x")])
        extra = [
            f"[{a:.6f}, {b:.6f}, 0]" for a, b in ((0.7071068, 0.7071068), (0.7071068, -0.7071068))
        ]
        names += extra
        up = np.vstack([up, [[0.70710678, 0.70710678, 0], [0.70710678, -0.70710678, 0]]])
    course = Course.of(len(up), rng.uniform(4, 10), 2.0, 20.0)
    values, _ = read(rng, course, up, bias, M, fault, k2)
    labels = list(names)
    if fault == "swapped_faces":
        i = rng.integers(len(labels) - 1)
        labels[i], labels[i + 1] = labels[i + 1], labels[i]
        if labels[i] == labels[i + 1]:
            labels[i] = next(f for f in FACES if f != labels[i])
    if fault == "wrong_face":
        i = rng.integers(len(labels))
        labels[i] = rng.choice([f for f in FACES if f != labels[i]])
    columns = {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")}
    if fault == "sign":
        columns["accel_y_m_s2"] = -columns["accel_y_m_s2"]
    if fault == "columns":
        columns["accel_x_m_s2"], columns["accel_z_m_s2"] = (
            columns["accel_z_m_s2"],
            columns["accel_x_m_s2"],
        )
    return Case(
        "six_position",
        "handheld",
        [{"name": "accel", "kind": "accelerometer", "rate_hz": 20.0}],
        course.time,
        columns,
        truth_of("accel", bias, M),
        fault,
        SIX.get(fault, ""),
        course.labels(labels),
    )


NORM = COMMON | {
    "few_sides": r"direction|pose|attitude|side",
    "too_few": r"dwell|redundant|determine",
}


@system("norm", NORM)
def norm(rng: np.random.Generator, fault: str) -> Case:
    n = int(rng.integers(14, 30))
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    turn = k * np.pi * (3 - np.sqrt(5))
    up = np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    up = up @ rotation("z", rng.uniform(0, 6)).T @ rotation("x", rng.uniform(0, 6)).T
    if rng.random() < 0.5 and fault != "drift":
        up = up[rng.permutation(n)]
    if fault == "few_sides":
        up[:, 2] = np.abs(up[:, 2]) * 0.3
        up /= np.linalg.norm(up, axis=1)[:, None]
    if fault == "too_few":
        up = up[:9]
    large = rng.random() < 0.5 and fault not in UNITS
    bias = rng.uniform(-1, 1, 3) * (0.5 * G if large else 0.05)
    M = np.eye(3) + np.diag(rng.uniform(-1, 1, 3)) * (0.3 if large else 0.02)
    C = rng.uniform(-0.01, 0.01, (3, 3))
    M += np.triu(C, 1) + np.triu(C, 1).T
    course = Course.of(len(up), rng.uniform(4, 10), 2.0, 20.0)
    values, _ = read(rng, course, up, bias, M, fault)
    return Case(
        "norm",
        "handheld",
        [{"name": "accel", "kind": "accelerometer", "rate_hz": 20.0}],
        course.time,
        {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")},
        truth_of("accel", bias, M),
        fault,
        NORM.get(fault, ""),
    )
