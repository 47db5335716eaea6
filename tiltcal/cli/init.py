"""``tiltcal init``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tiltcal.cli.options import Json
from tiltcal.cli.output import ask, print_json, print_line, print_note
from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.files import write_text
from tiltcal.core.frames import normal_gravity
from tiltcal.core.units import COLUMN_UNITS, DEG
from tiltcal.recordings.proposal.set_up import RigGuess, SensorGuess, rig_of, sensors_of
from tiltcal.recordings.quality import inspect_recording
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Rig, Setup, Site
from tiltcal.setup.tables import DUAL, tables

LATITUDE = 48.0  # deg, when none is given
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
        Parameter(
            "--from", help="Take sensors and table from the columns and numbers of this recording."
        ),
    ] = None,
    latitude: Annotated[
        float | None, Parameter(help="Latitude, deg; sets gravity (WGS 84). Default: 48.")
    ] = None,
    height: Annotated[float, Parameter(help="Height above sea level, m.")] = 0.0,
    table: Annotated[
        str | None,
        Parameter(help="Table: handheld, vertical, placing, dual, three, four; default: as found."),
    ] = None,
    json_schema: Annotated[
        bool, Parameter(help="Print the JSON Schema of scenario files instead.")
    ] = False,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File of the scenario; stdout if not given.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Write a commented scenario to start from.

    Without --from: a triad of accelerometers on a dual-axis table, six faces; on
    another --table without a sequence, for `tiltcal guide`, `design`, `calibrate`.
    With --from: sensors, units, rates, table and mounting by the columns and the
    numbers of a recording, with the reason of each and what it cannot know. On a
    terminal it asks for what the recording does not state.

      tiltcal init -o bench.toml
      tiltcal init --from run.csv -o bench.toml
      tiltcal init --latitude 52.5 --height 40
      tiltcal init --table handheld -o hand.toml
    """
    if json_schema:
        from tiltcal.laboratory.scenario import scenario_schema

        print_json(scenario_schema())
        return 0
    if latitude is None:
        latitude = _ask_latitude()
    text = scenario_text(recording_file, latitude, height, table)
    if output:
        write_text(output, text)
        print_note(
            f"{output}: written; edit it, then use it with `tiltcal simulate` or `calibrate"
            " --scenario`"
        )
    if as_json:
        print_json({"output": str(output) if output else None, "scenario": text})
    elif not output:
        print_line(text)
    return 0


def scenario_text(
    recording_file: Path | None, latitude: float, height: float, table: str | None = None
) -> str:
    """A scenario as TOML with comments; a note on stderr states what was taken from a recording.

    Args:
        recording_file: that it describes; None: an instrument to start from.
        latitude: deg.
        height: m.
        table: its name; None: that of the recording, or one of two axes.

    Raises:
        TiltcalError: the latitude is out of range, there is no such table, or the recording is not
            readable.
    """
    if table is not None and table not in tables():
        raise TiltcalError(
            f"--table {table}",
            found="no such table",
            need=", ".join(tables()),
            do=nearest(table, list(tables())),
        )
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
    if recording_file is None:
        rig = RigGuess(table or DUAL.name, "identity", "")
        text = "\n".join([*lines, *_rig(rig), *_default_sensor()])
        return text + SEQUENCE if rig.table == DUAL.name else text
    recording = read_recording(recording_file)
    return "\n".join([*lines, *_from_recording(recording, latitude, gravity, table)])


def _ask_latitude() -> float:
    answer = ask("latitude, deg", f"{LATITUDE:g}")
    try:
        return float(answer)
    except ValueError as error:
        raise TiltcalError(
            "latitude", found=f"'{answer}'", need="a number, deg", do="correct it"
        ) from error


def _from_recording(
    recording: Recording, latitude: float, gravity: float, stated: str | None
) -> list[str]:
    """Rig and sensors by a recording; notes on stderr state what was assumed."""
    sensors = sensors_of(recording, gravity)
    rig = rig_of(recording, _provisional(sensors, latitude, gravity))
    if stated is not None:
        rig = RigGuess(stated, rig.mount if stated == rig.table else "identity", "as stated")
    known = not rig.doubts
    table = rig.table if known else ask("table", rig.table, list(tables()))
    mount = rig.mount if known else ask("mount, such as Rz(180)", rig.mount)
    if (table, mount) != (rig.table, rig.mount):
        rig = RigGuess(table, mount, "your answer")
    print_note(f"table {rig.table}, mount {rig.mount}: {rig.reason}")
    for s in sensors:
        print_note(f"{s.name}: {s.kind}, {s.rate_hz:.4g} Hz: {s.reason}")
    for finding in inspect_recording(recording).findings:
        print_note(f"found: {finding.with_repair()}")
    for doubt in (*rig.doubts, *(d for s in sensors for d in s.doubts)):
        print_note(f"cannot know: {doubt}")
    return [*_rig(rig), *(line for s in sensors for line in _sensor(s))]


def _provisional(sensors: list[SensorGuess], latitude: float, gravity: float) -> Setup | None:
    """The sensors whose readings have a scale, on a table that is not known yet."""
    known = [s for s in sensors if s.kind == "accelerometer" and (not _raw(s) or s.zero)]
    parts = tuple(
        Sensor.model_validate(
            {"name": s.name, "kind": s.kind, "axes": s.axes, "rate_hz": s.rate_hz}
            | ({"input": _input(s)} if _raw(s) else {})
        )
        for s in known
    )
    site = Site(gravity_m_s2=gravity, latitude_deg=latitude)
    return Setup(site=site, rig=Rig(table=DUAL.name), sensor=parts) if parts else None


def _rig(rig: RigGuess) -> list[str]:
    *names, last = tables()
    reason = f"; {rig.reason}" if rig.reason else ""
    return [
        "[rig]",
        f'table = "{rig.table}"               # {", ".join(names)} or {last}{reason}',
        ('readout = "encoder"          # or "command": the table columns are commanded angles'),
        f'mount = "{rig.mount}"           # or for example "Rz(180)"',
        *(f"# cannot know: {doubt}" for doubt in rig.doubts),
        "",
    ]


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


def _raw(sensor: SensorGuess) -> bool:
    return COLUMN_UNITS[sensor.unit].quantity == "raw"


def _input(sensor: SensorGuess) -> dict[str, object]:
    return {"unit": sensor.unit, "zero": sensor.zero, "per_m_s2": sensor.per_m_s2}


def _sensor(s: SensorGuess) -> list[str]:
    lines = [
        "[[sensor]]",
        f'name = "{s.name}"',
        f'kind = "{s.kind}"       # {s.reason}',
        f"axes = {list(s.axes)}".replace("'", '"'),
        f"rate_hz = {s.rate_hz:.4g}",
    ]
    if s.kind == "fog":
        lines.append(
            "input_axis = [0.577350269, 0.577350269, 0.577350269]   # the FOG's input axis in the"
            " body frame"
        )
    if _raw(s):
        lines.append(_input_line(s))
    terms = '["bias", "scale"]' if s.kind == "fog" else '["bias", "scale", "cross_axis"]'
    doubts = [f"# cannot know: {doubt}" for doubt in s.doubts]
    return [*lines, f"adjustable = {terms}", *doubts, ""]


def _input_line(s: SensorGuess) -> str:
    """How raw readings become SI; a comment to fill in where the recording does not state it."""
    if not s.zero:
        slope = {"gyro": "per_deg_s", "fog": "per_deg_s", "inclinometer": "per_deg"}
        return (
            f'# input = {{ unit = "{s.unit}", zero = 0, {slope.get(s.kind, "per_m_s2")} = 1000 }}'
            "   # fill in: value = (raw - zero) / per"
        )
    zero = ", ".join(f"{x:.6g}" for x in s.zero)
    return f'input = {{ unit = "{s.unit}", zero = [{zero}], per_m_s2 = {s.per_m_s2:.6g} }}'
