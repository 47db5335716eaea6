"""The exported C header: compiled strictly by the system's compiler and compared with Python on a
million inputs.
"""

import json
import re
import subprocess

import host
import numpy as np
import pytest
from builders import ACCEL, G, setup_of
from firmware_vectors import Case
from scenario_files import refusal
from statistics_helpers import rng_of

from tiltcal.calibration.firmware.fixed_model import range_of
from tiltcal.calibration.firmware.header import header
from tiltcal.calibration.firmware.log_units import log_unit
from tiltcal.calibration.firmware.vectors import firmware_vectors
from tiltcal.calibration.methods.registry import _with_setup
from tiltcal.calibration.result import calibration_from
from tiltcal.cli import main
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import DEG
from tiltcal.recordings.recording import Recording
from tiltcal.setup.sensor import Input

SETUP = setup_of("placing", ACCEL.model_copy(update={"axes": ("x", "y")}))
N = 1_000_000
needs_compiler = pytest.mark.skipif(
    host.compiler() is None, reason="no C compiler on this machine: cc, gcc or clang"
)


MILLI_G = {
    "x": lambda b: 0.009 + 0.004 * np.cos(2 * b),
    "y": lambda b: -0.006 + 0.008 * np.sin(3 * b),
}


def calibration(lookup="interpolated", angles=range(91), axes="xy", sizes=MILLI_G, **more):
    """Biases of 1 mg by the placing angle, every degree."""
    tables = {
        f"accel.{a}": [
            {"angle_deg": k, "value": float(sizes[a](k * DEG)), "sigma": 1e-5, "unit": "m_s2"}
            for k in angles
        ]
        for a in axes
    }
    table = {
        "method": "placing_table",
        "verdict": "good",
        "parameters": {},
        "bias_tables": tables | more,
        "lookup": lookup,
    }
    return _with_setup(calibration_from(table), SETUP)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("firmware")
    (place / "level.h").write_text(header(calibration(), SETUP, "level"))
    return place


@pytest.fixture(scope="module")
def forces() -> np.ndarray:
    """A million samples of a level: inside the tables, outside, and beyond g; the third channel
    missing, (n, 3).
    """
    rng = rng_of("a million forces")
    return np.column_stack(
        [rng.uniform(-1.02 * G, 0.1 * G, N), rng.uniform(-0.1 * G, 1.02 * G, N), np.full(N, np.nan)]
    )


def python(forces, lookup="interpolated", channels=2):
    corrector = calibration(lookup).placing(SETUP.sensor[0], G)
    return corrector.correct(forces[:, :channels]), corrector.tilt(forces[:, :channels])


def differ(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Absolute differences where both are numbers; where only one is, the sample is at the edge of
    a table.
    """
    assert np.sum(np.isnan(a) != np.isnan(b)) <= 1e-5 * a.size
    return np.nan_to_num(np.abs(a - b))


@needs_compiler
def test_floats_agree_with_python_to_their_last_digits(folder, forces):
    program = host.build(folder / "level.h")
    corrected, tilt = python(forces)
    assert differ(host.run(program, "correct", forces)[0], corrected).max() < 4 * np.spacing(
        np.float32(G)
    )
    error = differ(host.run(program, "tilt", forces)[0], tilt) * np.nan_to_num(np.cos(tilt))
    assert error[np.abs(tilt) < 85 * DEG].max() < 1e-6  # rad; 0.2 arcsec


@needs_compiler
def test_doubles_agree_with_python_to_rounding(folder, forces):
    program = host.build(folder / "level.h", "-DLEVEL_DOUBLE")
    corrected, tilt = python(forces)
    assert differ(host.run(program, "correct", forces)[0], corrected).max() < 1e-13
    error = differ(host.run(program, "tilt", forces)[0], tilt)
    assert error[np.abs(tilt) < 89 * DEG].max() < 1e-12
    triad = forces.copy()
    triad[:, 2] = rng_of("third channel").uniform(-G, G, N)
    found = host.run(program, "correct", triad)[0]
    assert differ(found, python(triad, channels=3)[0]).max() < 1e-13


@needs_compiler
def test_integers_agree_with_python_to_their_unit(folder, forces):
    program = host.build(folder / "level.h")
    given = np.round(forces * 1e6)
    exact = python(given * 1e-6)[0] * 1e6
    error = differ(host.run(program, "integer", given)[0], exact)
    # the entries are rounded by up to 0.5 um/s2, the interpolated value and the input of the second
    # pass once more
    assert error.max() < 3
    assert np.quantile(error, 0.99) < 1
    given[:, 2] = np.round(
        np.sqrt(np.maximum(G**2 - forces[:, 0] ** 2 - forces[:, 1] ** 2, 0)) * 1e6
    )
    exact = python(given * 1e-6, channels=3)[0] * 1e6
    assert differ(host.run(program, "integer", given)[0], exact).max() < 3


@needs_compiler
def test_rounding_takes_the_same_entry_as_python(folder, forces):
    program = host.build(folder / "level.h", "-DLEVEL_DOUBLE", "-DLEVEL_ROUNDED")
    error = differ(host.run(program, "correct", forces)[0], python(forces, "rounded")[0])
    # an angle just on the edge between two entries may fall to either
    assert np.mean(error > 1e-13) < 1e-5
    assert error.max() < 5e-4
    given = np.round(forces * 1e6)
    exact = python(given * 1e-6, "rounded")[0] * 1e6
    integers = differ(
        host.run(host.build(folder / "level.h", "-DLEVEL_ROUNDED"), "integer", given)[0], exact
    )
    # codes of 1 um/s2 move the edges, and the first pass picks another entry there
    assert np.mean(integers > 1) < 1e-3


@needs_compiler
def test_look_ups_by_angle_agree_with_python(folder):
    program = host.build(folder / "level.h", "-DLEVEL_DOUBLE")
    rng = rng_of("angles")
    mdeg = np.column_stack([rng.integers(-5000, 95_000, N).astype(float)] * 3)
    tables = calibration().placing(SETUP.sensor[0], G).tables
    for what in ("rounded", "interpolated"):
        exact = np.column_stack([tables[a].at(mdeg[:, 0] * 1e-3 * DEG, what) for a in "xy"])
        error = differ(host.run(program, what, mdeg * 1e-3 * DEG)[0], exact)
        # exactly half a degree may fall to either side
        assert np.mean(error > 1e-13) < 2e-3 * (what == "rounded") + 1e-9
        found = host.run(program, f"{what}_mdeg", mdeg)[0]
        found[found == -(2**31)] = np.nan
        assert (
            np.mean(np.abs(np.nan_to_num(found - exact * 1e6)) > 1.01)
            < 2e-3 * (what == "rounded") + 1e-9
        )
        assert np.mean(np.isnan(found) != np.isnan(exact)) < 1e-4


@needs_compiler
@pytest.mark.parametrize(
    "changes",
    [
        {"axes": ("x", "y")},
        {"axes": ("y", "x"), "unit": "mg"},
        {"axes": ("x", "y", "z"), "input": Input(unit="LSB", zero=[33000, 32500, 100], per_g=4000)},
    ],
    ids=["m/s2", "mg", "counts and z"],
)
def test_readings_in_the_units_of_the_log_agree_with_correct(changes, tmp_path):
    setup = setup_of("placing", ACCEL.model_copy(update=changes))
    found = _with_setup(calibration(), setup)
    (sensor,) = setup.sensor
    unit = log_unit(sensor)
    (tmp_path / "level.h").write_text(header(found, setup, "level"))
    vectors = firmware_vectors(found)
    inputs = tuple(f"accel_{a}_{unit.written}" for a in sensor.axes)
    outputs = tuple(f"accel_{a}_corrected_{unit.corrected}" for a in "xy")
    case = Case(tmp_path / "level.h", "level", "accel", inputs, outputs)
    expected = np.column_stack([vectors.column(c) for c in outputs])
    assert not np.isnan(expected).any()
    assert np.abs(case.run(vectors, None, "-DLEVEL_DOUBLE") - expected).max() < 1e-10
    assert np.abs(case.run(vectors, None) - expected).max() < 2e-6 * np.abs(expected).max()
    text = (tmp_path / "level.h").read_text()
    places = int(re.search(r"f: (\d+) places; worst error", text)[1])
    stated = float(re.search(r"worst error .*: (\S+) ", text)[1])
    flags = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
    whole = case.run(vectors, range_of(sensor, unit).places, *flags)
    assert np.abs(whole * 2.0**-places - expected).max() < stated
    wild = {c: rng_of(c).choice([-(2**31), 2**31 - 1, 0], 400).astype(float) for c in inputs}
    assert len(case.run(Recording.from_columns(vectors.time, wild), 0, *flags)) == 400


@needs_compiler
@pytest.mark.parametrize("rows", [100_000, pytest.param(1_000_000, marks=pytest.mark.long)])
@pytest.mark.parametrize("axes", [("x", "y"), ("x", "y", "z")])
def test_integers_keep_their_error_down_to_the_steepest_inclination(axes, rows, tmp_path):
    steep = {"x": lambda b: 0.02 - 0.05 * np.sin(b), "y": lambda b: 0.03 * np.cos(4 * b)}
    setup = setup_of("placing", ACCEL.model_copy(update={"axes": axes}))
    found = _with_setup(calibration(angles=range(-90, 79, 3), sizes=steep), setup)
    (tmp_path / "level.h").write_text(header(found, setup, "level"))
    vectors = firmware_vectors(found, rows=rows)
    inputs = tuple(f"accel_{a}_m_s2" for a in axes)
    outputs = tuple(f"accel_{a}_corrected_m_s2" for a in "xy")
    case = Case(tmp_path / "level.h", "level", "accel", inputs, outputs)
    expected = np.column_stack([vectors.column(c) for c in outputs])
    slanted = np.sqrt(np.maximum(G**2 - (expected**2).sum(axis=1), 0)) < 0.3 * G
    assert np.mean(slanted) > 0.05
    text = (tmp_path / "level.h").read_text()
    places = int(re.search(r"f: (\d+) places; worst error", text)[1])
    stated = float(re.search(r"worst error .*: (\S+) m_s2", text)[1])
    whole = case.run(vectors, range_of(setup.sensor[0], log_unit(setup.sensor[0])).places)
    assert np.nanmax(np.abs(whole * 2.0**-places - expected)) < stated < 5e-5


@needs_compiler
def test_the_integers_need_no_floating_point_registers(folder):
    (folder / "only.c").write_text('#include "level.h"\n')
    words = [host.compiler(), "-std=c99", "-mgeneral-regs-only", "-DLEVEL_FIXED_ONLY", "-c"]
    words += ["-fkeep-inline-functions", "only.c"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if "unrecognized" in done.stderr or "unknown argument" in done.stderr:
        pytest.skip("this compiler cannot forbid floating-point registers")
    assert (done.returncode, done.stderr) == (0, "")


@needs_compiler
def test_one_axis_and_a_wide_table_compile_as_well(tmp_path, forces):
    (tmp_path / "level.h").write_text(
        header(calibration(axes="y", angles=range(-80, 81, 5)), SETUP, "level")
    )
    program = host.build(tmp_path / "level.h", "-DLEVEL_DOUBLE")
    found = host.run(program, "correct", forces[:1000])[0]
    np.testing.assert_array_equal(found[:, 0], forces[:1000, 0])
    wide = header(calibration(angles=range(-90, 91)), SETUP, "level")
    assert "needs a table of less than 170 deg" in wide
    assert "level_correct_i(int32_t" not in wide


def test_the_header_holds_no_malloc_and_the_2d_array():
    text = header(calibration(), SETUP)
    assert "malloc(" not in text
    assert "static const tiltcal_real tiltcal_bias[2][TILTCAL_COUNT]" in text
    assert "static const int32_t tiltcal_bias_um[2][TILTCAL_COUNT]" in text


def test_what_cannot_be_exported_is_refused_in_words():
    with pytest.raises(TiltcalError, match="look-up smooth, need interpolated or rounded"):
        header(calibration("smooth"), SETUP)
    odd = calibration(
        axes="x",
        **{
            "accel.y": [
                {"angle_deg": k, "value": 0.0, "sigma": 0.0, "unit": "m_s2"} for k in range(5)
            ]
        },
    )
    with pytest.raises(TiltcalError, match="tables of x and y at different angles"):
        header(odd, SETUP)
    with pytest.raises(TiltcalError, match="need whole millidegrees"):
        header(calibration(angles=[0, 0.0625, 0.125]), SETUP)
    with pytest.raises(TiltcalError, match="name '2level': found no C name"):
        header(calibration(), SETUP, "2level")


def test_the_command_writes_the_header_and_refuses_other_calibrations(tmp_path, good, capsys):
    calibration().save(tmp_path / "CAL.json")
    assert (
        main(
            [
                "export",
                str(tmp_path / "CAL.json"),
                "-o",
                str(tmp_path / "level.h"),
                "--name",
                "level",
                "--json",
            ]
        )
        == 0
    )
    assert "level_interpolated_mdeg" in (tmp_path / "level.h").read_text()
    assert main(["export", str(tmp_path / "CAL.json")]) == 0
    assert "tiltcal_rounded" in capsys.readouterr().out
    assert main(["export", str(good / "CAL.json"), "--name", "bench"]) == 0
    assert "static inline void bench_accel(const bench_real *reading" in capsys.readouterr().out
    tilt = json.loads((good / "CAL.json").read_text())
    tilt |= {"parameters": {"base.roll": {"value": 0.1, "sigma": 0.0, "unit": "rad"}}}
    tilt.pop("covariance")
    (tmp_path / "tilt.json").write_text(json.dumps(tilt))
    message = refusal(["export", tmp_path / "tilt.json", "-o", tmp_path / "no.h"], tmp_path, capsys)
    assert "no sensor" in message
    assert not (tmp_path / "no.h").exists()
