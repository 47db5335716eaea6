"""Sign conventions against oracles worked by hand (docs/interfaces.md, "Frames and signs")."""

from math import cos, radians, sin, sqrt

import numpy as np
import pytest
from builders import (
    ACCEL,
    FOG,
    GYRO,
    INCL,
    INSTRUMENT,
    LATITUDE,
    G,
    effect_of,
    motion_of,
    read_poses,
    setup_of,
    still,
)

from tiltcal.core import frames
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, EARTH_RATE
from tiltcal.forward.kinematics import closed_form
from tiltcal.setup.trajectory import Jet

HALF, ROOT3 = 0.5, sqrt(3) / 2


@pytest.mark.parametrize(
    ("table", "angles", "up"),
    [
        ("vertical", {"outer": 70}, (0, 0, 1)),
        ("placing", {"outer": 30}, (-HALF, 0, ROOT3)),
        ("placing", {"outer": 90}, (-1, 0, 0)),
        ("dual", {"outer": 30}, (0, HALF, ROOT3)),
        ("dual", {"outer": 30, "inner": 90}, (HALF, 0, ROOT3)),
        ("dual", {"outer": 90, "inner": -90}, (-1, 0, 0)),
        ("three", {"outer": 50, "middle": 30}, (-HALF, 0, ROOT3)),
        ("three", {"inner": 30}, (0, HALF, ROOT3)),
        ("three", {"outer": 10, "middle": 30, "inner": 90}, (-HALF, ROOT3, 0)),
    ],
)
def test_each_table_shows_up_where_the_hand_puts_it(table, angles, up):
    motion = motion_of(setup_of(table), **angles)
    np.testing.assert_allclose(motion.up[0], up, atol=1e-15)
    np.testing.assert_allclose(motion.force[0], G * np.array(up), atol=1e-14)


@pytest.mark.parametrize(
    ("mount", "up"),
    [
        ("Rz(180)", (HALF, 0, ROOT3)),
        ("Rx(90) Rz(180)", (HALF, -ROOT3, 0)),
        ("Ry(90)", (-ROOT3, 0, -HALF)),
    ],
)
def test_the_mount_turns_the_body_behind_the_table(mount, up):
    setup = setup_of("placing", mount=mount)
    drive = still(setup, outer=30)
    mounted = type(drive)(**{**vars(drive), "mounts": ((0, frames.parse_mount(mount)),)})
    np.testing.assert_allclose(closed_form(setup, mounted).up[0], up, atol=1e-15)


def test_on_the_placing_table_tilt_x_is_minus_outer():
    setup = setup_of("placing", INCL)
    tilt = read_poses(setup, still(setup, outer=np.array([-80.0, -10.0, 0.0, 25.0, 89.0])))["incl"]
    np.testing.assert_allclose(
        tilt / DEG, [[80, 0], [10, 0], [0, 0], [-25, 0], [-89, 0]], atol=1e-9
    )


def test_on_a_tilted_base_tilt_y_is_roll_and_tilt_x_the_shortened_pitch():
    setup, (roll, pitch) = setup_of("vertical", INCL), (15 * DEG, 15 * DEG)
    base = effect_of(
        "table_levelling", setup, tilt_east_arcsec=roll / ARCSEC, tilt_north_arcsec=pitch / ARCSEC
    )
    (tilt,) = read_poses(setup, still(setup), base)["incl"]
    assert tilt[1] == pytest.approx(roll, abs=1e-15)
    assert sin(tilt[0]) == pytest.approx(-cos(roll) * sin(pitch), abs=1e-15)


@pytest.mark.parametrize("a", [0.0, 37.0, 200.0])
@pytest.mark.parametrize(("roll", "pitch"), [(15, 15), (-15, 15), (0.01, -3)])
def test_two_readings_half_a_turn_apart_give_the_tilt_of_the_rotation_axis(a, roll, pitch):
    setup = setup_of("vertical", ACCEL)
    base = effect_of(
        "table_levelling", setup, tilt_east_arcsec=roll * 3600, tilt_north_arcsec=pitch * 3600
    )
    bias = effect_of("acc_bias", setup, bias_x_ug=3000, bias_y_ug=-2000)
    there, back = read_poses(setup, still(setup, outer=np.array([a, a + 180])), base, bias)["accel"]
    h = frames.rotation("z", a * DEG) @ ((there - back) / 2)
    np.testing.assert_allclose(np.degrees(frames.base_tilt(h[:2], G)), [roll, pitch], atol=1e-12)
    np.testing.assert_allclose(
        ((there + back) / 2)[:2], 1e-6 * 9.80665 * np.array([3000, -2000]), atol=1e-14
    )


def test_half_the_sum_holds_the_mount_and_leaves_the_base_alone():
    setup = setup_of("vertical", ACCEL)
    base = effect_of("table_levelling", setup, tilt_east_arcsec=100)
    mount = effect_of("mount_misalignment", setup, tilt_x_arcsec=1800)
    there, back = read_poses(setup, still(setup, outer=np.array([0.0, 180.0])), base, mount)[
        "accel"
    ]
    assert ((there + back) / 2)[1] == pytest.approx(
        G * cos(100 * ARCSEC) * sin(1800 * ARCSEC), abs=1e-14
    )
    assert ((there - back) / 2)[1] == pytest.approx(
        G * sin(100 * ARCSEC) * cos(1800 * ARCSEC), abs=1e-14
    )


def test_base_tilt_refuses_more_force_than_gravity():
    with pytest.raises(
        TiltcalError, match=r"base tilt: found a horizontal force of 13\.86 m/s2, need less than g"
    ):
        frames.base_tilt(np.array([9.8, 9.8]), 9.8)


def test_base_tilt_reaches_an_axis_that_lies_flat():
    """h of full length is a legal reading; rounding must not throw it out of the arcsine's
    domain.
    """
    for angle in np.linspace(0, 2 * np.pi, 2001):
        h = 9.8 * (1 - 1e-15) * np.array([cos(angle), sin(angle)])
        assert np.all(np.isfinite(frames.base_tilt(h, 9.8)))


def test_a_gyro_reads_the_table_rate_about_the_right_axis_and_sense():
    setup = setup_of("three", GYRO)
    drive = still(setup, inner=90.0)
    turning = type(drive)(
        **{
            **vars(drive),
            "axes": {**drive.axes, "outer": Jet(np.zeros(1), np.ones(1), np.zeros(1))},
        }
    )
    rate = closed_form(setup, turning).rate[0] - closed_form(setup, drive).rate[0]
    # roll 90 deg, azimuth 1 rad/s (verify_signs.py)
    np.testing.assert_allclose(rate, [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize(
    (
        "heading",
        "outer",
        "body_rate",
    ),  # in units of Earth's rate: body x, y at a latitude of 60 deg; North mark at ``heading``
    [
        (0, 0, (0, HALF)),
        (90, 0, (-HALF, 0)),
        (180, 0, (0, -HALF)),
        (0, 90, (HALF, 0)),
        (90, 90, (0, HALF)),
    ],
)
def test_earths_rate_follows_latitude_heading_and_table(heading, outer, body_rate):
    setup = setup_of("vertical", GYRO, heading=heading)
    setup = setup.model_copy(update={"site": setup.site.model_copy(update={"latitude_deg": 60.0})})
    rate = motion_of(setup, outer=outer).rate[0] / EARTH_RATE
    np.testing.assert_allclose(rate, [*body_rate, ROOT3], atol=1e-15)


def test_without_a_latitude_or_with_an_unknown_heading_earths_rate_is_still_defined():
    site = setup_of("vertical").site
    assert not site.model_copy(update={"latitude_deg": None}).earth_rate.any()
    np.testing.assert_array_equal(
        site.model_copy(update={"heading_deg": "unknown"}).earth_rate,
        frames.earth_rate(LATITUDE * DEG),
    )


@pytest.mark.parametrize(
    ("latitude", "height", "g"),  # WGS 84: equator, pole (NIMA TR8350.2); 45 deg; free-air gradient
    [
        (0, 0, 9.7803253359),
        (90, 0, 9.8321849379),
        (45, 0, 9.8061977694),
        (0, 1000, 9.7803253359 - 3.086e-3),
    ],
)
def test_normal_gravity_matches_the_tables(latitude, height, g):
    assert frames.normal_gravity(radians(latitude), height) == pytest.approx(g, abs=5e-7)
    assert frames.normal_gravity(radians(-latitude), height) == frames.normal_gravity(
        radians(latitude), height
    )


def test_a_fogs_input_axis_counts_azimuth_from_x_to_y_and_elevation_upwards():
    np.testing.assert_allclose(frames.input_axis(0, 90 * DEG), [0, 1, 0], atol=1e-16)
    np.testing.assert_allclose(
        frames.input_axis(30 * DEG, 60 * DEG), [ROOT3 / 2, 0.75, HALF], atol=1e-15
    )
    assert setup_of("vertical", FOG).named("fog").input_vector == pytest.approx(
        np.full(3, 1 / sqrt(3))
    )


@pytest.mark.parametrize("axis", "xyz")
def test_rotations_are_right_handed_and_skew_is_their_slope(axis):
    i = "xyz".index(axis)
    turned = frames.rotation(axis, 90 * DEG) @ np.eye(3)[(i + 1) % 3]
    np.testing.assert_allclose(turned, np.eye(3)[(i + 2) % 3], atol=1e-15)
    slope = (frames.rotation(axis, 1e-6) - frames.rotation(axis, -1e-6)) / 2e-6
    np.testing.assert_allclose(slope, frames.skew(np.eye(3)[i]), atol=1e-10)
    np.testing.assert_allclose(
        frames.skew(np.arange(3.0)) @ [3, 1, 2], np.cross(np.arange(3.0), [3, 1, 2])
    )


def test_mountings_read_as_products_and_quarter_turns_are_exact():
    np.testing.assert_array_equal(frames.parse_mount(" identity "), np.eye(3))
    np.testing.assert_array_equal(
        frames.parse_mount("Rx(90) Rz(180)"), [[-1, 0, 0], [0, 0, -1], [0, -1, 0]]
    )
    np.testing.assert_allclose(
        frames.parse_mount("Ry(-1e1)*Rz( 2.5 )"),
        frames.rotation("y", -10 * DEG) @ frames.rotation("z", 2.5 * DEG),
    )


@pytest.mark.parametrize("text", ["Rz", "Rq(3)", "Rz(180) upside down", "Rz(half)", "180"])
def test_a_wrong_mounting_is_shown_with_what_does_not_read(text):
    with pytest.raises(TiltcalError, match=r"need identity or factors such as Rz\(180\)"):
        frames.parse_mount(text)


def test_the_mount_metadata_holds_one_mounting_per_remount():
    (t0, first), (t1, second) = frames.parse_mounts("identity; 350.5 s: Rz(180)")
    assert (t0, t1) == (-np.inf, 350.5)
    np.testing.assert_array_equal(first, np.eye(3))
    np.testing.assert_array_equal(second, frames.parse_mount("Rz(180)"))


@pytest.mark.parametrize(
    "text", ["identity; Rz(180)", "identity; soon: Rz(180)", "nan s: identity"]
)
def test_a_mounting_without_its_time_is_refused(text):
    with pytest.raises(
        TiltcalError, match="need a mounting, or '<time> s: <mounting>' after the first"
    ):
        frames.parse_mounts(text)


@pytest.mark.parametrize("text", ["10 s: Rz(180)", "identity; 15 s: Rz(180); 10 s: identity"])
def test_mountings_that_leave_a_stretch_open_or_go_back_in_time_are_refused(text):
    with pytest.raises(TiltcalError, match="mount"):
        frames.parse_mounts(text)


@pytest.mark.parametrize(
    ("label", "up"),
    [
        ("+x", (1, 0, 0)),
        (" -z ", (0, 0, -1)),
        ("[0, 3, 4]", (0, 0.6, 0.8)),
        ("[-2 0 0]", (-1, 0, 0)),
    ],
)
def test_the_operators_word_for_up(label, up):
    np.testing.assert_allclose(frames.parse_up(label), up, atol=1e-16)


@pytest.mark.parametrize(
    "label", ["", "x", "+w", "warming up", "[1, 2]", "[0, 0, 0]", "[1, b, 2]", "[nan, 0, 1]"]
)
def test_free_text_is_no_direction(label):
    assert frames.parse_up(label) is None


def test_tilt_and_force_are_inverse_and_stay_finite_beyond_gravity():
    tilt = np.radians([-90.0, -30.0, 0.0, 45.0])
    np.testing.assert_allclose(
        frames.tilt_of_force(frames.force_of_tilt(tilt, G), G), tilt, atol=1e-15
    )
    np.testing.assert_allclose(
        np.degrees(frames.tilt_of_force(np.array([-10.0, 10.0]), 9.8)), [-90, 90]
    )


def test_the_best_rotation_is_found_and_never_a_mirror_image(rng):
    R = frames.rotation("x", 0.3) @ frames.rotation("y", -1.2) @ frames.rotation("z", 2.0)
    b = rng.normal(size=(20, 3))
    np.testing.assert_allclose(frames.best_rotation(b @ R.T, b), R, atol=1e-14)
    assert np.linalg.det(frames.best_rotation(-b, b)) == pytest.approx(1.0)


def test_angles_between_vectors_are_accurate_when_small_and_when_opposite():
    a = np.array([[0.0, 0, 2], [0, 0, 1], [1, 0, 0]])
    b = np.array([[1e-9, 0, 1], [0, 0, -3], [0, 5, 0]])
    np.testing.assert_allclose(frames.angle_between(a, b), [1e-9, np.pi, np.pi / 2], rtol=1e-14)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [5e-324, 1e-200, 1.0, 3.7, 1e200, 1e308])
def test_a_direction_has_no_length(size):
    assert frames.unit((0.0, -size, 0.0)).tolist() == [0, -1, 0]
    if size > 1e-300:
        assert frames.unit((3e-3 * size, 0.0, 4e-3 * size)) == pytest.approx([0.6, 0, 0.8])


def test_the_sphere_is_covered_evenly():
    points = frames.sphere(400)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0)
    # as the even distribution
    np.testing.assert_allclose(points.T @ points / 400, np.eye(3) / 3, atol=2e-3)
    assert np.abs(points.mean(axis=0)).max() < 2e-3


def test_every_sensor_of_the_instrument_reads_zero_or_gravity_level_at_rest():
    setup = setup_of("dual", *INSTRUMENT)
    read = {name: values[0] for name, values in read_poses(setup, still(setup)).items()}
    earth = setup.site.earth_rate
    np.testing.assert_array_equal(read["accel"], [0, 0, G])
    np.testing.assert_array_equal(read["incl"], [0, 0])
    np.testing.assert_allclose(read["gyro"], earth)
    np.testing.assert_allclose(read["fog"], [earth.sum() / sqrt(3)])
