"""S0: zero bias against the placing angle, from sweeps on a table whose axis lies along the
sensitive axis.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.calibration.methods.common import (
    leave_out_rms,
    pick_sensor,
    wrap_up,
)
from tiltcal.calibration.methods.placing_checks import (
    left_uncorrected,
    range_test,
    require_mounting,
    sweep_tests,
    table_notes,
    why_visits_differ,
)
from tiltcal.calibration.methods.placing_smooth import (
    ORDERS,
    interpolation_error,
    interpolation_test,
    joint_fit,
    smooth_fits,
)
from tiltcal.calibration.methods.placing_sweep import (
    DRIFTS,
    AxisTable,
    Drift,
    find_sweeps,
    mounting_of,
    mounts_of,
    solve_axis,
    split_at_remounts,
)
from tiltcal.calibration.result import Calibration
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.screen.outliers import outlier_tests
from tiltcal.calibration.validity import Test, chi2_test, verdict_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.units import DEG
from tiltcal.instrument.placing import LOOKUPS
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment, find_segments
from tiltcal.recordings.static_poses import Poses, find_poses
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Setup
from tiltcal.setup.tables import PLACING, angle_channel
from tiltcal.statistics.least_squares import Fit

NAME = "placing_table"
EQUATION = "{}_i = f_i + b_i(beta_i), beta_x = atan2(f_y, f_z), beta_y = atan2(-f_x, f_z)"
READOUT = angle_channel(PLACING.axis_names[0])


def placing_table(
    recording: Recording,
    setup: Setup,
    *,
    segments: Sequence[Segment] | None = None,
    sensor: str | None = None,
    lookup: str = "interpolated",
    harmonics: int | None = None,
    drift: Drift = "linear",
) -> Calibration:
    """Zero bias of x and y against the placing angle, as tables and as a smooth fit, from
    up-and-down sweeps.

    Model: with an axis along the table's, ``reading = b(beta) + d (t - t_mid)``, beta the rotation
    about that axis, equal to table_outer. Under the mounting identity that is the y axis, after a
    remount by Rz(90) the x axis; Rz(180) and Rz(-90) reverse them, which separates the tilt of the
    table's own axis.
    Smooth fit: ``b = b0 + sum c_n cos(n beta) + s_n sin(n beta)``.

    Args:
        recording: dwells every degree or so, up and down, with table_outer; remounts in the
            metadata.
        setup: table ``placing``, an accelerometer or inclinometer with x and y.
        segments: dwells to use.
        sensor: which, when several fit.
        lookup: how ``correct`` reads the table: interpolated, rounded (the patent's) or smooth.
        harmonics: of the smooth fit; unless given the fewest from 2 to 4 that describe the table.
        drift: of the zero over a sweep: linear, or warm_up, which dies away exponentially; the
            entries are then those after the warm-up.

    Raises:
        TiltcalError: another table, no angles, readings that contradict the stated mounting, an
            unknown option.

    Errors:
        The levelling and wobble of the table's axis enter one to one (the 180 deg remount separates
            them except for the part that is odd in the table's angle), its index error e only as
            b' e. The table includes cross-axis terms as measured, at 1 g across the axis; at a tilt
            t of the axis itself they are smaller by 1 - cos t. Interpolation: step^2/8 max b''.

    Source: patent CN 109459585 (docs/sources.md, "Placing-angle bias table"); docs/physics.md,
    "Placing-angle tables".
    """
    one_of(drift, DRIFTS, f"method {NAME}, option drift")
    used = _require(recording, setup, sensor, lookup, harmonics)
    poses = _poses(recording, setup, used, segments)
    axes, notes = _axes(poses, recording, setup, drift)
    smooth, smooth_tests, smooth_notes = smooth_fits(axes, used.name, harmonics)
    if lookup == "smooth":
        _require_smooth(len(smooth) == len(axes), smooth_notes)
    fit = joint_fit(axes, smooth)
    chi2 = _repeat_test(fit, axes)
    factor = fit.chi2_per_dof if not chi2.passed and fit.chi2_per_dof > 1 else 1.0
    g = setup.site.gravity
    tests = [
        chi2,
        range_test(poses, g),
        *sweep_tests(axes),
        interpolation_test(axes, g, lookup),
        *smooth_tests,
        *data_tests(recording, used, axes="xy"),
        *(t for p in poses for t in outlier_tests(recording, p)),
    ]
    left = [left_uncorrected(p, mounts_of(p, recording, setup), g) for p in poses]
    result = wrap_up(
        NAME,
        verdict_of(tests),
        fit,
        ["m_s2"] * len(fit.names),
        tests,
        [*notes, *table_notes(axes, g, drift), *filter(None, left), *smooth_notes],
        poses[0],
        recording,
        equation=EQUATION.format(used.name),
        inverse=f"f_i = {used.name}_i - b_i(beta_i), b {lookup}, beta from the other axis",
        heldout={used.name: leave_out_rms([_left_out(a) for a in axes])},
    )
    spans = dict.fromkeys(s for p in poses for s in p.spans)
    tables = {f"{used.name}.{a.axis}": _entries(a, factor) for a in axes}
    return replace(result, bias_tables=tables, lookup=lookup, poses=list(spans))


def _repeat_test(fit: Fit, axes: Sequence[AxisTable]) -> Test:
    """Do visits of the same angle agree, and if not, which cause explains it?"""
    words = f"visits of the same angle repeat within their noise ({fit.dof} redundant)"
    test = chi2_test("fit", fit.chi2, fit.dof, words)
    if test.passed:
        return test
    return replace(test, statement=f"visits of the same angle differ; {why_visits_differ(axes)}")


def _require_smooth(found: bool, notes: Sequence[str]) -> None:
    """Refuse a smooth look-up that cannot be built."""
    if not found:
        raise TiltcalError(
            f"method {NAME}, option lookup",
            found="; ".join(notes),
            need="a smooth fit of every table for lookup=smooth",
            do="use lookup=interpolated, or state --option harmonics",
        )


def _require(
    recording: Recording, setup: Setup, sensor: str | None, lookup: str, harmonics: int | None
) -> Sensor:
    """The sensor; refuses another table and unknown options."""
    if setup.rig.directions != PLACING.directions:
        raise TiltcalError(
            f"method {NAME}",
            found=f"table {setup.rig.table}",
            need=f"table {PLACING.name}: one horizontal axis along the sensitive axis",
            do="correct rig.table, or use six_position",
        )
    if lookup not in LOOKUPS:
        need = " or ".join(LOOKUPS)
        raise TiltcalError(
            f"method {NAME}, option lookup", found=str(lookup), need=need, do="correct it"
        )
    if harmonics is not None and harmonics not in ORDERS:
        raise TiltcalError(
            f"method {NAME}, option harmonics",
            found=str(harmonics),
            need="1, 2, 3 or 4",
            do="correct it",
        )
    recorded = [r for s in setup.sensor if (r := _recorded(s, recording)) is not None]
    kinds = ("accelerometer", "inclinometer")
    return pick_sensor(
        setup.model_copy(update={"sensor": tuple(recorded) or setup.sensor}),
        recording,
        kinds,
        sensor,
        NAME,
    )


def _recorded(sensor: Sensor, recording: Recording) -> Sensor | None:
    """The sensor with those of x and y that were recorded; None without them."""
    axes = tuple(a for a in sensor.axes if a in "xy" and recording.channel(f"{sensor.name}_{a}"))
    return sensor.model_copy(update={"axes": axes}) if axes else None


def _poses(
    recording: Recording, setup: Setup, sensor: Sensor, segments: Sequence[Segment] | None
) -> list[Poses]:
    """The dwells of each axis whose angle is known, split where the mounting changes. One axis may
    be recorded while the other is not.
    """
    found = find_segments(recording) if segments is None else segments
    cut = split_at_remounts(found, recording, setup)
    each = []
    for axis in sensor.axes:
        alone = sensor.model_copy(update={"axes": (axis,)})
        poses = find_poses(recording, setup, alone, cut)
        poses = poses.subset(np.asarray(~np.isnan(poses.up).any(axis=1)))
        if len(poses):
            each.append(poses)
    if not each:
        raise TiltcalError(
            recording.source,
            found=f"dwells without a readout of {READOUT}",
            need="the angle of every dwell",
            do=f"record {READOUT}_deg",
        )
    which = [mounting_of(p, recording, setup)[0] for p in each]
    require_mounting(each, which, setup.site.gravity, recording.source)
    return each


def _axes(
    poses: Sequence[Poses], recording: Recording, setup: Setup, drift: Drift
) -> tuple[list[AxisTable], list[str]]:
    """Tables of the axes that were swept, with notes."""
    tables, notes = [], []
    for each in poses:
        axis = each.sensor.axes[0]
        sweeps, grid, off = find_sweeps(each, recording, setup, axis)
        notes += off
        if sweeps and len(np.unique(np.concatenate([s.node for s in sweeps]))) >= 3:
            tables.append(solve_axis(axis, sweeps, grid, drift))
    if not tables or any(len(a.sensor.node) < 3 for a in tables):
        raise TiltcalError(
            recording.source,
            found="fewer than three placing angles of any axis, with x or y along the table's axis",
            need="a sweep with the y axis along it (mount identity) or the x axis (Rz(90))",
            do="sweep outer 0 ... 90 ... 0 deg by 1 deg, and state the mounting",
        )
    return tables, notes


def _left_out(a: AxisTable) -> Array:
    """Entries against the straight line between their neighbours, m/s2."""
    value, angles = a.sensor.value, a.angles
    between = np.interp(angles[1:-1], angles[::2], value[::2])
    return np.asarray(value[1:-1] - between)[::2]


def _entries(a: AxisTable, factor: float) -> list[dict[str, Any]]:
    """The table as CAL.json holds it; factor: by which the variances are widened."""
    sigma = np.sqrt(np.diag(a.sensor.covariance) * factor + interpolation_error(a) ** 2)
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
