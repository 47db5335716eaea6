"""``tiltcal init``."""

from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, say, tell
from tiltcal.core.errors import TiltcalError
from tiltcal.core.files import write_text
from tiltcal.core.frames import normal_gravity
from tiltcal.core.units import COLUMN_UNITS, DEG, split_unit
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.setup.sensor import RESERVED
from tiltcal.setup.tables import DUAL, HANDHELD, Table, angle_channel, axis_names, tables

LATITUDE = 48.0  # deg, when none is given
KINDS = {
    "acceleration": "accelerometer",
    "angle": "inclinometer",
    "rate": "gyro",
    "raw": "accelerometer",
}  # sensor kind by quantity of the unit
SEQUENCE = """
# Steps of the table: rest, move, turn, sweep, oscillate or remount. Labels are set by the operator.
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

# Accuracy that each method has to reach; `tiltcal run` compares with the injected errors.
[[method]]
name = "six_position"
[method.accept]
better_by = 20
"""


def init(
    *,
    recording_file: Annotated[
        Path | None,
        Parameter("--from", help="Take sensors and table from the columns of this recording."),
    ] = None,
    latitude: Annotated[
        float | None, Parameter(help="Latitude, deg; sets gravity (WGS 84). Default: 48.")
    ] = None,
    height: Annotated[float, Parameter(help="Height above sea level, m.")] = 0.0,
    json_schema: Annotated[
        bool, Parameter(help="Print the JSON Schema of scenario files instead.")
    ] = False,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File of the scenario; stdout if not given.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Write a commented scenario to start from.

    Without --from: a triad of accelerometers on a dual-axis table, six faces.

      tiltcal init -o bench.toml
      tiltcal init --from run.csv -o bench.toml
      tiltcal init --latitude 52.5 --height 40
    """
    if json_schema:
        from tiltcal.laboratory.scenario import scenario_schema

        print_json(scenario_schema())
        return 0
    text = scenario_text(recording_file, LATITUDE if latitude is None else latitude, height)
    if output:
        write_text(output, text)
        tell(
            f"{output}: written; edit it, then use it with `tiltcal simulate` or `calibrate"
            " --scenario`"
        )
    if as_json:
        print_json({"output": str(output) if output else None, "scenario": text})
    elif not output:
        say(text)
    return 0


def scenario_text(recording_file: Path | None, latitude: float, height: float) -> str:
    """A scenario as TOML with comments.

    Raises:
        TiltcalError: the latitude is out of range, or the recording is not readable.
    """
    if not -90 <= latitude <= 90:
        raise TiltcalError(
            "--latitude", found=f"{latitude:g} deg", need="-90 to 90 deg", do="correct it"
        )
    gravity = normal_gravity(latitude * DEG, height)
    lines = [
        "# A tiltcal scenario. Key names end in their units; unknown keys are errors.",
        "schema = 1",
        'name = "bench"',
        "",
        "[site]",
        (
            f"gravity_m_s2 = {gravity:.6f}        # WGS 84 at latitude {latitude:g} deg, height"
            f" {height:g} m; replace by yours"
        ),
        f"latitude_deg = {latitude:g}              # needed by gyros and FOGs",
        "",
    ]
    recording = read_recording(recording_file) if recording_file else None
    lines += _rig(recording)
    lines += _sensors(recording) if recording else _default_sensor()
    return "\n".join(lines) + ("" if recording else SEQUENCE)


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
        ('readout = "encoder"          # or "command": the table columns are commanded angles'),
        f'mount = "{mount}"           # or for example "Rz(180)"',
        "",
    ]


def _table_of(recording: Recording) -> Table:
    """The table that the recording's metadata name, or the first whose axes are its columns;
    handheld if there is none.
    """
    read = {a for a in axis_names() if recording.channel(angle_channel(a)) is not None}
    fitting = {t.name: t for t in tables().values() if set(t.axis_names) == read}
    stated = recording.metadata.get("table", "")
    return fitting.get(stated, next(iter(fitting.values()), HANDHELD))


def _default_sensor() -> list[str]:
    return [
        "[[sensor]]",
        'name = "accel"               # its columns are accel_x_<unit>, accel_y_<unit>, ...',
        'kind = "accelerometer"       # accelerometer, inclinometer, gyro, fog',
        'axes = ["x", "y", "z"]',
        "rate_hz = 100",
        'adjustable = ["bias", "scale", "cross_axis"]   # what ordinary calibration may adjust',
        "",
    ]


def _sensors(recording: Recording) -> list[str]:
    """Sensor tables from the columns: one for each prefix, its kind from the unit."""
    steps = np.diff(recording.time)
    onward = steps[steps > 0]
    rate = 1 / float(np.median(onward)) if len(onward) else 1.0
    found = _axes_and_units(recording).items()
    return [line for name, (axes, unit) in found for line in _sensor(name, axes, unit, rate)]


def _axes_and_units(recording: Recording) -> dict[str, tuple[list[str], str]]:
    """Axes and unit of each sensor that the columns name."""
    found: dict[str, tuple[list[str], str]] = {}
    for column in recording.column_names:
        channel, unit = split_unit(column)
        name, _, axis = channel.rpartition("_")
        quantity = COLUMN_UNITS[unit].quantity if unit else ""
        valid = name.isascii() and name.isalnum() and name[0].isalpha() and name not in RESERVED
        axes = ("x", "y") if quantity == "angle" else ("x", "y", "z", "a")
        if valid and quantity in KINDS and axis in axes:
            found.setdefault(name, ([], str(unit)))[0].append(axis)
    return found


def _sensor(name: str, axes: list[str], unit: str, rate: float) -> list[str]:
    quantity = COLUMN_UNITS[unit].quantity
    kind = "fog" if axes == ["a"] else KINDS[quantity]
    lines = [
        "[[sensor]]",
        f'name = "{name}"',
        f'kind = "{kind}"',
        f"axes = {axes}".replace("'", '"'),
        f"rate_hz = {rate:.4g}",
    ]
    if kind == "fog":
        lines.append(
            "input_axis = [0.577350269, 0.577350269, 0.577350269]   # the FOG's input axis in the"
            " body frame"
        )
    if quantity == "raw":
        lines.append(
            f'# input = {{ unit = "{unit}", zero = 0, per_m_s2 = 1000 }}   # fill in: value ='
            " (raw - zero) / per"
        )
    terms = '["bias", "scale"]' if kind == "fog" else '["bias", "scale", "cross_axis"]'
    return [*lines, f"adjustable = {terms}", ""]
