"""Placing-angle tables applied: look-ups, the on-line corrector, and what a table may not be
extended to.
"""

import math
import tracemalloc

import numpy as np
import pytest
from statistics_helpers import rng_of

from tiltcal.calibration.result import calibration_from
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG, G0
from tiltcal.instrument.placing import LOOKUPS, BiasTable, PlacingCorrector

MG = 1e-3 * G0
G = 9.80123


def wave(n: int, size: float = MG) -> BiasTable:
    """size cos(n beta) every degree from 0 to 90."""
    terms = [0.0] * (2 * n + 1)
    terms[2 * n - 1] = size
    return BiasTable(0.0, DEG, size * np.cos(n * np.arange(91) * DEG), np.zeros(91), tuple(terms))


def truth(axis: str, f: np.ndarray) -> np.ndarray:
    """Bias of an axis by hand: 1.2 mg cos 2 beta_x, 0.8 mg cos 3 beta_y."""
    beta = np.arctan2(f[:, 1], f[:, 2]) if axis == "x" else np.arctan2(-f[:, 0], f[:, 2])
    return 1.2 * MG * np.cos(2 * beta) if axis == "x" else 0.8 * MG * np.cos(3 * beta)


def level(n: int, rng: np.random.Generator) -> np.ndarray:
    """True forces with both placing angles between 0 and 85 deg, (n, 3)."""
    bx, by = rng.uniform(0, 85, n) * DEG, rng.uniform(0, 85, n) * DEG
    f = np.column_stack([-np.tan(by), np.tan(bx), np.ones(n)])
    return G * f / np.linalg.norm(f, axis=1)[:, None]


@pytest.mark.parametrize(
    ("n", "interpolated", "rounded"),
    [(1, 0.0079, 1.80), (2, 0.031, 3.6), (4, 0.126, 7.2), (8, 0.50, 14.4)],
)
def test_the_error_of_a_one_degree_table_is_the_one_worked_out_by_hand(n, interpolated, rounded):
    beta = np.linspace(0, 90, 90_001) * DEG
    error = {
        look: np.abs(wave(n).at(beta, look) - MG * np.cos(n * beta)).max() / G0 / ARCSEC
        for look in ("interpolated", "rounded")
    }
    assert error["interpolated"] == pytest.approx(interpolated, rel=0.02)
    assert error["rounded"] == pytest.approx(rounded, rel=0.01)
    assert error["interpolated"] <= DEG**2 / 8 * n * n * 1e-3 / ARCSEC * 1.0001  # h^2/8 max |b''|
    assert np.abs(wave(n).at(beta, "smooth") - MG * np.cos(n * beta)).max() < 1e-15


def corrector(lookup: str = "interpolated") -> PlacingCorrector:
    return PlacingCorrector({"x": wave(2, 1.2 * MG), "y": wave(3, 0.8 * MG)}, G, lookup)


@pytest.mark.parametrize("channels", [2, 3])
@pytest.mark.parametrize("lookup", LOOKUPS)
def test_a_sample_alone_and_in_a_block_are_corrected_alike(lookup, channels):
    f = level(20_000, rng_of(f"alike {lookup} {channels}"))
    f[::7] *= [-1, 1, 1]  # and outside the tables
    block = corrector(lookup).tilt(f[:, :channels])
    alone = np.array([corrector(lookup).update(row) for row in f[:200, :channels].tolist()])
    np.testing.assert_allclose(alone, block[:200], atol=1e-12)
    assert np.isnan(block[::7, 1]).mean() > 0.9


def test_each_axis_gives_the_other_its_angle():
    f = level(50_000, rng_of("cross feeding"))
    reading = f.copy()
    reading[:, 0] += truth("x", f)
    reading[:, 1] += truth("y", f)
    found = corrector("smooth").correct(reading)
    before = np.abs(reading - f)[:, :2].max() / G / ARCSEC
    after = np.abs(found - f[:, :2]).max() / G / ARCSEC
    assert before > 200
    # two passes leave (b'/g)^2 b of the 1 mg: 0.005 arcsec even where a tilt near 85 deg magnifies
    # an angle tenfold
    assert after < 0.01
    once = np.abs(
        reading[:, 0]
        - corrector().tables["x"].at(np.arctan2(reading[:, 1], reading[:, 2]), "smooth")
        - f[:, 0]
    )
    assert once.max() / G / ARCSEC > 5 * after  # the patent's single pass


def test_two_channels_know_the_third_from_gravity():
    f = level(5000, rng_of("two channels"))
    # what two passes leave grows as (b'/f_z)^2 b: here 0.006 arcsec of each axis
    f = f[f[:, 2] > 0.5 * G]
    reading = f.copy()
    reading[:, 0] += truth("x", f)
    reading[:, 1] += truth("y", f)
    assert np.abs(corrector("smooth").correct(reading[:, :2]) - f[:, :2]).max() / G / ARCSEC < 0.02


@pytest.mark.parametrize(
    ("f", "lost"),
    [
        ((-0.1, 0.2, 1.0), ()),
        ((-0.1, -0.2, 1.0), ("x",)),
        ((0.1, 0.2, 1.0), ("y",)),
        ((0.1, -0.2, 1.0), ("x", "y")),
        ((-0.1, 0.2, -1.0), ("x", "y")),
        ((-1.0, 0.03, 0.03), ("x",)),
        ((-0.001, 0.001, 1.0), ()),
        ((0.004, -0.004, 1.0), ()),
    ],
)
def test_negative_and_mirrored_quadrants_and_the_vertical_are_no_numbers(f, lost):
    found = dict(zip("xy", corrector().update([G * v for v in f]), strict=True))
    assert {a for a, v in found.items() if math.isnan(v)} == set(lost)


def test_a_sample_that_was_not_taken_stays_no_number():
    assert all(map(math.isnan, corrector().update([math.nan, math.nan])))
    assert corrector().update([-20.0, 0.1, 1.0])[0] == pytest.approx(-math.pi / 2)


def test_memory_does_not_grow_with_the_samples():
    one = corrector()
    rows = level(1000, rng_of("memory")).tolist()
    for row in rows:
        one.update(row)
    tracemalloc.start()
    try:
        for _ in range(20):
            for row in rows:
                one.update(row)
        assert tracemalloc.get_traced_memory()[1] < 10_000
    finally:
        tracemalloc.stop()


def stated(angles, unit="m_s2", **more):
    return [{"angle_deg": a, "value": 0.01, "sigma": 1e-5, "unit": unit, **more} for a in angles]


def cal(entries, lookup="interpolated"):
    table = {
        "method": "placing_table",
        "verdict": "good",
        "parameters": {},
        "bias_tables": {"accel.y": entries},
        "lookup": lookup,
    }
    return calibration_from(table)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (stated([0, 1, 3.5]), "3 entries at uneven or descending angles"),
        (stated([2, 1, 0]), "uneven or descending"),
        (stated([0]), "1 entries"),
        (stated([0, 1], unit="arcsec"), "unit arcsec"),
        ([{"value": 1}], "no key 'angle_deg'"),
    ],
)
def test_a_table_that_is_none_is_refused_in_words(entries, message):
    from builders import INCL

    with pytest.raises(TiltcalError, match=message):
        cal(entries).placing(INCL.model_copy(update={"name": "accel"}), G)


def test_an_angle_that_is_missing_is_bridged():
    from builders import INCL

    entries = stated([0, 1, 2, 4])
    entries[3]["value"] = 0.02
    found = cal(entries).placing(INCL.model_copy(update={"name": "accel"}), G)
    assert found.tables["y"].at(np.array([3 * DEG]))[0] == pytest.approx(0.015)


def test_an_unknown_look_up_and_a_smooth_one_without_a_fit_are_refused():
    with pytest.raises(TiltcalError, match=r"look-up: found nearest, need interpolated"):
        PlacingCorrector({}, G, "nearest")
    with pytest.raises(TiltcalError, match=r"axis x: found no smooth fit"):
        PlacingCorrector({"x": BiasTable(0.0, DEG, np.zeros(91), np.zeros(91))}, G, "smooth")
