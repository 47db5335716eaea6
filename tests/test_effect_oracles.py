"""Equations of the catalogue worked by hand: what a size of each effect adds to a reading
(docs/physics.md).
"""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from builders import (
    ACCEL,
    FOG,
    GYRO,
    INCL,
    INSTRUMENT,
    drive_of,
    effect_of,
    read_poses,
    schedule_of,
    setup_of,
    still,
)

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, DEG_H, G0
from tiltcal.effects import make_effect
from tiltcal.effects.sense import Sense
from tiltcal.forward.signal_chain import readings, stream
from tiltcal.setup.trajectory import Jet

N = 200
T = np.linspace(0.0, 40.0, N)  # s
WARM = 2.0 * np.sin(T / 6)  # K above the mean, about
G = G0
X, Y, Z = range(3)


def lively():
    """Three axes in arbitrary motion, temperature swinging, one reading every 0.2 s."""
    axes = {
        "outer": Jet(0.3 * T, np.full(N, 0.3), np.zeros(N)),
        "middle": Jet(np.sin(T / 5), np.cos(T / 5) / 5, -np.sin(T / 5) / 25),
        "inner": Jet(-0.5 * T, np.full(N, -0.5), np.zeros(N)),
    }
    return drive_of(axes, T, temperature=23 + WARM - WARM.mean())


def change(id, sensor, words, beside=()):
    """(true input, change of the reading) of one sensor, SI."""
    setup = setup_of("three", sensor)
    others = [effect_of(i, setup, **w) for i, w in beside]
    plain = read_poses(setup, lively(), *others)[sensor.name]
    return plain, read_poses(setup, lively(), *others, effect_of(id, setup, **words))[
        sensor.name
    ] - plain


DT = WARM - WARM.mean()


def odd(v):
    """v - v^3: +0.385 at 1/sqrt 3 of full scale, so that 2.6 of it is one."""
    return v - v**3


WIDE = {"width_unitless": 0.1}
HUM = {"pickup_x_ug": 100, "frequency_hz": 0.7}
ORACLES = [
    ("acc_bias", ACCEL, {"bias_y_ug": 100}, Y, lambda _: 1e-4 * G),
    ("acc_scale", ACCEL, {"scale_z_ppm": 100}, Z, lambda f: 1e-4 * f[:, Z]),
    ("acc_cross_axis", ACCEL, {"cross_zx_ppm": 100}, Z, lambda f: 1e-4 * f[:, X]),
    ("acc_K2", ACCEL, {"k2_y_ug_g2": 100}, Y, lambda f: 1e-4 * G * (f[:, Y] / G) ** 2),
    ("acc_K3", ACCEL, {"k3_y_ug_g3": 100}, Y, lambda f: 1e-4 * G * (f[:, Y] / G) ** 3),
    ("acc_Koq", ACCEL, {"koq_y_ug_g2": 100}, Y, lambda f: 1e-4 * f[:, Y] * np.abs(f[:, Y]) / G),
    ("acc_Kip", ACCEL, {"kip_z_ug_g2": 100}, Z, lambda f: 1e-4 * f[:, Z] * f[:, X] / G),
    ("acc_Kio", ACCEL, {"kio_z_ug_g2": 100}, Z, lambda f: 1e-4 * f[:, Z] * f[:, Y] / G),
    ("acc_Kpo", ACCEL, {"kpo_z_ug_g2": 100}, Z, lambda f: 1e-4 * f[:, X] * f[:, Y] / G),
    ("acc_scale_asym", ACCEL, {"scale_asym_y_ppm": 100}, Y, lambda f: 0.5e-4 * np.abs(f[:, Y])),
    ("acc_bias_asym", ACCEL, {"bias_asym_y_ug": 100}, Y, lambda f: 0.5e-4 * G * np.sign(f[:, Y])),
    (
        "acc_scale_asym, wide",
        ACCEL,
        {"scale_asym_y_ppm": 100} | WIDE,
        Y,
        lambda f: 0.5e-4 * np.hypot(f[:, Y], 0.1 * G),
    ),
    (
        "acc_bias_asym, wide",
        ACCEL,
        {"bias_asym_y_ug": 100} | WIDE,
        Y,
        lambda f: 0.5e-4 * G * np.tanh(10 * f[:, Y] / G),
    ),
    ("acc_temp_bias", ACCEL, {"temp_bias_x_ug_degC": 10}, X, lambda _: 1e-5 * G * DT),
    ("acc_temp_scale", ACCEL, {"temp_scale_x_ppm_degC": 10}, X, lambda f: 1e-5 * DT * f[:, X]),
    (
        "acc_thermal_gradient",
        ACCEL,
        {"temp_rate_x_ug_s_degC": 100},
        X,
        lambda _: 1e-4 * G * np.gradient(DT, T),
    ),
    ("acc_warmup", ACCEL, {"warmup_x_ug": 100, "tau_s": 7}, X, lambda _: 1e-4 * G * np.exp(-T / 7)),
    (
        "acc_bias_step",
        ACCEL,
        {"bias_step_x_ug": 100, "time_s": 20},
        X,
        lambda _: 1e-4 * G * (T >= 20),
    ),
    ("acc_drift", ACCEL, {"drift_x_ug": 100}, X, lambda _: 1e-4 * G * T / 40),
    (
        "acc_saturation",
        ACCEL,
        {"full_scale_m_s2": 5},
        Y,
        lambda f: np.clip(f[:, Y], -5, 5) - f[:, Y],
    ),
    (
        "acc_angle_bias",
        ACCEL,
        {"sin2_y_ug": 100},
        Y,
        lambda f: 1e-4 * G * np.sin(2 * np.arctan2(-f[:, X], f[:, Z])),
    ),
    ("adc_gain_error", ACCEL, {"gain_x_ppm": 100}, X, lambda f: 1e-4 * f[:, X]),
    ("adc_inl", ACCEL, {"inl_x_ug": 100}, X, lambda f: 1e-4 * G * (1 - (f[:, X] / (1.2 * G)) ** 2)),
    (
        "adc_inl, odd",
        ACCEL,
        {"inl_x_ug": 100, "odd_unitless": 1},
        X,
        lambda f: 2.6e-4 * G * odd(f[:, X] / (1.2 * G)),
    ),
    ("mains_pickup", ACCEL, HUM, X, lambda _: 1e-4 * G * np.sin(1.4 * np.pi * T)),
    (
        "mains_pickup, late",
        ACCEL,
        HUM | {"phase_deg": 90},
        X,
        lambda _: 1e-4 * G * np.cos(1.4 * np.pi * T),
    ),
    (
        "tilt_conversion",
        INCL,
        {"mix_unitless": 0.5},
        Y,
        lambda a: 0.5 * (np.sin(a[:, Y]) - a[:, Y]),
    ),
    ("gyr_bias", GYRO, {"bias_y_deg_s": 0.1}, Y, lambda _: 0.1 * DEG),
    ("gyr_scale", GYRO, {"scale_z_ppm": 100}, Z, lambda w: 1e-4 * w[:, Z]),
    ("gyr_scale_asym", GYRO, {"scale_asym_z_ppm": 100}, Z, lambda w: 0.5e-4 * np.abs(w[:, Z])),
    ("gyr_nonlinearity", GYRO, {"cubic_z_ppm_rad2_s2": 100}, Z, lambda w: 1e-4 * w[:, Z] ** 3),
    ("gyr_misalignment", GYRO, {"cross_zx_ppm": 100}, Z, lambda w: 1e-4 * w[:, X]),
    ("gyr_temp", GYRO, {"temp_bias_y_deg_s_degC": 0.1}, Y, lambda _: 0.1 * DEG * DT),
    (
        "gyr_warmup",
        GYRO,
        {"warmup_y_deg_s": 0.1, "tau_s": 7},
        Y,
        lambda _: 0.1 * DEG * np.exp(-T / 7),
    ),
    (
        "gyr_bias_step",
        GYRO,
        {"bias_step_y_deg_s": 0.1, "time_s": 20},
        Y,
        lambda _: 0.1 * DEG * (T >= 20),
    ),
    (
        "gyr_saturation",
        GYRO,
        {"full_scale_deg_s": 10},
        X,
        lambda w: np.clip(w[:, X], -10 * DEG, 10 * DEG) - w[:, X],
    ),
    ("fog_bias", FOG, {"bias_a_deg_h": 5}, 0, lambda _: 5 * DEG_H),
    ("fog_scale", FOG, {"scale_a_ppm": 100}, 0, lambda w: 1e-4 * w[:, 0]),
    ("fog_shupe", FOG, {"shupe_a_deg_h_s_degC": 50}, 0, lambda _: 50 * DEG_H * np.gradient(DT, T)),
]


@pytest.mark.parametrize(
    ("id", "sensor", "words", "channel", "expected"), ORACLES, ids=[case[0] for case in ORACLES]
)
def test_an_effect_adds_what_its_equation_says_to_its_channel_alone(
    id, sensor, words, channel, expected
):
    true, added = change(id.split(",")[0], sensor, words)
    np.testing.assert_allclose(
        added[:, channel], np.broadcast_to(expected(true), N), rtol=0, atol=1e-13
    )
    assert np.abs(added[:, channel]).max() > 1e-6
    if "full_scale" not in next(iter(words)) and id != "tilt_conversion":
        assert not np.delete(added, channel, axis=1).any()


def test_a_gyro_feels_the_force_of_its_pose():
    setup = setup_of("three", ACCEL, GYRO)
    force = read_poses(setup, lively())["accel"]
    effect = effect_of("gyr_gsens", setup, sensor="gyro", gsens_xz_deg_h_g=60)
    added = read_poses(setup, lively(), effect)["gyro"] - read_poses(setup, lively())["gyro"]
    np.testing.assert_allclose(added[:, X], 60 * DEG_H * force[:, Z] / G, atol=1e-15)


@pytest.mark.parametrize(("key", "across"), [("axis_u", [1, -1, 0]), ("axis_v", [1, 1, -2])])
def test_a_fog_out_of_its_axis_reads_the_transverse_rate(key, across):
    """a = (1, 1, 1): b1 = a x z = (1, -1, 0), a x b1 = (1, 1, -2), normalised."""
    setup = setup_of("three", GYRO, FOG)
    rate = read_poses(setup, lively())["gyro"]
    effect = effect_of("fog_axis_error", setup, **{f"{key}_arcsec": 400})
    added = read_poses(setup, lively(), effect)["fog"] - read_poses(setup, lively())["fog"]
    np.testing.assert_allclose(
        added[:, 0],
        400 * ARCSEC * rate @ np.array(across) / sqrt(np.dot(across, across)),
        atol=1e-15,
    )


def test_noise_free_codes_stay_and_with_chance_on_they_are_rounded():
    setup = setup_of("three", ACCEL)
    effect = effect_of("adc_quantisation", setup, lsb_si=0.25)
    plain = read_poses(setup, lively())["accel"]
    np.testing.assert_array_equal(
        read_poses(setup, lively(), effect, seed=1)["accel"], np.rint(plain / 0.25) * 0.25
    )


def moving(id, words, shift):
    """Reading of a placing table at a steady rate with a timing effect, and what it was ``shift(t,
    channel)`` earlier.
    """
    setup = setup_of("placing", ACCEL)
    course = schedule_of(
        setup, {"action": "turn", "axis": "outer", "angle_deg": 300, "rate_deg_s": 10}
    )
    time = np.linspace(2.0, 28.0, 400)
    found = readings(setup, course, {"accel": time}, [effect_of(id, setup, **words)])["accel"]
    early = [
        readings(setup, course, {"accel": time - shift(time, c)}, [])["accel"][:, c]
        for c in range(3)
    ]
    return found, np.column_stack(early)


@pytest.mark.parametrize(
    ("id", "words", "shift"),
    [
        ("data_latency", {"latency_ms": 80}, lambda t, _: 0.08 + 0 * t),
        ("channel_mux_skew", {"skew_ms": 15}, lambda t, channel: channel * 0.015 + 0 * t),
        ("clock_skew", {"skew_ppm": 2000}, lambda t, _: 0.002 * t),
    ],
)
def test_a_timing_effect_reads_an_earlier_signal(id, words, shift):
    found, early = moving(id, words, shift)
    np.testing.assert_allclose(found, early, atol=1e-12)


def test_lost_and_frozen_samples_stand_where_they_should():
    setup = setup_of("three", ACCEL)
    plain = read_poses(setup, lively())["accel"]
    lost = read_poses(setup, lively(), effect_of("data_drop", setup, samples=7, time_s=T[50]))[
        "accel"
    ]
    np.testing.assert_array_equal(lost[:50], plain[:50])
    np.testing.assert_array_equal(lost[50:-7], plain[57:])
    assert np.isnan(lost[-7:]).all()
    stuck = read_poses(
        setup,
        lively(),
        effect_of("data_stuck", setup, start_s=T[50], length_s=T[60] - T[50] - 0.01),
    )["accel"]
    np.testing.assert_array_equal(stuck[50:60], np.broadcast_to(plain[50], (10, 3)))
    np.testing.assert_array_equal(
        np.delete(stuck, slice(50, 60), axis=0), np.delete(plain, slice(50, 60), axis=0)
    )


def test_a_frozen_axis_leaves_the_others():
    setup = setup_of("three", ACCEL)
    plain = read_poses(setup, lively())["accel"]
    words = {"start_s": T[50], "length_s": T[60] - T[50] - 0.01}
    stuck = read_poses(
        setup, lively(), effect_of("data_stuck", setup, sensor="accel", axis="y", **words)
    )["accel"]
    np.testing.assert_array_equal(stuck[50:60, Y], plain[50, Y])
    np.testing.assert_array_equal(stuck[:, [X, Z]], plain[:, [X, Z]])
    np.testing.assert_array_equal(
        np.delete(stuck, slice(50, 60), axis=0), np.delete(plain, slice(50, 60), axis=0)
    )


def test_hysteresis_is_a_play_of_the_axis_own_force_or_dahl_s_where_it_is_rounded():
    setup = setup_of("placing", ACCEL)
    degrees = np.array([0.0, -30.0, -90.0, -30.0])  # f_x = g sin: 0, 1/2, 1, 1/2 g
    # half a width of 1 g: the play is not taken up
    for words, state in (
        ({}, [0, 1, 1, -1]),  # width 0.2 g: every step is longer than the gap
        (
            {"width_unitless": 2.0},
            [0, 0.5, 1.0, 0.5],
        ),
        (
            {"width_unitless": 0.5, "rounded_unitless": 1},
            [0, 1 - np.exp(-1), 1 - np.exp(-2), (2 - np.exp(-2)) * np.exp(-1) - 1],
        ),
    ):
        effect = effect_of("acc_hysteresis", setup, sensor="accel", hysteresis_x_ug=100, **words)
        plain, looped = (
            read_poses(setup, still(setup, outer=degrees), *e)["accel"] for e in ((), (effect,))
        )
        # local gravity against the standard one
        np.testing.assert_allclose((looped - plain)[:, X] / (1e-4 * G), state, atol=2e-3)
        assert not (looped - plain)[:, 1:].any()


def test_a_floor_that_tilts_for_a_span_keeps_its_tilt():
    """100 arcsec about East over 10 s and then no more: level, f_y = g sin(roll) of an untilted
    body.
    """
    setup = setup_of("vertical", ACCEL)
    drive = still(setup, outer=np.zeros(31))  # a second apart
    effect = effect_of("floor_tilt_drift", setup, tilt_east_arcsec=100, span_s=10)
    f = read_poses(setup, drive, effect)["accel"]
    np.testing.assert_allclose(
        f[:, Y] / setup.site.gravity,
        np.sin(100 * ARCSEC * np.minimum(np.arange(31) / 10, 1)),
        atol=1e-9,
    )
    whole = read_poses(setup, drive, effect_of("floor_tilt_drift", setup, tilt_east_arcsec=100))[
        "accel"
    ]
    np.testing.assert_allclose(
        whole[:, Y] / setup.site.gravity, np.sin(100 * ARCSEC * np.arange(31) / 30), atol=1e-9
    )


@pytest.mark.parametrize(("name", "n"), [("m1", -1), ("p2", 2), ("m2", -2)])
def test_the_wobble_of_a_vertical_axis_shows_one_order_lower_in_the_body(name, n):
    """Tilts e + i d of the axis about East and North lift x + i y by i (e + i d) exp(-i a): order n
    becomes n - 1.
    """
    setup = setup_of("vertical", ACCEL)
    setup = setup.model_copy(update={"site": setup.site.model_copy(update={"gravity_m_s2": G})})
    degrees = np.arange(0.0, 360.0, 5)
    effect = effect_of("table_axis_wobble", setup, **{f"{name}c_arcsec": 3, f"{name}s_arcsec": -2})
    force = read_poses(setup, still(setup, outer=degrees), effect)["accel"] / (G * ARCSEC)
    expected = 1j * (3 - 2j) * np.exp(1j * (n - 1) * np.radians(degrees))
    np.testing.assert_allclose(force[:, X] + 1j * force[:, Y], expected, atol=1e-3)


@pytest.mark.parametrize(
    ("table", "key", "angles", "up"),
    # Ry(e) between outer and inner; Rx(e1) after outer, Rz(e2) after middle, in arcsec of the up
    # direction
    [
        ("dual", "outer_inner", {"outer": 0, "inner": 0}, (-10, 0)),
        ("dual", "outer_inner", {"outer": 0, "inner": 90}, (0, 10)),
        ("three", "outer_middle", {"outer": 70}, (0, 10)),
        ("three", "middle_inner", {"middle": 90, "inner": 0}, (0, 10)),
    ],
)
def test_axes_out_of_square_lift_the_body_as_worked_by_hand(table, key, angles, up):
    setup = setup_of(table, ACCEL)
    square = read_poses(setup, still(setup, **angles))["accel"]
    skewed = read_poses(
        setup,
        still(setup, **angles),
        effect_of("axis_nonorthogonality", setup, **{f"{key}_arcsec": 10}),
    )["accel"]
    np.testing.assert_allclose(
        (skewed - square)[0, :2] / (setup.site.gravity * ARCSEC), up, atol=1e-3
    )


def test_every_name_has_a_random_stream_of_its_own():
    names = [("acc_noise", "a"), ("acc_noise", "b"), ("gyr_noise", "a"), ("acc_noise", None)]
    first = [stream(seed, *name).random() for seed in (1, 2) for name in names]
    assert len(set(first)) == len(first)
    assert stream(1, "acc_noise", "a").random() == first[0]


def test_a_delay_without_a_sensor_is_the_recorder_s_own_and_delays_all_alike():
    setup = setup_of("dual", *INSTRUMENT)
    course = schedule_of(
        setup, {"action": "move", "outer_deg": 80, "inner_deg": 50, "rate_deg_s": 30}
    )
    times = {s.name: np.arange(0.5, 2.5, 0.05) for s in setup.sensor}
    late = readings(
        setup, course, times, [make_effect("data_latency", {"latency_ms": 20.0}, setup)]
    )
    early = readings(setup, course, {n: t - 0.02 for n, t in times.items()}, ())
    for name, values in late.items():
        np.testing.assert_allclose(values, early[name], rtol=0, atol=1e-12)


@pytest.mark.parametrize("lag", [0.0, 30.0])
def test_a_reference_comes_after_a_thermometer_that_rises_steadily(lag):
    """At r K/s from rest a first-order lag is behind by r lag (1 - exp(-t/lag)); the gain follows
    it.
    """
    setup, time, rate = setup_of("dual", *INSTRUMENT), np.arange(0.0, 200.0, 0.5), 0.02
    sense = replace(
        Sense.at_rest(setup.named("accel"), 9.81, np.ones((len(time), 3))),
        time=time,
        temperature=rate * time,
    )
    behind = rate * lag * (1 - np.exp(-time / lag)) if lag else 0.0
    effect = make_effect(
        "reference_drift", {"gain_ppm_degC": 50.0, "lag_s": lag}, setup, sensor="accel"
    )
    gain = effect.apply(np.ones((len(time), 3)), sense, None)
    np.testing.assert_allclose(
        gain, np.outer(1 + 50e-6 * (rate * time - behind), np.ones(3)), rtol=0, atol=1e-12
    )


def test_clipping_of_a_named_axis_leaves_the_others():
    setup = setup_of("dual", *INSTRUMENT)
    drive = still(setup, outer=np.array([0.0, 80.0]))
    bare = read_poses(setup, drive)["accel"]
    clipped = read_poses(
        setup,
        drive,
        make_effect("acc_saturation", {"full_scale_m_s2": 5.0}, setup, sensor="accel", axis="y"),
    )["accel"]
    np.testing.assert_array_equal(clipped[:, [0, 2]], bare[:, [0, 2]])
    assert clipped[1, 1] == 5.0 < bare[1, 1]
    with pytest.raises(TiltcalError, match="axis 'a'"):
        make_effect("acc_saturation", {"full_scale_m_s2": 5.0}, setup, sensor="accel", axis="a")
