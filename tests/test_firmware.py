"""Headers of bias, scale, axes, g-sensitivity and temperature: strict C99, equal to `tiltcal
correct` in floating point to rounding and in integers within the error that they state.
"""

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import ACCEL, FOG, GYRO, INCL, setup_of
from cortex_m0 import COMPILER, EMULATOR, missing
from firmware_vectors import C99, Case
from host import compiler
from scenario_files import refusal
from statistics_helpers import rng_of
from term_sizes import size_of

from tiltcal.calibration.correction import correct_pieces
from tiltcal.calibration.correction import setup_of as stated_setup
from tiltcal.calibration.firmware.fixed_model import range_of
from tiltcal.calibration.firmware.header import fixed_sensors, header
from tiltcal.calibration.firmware.log_units import log_unit, with_recorded_units
from tiltcal.calibration.firmware.model_export import sensor_models
from tiltcal.calibration.firmware.vectors import firmware_vectors
from tiltcal.calibration.methods.registry import _with_setup
from tiltcal.calibration.result import calibration_from
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.effects import make_effect
from tiltcal.instrument.terms import terms_of
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording
from tiltcal.setup.sensor import Input

needs_compiler = pytest.mark.skipif(
    compiler() is None, reason="no C compiler on this machine: cc, gcc or clang"
)
PAGE = Path(__file__).parents[1] / "docs" / "firmware.md"
UNDEFINED = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
COUNTS = Input(unit="LSB", zero=[33000, 32500, 31900], per_m_s2=415)
AXES = {"bias_x": 0.05, "bias_y": -0.02, "bias_z": 0.01, "scale_x": 2e-3, "scale_y": -1e-3}
AXES |= {"scale_z": 5e-4, "cross_xy": 3e-4, "cross_yz": -8e-4, "cross_zx": 1e-3}
WARM = {"temp1_bias_x": 1e-3, "temp2_bias_y": 2e-5, "temp3_bias_z": 3e-7, "temp1_bias_z": -4e-4}
TURNED = {"temp1_scale_x": 3e-5, "temp1_cross_xy": 1e-5, "temp2_scale_z": -4e-7}
HEAT = {"T0": 19.5, "smoothing": 30.0, "lowest": -20.3, "highest": 60.7}
LAG, HYSTERESIS = {"lag": 900.0}, {"hysteresis": 8.0}
PAST = {f"tempmem_{a}": s for a, s in zip("xyz", (5e-4, -3e-4, 2e-4), strict=True)}
PULL = {"gsens_xx": 20.0, "gsens_xy": -15.0, "gsens_yz": 30.0, "gsens_zx": 8.0}


def calibration(sensors, parameters, heat=None):
    """Of stated parameters: sensor -> term -> value; heat: of the temperature."""
    named = {f"{s}.{t}": v for s, terms in parameters.items() for t, v in terms.items()}
    named |= {f"temperature.{n}": v for n, v in (heat or {}).items()}
    table = {
        "method": "stated",
        "verdict": "good",
        "parameters": {
            n: {"value": v, "sigma": 0.0, "unit": "deg_h_g" if "gsens" in n else "1"}
            for n, v in named.items()
        },
    }
    return _with_setup(calibration_from(table), setup_of("handheld", *sensors))


def accel(**changes):
    return ACCEL.model_copy(update=changes)


CASES = {
    "m/s2": ([ACCEL], {"accel": AXES}, None),
    "mg": ([accel(unit="mg", full_scale=39.0)], {"accel": AXES}, None),
    "counts": ([accel(input=COUNTS)], {"accel": AXES}, None),
    "two axes": (
        [accel(axes=("y", "x"))],
        {"accel": {"bias_x": 0.1, "scale_y": 0.01, "cross_xy": 2e-3}},
        None,
    ),
    "gyro": ([GYRO], {"gyro": {n: v / 10 for n, v in AXES.items()}}, None),
    "fog": (
        [FOG.model_copy(update={"full_scale": 0.2})],
        {"fog": {"bias_a": 1e-6, "scale_a": 2e-4}},
        None,
    ),
    "g-sensitivity": ([GYRO, accel(input=COUNTS)], {"gyro": AXES | PULL}, None),
    "temperature": ([ACCEL], {"accel": AXES | WARM}, HEAT),
    "temperature and axes": ([accel(unit="mg")], {"accel": AXES | WARM | TURNED}, HEAT),
    "lag": ([ACCEL], {"accel": AXES | WARM | TURNED | PAST}, HEAT | LAG),
    "hysteresis": ([ACCEL], {"accel": AXES | WARM | PAST}, HEAT | HYSTERESIS),
    "counts over temperature": ([accel(input=COUNTS)], {"accel": AXES | WARM | PAST}, HEAT | LAG),
    "no smoothing": ([ACCEL], {"accel": WARM}, HEAT | {"smoothing": 0.0}),
    "two sensors": (
        [ACCEL, GYRO],
        {"accel": AXES | WARM, "gyro": {"bias_x": 1e-4, "temp1_bias_z": 1e-6}},
        HEAT,
    ),
}


def cases_of(found, vectors, folder):
    """One case a sensor, with its numbers."""
    (folder / "imu.h").write_text(header(found, stated_setup(found), "imu"))
    setup = with_recorded_units(stated_setup(found), found)
    for fixed in fixed_sensors(found, setup)[0]:
        sensor, force, unit = fixed.model.sensor, fixed.model.force, fixed.model.unit
        name = sensor.name
        inputs = [f"{name}_{a}_{unit.written}" for a in sensor.axes]
        outputs = [f"{name}_{a}_corrected_{unit.corrected}" for a in sensor.axes]
        if force is not None:
            inputs += [f"{force[0].name}_{a}_{force[1].written}" for a in "xyz"]
        case = Case(
            folder / "imu.h",
            "imu",
            name,
            tuple(inputs),
            tuple(outputs),
            force is not None,
            "temperature_degC" in vectors.column_names,
        )
        yield case, fixed, np.column_stack([vectors.column(c) for c in outputs])


@needs_compiler
@pytest.mark.parametrize("name", CASES)
def test_the_header_corrects_as_correct_does(name, tmp_path):
    found = calibration(*CASES[name])
    vectors = firmware_vectors(found)
    for case, fixed, expected in cases_of(found, vectors, tmp_path):
        size = np.abs(expected).max()
        doubles = case.run(vectors, None, "-DIMU_DOUBLE")
        assert np.abs(doubles - expected).max() < 2e-13 * size
        assert np.abs(case.run(vectors, None) - expected).max() < 1e-6 * size
        places = np.full(len(case.inputs), fixed.readings.places)
        if fixed.force is not None:
            places[-3:] = fixed.force.places
        whole = case.run(vectors, places, *UNDEFINED)
        error = np.abs(whole * 2.0**-fixed.places - expected).max()
        assert error <= fixed.error
        assert fixed.error < 1e-6 * size  # and the stated error is a small one
        unit = fixed.model.unit.corrected
        (stated,) = re.findall(rf"worst error of f.*: (\S+) {unit}$", comment_of(case), re.M)
        assert fixed.error <= float(stated) < 1.2 * fixed.error


def comment_of(case):
    """What the header says of the integers of a sensor."""
    text = case.header.read_text()
    return text.partition(f"imu_{case.sensor}_fixed(")[2].partition("_fixed(")[0]


INCLINED = {
    "deg": (INCL, {}),
    "axes": (INCL, {"scale_x": 2e-3, "cross_xy": 3e-3, "cross_yz": -0.02, "cross_xz": 0.01}),
    "arcsec, y first": (
        INCL.model_copy(update={"unit": "arcsec", "axes": ("y", "x")}),
        {"scale_y": -4e-3, "cross_yx": 2e-3, "cross_xz": 1e-3},
    ),
    "counts": (
        INCL.model_copy(update={"input": Input(unit="LSB", zero=[32768, 32700], per_deg=350)}),
        {"scale_y": 1e-3, "cross_xz": 2e-3},
    ),
    "one axis": (INCL.model_copy(update={"axes": ("x",)}), {"scale_x": 1e-3}),
}


@needs_compiler
@pytest.mark.parametrize("name", INCLINED)
def test_the_header_of_an_inclinometer_corrects_as_correct_does(name, tmp_path):
    sensor, terms = INCLINED[name]
    biases = {f"bias_{a}": 0.02 for a in sensor.axes}
    found = calibration([sensor], {"incl": biases | terms})
    text = header(found, stated_setup(found), "imu")
    (tmp_path / "imu.h").write_text(text)
    vectors, unit = firmware_vectors(found), log_unit(sensor)
    inputs = tuple(f"incl_{a}_{unit.written}" for a in sensor.axes)
    outputs = tuple(f"incl_{a}_corrected_{unit.corrected}" for a in sensor.axes)
    case = Case(tmp_path / "imu.h", "imu", "incl", inputs, outputs)
    expected = np.column_stack([vectors.column(c) for c in outputs])
    size = np.abs(expected).max()
    assert np.abs(case.run(vectors, None, "-DIMU_DOUBLE") - expected).max() < 3e-11 * size
    assert np.abs(case.run(vectors, None) - expected).max() < 3e-6 * size
    places = int(re.search(r"f: (\d+) places", text)[1])
    stated = float(re.search(r"up to an inclination of 80 deg: (\S+) ", text)[1])
    whole = case.run(vectors, range_of(sensor, unit).places, *UNDEFINED)
    error = np.abs(whole * 2.0**-places - expected).max()
    assert error <= stated < 1e-6 * size  # 0.03 arcsec and less
    rng = rng_of("steep and wild")
    wild = {c: rng.choice([-(2**31), 2**31 - 1, 0, 10**6], 400).astype(float) for c in inputs}
    right_angle = np.pi / 2 / unit.corrected_factor
    steep = case.run(Recording.from_columns(vectors.time, wild), 0, *UNDEFINED) * 2.0**-places
    assert np.abs(steep).max() <= right_angle * (1 + 1e-6)
    code = re.sub(r"/\*.*?\*/", "", text.partition("#endif /* IMU_FIXED_ONLY */")[2])
    assert not re.search(r"\b(float|double|imu_real|math\.h)\b|\d\.\d", code)


@needs_compiler
@pytest.mark.parametrize("name", ["counts", "g-sensitivity", "lag", "hysteresis", "two axes"])
def test_no_integer_overflows_whatever_is_read(name, tmp_path):
    found = calibration(*CASES[name])
    vectors = firmware_vectors(found)
    rng, n = rng_of("any integer"), len(vectors)
    heat = rng.integers(-(2**31), 2**31, n) * 2.0**-16
    for case, fixed, _ in cases_of(found, vectors, tmp_path):
        held = [fixed.readings] * len(case.outputs) + [fixed.force] * 3 * case.forced
        wild, clipped = {"temperature_degC": heat}, {"temperature_degC": np.clip(heat, -21, 61)}
        for column, taken in zip(case.inputs, held, strict=True):
            whole = rng.choice([-(2**31), 2**31 - 1, -1, 0, 1, 10**9], n)
            wild[column] = whole.astype(float)
            clipped[column] = np.clip(whole, -taken.whole, taken.whole) * 2.0**-taken.places
        got = case.run(Recording.from_columns(vectors.time, wild), 0, *UNDEFINED)
        log, corrected = Recording.from_columns(vectors.time, clipped), list[Recording]()
        correct_pieces([log], found, corrected.append)
        expected = np.column_stack([corrected[0].column(c) for c in case.outputs])
        assert np.abs(got * 2.0**-fixed.places - expected).max() <= fixed.error


@needs_compiler
@pytest.mark.parametrize("name", ["g-sensitivity", "lag", "hysteresis"])
def test_the_integers_need_no_floating_point_registers(name, tmp_path):
    found = calibration(*CASES[name])
    (tmp_path / "imu.h").write_text(header(found, stated_setup(found), "imu"))
    (tmp_path / "only.c").write_text('#include "imu.h"\n')
    words = [
        compiler(),
        "-std=c99",
        "-mgeneral-regs-only",
        "-fkeep-inline-functions",
        "-c",
        "only.c",
    ]
    whole = subprocess.run(
        [*words, "-DIMU_FIXED_ONLY"], cwd=tmp_path, capture_output=True, text=True
    )
    if "unrecognized" in whole.stderr or "unknown argument" in whole.stderr:
        pytest.skip("this compiler cannot forbid floating-point registers")
    assert (whole.returncode, whole.stderr) == (0, "")
    text = header(found, stated_setup(found), "imu")
    after = text.partition("#endif /* IMU_FIXED_ONLY */")[2]
    assert not re.search(
        r"\b(float|double|imu_real|math\.h)\b|\d\.\d", re.sub(r"/\*.*?\*/", "", after)
    )


@needs_compiler
def test_the_program_of_the_page_compiles(tmp_path):
    found = calibration(*CASES["lag"])
    (tmp_path / "imu.h").write_text(header(found, stated_setup(found), "imu"))
    (program,) = re.findall(r"^```c\n(.*?)^```$", PAGE.read_text(), re.M | re.S)
    (tmp_path / "main.c").write_text(program)
    words = [compiler(), *C99, "-DIMU_FIXED_ONLY", "-c", "main.c"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs_compiler
def test_readings_beyond_the_range_are_held_and_said(tmp_path):
    found = calibration([accel(full_scale=20.0)], {"accel": AXES})
    (tmp_path / "imu.h").write_text(header(found, stated_setup(found), "imu"))
    (tmp_path / "host.c").write_text(
        '#include <stdio.h>\n#include "imu.h"\nint main(void)\n{\n  int32_t f[3], g[3];\n'
        "  const int32_t in[3] = { INT32_MAX, 0, INT32_MIN };\n"
        "  const int32_t at[3] = { IMU_ACCEL_LARGEST, 0, -IMU_ACCEL_LARGEST };\n"
        "  const unsigned a = imu_accel_fixed(in, f), b = imu_accel_fixed(at, g);\n"
        '  printf("%u %u %d", a, b, f[0] == g[0] && f[1] == g[1] && f[2] == g[2]);\n'
        "  return 0;\n}\n"
    )
    words = [compiler(), "-std=c99", "-DIMU_FIXED_ONLY", "host.c", "-o", "host"]
    subprocess.run(words, cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "host"], capture_output=True, text=True, check=True)
    assert done.stdout == "5 0 1"


@needs_compiler
def test_a_log_gives_the_units_and_the_vectors(tmp_path):
    found = calibration([ACCEL], {"accel": AXES})
    found.save(tmp_path / "CAL.json")
    rng = rng_of("log in mg")
    values = {f"accel_{a}_mg": rng.uniform(-1000, 1000, 900) for a in "xyz"}
    log = Recording.from_columns(np.arange(900) / 50, values)
    log.save(tmp_path / "run.csv")
    words = ["--log", tmp_path / "run.csv", "--vectors", tmp_path / "vectors.csv", "--name", "imu"]
    words = ["export", tmp_path / "CAL.json", *words, "-o", tmp_path / "imu.h"]
    assert main([str(w) for w in words]) == 0
    assert "3 readings in mg, corrected in mg" in (tmp_path / "imu.h").read_text()
    vectors = read_recording(tmp_path / "vectors.csv")
    whole: list[Recording] = []
    correct_pieces([log], found, whole.append)
    columns = tuple(f"accel_{a}_corrected_mg" for a in "xyz")
    for column in columns:
        assert np.array_equal(vectors.column(column), whole[0].column(column)[: len(vectors)])
    case = Case(tmp_path / "imu.h", "imu", "accel", tuple(values), columns)
    got = case.run(vectors, None, "-DIMU_DOUBLE")
    assert got == pytest.approx(np.column_stack([vectors.column(c) for c in columns]), abs=1e-9)


def test_the_command_leaves_integers_out(tmp_path, capsys):
    calibration([ACCEL], {"accel": AXES | {"K2_x": 0.05}}).save(tmp_path / "CAL.json")
    words = ["export", tmp_path / "CAL.json", "--vectors", tmp_path / "v.csv"]
    message = refusal([*words, "-o", tmp_path / "no.h"], tmp_path, capsys)
    assert "export with --no-integers" in message
    assert not (tmp_path / "no.h").exists()
    words += ["--no-integers", "-o", tmp_path / "imu.h"]
    assert main([str(w) for w in words]) == 0
    assert "int32_t" not in (tmp_path / "imu.h").read_text()
    assert np.isfinite(read_recording(tmp_path / "v.csv").column("accel_x_corrected_m_s2")).all()


@needs_compiler
@pytest.mark.parametrize(("sensor", "unit"), [(ACCEL, "mg"), (accel(input=COUNTS), "g")])
def test_the_columns_that_were_calibrated_give_the_units(sensor, unit, tmp_path):
    found = calibration([sensor], {"accel": AXES})
    found = replace(found, provenance=found.provenance | {"columns": {"accel": unit}})
    text = header(found, stated_setup(found), "imu")
    assert f"3 readings in {unit}, corrected in {unit}" in text
    (tmp_path / "imu.h").write_text(text)
    vectors = firmware_vectors(found)
    inputs = tuple(f"accel_{a}_{unit}" for a in "xyz")
    case = Case(
        tmp_path / "imu.h",
        "imu",
        "accel",
        inputs,
        tuple(f"accel_{a}_corrected_{unit}" for a in "xyz"),
    )
    expected = np.column_stack([vectors.column(c) for c in case.outputs])
    assert case.run(vectors, None, "-DIMU_DOUBLE") == pytest.approx(expected, rel=1e-12, abs=1e-9)


def test_counts_that_were_calibrated_stay_counts():
    found = calibration([accel(input=COUNTS)], {"accel": AXES})
    plain = header(found, stated_setup(found), "imu")
    found = replace(found, provenance=found.provenance | {"columns": {"accel": "LSB"}})
    assert header(found, stated_setup(found), "imu") == plain
    assert "3 readings in LSB" in plain


def test_what_firmware_does_not_have_is_refused_in_words(tmp_path, capsys):
    warming = calibration([ACCEL], {"accel": {"warmup_x": 1e-3}})
    with pytest.raises(TiltcalError, match=r"acc_warmup\[accel\]: found a term with the time, for"):
        header(warming, stated_setup(warming))
    play = replace(
        calibration([ACCEL], {"accel": AXES}),
        effects=[
            make_effect("acc_hysteresis", {"hysteresis_x_ug": 30}, setup_of("handheld", ACCEL))
        ],
    )
    with pytest.raises(TiltcalError, match=r"found acc_hysteresis, need terms that depend on one"):
        header(play, stated_setup(play))
    lean = calibration([INCL], {"incl": {"cross_xz": 0.3}})
    with pytest.raises(TiltcalError, match=r"terms that change by up to .* of their input, need"):
        header(lean, stated_setup(lean))
    jump = calibration([ACCEL], {"accel": {"bias_asym_x": 1e-3}})
    with pytest.raises(TiltcalError, match="found a term with sign, need"):
        header(jump, stated_setup(jump))
    assert "bias_asym" not in header(jump, stated_setup(jump), integers=False)
    folded = calibration([ACCEL], {"accel": {"K2_x": 0.05}})
    with pytest.raises(TiltcalError, match="found values that grow without a bound, need"):
        header(folded, stated_setup(folded))
    alone = calibration([GYRO], {"gyro": PULL})
    with pytest.raises(TiltcalError, match="no accelerometer triad"):
        header(alone, stated_setup(alone))
    wild = calibration([ACCEL], {"accel": {"temp1_scale_x": 0.05}}, HEAT)
    with pytest.raises(TiltcalError, match=r"a bound, need terms that change by less than 0\.58"):
        header(wild, stated_setup(wild))
    plain = calibration([ACCEL], {"accel": AXES})
    mixed = Recording.from_columns(
        np.arange(3.0), {"accel_x_mg": np.ones(3), "accel_y_g": np.ones(3), "accel_z_g": np.ones(3)}
    )
    with pytest.raises(TiltcalError, match="found units mg, g, g, need one unit"):
        header(plain, stated_setup(plain), log=mixed)
    plain.save(tmp_path / "CAL.json")
    table = json.loads((tmp_path / "CAL.json").read_text())
    table["parameters"] = {"base.azimuth": {"value": 1.0, "sigma": 0.0, "unit": "rad"}}
    table["covariance"] = {"names": ["base.azimuth"], "matrix": [[0.0]]}
    (tmp_path / "north.json").write_text(json.dumps(table))
    assert "no sensor" in refusal(["export", tmp_path / "north.json"], tmp_path, capsys)
    words = ["export", tmp_path / "CAL.json", "--format", "px4", "--vectors", "v.csv"]
    assert "found --vectors, need --format c" in refusal(words, tmp_path, capsys)


# --------------------------------------------------------------------------------------------------
# ---------- any list of terms


def drawn_terms(sensor, names, rng):
    """Plausible values of some terms of a sensor, SI."""
    return {name: float(rng.uniform(-1, 1)) * size_of(sensor, name) for name in names}


def all_terms(sensor):
    """Those that do not depend on the time."""
    known = terms_of(sensor.kind, sensor.axes)
    own = {n: cls for n, (cls, _) in known.items() if cls.row_wise and cls.stage == "sensor"}
    return [n for n, cls in own.items() if cls.needs != "time"]


SLOW = GYRO.model_copy(update={"full_scale": 5.0})
TURNING = FOG.model_copy(update={"full_scale": 0.2})
LISTS = [(sensor, "all", k) for k, sensor in enumerate((ACCEL, INCL, GYRO, FOG))]
LISTS += [(accel(axes=("x", "y")), "all", 4), (accel(unit="mg", axes=("z", "x")), "all", 5)]
LISTS += [((ACCEL, INCL, GYRO, FOG)[k % 4], "five", k) for k in range(6, 18)]


def with_terms(sensor, names, rng, **shapes):
    """A calibration of a sensor with plausible values of some terms."""
    sensors = [sensor] if sensor.is_accelerometer else [ACCEL, sensor]
    heat = {"T0": 21.0, "smoothing": 20.0, "lag": 300.0} | shapes
    found = calibration(sensors, {sensor.name: drawn_terms(sensor, names, rng)}, heat)
    return replace(found, parameters={n: replace(e, unit="1") for n, e in found.parameters.items()})


def case_of(found, sensor, folder, **options):
    """The header of a calibration of one sensor."""
    setup = stated_setup(found)
    (folder / "imu.h").write_text(header(found, setup, "imu", **options))
    own, unit = sensor.name, log_unit(sensor)
    (m,) = (m for m in sensor_models(found, setup) if m.sensor.name == own)
    inputs = [f"{own}_{a}_{unit.written}" for a in sensor.axes]
    inputs += [f"accel_{a}_{log_unit(ACCEL).written}" for a in "xyz"] if m.force else []
    outputs = [f"{own}_{a}_corrected_{unit.corrected}" for a in sensor.axes]
    return Case(
        folder / "imu.h",
        "imu",
        own,
        tuple(inputs),
        tuple(outputs),
        m.force is not None,
        m.follows_temperature,
    )


@needs_compiler
@pytest.mark.parametrize(("sensor", "which", "seed"), LISTS)
def test_any_list_of_terms_is_corrected_as_correct_does(sensor, which, seed, tmp_path):
    rng = rng_of(f"terms in C {seed}")
    names = all_terms(sensor)
    if which == "five":
        names = list(rng.choice(names, min(5, len(names)), replace=False))
    found = with_terms(sensor, names, rng)
    case = case_of(found, sensor, tmp_path, integers=False)
    vectors = firmware_vectors(found, integers=False)
    expected = np.column_stack([vectors.column(c) for c in case.outputs])
    size = np.abs(expected).max()
    assert np.abs(case.run(vectors, None, "-DIMU_DOUBLE") - expected).max() < 1e-12 * size
    assert np.abs(case.run(vectors, None) - expected).max() < 1e-5 * size


def errors_of_integers(found, sensor, folder, rows):
    """What integers are off `correct` at most, and the error that is stated for them; doubles are
    off by rounding only.
    """
    case, vectors = case_of(found, sensor, folder), firmware_vectors(found, rows=rows)
    known = fixed_sensors(found, stated_setup(found))[0]
    (fixed,) = (f for f in known if f.model.sensor.name == sensor.name)
    expected = np.column_stack([vectors.column(c) for c in case.outputs])
    size = np.abs(expected).max()
    assert np.abs(case.run(vectors, None, "-DIMU_DOUBLE") - expected).max() < 2e-13 * size
    places = np.full(len(case.inputs), fixed.readings.places)
    if fixed.force is not None:
        places[-3:] = fixed.force.places
    whole = case.run(vectors, places, *UNDEFINED) * 2.0**-fixed.places
    assert fixed.error < 1e-6 * size
    wild = rng_of("any integer").choice([-(2**31), 2**31 - 1, -1, 0, 10**9], (400, len(places)))
    columns = dict(zip(case.inputs, wild.T.astype(float), strict=True))
    columns["temperature_degC"] = np.resize([-1e4, 1e4, 20.0], 400)
    case.run(Recording.from_columns(np.arange(400.0), columns), 0, *UNDEFINED)
    (stated,) = re.findall(r"worst error of f.*: (\S+) ", comment_of(case))
    assert fixed.error <= float(stated) < 1.2 * fixed.error
    return np.abs(whole - expected).max(), fixed.error


KINDS = (
    ACCEL,
    INCL,
    SLOW,
    TURNING,
    accel(axes=("x", "y")),
    INCL.model_copy(update={"axes": ("x",)}),
)
JUMPS = "bias_asym_"  # without a width: its reading has no unique inverse
EFFECTS = {
    (k, terms_of(sensor.kind, sensor.axes)[n][0].id)
    for k, sensor in enumerate(KINDS)
    for n in all_terms(sensor)
    if not n.startswith(JUMPS)
}


@needs_compiler
@pytest.mark.parametrize(("k", "effect"), sorted(EFFECTS))
def test_integers_of_every_effect_alone_keep_their_error(k, effect, tmp_path):
    sensor = KINDS[k]
    known = terms_of(sensor.kind, sensor.axes)
    names = [n for n in all_terms(sensor) if known[n][0].id == effect]
    rng = rng_of(f"alone in integers {k} {effect}")
    names = list(rng.choice(names, min(5, len(names)), replace=False))
    found = with_terms(sensor, names, rng)
    off, error = errors_of_integers(found, sensor, tmp_path, 2000)
    assert off <= error


@needs_compiler
@pytest.mark.parametrize("seed", range(24))
def test_integers_of_five_terms_keep_their_error(seed, tmp_path):
    rng = rng_of(f"five in integers {seed}")
    sensor = KINDS[seed % len(KINDS)]
    names = [n for n in all_terms(sensor) if not n.startswith(JUMPS)]
    names = list(rng.choice(names, min(5, len(names)), replace=False))
    memory = ({}, {"lag": 0.0, "hysteresis": 8.0}, {"lag": 0.0})[seed % 3]
    names += [f"tempmem_{sensor.axes[0]}"] if seed % 4 == 0 else []
    found = with_terms(sensor, names, rng, **memory)
    off, error = errors_of_integers(found, sensor, tmp_path, 2000)
    assert off <= error


MANY = {
    "bias, scale and axes": (ACCEL, ["bias_x", "scale_x", "scale_y", "cross_xy", "cross_zx"]),
    "sine, two axes": (accel(axes=("x", "y"), full_scale=20.0), ["K2_x", "K3_y", "cross_xz"]),
    "angle, two axes": (INCL, ["K2_x", "K3_y", "Kip_x", "scale_asym_y", "temp1_scale_x"]),
    "three axes": (ACCEL, ["K2_x", "K3_y", "Koq_z", "cross_zx", "Kpo_y", "temp2_bias_x"]),
    "gyro": (SLOW, ["gsens_xy", "g2sens_zz", "cubic_x", "scale_asym_y", "tempmem_z"]),
}


@needs_compiler
@pytest.mark.parametrize("rows", [100_000, pytest.param(1_000_000, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", MANY)
def test_integers_keep_their_error_at_many_points(name, rows, tmp_path):
    sensor, names = MANY[name]
    found = with_terms(sensor, names, rng_of(f"many points {name}"))
    off, error = errors_of_integers(found, sensor, tmp_path, rows)
    assert off <= error


needs_cortex = pytest.mark.skipif(bool(missing(COMPILER)), reason=str(missing(COMPILER)))


@needs_cortex
@pytest.mark.parametrize("name", MANY)
def test_a_cortex_m0_computes_what_the_host_does(name, tmp_path):
    sensor, names = MANY[name]
    case = case_of(with_terms(sensor, names, rng_of(f"many points {name}")), sensor, tmp_path)
    target = case.target()
    sizes = target.sizes()
    assert 200 < sizes["flash"] < 8192
    assert 50 < sizes["stack"] < 1024
    if missing(EMULATOR):
        pytest.skip(str(missing(EMULATOR)))
    rows = rng_of("cortex").integers(-(2**30), 2**30, (5, len(case.inputs)))
    found, cycles = target.run(rows, len(case.outputs))
    assert 200 < cycles < 50_000
    columns = dict(zip(case.inputs, rows.T.astype(float), strict=True))
    columns["temperature_degC"] = np.full(5, 25.0)
    log = Recording.from_columns(np.arange(5.0), columns)
    whole = case.run(log, 0)
    assert np.array_equal(found, whole)


@needs_compiler
@pytest.mark.parametrize("size", [1e-40, 1e-25, 1e-12])
def test_a_term_below_the_last_place_compiles(size, tmp_path):
    found = calibration([ACCEL], {"accel": {"K3_x": size, "K2_x": 1e-4, "Kio_z": 1e-4}})
    off, error = errors_of_integers(found, ACCEL, tmp_path, 400)
    assert off <= error


@needs_compiler
@pytest.mark.parametrize("sensor", [ACCEL, INCL])
def test_integers_of_rounded_asymmetries_keep_their_error(sensor, tmp_path):
    setup = setup_of("handheld", sensor)
    effects = [
        make_effect(name, {size: value, "width_unitless": 0.12}, setup, sensor=sensor.name)
        for name, size, value in (
            ("acc_bias_asym", "bias_asym_x_ug", 150.0),
            ("acc_scale_asym", "scale_asym_y_ppm", 500.0),
        )
    ]
    found = replace(calibration([sensor], {sensor.name: {"bias_x": 0.01}}), effects=effects)
    off, error = errors_of_integers(found, sensor, tmp_path, 4000)
    assert off <= error


def test_a_header_without_integers_says_so():
    found = calibration([ACCEL], {"accel": AXES | {"K2_x": 1e-4}})
    text = header(found, stated_setup(found), "imu", integers=False)
    assert "K2_i f_i^2" in text
    assert '#error "exported with --no-integers"' in text
    assert "int32_t" not in text
