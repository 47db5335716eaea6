"""The Recording: blocks on one time axis, conversions to SI, and what it says when something is
missing.
"""

import numpy as np
import pytest

from tiltcal.core.errors import TiltcalError, nearest
from tiltcal.core.units import COLUMN_UNITS, DEG, G0, PARAMETER_UNITS, split_unit
from tiltcal.recordings.recording import Recording, stem
from tiltcal.setup.sensor import Input, Sensor

NAN = np.nan
TIME = np.array([100.0, 100.5, 101.0, 101.5])
ACCEL = Sensor(name="accel", kind="accelerometer")


def recording(**columns):
    return Recording.from_columns(
        TIME,
        {name: np.array(values, float) for name, values in columns.items()},
        source="recording r.csv",
    )


def triad(unit, x=(1, 2, 3, 4)):
    return recording(
        **{f"accel_x_{unit}": x, f"accel_y_{unit}": (0, 0, 0, 0), f"accel_z_{unit}": (9, 9, 9, 9)}
    )


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("accel_x_m_s2", ("accel_x", "m_s2")),
        ("gyro_z_rad_s", ("gyro_z", "rad_s")),  # not rad, not s
        ("fog_a_deg_h", ("fog_a", "deg_h")),
        ("time_s", ("time", "s")),
        ("adc_x_mV", ("adc_x", "mV")),
        ("operator", ("operator", None)),
        ("mg", ("mg", None)),
    ],
)
def test_the_unit_is_read_from_the_right_longest_first(name, parts):
    assert split_unit(name) == parts


def test_compound_units_of_parameters_have_their_size():
    assert split_unit("temp_bias_x_ug_degC", PARAMETER_UNITS) == ("temp_bias_x", "ug_degC")
    assert PARAMETER_UNITS["ug_degC"].factor == pytest.approx(1e-6 * G0)
    # 1 deg/rt h = 1/60 deg/rt s
    assert PARAMETER_UNITS["deg_rth"].factor == pytest.approx(DEG / 60)
    assert PARAMETER_UNITS["deg_h_rth"].factor == pytest.approx(DEG / 3600 / 60)
    assert COLUMN_UNITS["arcsec"].factor == pytest.approx(np.pi / 180 / 3600)


def test_columns_sampled_together_share_a_block():
    r = recording(
        table_outer_deg=(0, 1, 2, 3),
        accel_x_g=(1, NAN, 2, NAN),
        accel_y_g=(3, NAN, 4, NAN),
        gyro_x_deg_s=(NAN, 5, NAN, 6),
    )
    assert [(None if b.rows is None else b.rows.tolist(), list(b.columns)) for b in r.blocks] == [
        (None, ["table_outer_deg"]),
        ([0, 2], ["accel_x_g", "accel_y_g"]),
        ([1, 3], ["gyro_x_deg_s"]),
    ]
    assert len(r) == 4
    assert r.column_names == ["table_outer_deg", "accel_x_g", "accel_y_g", "gyro_x_deg_s"]
    np.testing.assert_array_equal(r.column("accel_y_g"), [3, NAN, 4, NAN])


def test_a_column_that_was_never_sampled_keeps_its_name():
    r = recording(accel_x_g=(NAN,) * 4)
    assert r.column_names == ["accel_x_g"]
    assert np.isnan(r.column("accel_x_g")).all()


@pytest.mark.parametrize(
    ("unit", "factor"), [("m_s2", 1), ("g", 9.80665), ("mg", 9.80665e-3), ("ug", 9.80665e-6)]
)
def test_a_sensor_reads_in_si_whatever_its_columns_unit(unit, factor):
    samples = triad(unit).sensor(ACCEL)
    np.testing.assert_allclose(samples.values, factor * np.array([[k, 0, 9] for k in (1, 2, 3, 4)]))
    assert samples.units == (unit,) * 3
    assert samples.axes == ("x", "y", "z")


def test_channels_of_one_sensor_may_differ_in_unit():
    values = (
        recording(gyro_x_deg_s=(1,) * 4, gyro_y_rad_s=(1,) * 4, gyro_z_deg_h=(3600,) * 4)
        .sensor(Sensor(name="gyro", kind="gyro"))
        .values
    )
    np.testing.assert_allclose(values[0], [DEG, 1, DEG])


def test_a_sensors_samples_are_the_rows_where_any_channel_was_read():
    r = recording(incl_x_deg=(1, NAN, NAN, 4), incl_y_deg=(NAN, NAN, 3, 4))
    samples = r.sensor(Sensor(name="incl", kind="inclinometer", axes=("x", "y")))
    np.testing.assert_array_equal(samples.rows, [0, 2, 3])
    np.testing.assert_array_equal(samples.time, TIME[[0, 2, 3]])
    np.testing.assert_allclose(samples.values / DEG, [[1, NAN], [NAN, 3], [4, 4]])


@pytest.mark.parametrize(
    ("slope", "si"),
    [
        ({"per_m_s2": 415}, 1.0),
        ({"per_g": 415}, 9.80665),
        ({"per_rad": 415}, 1.0),
        ({"per_deg_s": 415}, DEG),
        ({"per_rad_s": 415}, 1),
        ({"per_deg": 415}, DEG),
    ],
)
def test_raw_codes_become_si_by_zero_and_slope(slope, si):
    conversion = Input(unit="LSB", zero=33000, **slope)
    np.testing.assert_allclose(
        conversion.to_si(np.array([[33415.0, 33000, 32585]])), si * np.array([[1, 0, -1]])
    )
    np.testing.assert_allclose(
        conversion.from_si(si * np.array([[1, 0, -1]])), [[33415, 33000, 32585]]
    )


def test_a_sensor_with_an_input_conversion_takes_raw_columns_and_si_ones():
    sensor = ACCEL.model_copy(
        update={"input": Input(unit="LSB", zero=(100, 200, 300), per_m_s2=10)}
    )
    raw = recording(accel_x_LSB=(110,) * 4, accel_y_LSB=(200,) * 4, accel_z_LSB=(398,) * 4)
    np.testing.assert_allclose(raw.sensor(sensor).values[0], [1, 0, 9.8])
    np.testing.assert_allclose(triad("g").sensor(sensor).values[0], [G0, 0, 9 * G0])
    assert sensor.column_unit == "LSB"


def test_table_angles_and_temperature_are_read_with_their_gaps():
    r = recording(
        table_outer_deg=(0, NAN, 90, 180),
        table_outer_command_arcsec=(0, 0, 3600, 3600),
        temperature_degC=(NAN, 20, NAN, 22),
    )
    np.testing.assert_allclose(r.table("outer"), np.radians([0, NAN, 90, 180]))
    np.testing.assert_allclose(r.table("outer", "_command"), np.radians([0, 0, 1, 1]))
    np.testing.assert_allclose(r.temperature(), [20, 20, 21, 22])
    assert r.table("inner") is None
    assert recording(a_x_g=(0,) * 4).temperature() is None
    assert recording(temperature_degC=(NAN,) * 4).temperature() is None


def test_unknown_columns_are_kept_and_reported():
    r = Recording.from_columns(
        TIME,
        {
            name: np.zeros(4)
            for name in ("accel_x_g", "pressure_V", "table_outer_deg", "temperature_degC")
        },
        extra={"operator": np.array(["A"] * 4, object)},
    )
    assert r.unknown([ACCEL]) == ["pressure_V", "operator"]
    assert r.channel("pressure") == "pressure_V"
    assert r.channel("humidity") is None


def test_columns_can_be_added_and_the_first_recording_stays_as_it_was():
    r = triad("g")
    more = r.with_columns({"accel_x_corrected_g": np.array([1, NAN, 1, 1])})
    assert more.column_names == [*r.column_names, "accel_x_corrected_g"]
    assert "accel_x_corrected_g" not in r.column_names
    assert r.has(ACCEL)
    assert not recording(accel_x_g=(0,) * 4).has(ACCEL)


def test_time_that_increases_is_fine():
    r = triad("g")
    assert r.require_increasing() is r


# --------------------------------------------------------------------------------------------------
# messages


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (
            (0, 1, 0.98, 2),
            (
                r"r\.csv: found time_s: time goes back, once, in data row 3, need time stamps that"
                r" increase"
            ),
        ),
        ((0, 1, 2, 2), r"found time_s: a stamp is repeated, once, in data row 4"),
    ],
)
def test_time_that_does_not_increase_is_located(time, message):
    with pytest.raises(TiltcalError, match=message):
        Recording(np.array(time, float), source="recording r.csv").require_increasing()


def test_a_missing_column_is_answered_with_the_nearest():
    with pytest.raises(
        TiltcalError,
        match=(
            r"recording r\.csv, column accel_x_gg: found no such column.*did you mean 'accel_x_g'\?"
        ),
    ):
        triad("g").column("accel_x_gg")
    with pytest.raises(TiltcalError, match="it has none"):
        Recording(TIME).column("accel_x_g")


def test_a_sensor_without_a_column_names_the_axis():
    with pytest.raises(
        TiltcalError,
        match=(
            r"sensor accel: found no column accel_y_<unit>, need one column for each of its axes x,"
            r" y, z"
        ),
    ):
        recording(accel_x_g=(0,) * 4).sensor(ACCEL)
    with pytest.raises(TiltcalError, match="found no column accel_x_<unit>"):
        Recording(TIME).sensor(ACCEL)


@pytest.mark.parametrize(
    ("unit", "advice"),
    [("LSB", r"add input = \{unit = \.\.\."), ("V", "add input"), ("deg_s", "rename it")],
)
def test_a_unit_that_does_not_fit_the_sensor_is_refused(unit, advice):
    with pytest.raises(
        TiltcalError,
        match=f"column accel_x_{unit}: found unit {unit}, need a unit of acceleration; {advice}",
    ):
        triad(unit).sensor(ACCEL)


def test_the_nearest_word_is_a_near_one_or_the_whole_list():
    assert nearest("acc_k2", ["acc_K2", "acc_K3"]) == "did you mean 'acc_K2'?"
    assert (
        nearest("acceleration_of_gravity", ["acceptance", "limits"]) == "did you mean 'acceptance'?"
    )
    assert nearest("zzz", ["b", "a"]) == "valid are a, b"


def test_an_error_keeps_its_parts_and_a_recording_its_short_name():
    error = TiltcalError("file a", found="b", need="c", do="d")
    assert (str(error), error.subject, error.found, error.need, error.do) == (
        "file a: found b, need c; d",
        "file a",
        "b",
        "c",
        "d",
    )
    assert stem("/some/where/run7.csv") == "run7.csv"


@pytest.mark.parametrize(
    ("stated", "unit", "read"),
    [
        ({}, "rad", np.radians([-20.0, 30.0])),
        ({}, "arcsec", np.array([-72000.0, 108000.0])),
        ({}, "deg", np.array([340.0, 30.0])),
        ({"input": {"unit": "deg", "zero": 90, "per_deg": -1}}, "deg", np.array([110.0, 60.0])),
    ],
)
def test_tilt_reads_alike_in_every_unit_and_convention(stated, unit, read):
    sensor = Sensor.model_validate(
        {"name": "incl", "kind": "inclinometer", "axes": ["x"], "rate_hz": 20.0, **stated}
    )
    made = Recording.from_columns(np.array([0.0, 1.0]), {f"incl_x_{unit}": read})
    assert made.sensor(sensor).values[:, 0] == pytest.approx(np.radians([-20.0, 30.0]), abs=1e-12)
