"""S0: zero bias against the placing angle, from sweeps on a table whose axis lies along the
sensitive axis.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.calibration.bias_table import LOOKUPS
from tiltcal.calibration.methods.common import leave_out_rms, pick_sensor, wrap_up
from tiltcal.calibration.methods.placing_checks import channel_tests, require_mounting
from tiltcal.calibration.methods.placing_sweep import (
    AxisTable,
    Table,
    find_sweeps,
    mounting_of,
    solve_axis,
    split_at_remounts,
)
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import PLACING, angle_channel
from tiltcal.statistics.least_squares import Fit, linear_fit

NAME = "placing_table"
ORDERS = (1, 2, 3, 4)
READOUT = angle_channel(PLACING.axis_names[0])
REPEATED = 0.5  # of the angles; with fewer repeated visits the drift is hardly known
REMOUNT = {"x": "Rz(90)", "y": "identity"}


def placing_table(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    lookup: str = "interpolated",
    harmonics: int | None = None,
) -> Calibration:
    """Zero bias of x and y against the placing angle, as tables and as a smooth fit, from
    up-and-down sweeps.

    Model: with an axis along the table's, ``reading = b(beta) + d (t - t_mid)``, beta the turn
    about that axis, equal to table_outer. Mounted as it stands the y axis lies so, after a remount
    by Rz(90) the x axis; Rz(180), Rz(-90) turn them round and split the table's own tilt off.
    Smooth fit: ``b = b0 + sum c_n cos(n beta) + s_n sin(n beta)``.

    Args:
        recording: dwells every degree or so, up and down, with table_outer; remounts in the
            metadata.
        setup: table ``placing``, an accelerometer or inclinometer with x and y.
        segments: dwells to use.
        sensor: which, when several fit.
        lookup: how ``correct`` reads the table: interpolated, rounded (the patent's) or smooth.
        harmonics: of the smooth fit; unless given the fewest from 2 to 4 that describe the table.

    Raises:
        TiltcalError: another table, no angles, readings that contradict the stated mounting, an
            unknown option.

    Errors:
        The table's axis: its levelling and wobble enter one to one (split off by the 180 deg
            remount, but for what is odd in the table's angle), its index error e only as b' e.
            Cross-axis terms are inside the table as measured, at 1 g across the axis; at a tilt t
            of its own an axis has 1 - cos t less of them. Interpolation: step^2/8 max b''.

    Source: seed S0 (patent on zero-bias correction by placing angle); PHYSICS 6 (0).
    """
    used = _require(recording, setup, sensor, lookup, harmonics)
    found = split_at_remounts(
        find_segments(recording) if segments is None else segments, recording, setup
    )
    poses = find_poses(recording, setup, used, found)
    known = np.asarray(~np.isnan(poses.up).any(axis=1))
    if not known.any():
        raise TiltcalError(
            recording.source,
            found=f"dwells without a readout of {READOUT}",
            need="the angle of every dwell",
            do=f"record {READOUT}_deg",
        )
    poses = poses.subset(known)
    require_mounting(
        poses, mounting_of(poses, recording, setup)[0], setup.site.gravity, recording.source
    )
    axes, notes = _axes(poses, recording, setup)
    tests = [*channel_tests(poses, setup.site.gravity), *_sweep_tests(axes)]
    smooth, more_tests, more_notes = _smooth(axes, used, harmonics)
    fit = _together(axes, smooth)
    chi2 = chi2_test(
        "fit",
        fit.chi2,
        fit.dof,
        f"visits of the same angle repeat within their noise ({fit.dof} spare)",
    )
    widen = fit.chi2_per_dof if not chi2.passed and fit.chi2_per_dof > 1 else 1.0
    tests = [chi2, *tests, *more_tests]
    rms = leave_out_rms([_left_out(a) for a in axes])
    result = wrap_up(
        NAME,
        verdict_of(tests),
        fit,
        ["m_s2"] * len(fit.names),
        tests,
        [*notes, *_advice(axes, setup), *more_notes],
        poses,
        recording,
        equation=(
            f"{used.name}_i = f_i + b_i(beta_i), beta_x = atan2(f_y, f_z), beta_y = atan2(-f_x,"
            " f_z)"
        ),
        inverse=f"f_i = {used.name}_i - b_i(beta_i), b {lookup}, beta from the other axis",
        heldout={used.name: rms},
    )
    return replace(
        result,
        bias_tables={f"{used.name}.{a.axis}": _entries(a, widen) for a in axes},
        lookup=lookup,
    )


def _require(
    recording: Recording, setup: Setup, sensor: str | None, lookup: str, harmonics: int | None
) -> Sensor:
    if setup.rig.directions != PLACING.directions:
        raise TiltcalError(
            f"method {NAME}",
            found=f"table {setup.rig.table}",
            need=f"table {PLACING.name}: one horizontal axis along the sensitive axis",
            do="correct rig.table, or use six_position",
        )
    if lookup not in LOOKUPS:
        raise TiltcalError(
            f"method {NAME}, option lookup",
            found=str(lookup),
            need=" or ".join(LOOKUPS),
            do="correct it",
        )
    if harmonics is not None and harmonics not in ORDERS:
        raise TiltcalError(
            f"method {NAME}, option harmonics",
            found=str(harmonics),
            need="1, 2, 3 or 4",
            do="correct it",
        )
    used = pick_sensor(setup, recording, ("accelerometer", "inclinometer"), sensor, NAME)
    if not {"x", "y"} <= set(used.axes):
        raise TiltcalError(
            f"method {NAME}",
            found=f"axes {', '.join(used.axes)} of {used.name}",
            need="x and y: each gives the other's angle",
            do="add the other channel",
        )
    return used


def _axes(poses: Poses, recording: Recording, setup: Setup) -> tuple[list[AxisTable], list[str]]:
    """Tables of the axes that were swept, with notes."""
    tables, notes = [], []
    for axis in ("x", "y"):
        sweeps, grid, off = find_sweeps(poses, recording, setup, axis)
        notes += off
        if sweeps and len(np.unique(np.concatenate([s.node for s in sweeps]))) >= 3:
            tables.append(solve_axis(axis, sweeps, grid))
    if not tables or any(len(a.sensor.node) < 3 for a in tables):
        raise TiltcalError(
            recording.source,
            found="fewer than three placing angles of any axis, with x or y along the table's axis",
            need="a sweep with the y axis along it (mount identity) or the x axis (Rz(90))",
            do="sweep outer 0 ... 90 ... 0 deg by 1 deg, and state the mounting",
        )
    return tables, notes


def _sweep_tests(axes: Sequence[AxisTable]) -> list[Test]:
    """One-way sweeps and missing angles, by name."""
    one_way = [a.axis for a in axes if any(s.repeated < REPEATED for s in a.sweeps)]
    least = min(s.both_ways for a in axes for s in a.sweeps)
    said = (
        f"one-way sweep of axis {' and '.join(one_way)}: a linear drift of the zero passes whole"
        " into the table and nothing shows it; sweep up and down"
        if one_way
        else (
            f"{100 * least:.0f} % of the inner angles were approached from both sides, a linear"
            " drift is taken off"
        )
    )
    missing = {a.axis: a.missing for a in axes if a.missing}
    words = "; ".join(
        f"axis {x}: {', '.join(f'{m:.4g}' for m in angles[:12])} deg"
        for x, angles in missing.items()
    )
    ranges = "; ".join(
        f"axis {a.axis}: {a.angles[0] / DEG:.4g} ... {a.angles[-1] / DEG:.4g} deg" for a in axes
    )
    count = sum(map(len, missing.values()))
    return [
        Test("up and down", least, len(axes), float(not one_way), not one_way, said),
        Test(
            "angles complete",
            float(count),
            0,
            float(not count),
            not count,
            (
                f"no dwell at {words}: bridged by their neighbours"
                if count
                else f"every step was visited ({ranges})"
            ),
        ),
    ]


def _advice(axes: Sequence[AxisTable], setup: Setup) -> list[str]:
    """What the tables hold and may not be extended to, what is in them, and what to record next."""
    notes = []
    for a in axes:
        first, last = a.angles[[0, -1]] / DEG
        notes.append(
            f"the table of axis {a.axis} holds for placing angles {first:.4g} ... {last:.4g} deg;"
            " beyond, in negative or mirrored quadrants, the bias is another one: those samples"
            " are left empty"
        )
        drifts = ", ".join(
            f"{60 * t.drift / setup.site.gravity * 1e6:.3g} ug/min"
            for t in a.solved
            if t.drift is not None
        )
        if drifts:
            notes.append(f"drift of axis {a.axis}, taken off: {drifts}")
        if not any(s.both_ways > 0.5 for s in a.sweeps) and all(
            t.drift is not None for t in a.solved
        ):
            notes.append(
                f"axis {a.axis} was swept in one direction each time: hysteresis does not show"
            )
        if a.axle is None:
            notes.append(
                "the tilt and wobble of the table's own axis are inside the table of axis"
                f" {a.axis}; a second sweep, turned round by a remount of 180 deg, splits them off"
            )
        else:
            lean, sigma = _lean(a.axle)
            notes.append(
                f"table split from sensor on axis {a.axis}: the table's axis leans by"
                f" {lean / setup.site.gravity / ARCSEC:.4g} +-"
                f" {sigma / setup.site.gravity / ARCSEC:.2g} arcsec, taken off"
            )
    for axis in {"x", "y"} - {a.axis for a in axes}:
        notes.append(
            f"axis {axis} has no table: remount ({REMOUNT[axis]}) and sweep again; its reading is"
            " passed on as it is"
        )
    return notes


def _lean(axle: Table) -> tuple[float, float]:
    """Mean elevation of the table's axis as a reading and its uncertainty, m/s2."""
    n = len(axle.value)
    return float(np.mean(axle.value)), float(np.sqrt(axle.covariance.sum()) / n)


def _smooth(
    axes: Sequence[AxisTable], sensor: Sensor, harmonics: int | None
) -> tuple[dict[str, Fit], list[Test], list[str]]:
    """The smooth fit of each axis with its test; without a fit that holds there is none."""
    fits: dict[str, Fit] = {}
    tests, notes = [], []
    for a in axes:
        whiten = np.linalg.inv(np.linalg.cholesky(a.sensor.covariance))
        for order in ORDERS[1:] if harmonics is None else (harmonics,):
            names = smooth_names(sensor.name, a.axis, order)
            if len(names) > len(a.angles):
                break
            fit = linear_fit(names, whiten @ basis(a.angles, order), whiten @ a.sensor.value)
            test = chi2_test(
                f"smooth fit of {a.axis}",
                fit.chi2,
                fit.dof,
                f"{len(names)} terms describe {len(a.angles)} entries (variance"
                f" {len(names) / len(a.angles):.2g} of an entry's)",
            )
            if test.passed or harmonics is not None:
                fits[a.axis] = fit
                tests.append(test)
                break
        else:
            notes.append(
                f"no smooth fit of up to {ORDERS[-1]} harmonics describes the table of axis"
                f" {a.axis}"
            )
    return fits, tests, notes


def smooth_names(sensor: str, axis: str, order: int) -> list[str]:
    """``bias_y, cos1_y, sin1_y, ...`` of a sensor."""
    waves = [f"{sensor}.{part}{n}_{axis}" for n in range(1, order + 1) for part in ("cos", "sin")]
    return [f"{sensor}.bias_{axis}", *waves]


def basis(beta: Array, order: int) -> Array:
    """1, cos beta, sin beta, cos 2 beta, ... (n, 2 order + 1)."""
    waves = [part(n * beta) for n in range(1, order + 1) for part in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(beta), *waves])


def _together(axes: Sequence[AxisTable], smooth: dict[str, Fit]) -> Fit:
    """The smooth parameters of all axes as one Fit; its residuals are those of the single
    visits.
    """
    names = [n for f in smooth.values() for n in f.names]
    values = np.concatenate([f.values for f in smooth.values()]) if smooth else np.zeros(0)
    covariance = np.zeros((len(names), len(names)))
    at = 0
    for f in smooth.values():  # sweeps of different axes share no sample
        covariance[at : at + len(f.names), at : at + len(f.names)] = f.covariance
        at += len(f.names)
    residuals = np.concatenate([t.residuals for a in axes for t in a.solved])
    rank = sum(t.rank for a in axes for t in a.solved)
    dropped = tuple(n for f in smooth.values() for n in f.dropped)
    return Fit(tuple(names), values, covariance, residuals, dropped, 1, 1.0, rank)


def _left_out(a: AxisTable) -> Array:
    """Entries against the straight line between their neighbours, m/s2."""
    return np.asarray(
        a.sensor.value[1:-1] - np.interp(a.angles[1:-1], a.angles[::2], a.sensor.value[::2])
    )[::2]


def _entries(a: AxisTable, widen: float) -> list[dict[str, Any]]:
    """The table as CAL.json holds it."""
    sigma = np.sqrt(np.diag(a.sensor.covariance) * widen)
    entries = [
        {
            "angle_deg": round(float(b / DEG), 6),
            "value": float(v),
            "sigma": float(s),
            "unit": "m_s2",
        }
        for b, v, s in zip(a.angles, a.sensor.value, sigma, strict=True)
    ]
    if a.axle is not None:
        for entry, v in zip(entries, a.axle.value, strict=True):
            # elevation of the table's axis as a reading; its sigma is the same
            entry["table_value"] = float(v)
    return entries
