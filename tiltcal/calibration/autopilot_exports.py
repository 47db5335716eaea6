"""Calibrations as parameters of autopilots: PX4 and ArduPilot.

Noise of an IMU in the files of those who simulate or fuse it: kalibr and SDF (Gazebo).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.calibration.result import Calibration, setup_of
from tiltcal.core.arrays import Array
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import COLUMN_UNITS, G0, split_unit
from tiltcal.recordings.rest_noise import RestNoise
from tiltcal.setup.sensor import Sensor
from tiltcal.statistics.standstill_noise import StandstillNoise

# ranges of INS_ACCSCAL and INS_ACCOFFS (m/s2), ArduPilot, "Complete Parameter List"
SCALES = (0.8, 1.2)
OFFSET = 3.5
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

    Raises:
        TiltcalError: one of an accelerometer is beyond what an autopilot takes.
    """
    offset, scale = calibration.bias(sensor), 1 / np.diag(calibration.sensitivity(sensor))
    beyond = (scale < SCALES[0]) | (scale > SCALES[1]) | (np.abs(offset) > OFFSET)
    if sensor.kind == "accelerometer" and beyond.any():
        k = int(np.argmax(beyond))
        raise TiltcalError(
            f"calibration of {sensor.name}, axis {sensor.axes[k]}",
            found=f"offset {offset[k]:.4g} and scale {scale[k]:.4g}, in SI",
            need=f"a scale of {SCALES[0]:g} to {SCALES[1]:g} and at most {OFFSET:g} m/s2 of offset,"
            " the range of an autopilot's parameters",
            do="check the unit and the full-scale range of the columns",
        )
    return offset, scale


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


# of an IMU: names of the sensors of each quantity in kalibr, and SI units
_TRIADS = {"acceleration": ("accelerometer", "m/s^2"), "rate": ("gyroscope", "rad/s")}
_TAGS = {"rate": "angular_velocity", "acceleration": "linear_acceleration"}  # of SDF
_CORRELATION_S = 1000.0  # far longer than what a simulation notices: a random walk


@dataclass(frozen=True)
class TriadNoise:
    """Noise of a triad in SI.

    Args:
        density: N of ``sigma = N sqrt(rate)``, m/s2/rtHz or rad/s/rtHz, (3,).
        walk: K, m/s3/rtHz or rad/s2/rtHz, (3,); an upper limit where the record does not hold it.
        limit: whether ``walk`` is only an upper limit on some axis.
        unfit: columns that the noise model does not fit: upper limits, both.
        rate: of samples, Hz.
    """

    density: Array
    walk: Array
    limit: bool
    unfit: tuple[str, ...]
    rate: float


def triad_noise(models: Mapping[str, StandstillNoise], quantity: str) -> TriadNoise | None:
    """The noise of the first triad of that quantity in SI-like units; None where there is none.

    Args:
        models: column -> noise of a recording at rest.
        quantity: acceleration or rate.
    """
    found: dict[str, dict[str, tuple[StandstillNoise, float]]] = {}
    for column, model in models.items():
        channel, word = split_unit(column)
        unit = COLUMN_UNITS[str(word)]
        name, _, axis = channel.rpartition("_")
        if unit.quantity == quantity and axis in ("x", "y", "z"):
            found.setdefault(name, {})[column] = (model, unit.factor)
    three = next((axes for axes in found.values() if len(axes) == 3), None)
    if three is None:
        return None
    triad = three.values()
    return TriadNoise(
        np.array([m.effective["N"] * f for m, f in triad]),
        np.array([_walk(m) * f for m, f in triad]),
        not all(m.fits and m.held["K"] for m, _ in triad),
        tuple(column for column, (m, _) in three.items() if not m.fits),
        float(1 / next(iter(triad))[0].curve.tau[0]),
    )


def imu_noise(found: RestNoise, source: str) -> dict[str, TriadNoise]:
    """The noise of the first accelerometer and of the first gyro by quantity, acceleration and
    rate, of a recording that has at least one.

    Args:
        found: noise of a recording at rest.
        source: of the recording, for messages.

    Raises:
        TiltcalError: it has neither in SI-like units.
    """
    triads = {q: triad_noise(found.models, q) for q in _TRIADS}
    if not any(triads.values()):
        left_out = "".join(f"; {name}: {why}" for name, why in found.left_out.items())
        raise TiltcalError(
            source,
            found="no accelerometer and no gyro with the axes x, y, z in SI-like units" + left_out,
            need="a recording at rest of at least one of them",
            do="name its columns accel_x_m_s2 ..., gyro_x_rad_s ..., counts converted",
        )
    return {quantity: triad for quantity, triad in triads.items() if triad}


def _walk(model: StandstillNoise) -> float:
    """K, or the most that the Allan deviation allows."""
    return model.values["K"] if model.fits and model.held["K"] else model.limits["K"]


def kalibr_yaml(imu: Mapping[str, TriadNoise], topic: str) -> str:
    """``imu.yaml`` of kalibr; one number stands for the three axes, their root mean square. Of a
    sensor that is missing, a comment says so.

    Args:
        imu: acceleration and rate, or one of them -> noise.
        topic: of the IMU.

    Source: kalibr, IMU noise model: density sigma with sigma_d = sigma / sqrt(dt), and bias walk
        sigma_b with sigma_bd = sigma_b sqrt(dt). These are N and K of the Allan variance.
    """
    lines = [
        "# From a recording at rest. Many users multiply these by 5 to 20:",
        "# kalibr takes everything else (vibration, temperature, scale errors, time stamps) for",
        "# noise of this kind, and an optimiser that trusts the IMU too much fits all else badly.",
    ]
    for quantity, (name, unit) in _TRIADS.items():
        lines += _kalibr_sensor(name, unit, imu.get(quantity))
    rate = next(iter(imu.values())).rate
    lines += [f"rostopic: {topic}", f"update_rate: {rate:.6g}"]
    return "\n".join(lines) + "\n"


def _kalibr_sensor(name: str, unit: str, noise: TriadNoise | None) -> list[str]:
    density, walk = f"{name}_noise_density", f"{name}_random_walk"
    if noise is None:
        missing = f"# {name}: missing, the recording has no three axes of it with noise"
        return [missing, f"# kalibr needs {density} and {walk} of it as well"]
    mark = "   # upper limit: not visible in this recording" if noise.limit else ""
    lines = [
        f"# {column}: white noise, flicker and walk do not fit; upper limits"
        for column in noise.unfit
    ]
    return [
        *lines,
        f"# {name}: {unit}/sqrt(Hz), {unit}/s/sqrt(Hz)",
        f"{density}: {_rms(noise.density):.6g}",
        f"{walk}: {_rms(noise.walk):.6g}{mark}",
    ]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def sdf_imu(imu: Mapping[str, TriadNoise], bias: Mapping[str, Sequence[float]]) -> str:
    """The ``<imu>`` block of an SDF sensor; a sensor that is missing has no block.

    ``stddev`` is of one sample, N sqrt(rate). A known bias stands in ``mean``: Gazebo gives the
    bias of ``bias_mean`` either sign. ``dynamic_bias_stddev`` is K: a random walk, because the
    correlation time is long.

    Args:
        imu: acceleration and rate, or one of them -> noise.
        bias: acceleration and rate -> bias of each axis, SI; zeros where it is not known.
    """
    rate = next(iter(imu.values())).rate
    lines = [f"<!-- update_rate {rate:.6g} Hz; SI units -->"]
    for noise in imu.values():
        lines += [
            f"<!-- {column}: white noise, flicker and walk do not fit; upper limits -->"
            for column in noise.unfit
        ]
    lines.append("<imu>")
    for quantity, tag in _TAGS.items():
        if quantity not in imu:
            lines.append(f"  <!-- {tag} is missing: the recording has no three axes of it -->")
            continue
        lines.append(f"  <{tag}>")
        for k, axis in enumerate("xyz"):
            mean = float(bias.get(quantity, (0.0, 0.0, 0.0))[k])
            lines += _axis(axis, imu[quantity], k, mean)
        lines.append(f"  </{tag}>")
    return "\n".join([*lines, "</imu>"]) + "\n"


def _axis(axis: str, noise: TriadNoise, k: int, mean: float) -> list[str]:
    values = {
        "mean": mean,
        "stddev": float(noise.density[k] * np.sqrt(noise.rate)),
        "bias_mean": 0.0,
        "bias_stddev": 0.0,
    }
    if not noise.limit:
        values |= {
            "dynamic_bias_stddev": float(noise.walk[k]),
            "dynamic_bias_correlation_time": _CORRELATION_S,
        }
    inner = [f"        <{name}>{value:.9g}</{name}>" for name, value in values.items()]
    head, end = [f"    <{axis}>", '      <noise type="gaussian">'], ["      </noise>"]
    return [*head, *inner, *end, f"    </{axis}>"]
