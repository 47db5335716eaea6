"""``tiltcal export``."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from tiltcal.api.instruments import load_instrument
from tiltcal.calibration.result import Calibration, setup_of
from tiltcal.cli.options import Json
from tiltcal.cli.output import print_json, print_line, print_note, require_output
from tiltcal.cli.verdict import print_verdict
from tiltcal.core.errors import TiltcalError, one_of
from tiltcal.core.files import write_text

Format = Literal["c", "px4", "ardupilot", "kalibr", "sdf", "sysid", "recording"]
_OF_CALIBRATION = ("c", "px4", "ardupilot")
_BY_ENDING: dict[str, Format] = {".json": "c", ".toml": "sysid"}
_RECORDINGS = (".csv", ".parquet", ".npz", ".mcap")


def export(
    file: Annotated[Path, Parameter("FILE", help="Calibration (JSON), recording, or scenario.")],
    /,
    *,
    format: Annotated[
        Format | None,
        Parameter(
            help="c (header for firmware), px4, ardupilot: from a calibration;"
            " kalibr, sdf: from a recording at rest; sysid: from amended.toml;"
            " recording: by the ending of -o."
        ),
    ] = None,
    name: Annotated[str, Parameter(help="Prefix of all C names.")] = "tiltcal",
    topic: Annotated[str, Parameter(help="Topic in the file of kalibr.")] = "/imu",
    calibration: Annotated[
        Path | None, Parameter(help="Calibration whose biases the SDF noise has as means.")
    ] = None,
    log: Annotated[
        Path | None,
        Parameter(help="c: recording whose units are used, if not those that were calibrated."),
    ] = None,
    vectors: Annotated[
        Path | None,
        Parameter(help="c: recording to write for tests: readings and their correction."),
    ] = None,
    no_integers: Annotated[bool, Parameter(help="c: correct in floating point only.")] = False,
    output: Annotated[
        Path | None, Parameter(alias="-o", help="File to write; text goes to stdout if not given.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Export a calibration, noise, effects or a recording for other programs.

    C99 header of any terms that depend on one reading and the temperature, or of
    placing-angle tables, in floating point and in integers, in the units of the
    log, without malloc.

      tiltcal export CAL.json -o imu.h --name imu --vectors vectors.csv
      tiltcal export CAL.json --format px4 -o imu.params
      tiltcal export rest.csv --format kalibr -o imu.yaml
      tiltcal export out/amended.toml -o sysid.yaml # mujoco.sysid
      tiltcal export run.csv -o run.mcap            # PlotJuggler, Foxglove, ROS 2
    """
    chosen = format or _BY_ENDING.get(file.suffix, "recording")
    if chosen != "c" and (log or vectors):
        raise TiltcalError(
            f"command line of `tiltcal export --format {chosen}`",
            found="--log" if log else "--vectors",
            need="--format c: they belong to a header",
            do="leave it out",
        )
    if chosen == "recording":
        return _recording(file, output, as_json)
    require_output("export", output, as_json, "the text")
    if chosen == "sysid":
        text = _of_effects(file)
    elif chosen in _OF_CALIBRATION:
        text = _of_calibration(chosen, file, name, log, vectors, not no_integers)
    else:
        text = _of_noise(chosen, file, topic, calibration)
    if output is None:
        print_line(text.rstrip("\n"))
        return 0
    write_text(output, text)
    if as_json:
        print_json({"output": str(output), "name": name, "format": chosen, "bytes": len(text)})
    else:
        print_note(f"{output}: {len(text.splitlines())} lines, {chosen}")
    return 0


def _of_calibration(
    chosen: str, file: Path, name: str, log: Path | None, vectors: Path | None, integers: bool
) -> str:
    from tiltcal.calibration import autopilot_exports

    if file.suffix in _RECORDINGS:
        raise _wrong(chosen, file, "a calibration, CAL.json", "make one with `tiltcal calibrate`")
    found = load_instrument(file)
    print_verdict(found)
    if chosen == "c":
        return _firmware(found, name, log, vectors, integers)
    if chosen == "px4":
        return autopilot_exports.px4_parameters(found)
    return autopilot_exports.ardupilot_parameters(found)


def _firmware(
    found: Calibration, name: str, log: Path | None, vectors: Path | None, integers: bool
) -> str:
    from tiltcal.calibration.firmware.header import header
    from tiltcal.calibration.firmware.vectors import firmware_vectors
    from tiltcal.recordings.recording_files import read_recording
    from tiltcal.recordings.saving import write_recording

    recording = None if log is None else read_recording(log).require_increasing()
    text = header(found, setup_of(found), name, recording, integers=integers)
    if vectors is not None:
        written = firmware_vectors(found, recording, integers=integers)
        write_recording(written, vectors)
        print_note(f"{vectors}: {len(written)} rows, readings and their correction")
    return text


def _of_effects(file: Path) -> str:
    from tiltcal.api.model_parameters import to_sysid
    from tiltcal.laboratory.scenario import load_scenario

    if file.suffix != ".toml":
        raise _wrong("sysid", file, "a scenario with effects", "give amended.toml of a diagnosis")
    text, left_out = to_sysid(load_scenario(file))
    if left_out:
        message = ", ".join(f"{address} ({why})" for address, why in left_out.items())
        print_note(f"left out, no parameter of a model: {message}")
    return text


def _of_noise(chosen: str, file: Path, topic: str, calibration: Path | None) -> str:
    from tiltcal.calibration.autopilot_exports import imu_noise, kalibr_yaml, sdf_imu
    from tiltcal.recordings.recording_files import read_recording
    from tiltcal.recordings.rest_noise import rest_noise

    if file.suffix == ".json":
        raise _wrong(chosen, file, "a recording at rest", "record one: noise is seen at rest only")
    recording = read_recording(file).require_increasing()
    found = rest_noise(recording)
    for name, why in found.left_out.items():
        print_note(f"{name} is left out: {why}")
    for finding in found.findings:
        print_note(f"found: {finding.statement}")
    imu = imu_noise(found, recording.source)
    return kalibr_yaml(imu, topic) if chosen == "kalibr" else sdf_imu(imu, _biases(calibration))


def _biases(path: Path | None) -> dict[str, Any]:
    """Quantity -> bias of each axis, SI, of a calibration."""
    if path is None:
        return {}
    calibration = load_instrument(path)
    setup = setup_of(calibration)
    sensors = [setup.named(n) for n in calibration.sensors()]
    return {s.quantity: calibration.bias(s) for s in reversed(sensors) if len(s.axes) == 3}


def _recording(file: Path, output: Path | None, as_json: bool) -> int:
    from tiltcal.recordings.formats.mcap_writer import write_mcap
    from tiltcal.recordings.recording_files import read_recording
    from tiltcal.recordings.saving import write_recording

    if output is None:
        raise TiltcalError(
            "command line of `tiltcal export`",
            found="no -o",
            need="a file to write the recording to",
            do="add -o FILE ending in " + ", ".join(_RECORDINGS),
        )
    one_of(output.suffix, _RECORDINGS, f"output {output}", "the ending")
    recording = read_recording(file)
    if output.suffix == ".mcap":
        write_mcap(recording, output)
    else:
        write_recording(recording, output)
    if as_json:
        print_json({"output": str(output), "rows": len(recording)})
    else:
        print_note(f"{output}: {len(recording)} rows")
    return 0


def _wrong(chosen: str, file: Path, need: str, do: str) -> TiltcalError:
    return TiltcalError(
        f"command line of `tiltcal export --format {chosen}`",
        found=f"the file {file.name}",
        need=need,
        do=do,
    )
