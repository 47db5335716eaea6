"""Calibration over temperature: exact terms back, warming and cooling told apart, the real cycle,
streaming, C.
"""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from builders import ACCEL, GYRO, G, setup_of
from host import STRICT, compiler
from outside_files import RECORDINGS, needs
from statistics_helpers import rng_of

from tiltcal.calibration.correction import correct_pieces, corrected_columns
from tiltcal.calibration.firmware.header import header
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.result import calibration_from
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording

SENSOR = ACCEL.model_copy(update={"rate_hz": 1.0})
SETUP = setup_of("handheld", SENSOR)
HOURS = 3600.0
REAL = RECORDINGS / "thermal_cycle" / "imu_raw_data.csv"
WORDS = Path(__file__).parents[1] / "scenarios" / "real"
FACES = {"+x": 0, "-x": 0, "+y": 1, "-y": 1, "+z": 2, "-z": 2}


def cycle(hours=6.0, span=(-20.0, 60.0), step=2.0):
    """Time and a temperature that rises, falls and rises again."""
    time = np.arange(0, hours * HOURS, step)
    middle, half = np.mean(span), np.ptp(span) / 2
    return time, middle + half * np.sin(2 * np.pi * time / (hours * HOURS / 1.5))


def lagged(time, temperature, constant):
    """First-order lag by small steps, written out."""
    found = np.empty_like(temperature)
    found[0] = temperature[0]
    for k in range(1, len(time)):
        share = 1 - np.exp(-(time[k] - time[k - 1]) / constant)
        found[k] = found[k - 1] + share * (temperature[k] - found[k - 1])
    return found


def at_rest(rng, extra=0.0, span=(-20.0, 60.0), **kwargs):
    """One attitude, +z up: a cubic of temperature and what else is added."""
    time, temperature = cycle(span=span, **kwargs)
    warm = temperature - temperature.mean()
    bias = np.column_stack([1e-3 * warm, -4e-4 * warm + 2e-5 * warm**2, 3e-7 * warm**3])
    values = bias + np.array([0.0, 0.0, G]) + extra + rng.normal(0, 2e-3, (len(time), 3))
    columns = {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")}
    columns["temperature_degC"] = temperature
    labels = np.full(len(time), "+z", dtype=object)
    return Recording.from_columns(time, columns, labels=labels), bias


def test_a_cubic_comes_back_within_its_sigmas_and_no_memory_is_invented():
    inside, memory = [], 0
    for k in range(12):
        log, _ = at_rest(rng_of(f"thermal {k}"))
        found = calibrate("thermal", log, SETUP)
        assert found.verdict == "good"
        memory += any("tempmem" in n for n in found.parameters)
        truth = {"accel.temp1_bias_x": 1e-3, "accel.temp1_bias_y": -4e-4}
        truth |= {"accel.temp2_bias_y": 2e-5, "accel.temp3_bias_z": 3e-7}
        for name, value in truth.items():
            estimate = found.parameters[name]
            inside.append(abs(estimate.value - value) < 3 * estimate.sigma)
    assert np.mean(inside) > 0.93
    assert memory <= 1


@pytest.mark.parametrize("constant", [300.0, 1500.0])
def test_a_lag_is_told_from_a_polynomial_with_its_time_constant(constant):
    time, temperature = cycle()
    extra = 5e-4 * (temperature - lagged(time, temperature, constant))[:, None]
    found = calibrate("thermal", at_rest(rng_of("lag"), extra)[0], SETUP)
    assert found.verdict == "good"
    assert constant / 2 < found.value("temperature.lag") < constant * 2
    assert found.value("accel.tempmem_x") != 0
    assert any("a polynomial of temperature alone" in w for w in found.warnings)


def test_hysteresis_is_told_from_a_lag():
    time, temperature = cycle()
    state = np.zeros(len(time))
    for k in range(1, len(time)):
        change = temperature[k] - temperature[k - 1]
        state[k] = state[k - 1] + (np.sign(change) - state[k - 1]) * abs(change) / 8.0
    found = calibrate("thermal", at_rest(rng_of("hysteresis"), 0.02 * state[:, None])[0], SETUP)
    assert 4 < found.value("temperature.hysteresis") < 16
    assert found.value("accel.tempmem_y") == pytest.approx(0.02, rel=0.2)


def test_a_temperature_that_only_rises_is_suspect_and_one_that_stays_is_refused():
    rng = rng_of("one way")
    log, _ = at_rest(rng)
    rising = np.flatnonzero(np.gradient(log.column("temperature_degC")) > 0)
    first = rising[: np.flatnonzero(np.diff(rising) > 1)[0]]
    names = [n for n in log.column_names if n != "label"]
    part = Recording.from_columns(log.time[first], {n: log.column(n)[first] for n in names})
    found = calibrate("thermal", part, SETUP)
    assert found.verdict == "suspect"
    assert any("record the way back" in t.statement for t in found.tests if not t.passed)
    with pytest.raises(TiltcalError, match=r"need a column temperature_degC over 2 degC"):
        calibrate("thermal", at_rest(rng, span=(20.0, 20.5))[0], SETUP)


def six_faces():
    """Six faces visited through a cycle: bias, scale and axes change with temperature."""
    rng = rng_of("six faces over temperature")
    time, temperature = cycle(hours=12.0)
    number = (time // 300).astype(int) % 6
    names = list(FACES)
    up = np.array([[(1 if f[0] == "+" else -1) * (FACES[f] == j) for j in range(3)] for f in names])
    moving = (time % 300) < 10
    force = G * up[number].astype(float)
    warm = (temperature - temperature.mean())[:, None, None]
    M = np.diag([1.002, 0.999, 1.001]) + warm * 1e-5 * np.array([[3, 1, 0], [0, -2, 1], [2, 0, 4]])
    bias = np.array([0.05, -0.02, 0.01]) + warm[:, 0] * np.array([1e-3, 2e-3, -1e-3])
    values = bias + np.einsum("nij,nj->ni", M, force) + rng.normal(0, 2e-3, force.shape)
    values[moving] += rng.normal(0, 1.0, (int(moving.sum()), 3))
    columns = {f"accel_{a}_m_s2": values[:, i] for i, a in enumerate("xyz")}
    columns["temperature_degC"] = temperature
    labels = np.array([names[k] for k in number], dtype=object)
    return Recording.from_columns(time, columns, labels=labels), force, moving


def test_scale_and_axes_over_temperature_come_back_and_are_corrected():
    log, force, moving = six_faces()
    found = calibrate("thermal", log, SETUP)
    assert found.verdict == "good"
    assert found.value("accel.temp1_scale_x") == pytest.approx(3e-5, rel=0.1)
    assert found.value("accel.temp1_cross_zx") == pytest.approx(2e-5, rel=0.1)
    fixed = corrected_columns(log, found, SETUP)
    left = np.column_stack([fixed[f"accel_{a}_corrected_m_s2"] for a in "xyz"]) - force
    assert np.sqrt(np.mean(left[~moving] ** 2)) < 2.1e-3  # the noise of a sample is 2e-3


def test_pieces_are_corrected_as_the_whole_is():
    log, _, _ = six_faces()
    found = calibrate("thermal", log, SETUP)
    whole = corrected_columns(log, found, SETUP)
    names = [n for n in log.column_names if n != "label"]
    pieces = [
        Recording.from_columns(log.time[a:b], {n: log.column(n)[a:b] for n in names})
        for a, b in ((0, 1000), (1000, 1001), (1001, len(log)))
    ]
    written = []
    correct_pieces(pieces, found, written.append)
    for axis in "xyz":
        name = f"accel_{axis}_corrected_m_s2"
        joined = np.concatenate([p.column(name) for p in written])
        assert joined == pytest.approx(whole[name], abs=1e-12)


def test_cal_json_reads_back_and_a_recording_without_temperature_is_refused():
    log, _ = at_rest(rng_of("json"))
    found = calibrate("thermal", log, SETUP)
    again = calibration_from(json.loads(json.dumps(found.to_json())))
    assert again.parameters == found.parameters
    bare = Recording.from_columns(
        log.time, {f"accel_{a}_m_s2": log.column(f"accel_{a}_m_s2") for a in "xyz"}
    )
    with pytest.raises(TiltcalError, match="need a column temperature_degC"):
        corrected_columns(bare, again, SETUP)


HOST = """
#include <stdio.h>
#include "thermal.h"
int main(void)
{
  double t, c, r[3], last = 0;
  int first = 1;
  imu_state s;
  while (scanf("%lf %lf %lf %lf %lf", &t, &c, &r[0], &r[1], &r[2]) == 5) {
    const imu_real in[3] = { (imu_real)r[0], (imu_real)r[1], (imu_real)r[2] };
    imu_real f[3];
    if (first) imu_start(&s, (imu_real)c); else imu_step(&s, (imu_real)c, (imu_real)(t - last));
    first = 0;
    last = t;
    imu_accel(&s, in, f);
    printf("%.17g %.17g %.17g\\n", (double)f[0], (double)f[1], (double)f[2]);
  }
  return 0;
}
"""


@pytest.mark.skipif(compiler() is None, reason="no C compiler on this machine: cc, gcc or clang")
@pytest.mark.parametrize(
    ("flags", "within"),
    [(("-DIMU_DOUBLE",), 1e-11), ((), 2e-4)],
)
@pytest.mark.parametrize("made_of", ["six faces", "lag"])
def test_the_c_header_corrects_as_correct_does(tmp_path, flags, within, made_of):
    if made_of == "lag":
        time, temperature = cycle()
        extra = 5e-4 * (temperature - lagged(time, temperature, 900.0))[:, None]
        log, _ = at_rest(rng_of("C"), extra)
    else:
        log, _, _ = six_faces()
    found = calibrate("thermal", log, SETUP)
    (tmp_path / "thermal.h").write_text(header(found, SETUP, "imu"))
    (tmp_path / "host.c").write_text(HOST)
    program = tmp_path / "host"
    words = [str(compiler()), *STRICT, *flags, str(tmp_path / "host.c"), "-o", str(program), "-lm"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    rows = slice(0, 3000)
    values = np.column_stack([log.column(f"accel_{a}_m_s2")[rows] for a in "xyz"])
    lines = np.column_stack([log.time[rows], log.column("temperature_degC")[rows], values])
    text = "\n".join(" ".join(repr(float(v)) for v in line) for line in lines)
    answer = subprocess.run([str(program)], input=text, capture_output=True, text=True, check=True)
    got = np.array([[float(v) for v in line.split()] for line in answer.stdout.splitlines()])
    fixed = corrected_columns(log, found, SETUP)
    stated = np.column_stack([fixed[f"accel_{a}_corrected_m_s2"][rows] for a in "xyz"])
    assert np.abs(got - stated).max() < within


@needs(REAL)
def test_the_real_cycle_leaves_no_more_than_a_careful_fit_with_a_rate_term(tmp_path):
    run, cal = str(tmp_path / "run.csv"), tmp_path / "CAL.json"
    assert main(["import", str(REAL), "--map", str(WORDS / "thermal_map.toml"), "-o", run]) == 0
    words = ["--scenario", str(WORDS / "thermal.toml"), "--method", "thermal", "-o", str(cal)]
    # it leaves several times the noise of the readings, and says so
    assert main(["calibrate", run, *words]) == 1
    stated = json.loads(cal.read_text())
    failed = [t["name"] for t in stated["tests"] if not t["passed"]]
    assert failed == ["fit of accel", "cause of accel"]
    (note,) = [w for w in stated["warnings"] if "a polynomial of temperature alone" in w]
    before, after = note.split(" leaves ")[1].split(", with a ")
    plain = [float(v) for v in before.split(" mg")[0].split(", ")]
    left = [float(v) for v in after.removesuffix(" mg").split(" s ")[1].split(", ")]
    assert plain == pytest.approx([0.58, 1.74, 4.51], rel=0.1)  # a careful cubic, held out
    assert np.all(np.array(left) <= 1.1 * np.array([0.28, 0.72, 1.80]))  # with dT/dt


def test_a_gyro_beside_it_has_its_own_terms():
    rng = rng_of("gyro over temperature")
    log, _ = at_rest(rng)
    warm = log.column("temperature_degC") - log.column("temperature_degC").mean()
    rates = {
        f"gyro_{a}_rad_s": 1e-4 * (i + 1) * warm + rng.normal(0, 1e-3, len(warm))
        for i, a in enumerate("xyz")
    }
    gyro = GYRO.model_copy(update={"rate_hz": 1.0})
    found = calibrate("thermal", log.with_columns(rates), setup_of("handheld", SENSOR, gyro))
    assert found.value("gyro.temp1_bias_z") == pytest.approx(3e-4, rel=0.02)
    assert found.parameters["gyro.temp1_bias_z"].unit == "rad_s_degC1"


def spoiled(log, fault):
    """A cycle with a step of the bias, a stuck thermometer, or a stretch read upside down."""
    n, part = len(log), slice(len(log) // 3, len(log) // 2)
    z, T = log.column("accel_z_m_s2").copy(), log.column("temperature_degC").copy()
    if fault == "step":
        z[n // 2 :] += 0.02
    if fault == "stuck":
        T[part] = T[part.start]
    if fault == "label":
        z[part] = 2 * G - z[part] - 2 * G
    return changed(log, accel_z_m_s2=z, temperature_degC=T)


def changed(log, **columns):
    """A log with other values in some columns."""
    own = {name: log.column(name) for name in log.column_names} | columns
    return Recording.from_columns(log.time, own, labels=np.full(len(log), "+z", dtype=object))


@pytest.mark.parametrize("fault", ["step", "stuck", "label"])
def test_what_no_polynomial_follows_fails_the_fit_and_names_where(fault):
    log, _ = at_rest(rng_of(f"thermal {fault}"))
    found = calibrate("thermal", spoiled(log, fault), SETUP)
    (fit,) = [t for t in found.tests if t.name == "fit of accel"]
    assert found.verdict == "suspect"
    assert not fit.passed
    assert "times it; the largest from" in fit.statement
    (cause,) = [t for t in found.tests if t.name == "cause of accel"]
    assert ("temperature_degC: frozen at" in cause.statement) is (fault == "stuck")


def test_the_noise_of_a_thermometer_is_no_way_back():
    rng = rng_of("one way")
    log, _ = at_rest(rng)
    T = np.linspace(-20.0, 60.0, len(log)) + rng.normal(0, 0.01, len(log))
    found = calibrate("thermal", changed(log, temperature_degC=T), SETUP)
    (both,) = [t for t in found.tests if t.name == "warming and cooling"]
    assert not both.passed
