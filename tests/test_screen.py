"""The checks in front of every method: channels, units, drift, rounding, causes that fit alike."""

import re
import zlib

import numpy as np
import pytest
from builders import ACCEL, G, setup_of
from diagnosis_fixtures import recorded
from examiner.case import FAULTS, MAKERS
from examiner.judge import judged
from logs import log_of, triad_readings
from statistics_helpers import rng_of

from tiltcal.calibration.methods.north_checks import walk_density
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.calibration.screen.columns import (
    exchanged_words,
    order_test,
    unit_test,
    unit_tests,
)
from tiltcal.calibration.screen.data import data_tests
from tiltcal.calibration.screen.drift import slope_test
from tiltcal.calibration.screen.explanations import Explanation, alike, in_words
from tiltcal.calibration.screen.outliers import outlier_tests
from tiltcal.core.assets import folder
from tiltcal.core.frames import sphere
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.static_poses import find_poses
from tiltcal.statistics.dwell_noise import left_by_rounding, noise_posterior, rounding_variance

SETUP = setup_of("handheld", ACCEL)
CASES = [(name, fault) for name in MAKERS for fault in FAULTS[name]]


@pytest.mark.parametrize(("name", "fault"), CASES, ids=lambda word: word)
def test_a_wrong_result_is_never_good_and_its_cause_is_named(name, fault):
    for k in range(2):
        rng = np.random.default_rng([77, k, zlib.crc32(f"{name} {fault}".encode())])
        found = judged(MAKERS[name](rng, fault))
        assert not (found.verdict == "good" and found.wrong), found
        if FAULTS[name][fault]:
            assert re.search(FAULTS[name][fault], found.words, re.IGNORECASE), found


@pytest.mark.parametrize("name", list(MAKERS))
def test_clean_recordings_are_good(name):
    for k in range(6):
        rng = np.random.default_rng([78, k, zlib.crc32(name.encode())])
        found = judged(MAKERS[name](rng, "clean"))
        assert found.verdict == "good", found
        assert not found.wrong


@pytest.mark.parametrize("codes", [0.3, 1.0, 2.0, 4.0, 6.0, 12.0])
def test_what_rounding_leaves_in_a_long_mean_is_what_is_stated(codes):
    """Long means of rounded noise at true values that lie anywhere in a code."""
    rng = rng_of(f"rounding {codes}")
    true = rng.uniform(0, codes, (400, 1))
    rounded = np.round((true + rng.normal(size=(400, 4000))) / codes) * codes
    left = np.mean((rounded.mean(axis=1) - true[:, 0]) ** 2)
    variance = float(rounded.var(axis=1).mean())
    stated = float(left_by_rounding(np.array([1 / codes]))[0]) * codes**2
    assert left == pytest.approx(stated + variance / 4000, rel=0.2)


@pytest.mark.parametrize("codes", [2.0, 4.0, 6.0])
@pytest.mark.parametrize("place", ["anywhere", "half near edges"])
def test_few_dwells_tell_the_noise_before_rounding(codes, place):
    """Six dwells of 200 readings; near an edge their spread is that of two codes."""
    rng = rng_of(f"few dwells {codes} {place}")
    ratio = []
    for _ in range(60):
        edge = rng.uniform(-0.5, 0.5, 6)
        edge[: 0 if place == "anywhere" else 3] = rng.uniform(0.45, 0.5)
        true = codes * (np.arange(6) * 7 + edge)
        rounded = np.round((true[:, None] + rng.normal(size=(6, 200))) / codes) * codes
        means = rounded.mean(axis=1)
        residuals = [(r - m)[:, None] for r, m in zip(rounded, means, strict=True)]
        stated = rounding_variance(np.array([codes]), residuals, means[:, None])
        ratio.append(
            float(stated[0, 0]) / float(left_by_rounding(np.array([1 / codes]))[0]) / codes**2
        )
    assert 0.7 < np.median(ratio) < 1.6
    assert np.quantile(ratio, 0.05) > 0.4


def test_readings_without_codes_in_common_leave_the_noise_open():
    chances = noise_posterior([np.zeros(5)])
    assert chances.max() < 0.2


@pytest.mark.parametrize("share", [0.3, 1.0, 3.0])
def test_false_alarms_of_the_slope_test_are_as_rare_as_stated_under_random_walk(share):
    """Fewer than 1 % of 300 logs at a significance of 0.1 %."""
    up, alarms = sphere(12), 0
    clean = triad_readings(up, G, np.zeros(3), np.eye(3))
    rows = len(log_of(clean, ACCEL))
    for k in range(300):
        rng = rng_of(f"slopes {share} {k}")
        noise = rng.normal(0, 1e-3, (rows, 3))
        noise += np.cumsum(rng.normal(0, share * 1e-3 / np.sqrt(60), (rows, 3)), axis=0)
        alarms += not slope_test(find_poses(log_of(clean, ACCEL, noise=noise), SETUP, ACCEL)).passed
    assert alarms <= 3


def test_a_drift_inside_every_dwell_is_found_with_its_size():
    clean = triad_readings(sphere(12), G, np.zeros(3), np.eye(3))
    rows = len(log_of(clean, ACCEL))
    noise = rng_of("drift").normal(0, 1e-3, (rows, 3))
    noise[:, 1] += 1e-3 * np.arange(rows) / ACCEL.rate_hz
    test = slope_test(find_poses(log_of(clean, ACCEL, noise=noise), SETUP, ACCEL))
    assert not test.passed
    assert "accel_y drifts" in test.statement


@pytest.mark.parametrize(
    ("gain", "unit", "word"),
    [(1 / 9.80665, "m_s2", "look like g"), (101.97, "m_s2", "look like mg"), (1.0, "m_s2", "gain")],
)
def test_a_gain_says_which_unit_the_column_is_in(gain, unit, word):
    test = unit_test(ACCEL, gain, unit)
    assert word in test.statement
    assert test.passed == (gain == 1.0)


def test_counts_are_named_with_their_number_per_g():
    test = unit_test(ACCEL, 16384 / 9.80665, "m_s2")
    assert "counts (LSB), 16384 per g" in test.statement


def test_a_dead_channel_is_named_and_the_others_are_not():
    clean = triad_readings(sphere(9), G, np.zeros(3), np.diag([1.0, 0.0, 1.0]))
    noise = rng_of("dead").normal(0, 1e-3, (len(log_of(clean, ACCEL)), 3)) * [1, 0, 1]
    (alive,) = data_tests(log_of(clean, ACCEL, noise=noise), ACCEL)
    assert not alive.passed
    assert "accel_y" in alive.statement
    assert "accel_x" not in alive.statement


def test_causes_that_fit_alike_are_a_class_and_one_that_leaves_more_is_not_in_it():
    found = [
        Explanation("a", 20.0, 20, 30.0),
        Explanation("b", 21.0, 20, 33.0),
        Explanation("c", 22.0, 20, 40.0),
        Explanation("d", 200.0, 20, 10.0),
    ]
    assert [e.words for e in alike(found)] == ["a", "b"]
    assert in_words(found, "none") == "these causes fit alike: a; or b"
    assert in_words(found[3:], "none") == "none"


def test_the_walk_of_a_bias_is_nothing_where_there_is_none_and_its_size_where_there_is():
    rng = rng_of("walk")
    n, dt, white = 64, 15.0, 1e-7
    time = dt * np.arange(n)
    columns = np.ones((n, 1))
    none = [
        walk_density(rng.normal(0, white, n), np.full(n, white**2), time, columns)
        for _ in range(40)
    ]
    assert np.median(none) * time[-1] < 0.1 * white**2
    density = (5 * white) ** 2 / time[-1]
    found = []
    for _ in range(40):
        walk = np.cumsum(rng.normal(0, np.sqrt(density * dt), n))
        rate = walk + rng.normal(0, white, n)
        found.append(walk_density(rate, np.full(n, white**2), time, columns))
    assert np.median(found) == pytest.approx(density, rel=0.5)


FACES = np.vstack([np.eye(3), -np.eye(3)])


def dwells_with(rng, noise):
    """Poses of six faces, with this noise of every sample, (n, 3)."""
    clean = triad_readings(FACES, G, np.zeros(3), np.eye(3))
    log = log_of(clean, ACCEL, dwell=200, move=12, noise=noise(rng, (5 * 212 + 200, 3)))
    return log, find_poses(log, SETUP, ACCEL)


@pytest.mark.parametrize(
    "noise",
    [
        lambda rng, shape: rng.normal(0, 2e-3, shape),
        lambda rng, shape: 2e-3 * rng.standard_t(3, shape),
        lambda rng, shape: rng.normal(0, 2e-3, shape) + 5e-6 * np.arange(shape[0])[:, None],
    ],
    ids=["normal", "heavy tails", "with a drift"],
)
def test_symmetric_noise_is_no_outlier(noise):
    failed = 0
    for k in range(100):
        (test,) = outlier_tests(*dwells_with(rng_of(f"symmetric {k}"), noise))
        failed += not test.passed
    assert failed <= 1  # 0.1 each expected: more than one has a probability of 0.5 %


def test_spikes_to_one_side_are_found_with_their_channel():
    def spiky(rng, shape):
        noise = rng.normal(0, 2e-3, shape)
        noise[:, 1] += 0.02 * (rng.random(shape[0]) < 0.1)
        return noise

    (test,) = outlier_tests(*dwells_with(rng_of("spikes"), spiky))
    assert not test.passed
    assert "accel_y" in test.statement
    assert "outliers to one side" in test.statement


@pytest.mark.parametrize("limited", [False, True])
def test_a_limiter_ahead_of_the_noise_shows_while_the_table_turns(limited):
    """A base that leans by 8 deg and a limit at 5 deg, in closed form: both positions read it."""
    rng = rng_of(f"limiter {limited}")
    angle = np.concatenate([np.zeros(200), np.linspace(0, np.pi, 80), np.full(200, np.pi)])
    lean = np.sin(np.radians(8.0))
    force = G * lean * np.column_stack([np.sin(angle), np.cos(angle)])
    if limited:
        force = np.clip(force, -G * np.sin(np.radians(5.0)), G * np.sin(np.radians(5.0)))
    read = force + rng.normal(0, 5e-4, force.shape)
    columns = {f"accel_{a}_m_s2": read[:, i] for i, a in enumerate("xy")}
    columns["table_outer_deg"] = np.degrees(angle)
    setup = setup_of("vertical", ACCEL.model_copy(update={"axes": ("x", "y")}))
    made = Recording.from_columns(np.arange(len(read)) / 20, columns, source="turn.csv")
    found = calibrate("two_position", made, setup)
    (test,) = [t for t in found.tests if t.name == "accel not limited"]
    assert test.passed is not limited, test.statement
    assert found.verdict == ("suspect" if limited else "good")
    assert ("limiter ahead of the noise" in test.statement) is limited


CYCLIC = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
"""Columns x, y, z that hold the axes z, x, y, by hand: the first responds to z, and so on."""


def test_exchanged_columns_are_said_alike_by_the_fit_and_by_the_cause():
    test = order_test(1.003 * CYCLIC + 0.001)
    assert "the columns x, y, z hold the axes z, x, y:" in test.statement
    # by the cause: axis x is in the second column, y in the third, z in the first
    assert exchanged_words((1, 2, 0), (1, 1, 1)) == test.statement
    assert "hold the axes z, -x, y" in exchanged_words((1, 2, 0), (-1, 1, 1))


def test_exchanged_columns_have_the_right_unit_and_exchanged_faces_have_none():
    (test,) = unit_tests(ACCEL, 1.02 * CYCLIC, "m_s2")
    assert test.passed
    (wrong,) = unit_tests(ACCEL, CYCLIC / 9.80665, "m_s2")
    assert "look like g" in wrong.statement
    assert unit_tests(ACCEL, np.array([[1, 0.9, 0], [0.9, 1, 0], [0, 0, 1.0]]), "m_s2") == []


@pytest.mark.parametrize(("gain", "words"), [(2.006, "2 of what acts"), (0.5015, "1/2 of what")])
def test_the_gain_of_another_full_scale_range_is_no_unit_that_passes(gain, words):
    test = unit_test(ACCEL, gain, "m_s2")
    assert not test.passed
    assert words in test.statement


def test_the_columns_of_an_inclinometer_in_rad_are_not_in_deg():
    scenario = load_scenario(folder("scenarios") / "tumble_inclinometer.toml")
    read = recorded(scenario, 1)
    columns = {n: read.column(n) for n in read.column_names}
    columns |= {n: np.radians(v) for n, v in columns.items() if n.startswith("incl")}
    made = Recording.from_columns(read.time, columns, labels=read.labels, source="rad.csv")
    found = calibrate("six_position", made, scenario)
    (unit,) = [t for t in found.tests if t.name == "unit"]
    assert not unit.passed
    assert "the columns say deg, the readings look like rad" in unit.statement
