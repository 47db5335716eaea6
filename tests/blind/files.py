"""The files of a case, as an honest user has them: recording and scenario; and the noise-free one
that only judges.
"""

from pathlib import Path

import numpy as np

from blind.cases import channel_names
from blind.faults import Rows
from blind.laboratory import Lab
from blind.nuisance import Nuisance
from blind.rotations import ARCSEC, DEG, G0

UNITS = {
    "m_s2": 1.0,
    "g": G0,
    "mg": 1e-3 * G0,
    "deg": DEG,
    "arcsec": ARCSEC,
    "deg_s": DEG,
    "rad_s": 1.0,
    "deg_h": DEG / 3600,
}
TITLES = {
    "dual": "dual-axis tumble",
    "placing": "placing-angle sweep",
    "vertical": "vertical table",
    "three": "three-axis rates",
    "handheld": "by hand",
}


def write_recording(path: Path, lab: Lab, rows: Rows, rng: np.random.Generator | None) -> None:
    """A recording in CSV. ``rng`` None: nothing is missing."""
    own = (lab.noise.nuisance if rng is not None else None) or Nuisance("none")
    stamps = own.written(rows.t) if own.written else rows.t
    columns, head, blank = [stamps], ["time_s"], [np.zeros(len(rows.t), bool)]
    if lab.written:
        between = _between(lab, rows.t) if lab.unlocked else blank[0]
        for k, name in enumerate(lab.axis_names):
            columns.append(np.round(rows.table[:, k] / DEG, 5))
            head.append(f"table_{name}_deg")
            blank.append(between)
    formats = ["%.7f" if own.stamps else "%.4f"] + ["%.5f"] * (len(head) - 1)
    empty = (
        own.empty(rng, len(rows.t), len(lab.channels)) if own.empty and rng is not None else None
    )
    for c, (name, (s, _)) in enumerate(zip(channel_names(lab), lab.channels, strict=True)):
        unit = lab.sensors[s].unit
        columns.append(rows.y[:, c] / UNITS[unit])
        head.append(f"{name}_{unit}")
        step = lab.sensors[s].sigma / UNITS[unit] * (own.coarse or 1 / 30)
        decimals = 9 if rng is None else max(0, int(np.ceil(-np.log10(step))))
        formats.append(f"%.{decimals}f")
        blank.append(rng.random(len(rows.t)) < lab.noise.missing if rng is not None else blank[0])
        blank[-1] = blank[-1] | empty[:, c] if empty is not None else blank[-1]
    columns.append(rows.T)
    head.append("temperature_degC")
    formats.append("%.2f")
    blank.append(np.arange(len(rows.t)) % int(lab.rate_hz) != 0)
    cells = [
        np.where(b, "", np.char.mod(f, x)) for f, x, b in zip(formats, columns, blank, strict=True)
    ]
    lines = [",".join(row) for row in zip(*(c.tolist() for c in cells), strict=True)]
    path.write_text(
        f"# set-up: {TITLES[lab.table]}\n{','.join(head)}\n" + "\n".join(lines) + "\n",
        encoding="utf-8",
    )


def _between(lab: Lab, t: np.ndarray) -> np.ndarray:
    """Rows at which the head is unlocked."""
    rest = np.zeros(len(t), bool)
    for a, b in lab.track.dwells:
        rest |= (t >= a) & (t <= b)
    return ~rest


def write_scenario(path: Path, lab: Lab) -> None:
    """What the scenario states: nothing of what is concealed."""
    lever = ", ".join(f"{x:.4f}" for x in lab.lever)
    text = [
        f'schema = 1\nname = "{TITLES[lab.table]}"\n\n[site]\ngravity_m_s2 = {lab.gravity:.6f}\n',
        f"latitude_deg = {lab.latitude:.4f}\n",
        f'[rig]\ntable = "{lab.table}"\nreadout = "{lab.readout}"\nlever_arm_m = [{lever}]\n',
    ]
    for s in lab.sensors:
        axes = ", ".join(f'"{a}"' for a in s.axes)
        own = (
            ""
            if s.input_axis is None
            else "input_axis = [" + ", ".join(f"{x:.9f}" for x in s.input_axis) + "]\n"
        )
        adjustable = ", ".join(f'"{a}"' for a in s.adjustable)
        text.append(
            f'[[sensor]]\nname = "{s.name}"\nkind = "{s.kind}"\naxes = [{axes}]\n{own}rate_hz ='
            f" {s.rate_hz}\nadjustable = [{adjustable}]\n"
        )
    path.write_text("\n".join(text), encoding="utf-8")
