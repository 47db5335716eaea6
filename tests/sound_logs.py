"""Sound logs of many kinds, by numpy alone: what checks of the data must not find fault with."""

import numpy as np

G0 = 9.80665
UNITS = {"m_s2": 1.0, "g": 1 / G0, "mg": 1000 / G0, "LSB": 16384 / G0}
RATES = {"rad_s": 1.0, "deg_s": 180 / np.pi, "LSB": 131 * 180 / np.pi}
TILTS = {"deg": 180 / np.pi, "arcsec": 648000 / np.pi}


def smooth_course(rng, knots, n, still):
    """Angles that rest and move in turn, rad, (n,)."""
    stops = np.repeat(rng.uniform(-np.pi, np.pi, knots), 2)
    times = np.linspace(0, n, 2 * knots)
    times[1:-1:2] += still * n / knots
    return np.interp(np.arange(n), np.sort(times), stops)


def attitude(rng, n):
    """Direction of up in the body, (n, 3)."""
    a = smooth_course(rng, int(rng.integers(4, 14)), n, rng.uniform(0.1, 0.4))
    b = smooth_course(rng, int(rng.integers(4, 14)), n, rng.uniform(0.1, 0.4))
    return np.column_stack([np.cos(a) * np.sin(b), np.sin(a), np.cos(a) * np.cos(b)]), a, b


def rounded(rng, values, noise):
    """Values written in codes or digits that are fine beside their noise; or not rounded."""
    share = rng.choice([0.0, 0.03, 0.3, 0.6])
    lsb = share * noise
    return values if lsb == 0 else np.round(values / lsb) * lsb


def sound_log(rng):
    """Stamps, s, and columns of a sound log."""
    n = int(rng.integers(600, 6000))
    rate = float(rng.choice([10.0, 20.0, 50.0, 100.0]))
    time = np.arange(n) / rate + rng.choice([0.0, 1.6e9])
    if rng.random() < 0.3:
        time = time + rng.uniform(-0.2, 0.2, n) / rate  # jitter
    up, a, b = attitude(rng, n)
    columns = {}
    kind = rng.choice(["triad", "pair", "tilt"])
    if kind == "tilt":
        unit = str(rng.choice(list(TILTS)))
        noise = 10 ** rng.uniform(-5, -3)
        for i, axis in enumerate("xy"):
            tilt = np.arcsin(up[:, i]) + noise * rng.normal(size=n)
            columns[f"incl_{axis}_{unit}"] = rounded(rng, tilt, noise) * TILTS[unit]
    else:
        unit = str(rng.choice(list(UNITS)))
        noise = G0 * 10 ** rng.uniform(-5, -2.3)
        for i, axis in enumerate("xyz" if kind == "triad" else "xy"):
            force = G0 * up[:, i] + noise * rng.normal(size=n) + rng.normal(0, 0.1)
            columns[f"accel_{axis}_{unit}"] = rounded(rng, force, noise) * UNITS[unit]
    if rng.random() < 0.5:
        unit = str(rng.choice(list(RATES)))
        noise = 10 ** rng.uniform(-4, -2)
        for i, axis in enumerate("xyz"):
            turn = np.gradient(up[:, i]) * rate + noise * rng.normal(size=n)
            columns[f"gyro_{axis}_{unit}"] = rounded(rng, turn, noise) * RATES[unit]
    if rng.random() < 0.5:
        columns["table_outer_deg"] = np.round(np.degrees(a), 4)
        columns["table_inner_deg"] = np.round(np.degrees(b), 4)
    if rng.random() < 0.5:
        warm = 20 + 5 * np.sin(np.arange(n) / n * 3) + 0.02 * rng.normal(size=n)
        columns["temperature_degC"] = np.round(warm, int(rng.integers(1, 4)))
    return time, columns
