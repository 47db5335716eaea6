"""Calibrations as parameters of autopilots: PX4 and ArduPilot."""

from collections.abc import Iterator, Sequence

import numpy as np

from tiltcal.calibration.correction import setup_of
from tiltcal.calibration.result import Calibration
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import G0
from tiltcal.setup.sensor import Sensor

_FLOAT = 9  # MAVLink type of a parameter
_LINEAR = ("bias_", "scale_", "cross_")


def px4_parameters(calibration: Calibration) -> str:
    """Parameters of PX4 as QGroundControl loads them, of the first accelerometer and gyro.

    PX4 corrects an accelerometer by ``(raw - OFF) * SCALE`` for each axis, a gyro by ``raw - OFF``,
    in m/s2 and rad/s, in the axes of the sensor before PX4 turns them by ``CAL_ACC0_ROT``.

    Raises:
        TiltcalError: there is no accelerometer or gyro triad in it.
    """
    lines = []
    for sensor in _triads(calibration):
        acc = sensor.kind == "accelerometer"
        prefix = "CAL_ACC0_" if acc else "CAL_GYRO0_"
        offset, scale = offset_and_scale(calibration, sensor)
        lines += [(f"{prefix}{a}OFF", v) for a, v in zip("XYZ", offset, strict=True)]
        if acc:
            lines += [(f"{prefix}{a}SCALE", v) for a, v in zip("XYZ", scale, strict=True)]
    head = ["# Onboard parameters", *_comments(calibration)]
    body = [f"1\t1\t{name}\t{value:.9g}\t{_FLOAT}" for name, value in lines]
    return "\n".join([*head, "# Vehicle-Id Component-Id Name Value Type", *body]) + "\n"


def ardupilot_parameters(calibration: Calibration) -> str:
    """Parameters of ArduPilot as Mission Planner loads them, of the first IMU.

    ArduPilot corrects an accelerometer by ``(raw - OFFS) * SCAL`` for each axis, a gyro by
    ``raw - OFFS``, in m/s2 and rad/s, in the axes of the board.

    Raises:
        TiltcalError: there is no accelerometer or gyro triad in it.
    """
    lines = []
    for sensor in _triads(calibration):
        offset, scale = offset_and_scale(calibration, sensor)
        if sensor.kind == "accelerometer":
            lines += [(f"INS_ACCOFFS_{a}", v) for a, v in zip("XYZ", offset, strict=True)]
            lines += [(f"INS_ACCSCAL_{a}", v) for a, v in zip("XYZ", scale, strict=True)]
        else:
            lines += [(f"INS_GYROFFS_{a}", v) for a, v in zip("XYZ", offset, strict=True)]
    body = [f"{name},{value:.9g}" for name, value in lines]
    return "\n".join([*_comments(calibration), *body]) + "\n"


def offset_and_scale(calibration: Calibration, sensor: Sensor) -> tuple[Array, Array]:
    """``corrected = (reading - offset) * scale`` for each axis, SI, (3,) each.

    This is what ``tiltcal correct`` does where there are no cross-axis and higher-order terms.
    """
    return calibration.bias(sensor), 1 / np.diag(calibration.sensitivity(sensor))


def left_out(calibration: Calibration, sensor: Sensor) -> list[str]:
    """What an offset and a scale for each axis leave out, in words."""
    M = calibration.sensitivity(sensor)
    cross = float(np.max(np.abs(M - np.diag(np.diag(M)))))
    found = []
    if cross > 0:
        at = f", up to {cross * G0:.3g} m/s2 at 1 g" if sensor.kind == "accelerometer" else ""
        found.append(f"cross-axis terms up to {cross:.3g}{at}")
    names = [n for n in calibration.parameters if n.startswith(f"{sensor.name}.")]
    others = [n for n in names if not n.partition(".")[2].startswith(_LINEAR)]
    if others:
        found.append(", ".join(others))
    gyro_scale = np.abs(np.diag(M) - 1).max()
    if sensor.kind == "gyro" and gyro_scale > 0:
        found.append(f"scale errors up to {gyro_scale:.3g}: the autopilot has no gyro scale")
    return found


def _triads(calibration: Calibration) -> Sequence[Sensor]:
    """The first accelerometer triad and the first gyro triad of a calibration."""
    setup = setup_of(calibration)
    triads = [setup.named(n) for n in calibration.sensors()]
    triads = [s for s in triads if len(s.axes) == 3 and not calibration.placing(s, G0)]
    found = [
        next((s for s in triads if s.kind == kind), None) for kind in ("accelerometer", "gyro")
    ]
    kept = [s for s in found if s is not None]
    if not kept:
        raise TiltcalError(
            f"calibration by {calibration.method}",
            found="no accelerometer or gyro with three axes",
            need="offsets of a triad",
            do="calibrate one, for example with --method six_position or norm",
        )
    return kept


def _comments(calibration: Calibration) -> Iterator[str]:
    yield f"# tiltcal, method {calibration.method}, verdict {calibration.verdict}"
    yield "# corrected = (raw - offset) * scale, m/s2 and rad/s, in the axes of the recording"
    for sensor in _triads(calibration):
        for words in left_out(calibration, sensor):
            yield f"# left out, {sensor.name}: {words}"
