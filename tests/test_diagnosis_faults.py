"""Faults of the data are named, placed and mended before any physics is looked for."""

import numpy as np
import pytest
from dossier import bench, honest, recorded, rewritten

from tiltcal.diagnosis.diagnose import prepare
from tiltcal.recording import Recording


@pytest.fixture(scope="module")
def truth():
    return bench()


@pytest.fixture(scope="module")
def sound(truth):
    return recorded(truth, 5)


def faults_of(truth, recording):
    return {f.effect.id: f for f in prepare(honest(truth), [recording]).faults}


def x_of(recording):
    return recording.column("accel_x_m_s2").copy()


def test_a_sound_recording_has_none(truth, sound):
    assert faults_of(truth, sound) == {}


def test_a_frozen_channel(truth, sound):
    x = x_of(sound)
    x[400:460] = x[400]
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=x))["data_stuck"]
    assert fault.axes == ("x",)
    assert fault.interval == pytest.approx((40.0, 45.9), abs=0.2)


def test_repeated_samples(truth, sound, rng):
    columns = {}
    again = rng.random(len(sound)) < 0.05
    again[0] = False
    source = np.maximum.accumulate(np.where(again, 0, np.arange(len(sound))))
    for axis in "xyz":
        columns[f"accel_{axis}_m_s2"] = sound.column(f"accel_{axis}_m_s2")[source]
    fault = faults_of(truth, rewritten(sound, **columns))["data_duplicate"]
    assert fault.effect.value("share") == pytest.approx(again.mean(), rel=0.1)


def test_clipping(truth, sound):
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=np.clip(x_of(sound), -7.0, 7.0)))["acc_saturation"]
    assert (fault.axes, fault.effect.value("full_scale")) == (("x",), pytest.approx(7.0))


def test_coarse_codes(truth, sound):
    lsb = 0.004
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=lsb * np.rint(x_of(sound) / lsb)))["adc_quantisation"]
    assert (fault.axes, fault.effect.value("lsb")) == (("x",), pytest.approx(lsb, rel=1e-6))


def test_gross_errors(truth, sound, rng):
    x = x_of(sound)
    hit = rng.choice(len(x), 12, replace=False)
    x[hit] += 0.05 * rng.choice([-1, 1], 12)
    fault = faults_of(truth, rewritten(sound, accel_x_m_s2=x))["data_outlier"]
    assert fault.axes[0] == "x"
    assert fault.effect.value("share") == pytest.approx(12 / len(x), rel=0.35)


def test_heavy_tails_are_no_gross_errors(truth, sound, rng):
    x = x_of(sound)
    wide = rng.random(len(x)) < 0.03
    x[wide] += 3 * 7.8e-4 * rng.normal(size=wide.sum())
    assert "data_outlier" not in faults_of(truth, rewritten(sound, accel_x_m_s2=x))


def test_a_sign(truth, sound):
    fault = faults_of(truth, rewritten(sound, accel_z_m_s2=-sound.column("accel_z_m_s2")))["data_sign"]
    assert fault.effect.values == {"flip_z": 1.0}


def test_exchanged_columns(truth, sound):
    swapped = {"accel_x_m_s2": sound.column("accel_y_m_s2"), "accel_y_m_s2": sound.column("accel_x_m_s2")}
    assert faults_of(truth, rewritten(sound, **swapped))["data_axis_swap"].effect.values == {"swap_xy": 1.0}


def test_a_wrong_unit(truth, sound):
    columns = {f"accel_{a}_m_s2": sound.column(f"accel_{a}_m_s2") / 9.80665 for a in "xyz"}
    factor = faults_of(truth, rewritten(sound, **columns))["data_unit"].effect.value("factor")
    assert factor == pytest.approx(1 / 9.80665, rel=1e-6)


def test_a_table_counted_the_other_way(truth, sound):
    fault = faults_of(truth, rewritten(sound, table_outer_deg=-sound.column("table_outer_deg")))["data_rotation_sense"]
    assert fault.effect.axis == "outer"


def test_a_mistyped_angle(truth, sound):
    outer = sound.column("table_outer_deg").copy()
    bench_ = prepare(honest(truth), [sound])
    stop = bench_.observations.courses[0].stop
    outer[stop == 7] += 0.5
    fault = faults_of(truth, rewritten(sound, table_outer_deg=outer))["data_pose_label"]
    assert (fault.effect.axis, fault.effect.value("error")) == ("outer", pytest.approx(np.radians(0.5), rel=0.02))


def test_time_that_goes_back_is_mended_and_said(truth, sound):
    time = sound.time.copy()
    time[100] -= 1.0
    columns = {n: sound.column(n) for n in sound.column_names}
    notes = prepare(honest(truth), [Recording.from_columns(time, columns, source="run.csv")]).notes
    assert "run.csv: 1 row(s) whose time goes back or repeats, the first at data row 101; they are left out" in notes


def test_what_was_mended_leaves_the_rest_as_it_was(truth, sound):
    """After mending a sign, the calibration is that of the sound recording."""
    flipped = rewritten(sound, accel_z_m_s2=-sound.column("accel_z_m_s2"))
    first, second = (prepare(honest(truth), [r]).start for r in (sound, flipped))
    for a, b in zip(first.nuisance, second.nuisance, strict=True):
        np.testing.assert_allclose(a.values, b.values, atol=1e-9)
