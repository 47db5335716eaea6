"""Dwells of simulated logs against the schedule that made them."""

from itertools import groupby, pairwise

import numpy as np
import pytest
from builders import setup_of

from tiltcal.core.errors import TiltcalError
from tiltcal.laboratory.laboratory import SimulatedLaboratory
from tiltcal.laboratory.scenario import parse_scenario
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.segmentation import (
    can_show_standstill,
    dwells,
    find_segments,
    majority,
    standstill_rows,
)

DWELL = 5.0  # s
POSES = {
    "vertical": [{"outer_deg": a} for a in (0, 90, 180, 360, 180)],
    "placing": [{"outer_deg": a} for a in (0, 10, 45, 100, -90, 80)],
    "dual": [
        {"outer_deg": o, "inner_deg": i}
        for o, i in ((0, 0), (30, 90), (30, 180), (-60, 180), (90, 0))
    ],
    "three": [
        {"outer_deg": 40},
        {"middle_deg": 40},
        {"inner_deg": 70},
        {"outer_deg": 0, "middle_deg": 0},
        {"inner_deg": 0},
    ],
    "handheld": [{"up": up} for up in ("+x", "-x", "+y", "-y", "+z", "-z")],
}
ACCEL = {"name": "accel", "kind": "accelerometer", "rate_hz": 50}
GYRO = {"name": "gyro", "kind": "gyro", "rate_hz": 100}
NOISE = [{"id": "acc_noise", "white_ug_rthz": 100}, {"id": "gyr_noise", "white_deg_rth": 0.3}]
CODES = [
    *NOISE,
    {"id": "adc_quantisation", "sensor": "accel", "lsb_si": 0.01},
    {"id": "adc_quantisation", "sensor": "gyro", "lsb_si": 1e-3},
]


def scenario_of(table, effects=()):
    """Five seconds at each pose; each pose is a step, the last ones repeated nowhere."""
    steps = [
        {"action": "move", "dwell_s": DWELL, "rate_deg_s": 40, **pose} for pose in POSES[table]
    ]
    return parse_scenario(
        {
            "schema": 1,
            "site": {"gravity_m_s2": 9.8, "latitude_deg": 40},
            "rig": {"table": table},
            "sensor": [ACCEL, GYRO],
            "sequence": steps,
            "effect": list(effects),
        }
    )


def truly(schedule):
    """(start, end) of each true dwell; rests that touch are one."""
    groups = (
        list(group)
        for rest, group in groupby(schedule.legs, key=lambda leg: leg.profile == "rest")
        if rest
    )
    return [(group[0].t0, group[-1].t1) for group in groups]


def logged(table, effects=(), seed=1):
    scenario = scenario_of(table, effects)
    return SimulatedLaboratory().record(scenario, seed=seed), truly(scenario.schedule)


def assert_found(recording, truth, window=0.5):
    found = dwells(find_segments(recording, window))
    assert len(found) == len(truth)
    for segment, (start, end) in zip(found, truth, strict=True):
        assert start - 1e-9 <= segment.start < segment.end <= end + 1e-9
        assert segment.end - segment.start >= 0.6 * (end - start)
        np.testing.assert_array_equal(
            recording.time[[segment.first, segment.last - 1]], [segment.start, segment.end]
        )


@pytest.mark.parametrize("effects", [(), NOISE, CODES], ids=["clean", "noisy", "in coarse codes"])
@pytest.mark.parametrize("table", POSES)
def test_every_dwell_is_found_inside_the_true_one(table, effects):
    assert_found(*logged(table, effects))


def test_a_steady_turn_about_the_vertical_is_no_dwell_to_a_gyro():
    recording, truth = logged("vertical", NOISE)
    gyro = {
        name: recording.column(name) for name in recording.column_names if name.startswith("gyro")
    }
    assert_found(Recording.from_columns(recording.time, gyro), truth)


@pytest.mark.parametrize(
    "table", [t for t in POSES if t != "vertical"]
)  # gravity does not see a turn about the vertical
def test_dwells_are_found_without_a_table_readout(table):
    recording, truth = logged(table, NOISE)
    bare = {
        name: recording.column(name)
        for name in recording.column_names
        if not name.startswith("table_")
    }
    assert_found(Recording.from_columns(recording.time, bare), truth)


@pytest.mark.parametrize("window", [0.5, 0.8, 1.2, 2.0])
@pytest.mark.parametrize("table", POSES)
def test_the_window_does_not_decide_how_many_dwells_there_are(table, window):
    recording, truth = logged(table, NOISE)
    assert len(dwells(find_segments(recording, window))) == len(truth)


@pytest.mark.parametrize("effects", [(), NOISE, CODES], ids=["clean", "noisy", "in coarse codes"])
def test_a_log_at_rest_is_one_dwell(effects):
    scenario = scenario_of("vertical", effects)
    rest = scenario.model_copy(update={"sequence": scenario.sequence[:0]})
    rest = type(rest).model_validate(
        {
            **scenario.model_dump(by_alias=True, exclude_none=True),
            "sequence": [{"action": "rest", "dwell_s": 60}],
        }
    )
    recording = SimulatedLaboratory().record(rest, seed=3)
    (segment,) = find_segments(recording)
    assert (segment.kind, segment.first, segment.last) == ("dwell", 0, len(recording))


def test_segments_cover_the_log_in_order_and_moves_lie_between():
    recording, truth = logged("placing", NOISE)
    segments = find_segments(recording)
    assert [s.kind for s in segments][:3] == ["dwell", "move", "dwell"]
    assert sum(s.kind == "dwell" for s in segments) == len(truth)
    assert all(one.end <= two.end and one.first < two.last for one, two in pairwise(segments))


def test_a_guard_shortens_both_ends_inside_the_log():
    recording, _ = logged("placing", NOISE)
    wide, narrow = (dwells(find_segments(recording, guard=g)) for g in (0.0, 1.0))
    for a, b in zip(wide[1:-1], narrow[1:-1], strict=True):
        assert b.start - a.start == pytest.approx(1.0, abs=0.021)
        assert a.end - b.end == pytest.approx(1.0, abs=0.021)


# --------------------------------------------------------------------------------------------------
# -- labels


def words(*labels):
    return Recording(np.arange(float(len(labels))), labels=np.array(labels, object))


@pytest.mark.parametrize(
    ("labels", "word"),
    [
        (("+x", "+x", "-x"), "+x"),
        (("+x", None, None), None),
        (("+x", None, "+x"), "+x"),
        ((None, None, None), None),
        (("+x", "", None, "+x"), "+x"),
    ],
)
def test_a_label_is_the_word_on_most_rows(labels, word):
    assert majority(words(*labels), 0, len(labels)) == word


def test_a_recording_without_labels_has_none():
    assert majority(Recording(np.arange(3.0)), 0, 3) is None


def test_each_dwell_of_a_hand_held_log_carries_its_label():
    recording, _ = logged("handheld", NOISE)
    assert [s.label for s in dwells(find_segments(recording))] == [
        "+x",
        "-x",
        "+y",
        "-y",
        "+z",
        "-z",
    ]


# --------------------------------------------------------------------------------------------------
# messages


def test_a_log_that_cannot_show_motion_is_refused():
    with pytest.raises(
        TiltcalError,
        match=(
            "found no table, accelerometer, inclinometer or gyro column, need one that shows motion"
        ),
    ):
        find_segments(Recording.from_columns(np.arange(9.0), {"temperature_degC": np.zeros(9)}))


def test_a_log_shorter_than_the_window_is_refused():
    with pytest.raises(
        TiltcalError, match="found 5 rows, need more than one window of 6 rows; record longer"
    ):
        find_segments(Recording.from_columns(np.arange(5.0), {"accel_x_g": np.zeros(5)}))


def test_a_log_that_runs_backwards_is_refused():
    with pytest.raises(TiltcalError, match="time goes back"):
        find_segments(Recording.from_columns(np.array([0.0, 2.0, 1.0]), {"accel_x_g": np.zeros(3)}))


def test_resting_rows_of_a_readout_are_the_true_ones():
    scenario = scenario_of("placing")
    time = np.arange(0, scenario.schedule.times[1], 0.02)
    jet = scenario.schedule.drive(time).axes["outer"]
    resting = standstill_rows(time, jet.x[:, None])
    assert not resting[np.abs(jet.v) > 0.05].any()
    assert resting[jet.v == 0].mean() > 0.9
    assert standstill_rows(time[:2], jet.x[:2, None]).all()
    assert setup_of("placing").rig.axis_names == ("outer",)


def test_stamps_that_all_repeat_show_no_motion():
    time, angles = np.repeat(np.arange(4.0), 20), np.zeros((80, 1))
    angles[40:] = 1.0
    assert not can_show_standstill(time)
    with pytest.raises(TiltcalError, match="more than one window"):
        standstill_rows(time, angles)


@pytest.mark.parametrize("size", [0.02, 30.0])
def test_a_readout_that_is_set_while_the_readings_go_on_parts_a_dwell(size):
    """An angle typed in late: the readings stand still, the readout steps in one row. A step of
    0.02 deg may be the code of a coarse encoder.
    """
    rng = np.random.default_rng(4)
    angle = np.concatenate([np.zeros(200), np.linspace(0, -30, 40), np.full(400, -30.0)])
    reading = 9.8 * np.sin(np.radians(angle)) + 1e-3 * rng.normal(size=len(angle))
    readout = angle.copy()
    readout[440:] += size
    columns = {"accel_x_m_s2": reading, "table_outer_deg": readout}
    found = dwells(find_segments(Recording.from_columns(np.arange(640) / 20, columns)))
    assert len(found) == (3 if size > 1 else 2)
    if size > 1:
        assert found[1].last <= 440 <= found[2].first
