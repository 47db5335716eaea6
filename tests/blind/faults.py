"""Faults of the data: what a logger, a converter or an operator does to the rows of a file."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.laboratory import Lab
from blind.rotations import DEG, G0


@dataclass
class Rows:
    """The rows of a file, SI. t: (n,), table: (n, axes), y: (n, channels), T: (n,)."""

    t: np.ndarray
    table: np.ndarray
    y: np.ndarray
    T: np.ndarray


@dataclass(frozen=True)
class Fault:
    """One fault in one laboratory: ``make(rng, lab, rows)`` changes the rows and says what it
    did.
    """

    id: str
    stage: str
    where: tuple[str, ...]
    make: Callable[[np.random.Generator, Lab, Rows], dict[str, Any]]
    before_noise: bool = False


def _strong(lab: Lab, rows: Rows) -> list[int]:
    """Channels that sense much: a fault of theirs shows."""
    limit = {"accelerometer": 3.0, "inclinometer": 0.2, "gyro": 0.25, "fog": 0.15}
    return [
        c
        for c, (s, _) in enumerate(lab.channels)
        if rows.y[:, c].std() > limit[lab.sensors[s].kind]
    ]


def _axis(lab: Lab, c: int) -> dict[str, Any]:
    s, i = lab.channels[c]
    return {"sensor": lab.sensors[s].name, "axis": lab.sensors[s].axes[i]}


def sign(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """One channel upside down."""
    c = int(rng.choice(_strong(lab, rows)))
    rows.y[:, c] *= -1
    return _axis(lab, c)


def swap(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """Two channels of a triad change places."""
    triad = int(rng.choice([s for s, x in enumerate(lab.sensors) if len(x.axes) == 3]))
    a, b = rng.choice([c for c, (s, _) in enumerate(lab.channels) if s == triad], 2, replace=False)
    rows.y[:, [a, b]] = rows.y[:, [b, a]]
    return {**_axis(lab, int(a)), "with": _axis(lab, int(b))["axis"]}


def unit(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """A whole sensor in another unit than the column says."""
    s = int(rng.integers(len(lab.sensors)))
    factor = float(
        rng.choice([G0, 1 / G0] if lab.sensors[s].kind == "accelerometer" else [DEG, 1 / DEG])
    )
    for c, (k, _) in enumerate(lab.channels):
        rows.y[:, c] *= factor if k == s else 1.0
    return {"sensor": lab.sensors[s].name, "factor_unitless": factor}


def stuck(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """One channel repeats a value for a while."""
    c = int(rng.integers(len(lab.channels)))
    start, length = rng.uniform(0.2, 0.7) * rows.t[-1], rng.uniform(6, 20)
    a, b = np.searchsorted(rows.t, [start, start + length])
    rows.y[a:b, c] = rows.y[a, c]
    return {
        **_axis(lab, c),
        "start_s": start,
        "length_s": length,
        "interval_s": [start, start + length],
    }


def duplicate(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """Some samples are the one before."""
    share = rng.uniform(0.02, 0.08)
    for k in np.flatnonzero(rng.random(len(rows.t)) < share):
        rows.y[k] = rows.y[max(k - 1, 0)]
    return {"sensor": "", "share_unitless": share}


def outlier(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """Gross values in one channel."""
    c, share, size = (
        int(rng.integers(len(lab.channels))),
        rng.uniform(0.003, 0.02),
        rng.uniform(15, 60),
    )
    hit = rng.random(len(rows.t)) < share
    rows.y[hit, c] += rng.choice([-1, 1], hit.sum()) * size * lab.sensors[lab.channels[c][0]].sigma
    return {**_axis(lab, c), "share_unitless": share, "size_sigma": size}


def drop(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """Samples of all sensors lost at an instant; the rest moved up, against the table's time."""
    lost, at = int(rng.integers(4, 40)), int(rng.uniform(0.2, 0.7) * len(rows.t))
    n = len(rows.t) - lost
    rows.y = np.vstack([rows.y[:at], rows.y[at + lost :]])
    rows.t, rows.table, rows.T = rows.t[:n], rows.table[:n], rows.T[:n]
    return {
        "sensor": "",
        "samples": lost,
        "time_s": float(rows.t[at]),
        "interval_s": [float(rows.t[at]), None],
    }


def label(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """The angle of one dwell is wrong."""
    k, (a, b) = (
        int(rng.integers(len(lab.axes))),
        lab.track.dwells[int(rng.integers(3, len(lab.track.dwells) - 3))],
    )
    error = rng.choice([-1, 1]) * rng.uniform(0.1, 2) * DEG
    rows.table[(rows.t >= a) & (rows.t <= b), k] += error
    return {
        "sensor": "",
        "axis": lab.axis_names[k],
        "error_arcsec": error / DEG * 3600,
        "interval_s": [a, b],
    }


def clip(kinds: tuple[str, ...]) -> Callable[[np.random.Generator, Lab, Rows], dict[str, Any]]:
    """One channel of such a sensor saturates."""

    def make(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
        c = int(
            rng.choice(
                [c for c in _strong(lab, rows) if lab.sensors[lab.channels[c][0]].kind in kinds]
            )
        )
        limit = rng.uniform(0.6, 0.95) * np.abs(rows.y[:, c]).max()
        rows.y[:, c] = np.clip(rows.y[:, c], -limit, limit)
        return {**_axis(lab, c), "full_scale_si": limit}

    return make


def codes(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """A whole sensor in coarse codes."""
    s = int(rng.integers(len(lab.sensors)))
    lsb = rng.uniform(3, 12) * lab.sensors[s].sigma
    for c, (k, _) in enumerate(lab.channels):
        rows.y[:, c] = np.round(rows.y[:, c] / lsb) * lsb if k == s else rows.y[:, c]
    return {"sensor": lab.sensors[s].name, "lsb_si": lsb}


def bit(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """One bit of a channel always reads 0."""
    c = int(rng.choice(_strong(lab, rows)))
    lsb, n = 0.5 * lab.sensors[lab.channels[c][0]].sigma, int(rng.integers(4, 8))
    code = np.round(rows.y[:, c] / lsb).astype(np.int64)
    rows.y[:, c] = np.where(code >= 0, code & ~(1 << n), -((-code) & ~(1 << n))) * lsb
    return {**_axis(lab, c), "bit_value_si": lsb * 2**n}


def jitter(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """Stamps wrong by chance: readings taken a little earlier or later."""
    sigma = rng.uniform(4, 15) * 1e-3
    rows.y = (
        rows.y + np.gradient(rows.y, rows.t, axis=0) * rng.normal(0, sigma, len(rows.t))[:, None]
    )
    return {"sensor": "", "jitter_ms": sigma * 1e3}


def truncation(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """Too few decimals in the readout."""
    step_deg = float(rng.choice([0.05, 0.1, 0.2]))
    rows.table = np.trunc(rows.table / DEG / step_deg) * step_deg * DEG
    return {"sensor": "", "step_deg": step_deg}


def sense(rng: np.random.Generator, lab: Lab, rows: Rows) -> dict[str, Any]:
    """The outer angle counted the other way."""
    rows.table[:, 0] *= -1
    return {"sensor": "", "axis": lab.axis_names[0]}


CLIPPED = {"acc_saturation": ("accelerometer", "inclinometer"), "gyr_saturation": ("gyro",)}


def faults(lab: Lab, rows: Rows) -> list[Fault]:
    """Those that this laboratory can have, and that show in it."""
    time, sample = ("time", "sample"), ("sample", "time", "tilt", "rate")
    every = [
        Fault("data_stuck", "data", time, stuck),
        Fault("data_duplicate", "data", sample, duplicate),
        Fault("data_outlier", "data", sample, outlier),
        Fault("adc_quantisation", "electronics", sample, codes),
    ]
    if _strong(lab, rows):
        kind = {lab.sensors[lab.channels[c][0]].kind for c in _strong(lab, rows)}
        every += [
            Fault("data_sign", "data", ("tilt", "rate"), sign),
            Fault("data_unit", "data", ("tilt", "rate"), unit),
        ]
        if not lab.unlocked and lab.kind != "six_any":
            every += [Fault("adc_stuck_bit", "electronics", sample, bit)]
            every += [
                Fault(i, "sensor", sample, clip(k)) for i, k in CLIPPED.items() if kind & set(k)
            ]
    if lab.table in ("dual", "three") and not lab.unlocked:
        every += [
            Fault("data_axis_swap", "data", ("tilt", "rate"), swap),
            Fault("data_rotation_sense", "data", ("table_outer", "tilt", "rate"), sense),
        ]
    if lab.table in ("dual", "three", "placing") and not lab.unlocked:
        every += [
            Fault(
                "data_pose_label",
                "data",
                ("table_outer", "table_inner", "time", "move", "table_middle"),
                label,
            ),
            Fault("data_drop", "data", time, drop),
            Fault("data_truncation", "data", (*sample, "table_outer", "table_inner"), truncation),
            Fault("data_jitter", "timing", ("rate", "time", "sample"), jitter, before_noise=True),
        ]
    return every
