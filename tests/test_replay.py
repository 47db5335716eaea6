"""A recorded readout played again predicts what the recording read."""

import numpy as np
import pytest
from builders import ACCEL, FOG, GYRO, INCL, setup_of

from tiltcal.core.errors import TiltcalError
from tiltcal.core.units import ARCSEC
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.replay import replay
from tiltcal.recordings.table_standstills import still_rows

LABORATORY = SimulatedLaboratory()
STEPS = [
    {"action": "move", "outer_deg": 0, "dwell_s": 3},
    {"action": "move", "outer_deg": 60, "inner_deg": 30, "dwell_s": 3},
    {"action": "remount", "mount": "Rz(180)", "dwell_s": 3},
    {"action": "turn", "axis": "inner", "angle_deg": -400, "rate_deg_s": 50, "dwell_s": 3},
]


def scenario(**more):
    setup = setup_of(
        "dual",
        *(s.model_copy(update={"rate_hz": 100}) for s in (ACCEL, GYRO, FOG, INCL)),
        lever_arm_m=(0.05, 0, 0.02),
    )
    table = setup.model_dump(exclude_none=True)
    return parse_scenario(
        {"schema": 1, **table, "sequence": STEPS, "climate": {"ramp_degC_h": 600}, **more}
    )


def steady(time):
    """Rows well inside a dwell, or a turn at constant rate: away from where the table speeds up or
    slows down.
    """
    drive = scenario().schedule.drive(time)
    unsteady = np.any([jet.a != 0 for jet in drive.axes.values()], axis=0) | (
        np.diff(drive.stop, prepend=0) != 0
    )
    return np.convolve(unsteady.astype(float), np.ones(61), mode="same") < 0.5


def test_a_noise_free_recording_is_predicted_exactly_at_rest_and_in_steady_turns():
    effects = [
        {"id": "acc_K2", "sensor": "accel", "k2_x_ug_g2": 500},
        {"id": "acc_temp_bias", "sensor": "accel", "temp_bias_z_ug_degC": 100},
    ]
    told = scenario(effect=effects)
    recording = LABORATORY.record(told)
    assert recording.metadata["mount"].endswith("s: Rz(180)")
    prediction = LABORATORY.predict(told, recording)
    assert set(prediction.column_names) == set(recording.column_names)
    rows = steady(recording.time)
    assert 0.5 < rows.mean() < 0.95
    assert np.abs(recording.column("gyro_z_deg_s")[rows]).max() > 49
    for sensor in told.sensor:
        error = np.abs(prediction.sensor(sensor).values - recording.sensor(sensor).values)
        assert error[rows].max() < 1e-8, sensor.name


def test_what_the_table_did_not_read_is_not_predicted():
    told = scenario()
    recording = LABORATORY.record(told)
    columns = {name: recording.column(name) for name in recording.column_names}
    columns["table_outer_deg"] = np.where(recording.time < 2, np.nan, columns["table_outer_deg"])
    gap = Recording.from_columns(recording.time, columns, metadata=recording.metadata)
    values = LABORATORY.predict(told, gap).column("accel_x_m_s2")
    np.testing.assert_array_equal(np.isnan(values), recording.time < 2)


def test_temperature_comes_from_the_column_or_the_site():
    recording = LABORATORY.record(scenario())
    course = replay(recording, scenario())
    assert course.reference == pytest.approx(np.mean(recording.column("temperature_degC")))
    bare = Recording.from_columns(
        recording.time, {n: recording.column(n) for n in ("table_outer_deg", "table_inner_deg")}
    )
    assert set(replay(bare, scenario()).temperature) == {23.0}
    assert replay(recording, scenario(), reference_temperature=20.0).reference == 20.0


def test_between_stamps_a_steady_table_moves_on():
    recording = LABORATORY.record(scenario())
    course, schedule = replay(recording, scenario()), scenario().schedule
    rows = steady(recording.time)
    later = recording.time[rows][:-1] + 0.004
    played, true = course.drive(later).axes["inner"], schedule.drive(later).axes["inner"]
    assert np.abs(played.x - true.x).max() < 1e-8


def test_a_recording_without_the_tables_readout_is_refused():
    recording = LABORATORY.record(scenario())
    bare = Recording.from_columns(
        recording.time,
        {"table_outer_deg": recording.column("table_outer_deg")},
        source="recording r.csv",
    )
    with pytest.raises(
        TiltcalError,
        match=r"recording r\.csv: found no column table_inner_<unit>, need the readout of",
    ):
        replay(bare, scenario())
    backwards = Recording.from_columns(recording.time[::-1], {})
    with pytest.raises(TiltcalError, match="time goes back"):
        replay(backwards, scenario())


def test_a_table_that_never_rests_has_no_stops_at_its_turning_points():
    """The quietest tenth of a record that only oscillates is no dwell: its rates are those of the
    motion.
    """
    swing = [
        {
            "action": "oscillate",
            "axis": "inner",
            "amplitude_deg": 60,
            "frequency_hz": 0.2,
            "cycles": 10,
        }
    ]
    setup = setup_of("dual", GYRO.model_copy(update={"rate_hz": 100}))
    recording = LABORATORY.record(
        parse_scenario({"schema": 1, **setup.model_dump(exclude_none=True), "sequence": swing}), 1
    )
    course = replay(recording, setup)
    assert not (course.stop >= 0).any()
    axis = course.drive(recording.time).axes["inner"]
    assert np.abs(np.gradient(course.angles["inner"], recording.time) - axis.v)[20:-20].max() < 1e-3


@pytest.mark.parametrize(("first", "second", "lasts"), [(2.0, -0.5, 5.0), (3.0, 3.0, 8.0)])
def test_where_a_move_follows_the_last_at_once_the_axis_is_not_at_rest(first, second, lasts, rng):
    """A stop of no duration: 0.3 s beside it the axis turns at some 0.1 deg/s, in noise of 0.06
    arcsec.
    """
    time = np.arange(0, 2 * lasts + 3, 0.02)
    begin, end = 1.003, 1.003 + lasts
    angle = first * smooth((time - begin) / lasts) + second * smooth((time - end) / lasts)
    read = Recording.from_columns(
        time, {"table_outer_deg": np.degrees(angle + 3e-7 * rng.standard_normal(len(time)))}
    )
    course = replay(read, setup_of("placing", ACCEL))
    off = np.abs(course.drive(time).axes["outer"].v - np.gradient(angle, time))
    assert off[np.abs(time - end) < 0.5].max() < 3e-4  # taken for rest: 3e-3


def smooth(u):
    """From 0 to 1, three derivatives of nothing at both ends."""
    u = np.clip(u, 0, 1)
    return u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)


def test_no_rate_is_told_across_angles_that_were_not_read(rng):
    """A head that is read at its stops only: between them nobody knows how it turned, and it rests
    up to the last sample that was read.
    """
    time = np.arange(0, 30, 0.04)
    turned = np.clip((time % 10 - 7) / 3, 0, 1) + np.floor(time / 10)
    read = np.where(time % 10 < 7, 90 * turned + 1e-5 * rng.standard_normal(len(time)), np.nan)
    course = replay(
        Recording.from_columns(time, {"table_outer_deg": read}), setup_of("placing", ACCEL)
    )
    axis = course.drive(time).axes["outer"]
    assert course.known.sum() == np.isfinite(read).sum()
    assert np.abs(axis.v[course.known]).max() < 1e-5
    assert np.abs(axis.a[course.known]).max() < 1e-3


@pytest.mark.parametrize("noise_codes", [0.0, 0.2, 0.4, 0.6, 0.9, 2.0, 5.0])
def test_every_dwell_is_one_stop_however_coarse_the_readout_is(noise_codes, rng):
    time = np.arange(0, 60, 0.04)
    edges = np.clip((time % 6.0 - 4.0) / 2.0, 0, 1)  # 4 s at rest, 2 s moving
    angle = 10.0 * (np.floor(time / 6.0) + 3 * edges**2 - 2 * edges**3)
    code = 1e-5
    angle = np.round((angle + noise_codes * code * rng.standard_normal(len(time))) / code) * code
    stop = replay(
        Recording.from_columns(time, {"table_outer_deg": angle}), setup_of("placing", ACCEL)
    ).stop
    lengths = np.bincount(stop[stop >= 0])
    assert len(lengths) == 10
    assert lengths.min() > 90
    assert lengths.max() < 103


def test_a_slow_move_within_a_dwell_parts_it_into_two_stops(rng):
    """0.05 deg in 5 s, less than any limit of a stop: what turns fast before and after it keeps its
    ends, and it has its rates.
    """
    time = np.arange(0, 40, 0.02)
    fast = np.clip(time - 5, 0, 2) / 2, np.clip(time - 30, 0, 2) / 2
    slow = np.clip(time - 15, 0, 5) / 5
    angle = sum(
        (3 * u**2 - 2 * u**3) * np.deg2rad(step)
        for u, step in zip((*fast, slow), (60, 40, 0.05), strict=True)
    )
    rate = np.gradient(angle, time)
    read = angle + 5e-7 * rng.standard_normal(len(time))
    course = replay(
        Recording.from_columns(time, {"table_outer_deg": np.rad2deg(read)}),
        setup_of("placing", ACCEL),
    )
    assert [
        len(set(course.stop[(time > a) & (time < b)]) - {-1})
        for a, b in ((0, 5), (7, 15), (20, 30), (32, 40))
    ] == [1] * 4
    assert len(set(course.stop) - {-1}) == 4
    error = np.abs(course.drive(time).axes["outer"].v - rate)
    inside = (time > 15.2) & (time < 19.8)
    assert error[inside].max() < 2e-5 < rate[inside].max() / 4
    assert error[(time > 30.0) & (time < 32.0)].max() < 2e-3


@pytest.mark.parametrize("rows", [(53, 46), (46, 53), (15, 13)])
def test_a_slow_move_beside_one_rest_is_no_rest(rows, rng):
    """The search for dwells takes the slow part of a move for rest: one axis moves 0.16 deg while
    others turn fast, or a move ends slowly before a short rest.
    """
    at_rest, moving = rows
    n, u = at_rest + moving, np.arange(1, moving + 1) / moving / 2
    angle = np.deg2rad(0.16) * np.concatenate([np.zeros(at_rest), u**3 * (10 - 15 * u + 6 * u**2)])
    read = (angle + 0.07 * ARCSEC * rng.standard_normal(n))[:, None]
    for part in (read, read[::-1]):
        still = still_rows(part, np.ones(n, bool))
        still = still if part is read else still[::-1]
        assert still[: at_rest - 3].mean() > 0.9
        assert not still[at_rest + moving // 4 :].any()


def test_the_end_of_a_slow_approach_is_told_though_it_hides_in_the_noise(rng):
    """The rate falls with the cube of the time: the last five samples of a move are within 3 sigma
    of its end.

    It is told to a fifth of a sample.
    """
    time = np.arange(0, 360, 0.04)
    u = np.clip((time % 12.0) / 4.0, 0, 1)
    half = np.minimum(u, 1 - u)
    way = 16 * half**4 * (2.5 - 6 * half + 4 * half**2)
    read = np.radians(5.0) * (
        np.floor(time / 12.0) + np.where(u < 0.5, way, 1 - way)
    ) + 1e-6 * rng.standard_normal(len(time))
    course = replay(
        Recording.from_columns(time, {"table_outer_deg": np.degrees(read)}),
        setup_of("placing", ACCEL),
    )
    middle = np.abs(time % 12.0 - 10.0) < 0.02
    late = course.standstills.since(time)[middle] - (time[middle] % 12.0 - 4.0)
    assert len(late) == 30
    assert np.sqrt(np.mean(late**2)) < 0.04 / 5


def head_by_hand(rng, hold=12.0, turn=3.0, count=12):
    """A dividing head that is turned by hand: its angle is typed in while it turns, so that the
    readout steps and the reading follows for seconds.
    """
    time = np.arange(0, count * hold, 0.1)
    number = (time // hold).astype(int)
    settings = np.radians(5.0 * ((7 * np.arange(count + 1)) % 11 - 5))
    since = time - number * hold
    u = np.clip(since / turn, 0, 1)
    true = settings[number] + (settings[number + 1] - settings[number]) * u * u * (3 - 2 * u)
    written = np.where(since < 0.6 * turn, settings[number], settings[number + 1])
    read = -9.81 * np.sin(true) + 1e-3 * rng.standard_normal(len(time))
    columns = {"table_outer_deg": np.degrees(written), "accel_x_m_s2": read}
    return Recording.from_columns(time, columns), true


PLACED = parse_scenario(
    {
        "schema": 1,
        "name": "dividing head",
        "site": {"gravity_m_s2": 9.81},
        "rig": {"table": "placing", "readout": "command"},
        "sensor": [
            {
                "name": "accel",
                "kind": "accelerometer",
                "axes": ["x"],
                "rate_hz": 10,
                "adjustable": ["bias", "scale"],
            }
        ],
    }
)


def test_a_readout_of_settings_is_known_at_its_dwells_alone(rng):
    recording, true = head_by_hand(rng)
    course = replay(recording, PLACED)
    assert course.rests_only
    assert course.stop.max() + 1 in (12, 13)
    assert course.known.mean() > 0.5
    np.testing.assert_allclose(course.angles["outer"][course.known], true[course.known], atol=2e-3)
    assert not any(np.any(part) for part in course.motion_noise("outer"))
    assert not course.drive(recording.time).axes["outer"].v.any()


@pytest.mark.parametrize("rows", [1, 7])
def test_a_readout_that_follows_its_axis_is_no_list_of_settings(rng, rows):
    """It may be held for some rows, as of a slow link."""
    time = np.arange(0, 120, 0.1)
    true = np.radians(60) * np.sin(2 * np.pi * time / 40)
    written = true[np.arange(len(time)) // rows * rows]
    read = -9.81 * np.sin(true) + 1e-3 * rng.standard_normal(len(time))
    columns = {"table_outer_deg": np.degrees(written), "accel_x_m_s2": read}
    assert not replay(Recording.from_columns(time, columns), PLACED).rests_only


def test_a_head_that_is_turned_by_hand_matches_its_scenario(rng):
    recording, _ = head_by_hand(rng)
    found = diagnose(PLACED, [recording])
    assert found.verdict == "match"
    assert found.after.chi2_per_dof == pytest.approx(1, abs=0.2)


def test_between_stamps_an_acceleration_is_as_exact_as_at_them():
    """A straight line from one stamp to the next would lose 0.35 % of it at 50 Hz, which a stated
    latency took for a lever arm.
    """
    steps = [
        {"action": "move", "outer_deg": angle, "rate_deg_s": 30, "dwell_s": 2}
        for angle in (0, 45, 90)
    ]
    table = setup_of("dual", ACCEL.model_copy(update={"rate_hz": 50})).model_dump(exclude_none=True)
    told = parse_scenario({"schema": 1, **table, "sequence": steps})
    recording = LABORATORY.record(told)
    time = recording.time[5:-5] - 0.006
    read = replay(recording, told, None).drive(time).axes["outer"]
    truth = told.schedule.drive(time).axes["outer"]
    assert np.abs(truth.a).max() > 1
    lost = np.sum((read.a - truth.a) * truth.a) / np.sum(truth.a**2)
    assert abs(lost) < 3e-4
    assert np.abs(read.v - truth.v).max() < 2e-4
