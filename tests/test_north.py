"""S4's north-seeker: azimuth and tilt from the same turn of a vertical table."""

import numpy as np
import pytest
from builders import setup_of
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.methods.turntable import Turntable, start_of
from tiltcal.calibration.methods.turntable import solve as solve_table
from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import rotation
from tiltcal.core.units import ARCSEC, DEG, DEG_H, EARTH_RATE
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.setup.sensor import Sensor
from tiltcal.setup.setup import Rig, Setup, Site
from tiltcal.validation.accuracy import normalised_error

G, FAMILY = 9.80665, 1e-3
FOG = Sensor(name="fog", kind="fog", axes=("a",), input_axis=(1, 0, 0), rate_hz=10)
ACCEL = Sensor(name="accel", kind="accelerometer", axes=("x", "y"), rate_hz=10)
FOUR, TWO = (0.0, 90.0, 180.0, 270.0), (0.0, 180.0)
DWELL, MOVE = 60, 10
FOG_SIGMA, ACCEL_SIGMA = 0.3 * DEG_H, 50e-6 * G  # of a sample
FOG_BIAS, ACCEL_BIAS = 2 * DEG_H, np.array([0.02, -0.01])


def site(latitude=40.0, sensors=(FOG, ACCEL), **more):
    return Setup(
        site=Site(gravity_m_s2=G, latitude_deg=latitude, **more),
        rig=Rig(table="vertical"),
        sensor=sensors,
    )


def log(
    azimuth,
    *,
    latitude=40.0,
    roll=0.0,
    pitch=0.0,
    angles=FOUR,
    rng=None,
    axis=(1.0, 0.0, 0.0),
    forces=True,
):
    """Written out by hand: East, North, Up of the site; the base turned by its tilt about table
    axes, then the table.
    """
    up_rate, north_rate = EARTH_RATE * np.sin(latitude * DEG), EARTH_RATE * np.cos(latitude * DEG)
    heading = azimuth - np.pi / 2  # body x points along the table's East at zero
    earth = np.array([-north_rate * np.sin(heading), north_rate * np.cos(heading), up_rate])
    to_world = [rotation("x", roll) @ rotation("y", pitch) @ rotation("z", a * DEG) for a in angles]
    fog = np.array([np.asarray(axis) @ R.T @ earth for R in to_world]) + FOG_BIAS
    force = np.array([(R.T @ [0, 0, G])[:2] for R in to_world]) + ACCEL_BIAS
    track = np.repeat(np.arange(len(angles)), DWELL + MOVE)[:-MOVE]
    n = len(track)
    noise = (
        np.zeros((n, 3))
        if rng is None
        else rng.normal(size=(n, 3)) * [FOG_SIGMA, ACCEL_SIGMA, ACCEL_SIGMA]
    )
    columns = {
        "table_outer_deg": np.asarray(angles)[track],
        "fog_a_rad_s": fog[track] + noise[:, 0],
    }
    if forces:
        columns |= {
            f"accel_{a}_m_s2": force[track, i] + noise[:, 1 + i] for i, a in enumerate("xy")
        }
    return Recording.from_columns(np.arange(n) / 10.0, columns)


def spans(angles=FOUR):
    starts = np.arange(len(angles)) * (DWELL + MOVE)
    return [Segment(i / 10, (i + DWELL - 1) / 10, i, i + DWELL, "dwell") for i in starts]


def solve(recording, setup=None, angles=FOUR, **options):
    return calibrate("north", recording, setup or site(), segments=spans(angles), **options)


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def azimuth_of(azimuth, roll, pitch):
    """Azimuth of the horizontal projection of body x on the tilted base."""
    x = (rotation("x", roll) @ rotation("y", pitch))[:, 0]
    return azimuth - np.pi / 2 + np.arctan2(x[0], x[1])


@pytest.mark.parametrize("azimuth", [0.1, 1.4, 2.5, 3.3, 4.6, 6.2])
def test_four_positions_give_any_azimuth_exactly_on_any_tilt(azimuth):
    found = solve(log(azimuth, roll=0.02, pitch=-0.05))
    assert wrapped(found.value("base.azimuth") - azimuth_of(azimuth, 0.02, -0.05)) == pytest.approx(
        0, abs=1e-9
    )
    assert found.value("base.roll") == pytest.approx(0.02, abs=1e-12)
    assert found.value("base.pitch") == pytest.approx(-0.05, abs=1e-12)
    assert found.value("fog.bias_a") == pytest.approx(FOG_BIAS, abs=1e-13)


def test_two_positions_give_the_cosine_only_and_the_sign_cannot_be_told():
    draw = log(2.0, angles=TWO, rng=rng_of("two positions"))
    found = solve(draw, angles=TWO)
    assert found.verdict == "cannot_tell"
    note = next(w for w in found.warnings if "sign cannot be determined" in w)
    assert "114" in note or "115" in note
    assert "245" in note
    for near in (100.0, 260.0):
        one = solve(draw, angles=TWO, near_deg=near)
        assert one.verdict == "good"
        assert abs(wrapped(one.value("base.azimuth") - near * DEG)) < 20 * DEG


def test_an_axis_that_points_north_at_both_positions_is_hardly_resolved():
    found = solve(log(0.0, angles=TWO, rng=rng_of("north")), angles=TWO, near_deg=5)
    assert found.verdict == "cannot_tell"  # both solutions lie within the compass's error
    assert (
        "turn the FOG's axis off north"
        in next(t for t in found.tests if t.name == "resolution").statement
    )


@pytest.mark.parametrize("latitude", [0.0, 20.0, 45.0, 60.0, -35.0])
@pytest.mark.parametrize("tilt_deg", [0.2, 1.0])
def test_without_the_tilt_correction_the_error_is_tan_latitude_over_sine_times_the_elevation(
    latitude, tilt_deg
):
    """Two positions: e the elevation of the FOG's axis at zero; four: the elevation across the
    heading.
    """
    azimuth, pitch = 70 * DEG, tilt_deg * DEG
    setup = site(latitude)
    draw = log(azimuth, latitude=latitude, pitch=pitch, angles=TWO)
    elevation = -pitch
    bare = solve(draw, setup, TWO, tilt=False, near_deg=70)
    expected = -np.tan(latitude * DEG) * elevation / np.sin(azimuth)
    second = 4 * pitch**2 * (1 + np.tan(latitude * DEG) ** 2)
    assert wrapped(bare.value("base.azimuth") - azimuth) == pytest.approx(expected, abs=second)
    kept = solve(draw, setup, TWO, near_deg=70)
    assert wrapped(kept.value("base.azimuth") - azimuth_of(azimuth, 0.0, pitch)) == pytest.approx(
        0, abs=1e-8
    )
    said = next(w for w in kept.warnings if w.startswith("without the tilt correction"))
    assert float(said.split("would be ")[1].split()[0]) * ARCSEC == pytest.approx(
        expected, abs=second + 1e-9
    )


def drawn(azimuth, roll, pitch, angles, rng):
    """The table's means with noise of known size, without the log around them."""
    clean = log(azimuth, roll=roll, pitch=pitch, angles=angles)
    rows = [s.first for s in spans(angles)]
    fog = clean.column("fog_a_rad_s")[rows]
    force = np.column_stack([clean.column(f"accel_{a}_m_s2")[rows] for a in "xy"])
    m, n = len(angles), np.sqrt(DWELL)
    whiten = np.tile(np.eye(2) / (ACCEL_SIGMA / n), (m, 1, 1))
    sigma = np.full(m, FOG_SIGMA / n)

    def draw():
        return Turntable(
            np.radians(angles),
            np.eye(3),
            np.array([1.0, 0, 0]),
            fog + rng.normal(size=m) * sigma,
            np.diag(1 / sigma),
            (force + rng.normal(size=(m, 2)) * ACCEL_SIGMA / n, whiten),
            G,
            40 * DEG,
            ("fog", "accel"),
        )

    return draw


@pytest.mark.parametrize("angles", [TWO, FOUR])
def test_variance_nees_and_coverage_lie_in_one_computed_band(angles):
    """Bounds by hand: half differences of two dwells, or sine and cosine of four; biases are means
    of all dwells.
    """
    draws, azimuth, m = draws_of(4000), 100 * DEG, len(angles)
    draw = drawn(azimuth, 0.0, 0.0, angles, rng_of(f"north statistics {m}"))
    truth = np.array([azimuth, FOG_BIAS, 0.0, 0.0, *ACCEL_BIAS])
    fog, level = FOG_SIGMA / np.sqrt(DWELL), ACCEL_SIGMA / np.sqrt(DWELL)
    slope = EARTH_RATE * np.cos(40 * DEG) * (abs(np.sin(azimuth)) if m == 2 else 1.0)
    tilt = level / G / np.sqrt(m)
    # the tilt's own noise, through tan(latitude)
    lean = np.tan(40 * DEG) * tilt / (abs(np.sin(azimuth)) if m == 2 else 1.0)
    sigma = np.array(
        [
            np.hypot(fog / slope / np.sqrt(2), lean),
            fog / np.sqrt(m),
            tilt,
            tilt,
            *[level / np.sqrt(m)] * 2,
        ]
    )
    errors, nees, inside = np.empty((draws, 6)), 0.0, np.zeros(6)
    for k in range(draws):
        table = draw()
        roll, pitch, _, rivals = start_of(table)
        heading = min(rivals, key=lambda h: abs(wrapped(h + np.pi / 2 - azimuth)))
        fit, _ = solve_table(table, heading, roll, pitch)
        errors[k] = fit.values - truth
        errors[k, 0] = wrapped(errors[k, 0])
        nees += errors[k] @ np.linalg.solve(fit.covariance, errors[k])
        inside += np.abs(errors[k]) <= 1.96 * fit.sigmas
    p = FAMILY / 13 / 2  # six variances, six coverages, NEES
    ratio = (errors**2).sum(axis=0) / sigma**2
    assert np.all((ratio > chi2.ppf(p, draws)) & (ratio < chi2.isf(p, draws))), ratio / draws
    assert chi2.ppf(p, 6 * draws) < nees < chi2.isf(p, 6 * draws), nees / 6 / draws
    low, high = binom.ppf([p, 1 - p], draws, 0.95)
    assert np.all((inside >= low) & (inside <= high)), inside / draws


@pytest.mark.long
def test_the_whole_method_is_consistent_and_seldom_suspects_itself():
    rng, total, draws, verdicts = rng_of("north whole"), 0.0, 100, []
    truth = {
        "base.azimuth": azimuth_of(1.0, 0.003, -0.004),
        "base.roll": 0.003,
        "base.pitch": -0.004,
    }
    for _ in range(draws):
        found = solve(log(1.0, roll=0.003, pitch=-0.004, rng=rng))
        nees, _ = normalised_error(found, truth)
        total += nees
        verdicts.append(found.verdict)
    nu = 4 * (DWELL - 1)  # residuals that the noise is estimated from
    assert (
        chi2.ppf(FAMILY / 2, 3 * draws) < total * (nu - 2) / nu < chi2.isf(FAMILY / 2, 3 * draws)
    ), total / 3 / draws
    assert verdicts.count("suspect") <= binom.isf(1e-4, draws, 3e-3)


def test_a_wrong_latitude_shows_in_the_horizontal_rate():
    found = solve(log(1.0, latitude=40.0, rng=rng_of("latitude")), site(30.0))
    assert found.verdict == "suspect"
    assert (
        "of what the latitude says"
        in next(t for t in found.tests if t.name == "horizontal Earth rate").statement
    )


def test_a_base_that_moved_between_the_positions_is_seen_by_four_of_them():
    still, moved = (log(1.0, pitch=p, rng=rng_of("moved")) for p in (0.0, 60 * ARCSEC))
    half = 2 * (DWELL + MOVE)
    columns = {
        n: np.where(np.arange(len(still)) < half, still.column(n), moved.column(n))
        for n in still.column_names
    }
    assert solve(Recording.from_columns(still.time, columns)).verdict == "suspect"


def test_without_accelerometers_it_says_what_a_tilt_would_cost():
    found = solve(log(1.0, forces=False, rng=rng_of("bare")))
    assert found.verdict == "good"
    assert "base.roll" not in found.parameters
    assert any("no tilt correction" in w for w in found.warnings)
    named = solve(log(1.0, rng=rng_of("bare")), level="accel")
    assert "base.roll" in named.parameters


def test_what_it_cannot_use_is_refused_in_words():
    draw = log(1.0)
    with pytest.raises(TiltcalError, match="need table vertical"):
        calibrate("north", draw, setup_of("dual", FOG, ACCEL))
    with pytest.raises(TiltcalError, match="found no latitude, need one within 85 deg"):
        solve(
            draw, Setup(site=Site(gravity_m_s2=G), rig=Rig(table="vertical"), sensor=(FOG, ACCEL))
        )
    with pytest.raises(TiltcalError, match="found latitude 89 deg"):
        solve(draw, site(89.0))
    with pytest.raises(TiltcalError, match="need two positions half a turn apart"):
        calibrate("north", draw, site(), segments=spans()[:1])
    half = {n: draw.column(n) for n in draw.column_names}
    for a in "xy":
        half[f"accel_{a}_m_s2"] = np.where(
            np.arange(len(draw)) < 100, half[f"accel_{a}_m_s2"], np.nan
        )
    with pytest.raises(TiltcalError, match="need both sensors at every position"):
        solve(Recording.from_columns(draw.time, half))
