"""By hand, what the sensors should have read: gyro triad and FOG smoothed together."""

import numpy as np
import pytest

from tiltcal.core.units import DEG
from tiltcal.laboratory.hand_motion import HandMotion, smoothed_readings
from tiltcal.laboratory.handheld import predicted_readings
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.laboratory.smoothing import leave_one_out, smoothed, stops_of
from tiltcal.recordings.recording import Recording
from tiltcal.statistics.splines import most_probable_course

AXIS = np.array([1.0, 2.0, 2.0]) / 3
GYRO, FOG = 0.03 * DEG, 0.015 * DEG  # noise of a sample, rad/s
SCALE = {"id": "fog_scale", "sensor": "fog", "scale_a_ppm": 5000.0}
RANGE = {"id": "gyr_saturation", "sensor": "gyro", "full_scale_deg_s": 25.0}
LATE = {"id": "data_latency", "sensor": "fog", "latency_ms": 30.0}


def scenario(*effects):
    sensors = [
        {"name": "gyro", "kind": "gyro", "rate_hz": 50.0},
        {"name": "fog", "kind": "fog", "axes": ["a"], "input_axis": [1, 2, 2], "rate_hz": 50.0},
    ]
    return parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": 9.81},
            "rig": {"table": "handheld"},
            "sensor": sensors,
            "effect": list(effects),
        }
    )


def turned(seed, scale=0.0, clip=np.inf, late=0.0, seconds=60.0, growth=1.0, power=4):
    """Turns of random bumps between rests, written without the product: the recording, and the two
    courses without noise, (n, 3) and (n,); noise that grows so many times in motion. A bump of the
    power 1 begins and ends with a jump of the angular acceleration.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(50 * seconds)) / 50
    bumps = []
    for begin in np.arange(8.0, seconds - 10, 14.0):
        centres = begin + rng.uniform(1.2, 4.8, 8)
        bumps += [(c, rng.uniform(0.3, 0.8), rng.normal(0, 40 * DEG, 3)) for c in centres]

    def rate(at):
        inside = [(1 - np.minimum(((at - c) / w) ** 2, 1)) ** power for c, w, _ in bumps]
        return np.array(inside).T @ np.array([size for *_, size in bumps])

    gyro = np.clip(rate(t), -clip, clip)
    fog = (1 + scale) * rate(t - late) @ AXIS
    times = np.where(np.abs(rate(t)).sum(axis=1) > 0, growth, 1.0)
    read = rate(t) + GYRO * times[:, None] * rng.standard_normal(gyro.shape)
    columns = {f"gyro_{a}_rad_s": np.clip(read[:, i], -clip, clip) for i, a in enumerate("xyz")}
    columns["fog_a_rad_s"] = fog + FOG * times * rng.standard_normal(len(t))
    return Recording.from_columns(t, columns), gyro, fog


def off(found, truth, sigma):
    """Rms in units of a sample's noise."""
    return float(np.sqrt(np.mean((found - truth) ** 2)) / sigma)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_prediction_has_hardly_more_noise_than_the_best_smoothness_leaves(seed, monkeypatch):
    """The best one is found with the truth."""
    recording, gyro, fog = turned(seed)
    found = smoothed_readings(scenario(), recording, ())
    left = off(found["fog"][:, 0], fog, FOG)
    others = off(predicted_readings(scenario(), recording, ())["fog"][:, 0], fog, FOG)
    assert left < 0.4
    assert left < 0.6 * others
    assert off(found["gyro"], gyro, GYRO) < 0.4
    every = [
        off(with_smoothness(motion(recording), factor, monkeypatch), fog, FOG)
        for factor in 10.0 ** np.arange(-3, 4)
    ]
    assert left < 1.15 * min(every)


def with_smoothness(hand, factor, monkeypatch):
    """The FOG's prediction where the penalty is this often the most probable one."""
    import tiltcal.statistics.splines as module

    probable = module._smoothness
    with monkeypatch.context() as changed:
        changed.setattr(module, "_smoothness", lambda move: factor * probable(move))
        return hand.fog_reading(hand.fogs[0])[:, 0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_a_hand_begins_and_ends_at_once_the_course_does_not_ring(seed):
    """A course of one smoothness rings there, and a reading off it is no outlier: the FOG and the
    triad agree. Without the readings at such instants it would be off by up to 88 sigma, and the
    triad alone by up to 292.
    """
    recording, _, fog = turned(seed, power=1)
    hand = motion(recording)
    readings = [*hand._gyro_readings(), hand._fog_readings(hand.fogs[0], None)]
    even = most_probable_course(hand._basis, readings).at(recording.time) @ AXIS
    found = hand.fog_reading(hand.fogs[0])[:, 0]
    assert off(found, fog, FOG) < 1.05 * off(even, fog, FOG)
    assert np.abs(found - fog).max() < 6 * FOG
    alone = motion(recording, ()).fog_reading(hand.fogs[0])[:, 0]
    assert np.abs(alone - fog).max() < 6 * GYRO


def test_by_the_others_a_fog_is_predicted_with_their_noise_as_it_was_fitted():
    """Whatever the smoothing of the triad takes off, and were it motion."""
    recording, _, _ = turned(1)
    slow = Recording.from_columns(
        recording.time[::5],
        {name: recording.column(name)[::5] for name in recording.column_names},
    )
    read = np.column_stack([slow.column(f"gyro_{a}_rad_s") for a in "xyz"])
    found = predicted_readings(scenario(), slow, ())["fog"][:, 0]
    np.testing.assert_allclose(found, read @ AXIS, atol=1e-12)


def test_with_the_effect_that_is_there_it_predicts_better_than_without():
    recording, _, fog = turned(4, scale=5e-3)
    nominal, amended = (
        off(smoothed_readings(s, recording, s.effects)["fog"][:, 0], fog, FOG)
        for s in (scenario(), scenario(SCALE))
    )
    assert amended < 0.4
    assert nominal > 3 * amended


def test_a_fog_that_contradicts_the_triad_says_nothing_of_the_motion():
    recording, gyro, fog = turned(5)
    columns = {name: recording.column(name) for name in recording.column_names}
    wrong = Recording.from_columns(recording.time, columns | {"fog_a_rad_s": -2 * fog + 0.1})
    with_it, without = (motion(wrong, fogs) for fogs in (("fog",), ()))
    np.testing.assert_array_equal(with_it.gyro_reading(), without.gyro_reading())
    found = smoothed_readings(scenario(), wrong, ())
    assert off(found["fog"][:, 0], fog, FOG) < 0.8  # the triad has twice the noise
    assert off(found["gyro"], gyro, GYRO) < 0.4


def test_noise_that_grows_in_motion_does_not_keep_the_fog_out():
    """Three times as much: the FOG and the triad differ by no more than that."""
    recording, _, fog = turned(1, growth=3.0)
    hand = motion(recording)
    assert 2.5 < hand._growth(hand.fogs[0]) < 3.5
    assert hand._agrees(hand.fogs[0], list(hand._gyro_readings()))
    found = smoothed_readings(scenario(), recording, ())["fog"][:, 0]
    assert off(found, fog, FOG) < 0.4 * 3.0
    quiet = motion(turned(1)[0])
    assert quiet._growth(quiet.fogs[0]) < 1.15
    scaled = motion(turned(1, growth=3.0, scale=0.02)[0])  # far beyond the noise, grown or not
    assert not scaled._agrees(scaled.fogs[0], list(scaled._gyro_readings()))


def motion(recording, fogs=("fog",)):
    s = scenario()
    force = np.full((len(recording), 3), np.nan)
    return HandMotion(s, recording, (), s.named("gyro"), tuple(s.named(f) for f in fogs), force)


def test_where_the_triad_is_out_of_range_the_fog_tells_the_rate():
    recording, gyro, fog = turned(6, clip=25 * DEG)
    s = scenario(RANGE)
    assert (np.abs(gyro) == 25 * DEG).mean() > 0.01
    found = smoothed_readings(s, recording, s.effects)
    by_others = predicted_readings(s, recording, s.effects)
    assert off(found["fog"][:, 0], fog, FOG) < 0.6
    assert off(by_others["fog"][:, 0], fog, FOG) > 20
    assert np.abs(found["gyro"]).max() <= 25 * DEG


def test_a_fog_that_is_late_is_predicted_late():
    recording, _, fog = turned(7, late=0.03)
    s = scenario(LATE)
    assert off(smoothed_readings(s, recording, s.effects)["fog"][:, 0], fog, FOG) < 0.4
    assert off(smoothed_readings(scenario(), recording, ())["fog"][:, 0], fog, FOG) > 1.0


def test_a_single_wrong_reading_leaves_no_trace():
    recording, _, fog = turned(8)
    columns = {name: recording.column(name).copy() for name in recording.column_names}
    for name, row in (("gyro_x_rad_s", 560), ("fog_a_rad_s", 600), ("fog_a_rad_s", 100)):
        columns[name][row] += 1.0
    spoiled = Recording.from_columns(recording.time, columns)
    clean, found = (smoothed_readings(scenario(), r, ())["fog"][:, 0] for r in (recording, spoiled))
    assert np.abs(found - clean).max() < FOG
    assert off(found, fog, FOG) < 0.4


def test_missing_readings_and_a_slower_fog_are_no_obstacle():
    recording, gyro, fog = turned(9)
    columns = {name: recording.column(name).copy() for name in recording.column_names}
    columns["fog_a_rad_s"][np.arange(len(fog)) % 5 > 0] = np.nan
    columns["gyro_y_rad_s"][500:520] = np.nan
    thinned = Recording.from_columns(recording.time, columns)
    found = smoothed_readings(scenario(), thinned, ())
    assert off(found["fog"][:, 0], fog, FOG) < 0.7
    assert off(found["gyro"], gyro, GYRO) < 0.4


@pytest.mark.parametrize("pause", [0.0, 300.0])
def test_a_quartic_is_smoothed_to_itself_at_uneven_stamps(pause):
    """Of a motion whose fifth derivative is nothing no window leaves anything, whatever the gaps
    between its samples; nor does a pause of the log, on either side of which it is the same.
    """
    rng = np.random.default_rng(4)
    time = 0.02 * np.arange(300) + rng.uniform(-0.004, 0.004, 300)
    course = np.column_stack([1 + time - 3 * time**2, 0.2 * time**4 - time**3])
    read = np.arange(300)
    found, _ = smoothed(time + np.where(read < 150, 0.0, pause), course, np.full(300, -1))
    inside = (read >= 15) & (read < 285)
    away = inside & (np.abs(read - 149.5) > 15 if pause else True)
    np.testing.assert_allclose(found[away], course[away], rtol=0, atol=1e-9)
    # beside a pause by what is near, on one side: to a hundredth of a sample
    step = np.abs(np.diff(course, axis=0)).max(axis=0)
    assert np.all(np.abs(found - course)[inside] < 0.01 * step)


def test_what_the_others_tell_of_a_sample_does_not_change_with_it():
    rng = np.random.default_rng(7)
    time, read = 0.02 * np.arange(200), rng.standard_normal((200, 3))
    stop = np.where((time > 1) & (time < 2), 0, -1)
    told = leave_one_out(read, *smoothed(time, read, stop))
    for row in (20, 75, 150):  # of a turn, a rest, a turn
        other = read.copy()
        other[row] += 1e-3
        changed = leave_one_out(other, *smoothed(time, other, stop))
        np.testing.assert_allclose(changed[row], told[row], rtol=0, atol=1e-12)
        assert np.all(changed[row + 1] != told[row + 1])


@pytest.mark.parametrize("tremor", [0.0, 0.5])
def test_a_hand_that_trembles_does_not_rest(tremor):
    """At 2.7 Hz, and as large as this in deg/s: the gyro's noise at rest is none of it."""
    recording, _, fog = turned(4)
    t, shakes = recording.time, np.array([0.6, -0.2, 0.7]) * tremor * DEG
    wave = np.sin(2 * np.pi * 2.7 * t)
    columns = {n: recording.column(n) + 0.0 for n in recording.column_names}
    for a, size in zip("xyz", shakes, strict=True):
        columns[f"gyro_{a}_rad_s"] += size * wave
    columns["fog_a_rad_s"] += shakes @ AXIS * wave
    shaken = Recording.from_columns(t, columns)
    assert (stops_of(shaken) >= 0).any() == (tremor == 0)
    found = smoothed_readings(scenario(), shaken, ())["fog"][:, 0]
    assert off(found, fog + shakes @ AXIS * wave, FOG) < 0.7
