"""``tiltcal init`` and ``import``."""

import argparse
import sys
from pathlib import Path

import numpy as np

from tiltcal.cli.output import print_json
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_text
from tiltcal.core.frames import normal_gravity
from tiltcal.core.units import COLUMN_UNITS, DEG, split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording, write_recording
from tiltcal.setup.sensor import RESERVED
from tiltcal.setup.tables import DUAL, HANDHELD, Table, angle_channel, axis_names, tables

SEQUENCE = """
# What the table does: rest, move, turn, sweep, oscillate or remount. Labels are the operator's.
[[sequence]]
action = "move"
outer_deg = 0
dwell_s = 10
label = "+z"
[[sequence]]
action = "move"
outer_deg = 90
dwell_s = 10
label = "+y"
[[sequence]]
action = "move"
outer_deg = 180
dwell_s = 10
label = "-z"
[[sequence]]
action = "move"
outer_deg = 270
dwell_s = 10
label = "-y"
[[sequence]]
action = "move"
outer_deg = 90
inner_deg = 90
dwell_s = 10
label = "+x"
[[sequence]]
action = "move"
outer_deg = 90
inner_deg = 270
dwell_s = 10
label = "-x"

# Errors of the simulated instrument; `tiltcal effects` lists all, with units and sizes.
[[effect]]
id = "acc_noise"
white_ug_rthz = 25
[[effect]]
id = "acc_bias"
bias_x_ug = 3000
bias_y_ug = -1500
bias_z_ug = 800
[[effect]]
id = "acc_scale"
scale_x_ppm = 1200
scale_y_ppm = -700
[[effect]]
id = "acc_cross_axis"
cross_xy_ppm = 900
cross_zx_ppm = -600

# What each method has to reach; `tiltcal run` compares with what was injected.
[[method]]
name = "six_position"
[method.accept]
better_by = 20
"""


def init(args: argparse.Namespace) -> int:
    """Write a scenario to start from."""
    if args.json_schema:
        from tiltcal.laboratory.scenario import scenario_schema

        print_json(scenario_schema())
        return 0
    if args.latitude is not None and not -90 <= args.latitude <= 90:
        raise TiltcalError(
            "--latitude", found=f"{args.latitude:g} deg", need="-90 to 90 deg", do="correct it"
        )
    latitude = 48.0 if args.latitude is None else args.latitude
    gravity = normal_gravity(latitude * DEG, args.height)
    lines = [
        "# A tiltcal scenario. Units stand in the names; unknown keys are errors.",
        "schema = 1",
        'name = "bench"',
        "",
        "[site]",
        (
            f"gravity_m_s2 = {gravity:.6f}        # WGS 84 at latitude {latitude:g} deg, height"
            f" {args.height:g} m; put yours"
        ),
        f"latitude_deg = {latitude:g}              # needed by gyros and FOGs",
        "",
    ]
    recording = read_recording(args.recording) if args.recording else None
    lines += _rig(recording) + (_sensors(recording) if recording else _default_sensor())
    text = "\n".join(lines) + ("" if recording else SEQUENCE)
    if args.output:
        write_text(Path(args.output), text)
        print(
            f"{args.output}: written; edit it, then `tiltcal simulate` or `calibrate"
            " --scenario` it",
            file=sys.stderr,
        )
    if args.json:
        print_json({"output": args.output, "scenario": text})
    elif not args.output:
        print(text)
    return 0


def _rig(recording: Recording | None) -> list[str]:
    table = DUAL if recording is None else _table_of(recording)
    *names, last = tables()
    mount = (
        "identity"
        if recording is None
        else recording.metadata.get("mount", "identity").partition(";")[0].strip()
    )
    return [
        "[rig]",
        f'table = "{table.name}"               # {", ".join(names)} or {last}',
        (
            'readout = "encoder"          # or "command": the table columns are what was asked of'
            " the drive"
        ),
        f'mount = "{mount}"           # or for example "Rz(180)"',
        "",
    ]


def _table_of(recording: Recording) -> Table:
    """The first table with the axes that a recording has columns of; by hand when there is none."""
    read = {a for a in axis_names() if recording.channel(angle_channel(a)) is not None}
    return next((t for t in tables().values() if set(t.axis_names) == read), HANDHELD)


def _default_sensor() -> list[str]:
    return [
        "[[sensor]]",
        'name = "accel"               # its columns are accel_x_<unit>, accel_y_<unit>, ...',
        'kind = "accelerometer"       # accelerometer, inclinometer, gyro, fog',
        'axes = ["x", "y", "z"]',
        "rate_hz = 100",
        'adjustable = ["bias", "scale", "cross_axis"]   # what ordinary calibration may re-tune',
        "",
    ]


def _sensors(recording: Recording) -> list[str]:
    """Sensor tables from the columns: one a prefix, its kind from the unit."""
    kinds = {
        "acceleration": "accelerometer",
        "angle": "inclinometer",
        "rate": "gyro",
        "raw": "accelerometer",
    }
    found: dict[str, tuple[list[str], str]] = {}
    for column in recording.column_names:
        channel, unit = split_unit(column)
        name, _, axis = channel.rpartition("_")
        quantity = COLUMN_UNITS[unit].quantity if unit else ""
        named = name.isascii() and name.isalnum() and name[0].isalpha() and name not in RESERVED
        if (
            named
            and quantity in kinds
            and axis in (("x", "y") if quantity == "angle" else ("x", "y", "z", "a"))
        ):
            found.setdefault(name, ([], str(unit)))[0].append(axis)
    rate = 1 / float(np.median(np.diff(recording.time))) if len(recording) > 1 else 1.0
    lines = []
    for name, (axes, unit) in found.items():
        kind = "fog" if axes == ["a"] else kinds[COLUMN_UNITS[unit].quantity]
        lines += [
            "[[sensor]]",
            f'name = "{name}"',
            f'kind = "{kind}"',
            f"axes = {axes}".replace("'", '"'),
            f"rate_hz = {rate:.4g}",
        ]
        if kind == "fog":
            lines.append(
                "input_axis = [0.577350269, 0.577350269, 0.577350269]   # state the FOG's input"
                " axis in the body frame"
            )
        if COLUMN_UNITS[unit].quantity == "raw":
            lines.append(
                f'# input = {{ unit = "{unit}", zero = 0, per_m_s2 = 1000 }}   # fill in: value ='
                " (raw - zero) / per"
            )
        lines += [
            (
                'adjustable = ["bias", "scale", "cross_axis"]'
                if kind != "fog"
                else 'adjustable = ["bias", "scale"]'
            ),
            "",
        ]
    return lines


def import_(args: argparse.Namespace) -> int:
    """Bring a foreign log in."""
    from tiltcal.recordings.text_import import import_recording, load_mapping

    recording = import_recording(args.file, load_mapping(args.map))
    write_recording(recording, args.output)
    back = int(np.sum(np.diff(recording.time) <= 0))
    summary = {
        "recording": args.output,
        "rows": len(recording),
        "columns": recording.column_names,
        "steps_back_in_time": back,
    }
    if args.json:
        print_json(summary)
    else:
        note = f"; time does not increase at {back} rows" if back else ""
        print(
            f"{args.output}: {len(recording)} rows, {len(recording.column_names)} channels{note}",
            file=sys.stderr,
        )
    return 0
