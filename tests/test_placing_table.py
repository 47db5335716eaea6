"""S0: tables from sweeps. Recordings are made by hand here; the scenarios do the same through
MuJoCo.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from builders import ACCEL, INCL, G, setup_of
from logs import log_of, rows_of
from scipy.stats import binom, chi2
from statistics_helpers import draws_of, rng_of

from tiltcal.calibration.correction import corrected_columns
from tiltcal.calibration.methods import placing_table as placing_table_module
from tiltcal.calibration.methods.registry import calibrate
from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC, DEG
from tiltcal.recordings import static_poses
from tiltcal.recordings.joining import joined
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import Segment
from tiltcal.validation.accuracy import normalised_error

SENSOR = ACCEL.model_copy(update={"axes": ("x", "y"), "rate_hz": 50.0})
SETUP = setup_of("placing", SENSOR)
UP = np.arange(0.0, 90.1, 5.0)
UP_AND_DOWN = np.concatenate([UP, UP[-2::-1]])
SIGMA, DWELL, MOVE = 2e-4, 60, 12
WAVE = {"x": (0.009, 0.004, 0.001, -0.002, 0.0005), "y": (-0.007, 0.001, 0.005, 0.003, -0.001)}
FAMILY = 1e-3


def bias(axis: str, degrees: np.ndarray) -> np.ndarray:
    """b0 + c1 cos + s1 sin + c2 cos 2 + s2 sin 2, by hand."""
    b, (b0, c1, s1, c2, s2) = np.radians(degrees), WAVE[axis]
    return b0 + c1 * np.cos(b) + s1 * np.sin(b) + c2 * np.cos(2 * b) + s2 * np.sin(2 * b)


def readings(mount: int, outer: np.ndarray, lean: float = 0.0) -> np.ndarray:
    """x and y of a two-axis level on the table turned by Rz(mount), worked out by hand, (m, 2)."""
    s, zero = G * np.sin(np.radians(outer)), np.zeros_like(outer)
    e = G * lean + zero  # the North end of the table's axis is high by this angle
    f = {0: (-s, e), 90: (e, s), 180: (s, -e), 270: (-e, -s)}[mount]
    beta = {0: ("y", outer), 90: ("x", outer), 180: ("y", -outer), 270: ("x", -outer)}[mount]
    # the other axis stands at 0
    across = {"x": bias("x", zero), "y": bias("y", zero)} | {beta[0]: bias(*beta)}
    return np.column_stack(f) + np.column_stack([across["x"], across["y"]])


def log(*sweeps, noise=None, drift=0.0, lean=0.0, sensor=SENSOR, stated=None, readings_of=readings):
    """A recording of sweeps (mount, angles), one after the other, with the mountings in its
    metadata.
    """
    outer = np.concatenate([a for _, a in sweeps])
    means = np.vstack([readings_of(m, a, lean) for m, a in sweeps])
    if drift:
        rows = rows_of(len(outer), DWELL, MOVE)[-1] + 1
        noise = (0.0 if noise is None else noise) + drift * (
            np.arange(rows)[:, None] / sensor.rate_hz
        ) * np.ones(2)
    made = log_of(means, sensor, dwell=DWELL, move=MOVE, noise=noise, angles={"outer": outer})
    starts = (
        np.cumsum([0, *(len(a) for _, a in sweeps[:-1])]) * (DWELL + MOVE) / sensor.rate_hz
        - MOVE / sensor.rate_hz / 2
    )
    words = [
        ("" if k == 0 else f"{t:g} s: ") + f"Rz({m})"
        for k, (t, (m, _)) in enumerate(zip(starts, stated or sweeps, strict=True))
    ]
    return replace(made, metadata={"mount": "; ".join(words)})


BOTH = ((0, UP_AND_DOWN), (90, UP_AND_DOWN))


def dwells(made) -> list[Segment]:
    """The dwells that ``log_of`` made, a tenth cut off at both ends."""
    found = []
    for first in range(6, len(made), DWELL + MOVE):
        last = first + DWELL - 12
        found.append(
            Segment(float(made.time[first]), float(made.time[last - 1]), first, last, "dwell")
        )
    return found


def swept(made, setup=SETUP, **options):
    """The tables of a recording made by hand."""
    return calibrate("placing_table", made, setup, segments=dwells(made), **options)


def entries(found, axis):
    return np.array([e["value"] for e in found.bias_tables[f"accel.{axis}"]])


def test_exact_sweeps_give_exact_tables_of_both_axes_and_the_smooth_fit():
    found = swept(log(*BOTH))
    assert found.verdict == "good"
    for axis in "xy":
        assert [e["angle_deg"] for e in found.bias_tables[f"accel.{axis}"]] == list(UP)
        np.testing.assert_allclose(entries(found, axis), bias(axis, UP), atol=1e-9)
        for name, value in zip(("bias", "cos1", "sin1", "cos2", "sin2"), WAVE[axis], strict=True):
            assert found.value(f"accel.{name}_{axis}") == pytest.approx(value, abs=1e-6), name


def test_correct_takes_the_table_off_and_leaves_the_rest_empty():
    made = log(*BOTH, (0, np.array([-30.0, -30.0, 20.0, 40.0])))
    found = swept(log(*BOTH))
    columns = corrected_columns(made, found, SETUP)
    outer, y = np.degrees(made.table("outer")), columns["accel_y_corrected_m_s2"]
    first = (made.time > 0) & (made.time < 26) & (np.abs(outer % 5) < 1e-9) & (outer < 85)
    assert np.abs(y[first]).max() < 1e-8
    last = made.time > made.time[-1] - 6
    assert np.isnan(y[last & (outer < -3)]).all()
    assert not np.isnan(y[last & (outer > -2)]).any()
    assert np.nanmax(np.abs(columns["tilt_y_deg"][first])) < 1e-6


def test_the_sigma_of_an_entry_is_that_of_two_visits():
    noisy = log(*BOTH, noise=rng_of("entry sigma").normal(0, SIGMA, (len(log(*BOTH)), 2)))
    found = swept(noisy)
    inner = found.bias_tables["accel.y"][9]
    assert inner["sigma"] == pytest.approx(SIGMA / np.sqrt(2 * (DWELL - 12)), rel=0.1)


def test_an_ascending_sweep_hides_a_linear_drift_and_says_so_and_up_and_down_hides_none():
    drift = 1e-5
    seconds = len(UP) * (DWELL + MOVE) / 50
    one_way = swept(log((0, UP), drift=drift))
    wrong = entries(one_way, "y") - bias("y", UP)
    passed = np.polyfit(UP, wrong, 1)[0] * 90 / (drift * seconds)
    assert passed > 0.94  # from the first dwell to the last: what the table took of the drift ...
    left = wrong - np.polyval(np.polyfit(UP, wrong, 1), UP)
    # ... is all of it, and nothing is left to show it
    assert 1 - np.sum(left**2) / np.sum((wrong - wrong.mean()) ** 2) > 0.999
    assert one_way.dof <= 0 or one_way.chi2_per_dof < 1
    assert one_way.verdict == "suspect"
    (test,) = [t for t in one_way.tests if t.name == "up and down"]
    assert not test.passed
    assert "one-way sweep of axis y" in test.statement
    both_ways = swept(log((0, UP_AND_DOWN), drift=drift))
    error = entries(both_ways, "y") - bias("y", UP)
    assert np.ptp(error) < 1e-8  # none of it; what is common is the zero at mid-sweep
    assert any("drift of axis y, subtracted: 61.2 ug/min" in w for w in both_ways.warnings)
    assert both_ways.verdict == "good"


def test_a_few_repeated_angles_do_not_make_a_sweep_two_way():
    found = swept(log((0, np.array([5.0, 0.0, *UP[1:]]))))
    assert found.verdict == "suspect"
    assert any("one-way sweep of axis y" in t.statement for t in found.tests)


def test_a_second_sweep_turned_round_splits_the_table_from_the_sensor():
    lean = 8 * ARCSEC
    plain = swept(log(*BOTH, lean=lean))
    np.testing.assert_allclose(entries(plain, "y") - bias("y", UP), G * lean, atol=1e-8)
    assert any("remount of 180 deg" in w for w in plain.warnings)
    four = ((0, UP_AND_DOWN), (180, -UP_AND_DOWN), (90, UP_AND_DOWN), (270, -UP_AND_DOWN))
    split = swept(log(*four, lean=lean))
    for axis in "xy":
        np.testing.assert_allclose(entries(split, axis), bias(axis, UP), atol=1e-8)
        assert split.bias_tables[f"accel.{axis}"][3]["table_value"] == pytest.approx(
            G * lean, rel=1e-4
        )
    assert any("leans by 8 " in w for w in split.warnings)
    assert not any("remount of 180 deg, separates" in w for w in split.warnings)


def test_up_and_down_that_do_not_repeat_are_called_suspect():
    def hysteresis(mount, outer, lean):
        return readings(mount, outer, lean) + 1e-3 * np.sign(np.gradient(outer))[:, None]

    noise = rng_of("hysteresis seen").normal(0, SIGMA, (len(log(*BOTH)), 2))
    found = swept(log(*BOTH, noise=noise, readings_of=hysteresis))
    assert found.verdict == "suspect"
    assert not next(t for t in found.tests if t.name == "fit").passed


def test_one_axis_alone_is_calibrated_and_the_other_is_asked_for():
    found = swept(log((0, UP_AND_DOWN)))
    assert list(found.bias_tables) == ["accel.y"]
    assert any("axis x has no table: remount (Rz(90))" in w for w in found.warnings)


def test_an_inclinometer_is_swept_alike():
    incl = INCL.model_copy(update={"rate_hz": 50.0})
    setup = setup_of("placing", incl)
    made = log(
        *BOTH,
        sensor=incl,
        readings_of=lambda m, a, e: np.arcsin(np.clip(readings(m, a, e) / G, -1, 1)),
    )
    found = swept(made, setup)
    np.testing.assert_allclose(
        [e["value"] for e in found.bias_tables["incl.x"]], bias("x", UP), atol=1e-8
    )


def test_a_table_with_a_shape_beyond_four_harmonics_has_no_smooth_fit_and_stays_a_table():
    def kinked(mount, outer, lean):
        return readings(mount, outer, lean) + 1e-3 * ((np.abs(outer) % 20) > 9)[:, None]

    noise = rng_of("kinked").normal(0, SIGMA, (len(log(*BOTH)), 2))
    found = swept(log(*BOTH, noise=noise, readings_of=kinked))
    assert not found.parameters
    assert any("no smooth fit of up to 4 harmonics" in w for w in found.warnings)
    np.testing.assert_allclose(
        entries(found, "y"), kinked(0, UP, 0.0)[:, 1], atol=6 * SIGMA / np.sqrt(70)
    )
    asked = swept(log(*BOTH, noise=noise, readings_of=kinked), harmonics=2)
    assert asked.verdict == "suspect"
    with pytest.raises(TiltcalError, match="no smooth fit that holds"):
        replace(found, lookup="smooth").correct(SENSOR, np.zeros((3, 2)), G)


def test_missing_angles_and_dwells_off_the_steps_are_named():
    gap = UP_AND_DOWN[(UP_AND_DOWN != 35) & (UP_AND_DOWN != 40)]
    found = swept(log((0, gap), (90, UP_AND_DOWN)))
    assert found.verdict == "suspect"
    assert any("no dwell at axis y: 35, 40 deg" in t.statement for t in found.tests)
    odd = swept(log((0, np.array([*UP_AND_DOWN, 12.0])), (90, UP_AND_DOWN)))
    assert any("off the steps of 5 deg are not used: axis y at 12 deg" in w for w in odd.warnings)
    alone = swept(log((0, UP_AND_DOWN), (180, np.array([12.0])), (90, UP_AND_DOWN)))
    assert any("not used: axis y at" in w for w in alone.warnings)


@pytest.mark.parametrize(("stated", "look"), [((0, 0), 90), ((0, 180), 270)])
def test_a_mounting_that_the_readings_contradict_is_refused_by_name(stated, look):
    made = log(*BOTH, stated=[(m, None) for m in stated])
    with pytest.raises(
        TiltcalError,
        match=rf"off the stated mounting but look like one turned by a further Rz\({look}\)",
    ):
        swept(made)


def test_a_channel_that_clips_is_named():
    made = log(*BOTH, readings_of=lambda m, a, e: np.clip(readings(m, a, e), -5.0, 5.0))
    found = swept(made)
    assert found.verdict == "suspect"
    (test,) = [t for t in found.tests if t.name == "channels within range"]
    assert "saturated: x stays at 5 m/s2" in test.statement


def test_unusable_recordings_and_options_are_refused_in_words():
    made = log(*BOTH)
    with pytest.raises(TiltcalError, match="found table dual, need table placing"):
        calibrate("placing_table", made, setup_of("dual", SENSOR))
    blind = replace(
        made,
        blocks=tuple(
            replace(b, columns={n: v for n, v in b.columns.items() if "table" not in n})
            for b in made.blocks
        ),
    )
    with pytest.raises(TiltcalError, match="without a readout of table_outer"):
        calibrate("placing_table", blind, SETUP)
    with pytest.raises(TiltcalError, match="no column accel_z"):
        calibrate(
            "placing_table", made, setup_of("placing", SENSOR.model_copy(update={"axes": ("z",)}))
        )
    with pytest.raises(TiltcalError, match=r"option lookup: found nearest"):
        swept(made, lookup="nearest")
    with pytest.raises(TiltcalError, match=r"option harmonics: found 7"):
        swept(made, harmonics=7)
    with pytest.raises(TiltcalError, match="fewer than three placing angles"):
        swept(log((0, np.array([0.0, 10.0]))))


def _only(recording, axis):
    """The recording without the columns of the other axis, as arcsec of an inclinometer."""
    values = recording.sensor(SENSOR).values[:, SENSOR.axes.index(axis)]
    columns = {
        f"incl_{axis}_arcsec": np.arcsin(values / G) / ARCSEC,
        "table_outer_deg": recording.table("outer") / DEG,
    }
    return Recording.from_columns(recording.time, columns, metadata=dict(recording.metadata))


def test_one_channel_at_a_time_gives_the_tables_of_both():
    """Each axis in a recording of its own, which holds that channel only, in arcsec."""
    setup = setup_of("placing", INCL)
    first = _only(log((0, UP_AND_DOWN)), "y")
    second = _only(log((90, UP_AND_DOWN)), "x")
    assert calibrate("placing_table", first, setup).verdict == "good"
    found = calibrate("placing_table", joined([first, second], "identity"), setup)
    for axis in "xy":
        value = [e["value"] for e in found.bias_tables[f"incl.{axis}"]]
        np.testing.assert_allclose(value, bias(axis, UP), rtol=0, atol=2e-6)


def test_what_no_table_corrects_is_said_only_where_it_is_there():
    rows = rows_of(2 * len(UP_AND_DOWN), DWELL, MOVE)[-1] + 1
    noise = np.random.default_rng(5).normal(0, SIGMA, (rows, 2))
    clean = swept(log(*BOTH, noise=noise))
    assert not any("no table corrects" in w for w in clean.warnings)

    def too_long(mount, outer, lean=0.0):
        return readings(mount, outer, lean) * [1.0002, 1.0]

    scaled = swept(log(*BOTH, noise=noise, readings_of=too_long))
    (note,) = [w for w in scaled.warnings if "no table corrects" in w]
    found, sigma = (float(w) for w in re.search(r"of x, (\S+) \+- ([\d.e-]+)", note).groups())
    assert abs(found - 2e-4) < 3 * sigma < 2e-5


def test_a_dwell_that_spans_a_remount_is_cut_there():
    made = log(*BOTH)
    whole = dwells(made)
    k = len(UP_AND_DOWN) - 1  # both sweeps stand at 0 where the mounting changes
    joined = Segment(whole[k].start, whole[k + 1].end, whole[k].first, whole[k + 1].last, "dwell")
    found = calibrate("placing_table", made, SETUP, segments=[*whole[:k], joined, *whole[k + 2 :]])
    assert len(found.poses) == len(whole)
    np.testing.assert_allclose(entries(found, "x"), bias("x", UP), atol=1e-3)


@pytest.mark.long
def test_all_draws_together_reach_the_bound_and_their_intervals_cover(monkeypatch):
    """Tables and smooth fits of both axes: one family of variances and NEES at 0.1 %, and 95 %
    intervals. An entry's sigma also holds what straight lines beside it miss: left out here, where
    entries are compared at their own angles.
    """
    monkeypatch.setattr(placing_table_module, "interpolation_error", lambda _: 0.0)
    draws, angles = draws_of(10_000), UP[::3]
    sweep = np.concatenate([angles, angles[-2::-1]])
    clean = log((0, sweep), (90, sweep))
    segments = dwells(clean)
    known = static_poses._known_up(clean, SETUP, segments)
    # the readout is the same in every draw: read it once
    monkeypatch.setattr(static_poses, "_known_up", lambda *_: known)
    rng = rng_of("placing table at its bound")
    columns = np.column_stack([clean.column(f"accel_{a}_m_s2") for a in "xy"])
    truth = dict(
        zip(
            [f"accel.{n}_{a}" for a in "xy" for n in ("bias", "cos1", "sin1", "cos2", "sin2")],
            (*WAVE["x"], *WAVE["y"]),
            strict=True,
        )
    )
    names, n = list(truth), len(angles)
    angle = {"table_outer_deg": clean.column("table_outer_deg")}
    values, sigmas, nees = (
        np.empty((draws, 2 * n + 10)),
        np.empty((draws, 2 * n + 10)),
        np.empty(draws),
    )
    for k in range(draws):
        noisy = columns + rng.normal(0, SIGMA, columns.shape)
        made = type(clean).from_columns(
            clean.time,
            {f"accel_{a}_m_s2": noisy[:, i] for i, a in enumerate("xy")} | angle,
            metadata=clean.metadata,
        )
        found = calibrate("placing_table", made, SETUP, segments=segments, harmonics=2)
        tables = [e for a in "xy" for e in found.bias_tables[f"accel.{a}"]]
        values[k] = [e["value"] for e in tables] + [found.value(x) for x in names]
        sigmas[k] = [e["sigma"] for e in tables] + [found.parameters[x].sigma for x in names]
        nees[k] = normalised_error(found, truth)[0]
    exact = np.array([*bias("x", angles), *bias("y", angles), *truth.values()])
    ratio = values.var(axis=0, ddof=1) / _bound(segments, sweep, angles)
    p = FAMILY / (len(exact) + 1) / 2
    low, high = chi2.ppf(p, draws - 1) / (draws - 1), chi2.isf(p, draws - 1) / (draws - 1)
    assert np.all((ratio > low) & (ratio < high)), ratio
    # samples about their dwell means, from which the noise is estimated
    residuals = 2 * len(segments) * 39
    assert (
        chi2.ppf(p, 10 * draws) / (10 * draws)
        < nees.mean() / 10
        < chi2.isf(p, 10 * draws) / (10 * draws) * (1 + 4 / residuals)
    )
    coverage = (np.abs(values - exact) <= 1.959964 * sigmas).mean(axis=0)
    least, most = binom.ppf([p, 1 - p], draws, 0.95) / draws  # of 10 000: 94 to 96 %
    assert np.all((coverage >= least) & (coverage <= most)), coverage


def _bound(segments, sweep, angles) -> np.ndarray:
    """Cramer-Rao by the whole design: table entries and a drift against samples; five terms and a
    drift against samples.
    """
    counts = np.array([s.last - s.first for s in segments], dtype=float)
    times = np.array([(s.start + s.end) / 2 for s in segments])
    tables, smooth = [], []
    # x in the second sweep, y in the first
    for half in (
        slice(len(sweep), None),
        slice(0, len(sweep)),
    ):
        t, w = times[half] - times[half].mean(), counts[half] / SIGMA**2
        b = np.radians(sweep)
        for basis, out in (
            (np.eye(len(angles))[np.round(sweep / (angles[1] - angles[0])).astype(int)], tables),
            (
                np.column_stack(
                    [np.ones_like(b), np.cos(b), np.sin(b), np.cos(2 * b), np.sin(2 * b)]
                ),
                smooth,
            ),
        ):
            A = np.column_stack([basis, t])
            out.append(np.diag(np.linalg.inv(A.T @ (A * w[:, None])))[:-1])
    return np.concatenate([*tables, *smooth])


def test_the_bound_of_a_smooth_fit_is_the_share_of_its_terms():
    # docs/physics.md, "Placing-angle tables": p terms against n entries have p/n of the
    # variance of an entry
    b = UP * DEG
    B = np.column_stack([np.ones_like(b), np.cos(b), np.sin(b), np.cos(2 * b), np.sin(2 * b)])
    hat = B @ np.linalg.inv(B.T @ B) @ B.T
    assert np.mean(np.diag(hat)) == pytest.approx(5 / len(UP))
