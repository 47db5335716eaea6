"""Sequences in laboratory words: what each action does, and what it refuses."""

import numpy as np
import pytest
from builders import schedule_of, setup_of
from pydantic import ValidationError

from tiltcal.core.errors import TiltcalError
from tiltcal.core.frames import parse_mount
from tiltcal.core.units import DEG
from tiltcal.setup.schedule import RAMP, build_schedule
from tiltcal.setup.sequence import Climate, Step


def course(table, *steps, **climate):
    return schedule_of(setup_of(table), *steps, **climate)


def ends(schedule):
    """Angles in degrees after each leg, by axis."""
    drive = schedule.drive(np.array([leg.t1 for leg in schedule.legs]))
    return {name: np.round(jet.x / DEG, 9).tolist() for name, jet in drive.axes.items()}


def test_a_move_takes_its_distance_at_its_rate_and_one_ramp():
    schedule = course(
        "dual",
        {"action": "move", "outer_deg": 90, "inner_deg": -45, "rate_deg_s": 30, "dwell_s": 2},
    )
    assert schedule.times == (0.0, pytest.approx(90 / 30 + RAMP + 2))
    rate = schedule.drive(np.array([1.5])).axes
    assert rate["outer"].v[0] == pytest.approx(30 * DEG)
    assert rate["inner"].v[0] == pytest.approx(-15 * DEG)
    assert ends(schedule) == {"outer": [90, 90], "inner": [-45, -45]}


def test_angles_left_out_stay_and_a_short_move_takes_two_ramps():
    schedule = course(
        "three", {"action": "move", "outer_deg": 10}, {"action": "move", "inner_deg": 1}
    )
    assert ends(schedule) == {"outer": [10, 10], "middle": [0, 0], "inner": [0, 1]}
    assert schedule.legs[1].t1 - schedule.legs[1].t0 == pytest.approx(2 * RAMP)


def test_a_turn_counts_from_where_the_table_stands():
    schedule = course(
        "vertical",
        {"action": "turn", "axis": "outer", "angle_deg": 270},
        {"action": "turn", "axis": "outer", "angle_deg": -360},
    )
    assert ends(schedule)["outer"] == [270, -90]


def test_a_sweep_stops_at_every_step_its_start_included():
    schedule = course("placing", {"action": "sweep", "outer_deg": 90, "step_deg": 30, "dwell_s": 1})
    stops = [leg for leg in schedule.legs if leg.profile == "rest"]
    assert [leg.q0[0] / DEG for leg in stops] == pytest.approx([0, 30, 60, 90])
    assert [leg.stop for leg in stops] == [0, 1, 2, 3]


def test_a_sweep_back_does_not_stop_twice_at_its_start_and_uneven_steps_become_even():
    schedule = course(
        "placing",
        {"action": "sweep", "outer_deg": 90, "step_deg": 45, "dwell_s": 1},
        {"action": "sweep", "outer_deg": 0, "step_deg": 40, "dwell_s": 1},
    )
    assert [leg.q0[0] / DEG for leg in schedule.legs if leg.profile == "rest"] == pytest.approx(
        [0, 45, 90, 60, 30, 0]
    )


def test_an_oscillation_swings_its_axis_and_comes_back():
    schedule = course(
        "three",
        {
            "action": "oscillate",
            "axis": "middle",
            "amplitude_deg": 5,
            "frequency_hz": 2,
            "cycles": 8,
            "dwell_s": 1,
        },
    )
    middle = schedule.drive(np.linspace(0, 4, 4001)).axes["middle"].x / DEG
    assert schedule.times[1] == 8 / 2 + 1
    assert (middle.max(), middle.min()) == (pytest.approx(5, rel=0.02), pytest.approx(-5, rel=0.02))
    assert middle[-1] == pytest.approx(0, abs=1e-9)


def test_a_remount_changes_the_mounting_from_its_step_on_and_labels_follow():
    schedule = course(
        "placing",
        {"action": "rest", "dwell_s": 2, "label": "+z"},
        {"action": "remount", "mount": "Rz(180)", "dwell_s": 2},
    )
    time = np.array([0.0, 1.9, 2.0, 3.0])
    assert schedule.mountings(time) == ((0, "identity"), (2, "Rz(180)"))
    np.testing.assert_array_equal(schedule.drive(time).mounts[1][1], parse_mount("Rz(180)"))
    assert list(schedule.labels(time)) == ["+z", "+z", None, None]
    assert schedule.drive(time).stop.tolist() == [0, 0, 1, 1]


def test_before_and_after_a_schedule_the_table_rests():
    drive = course("vertical", {"action": "turn", "axis": "outer", "angle_deg": 90}).drive(
        np.array([-5.0, 1e3])
    )
    np.testing.assert_allclose(drive.axes["outer"].x / DEG, [0, 90])
    np.testing.assert_allclose(drive.axes["outer"].v, 0, atol=1e-15)


def test_a_hand_held_step_dwells_as_long_as_it_says_and_once():
    schedule = course(
        "handheld",
        {"action": "rest", "dwell_s": 3},
        {"action": "turn", "axis": "x", "angle_deg": 90, "dwell_s": 2},
    )
    assert [leg.t1 - leg.t0 for leg in schedule.legs if leg.profile == "rest"] == pytest.approx(
        [3, 2]
    )


def test_a_hand_held_turn_about_a_body_axis_and_a_move_to_up():
    schedule = course(
        "handheld",
        {"action": "turn", "axis": "x", "angle_deg": 90},
        {"action": "move", "up": "+x"},
        {"action": "move", "up": "-x"},
    )
    R = schedule.drive(np.array([leg.t1 for leg in schedule.legs])).attitude.R_wb
    # up in the body frame
    np.testing.assert_allclose(R[:, 2], [[0, 1, 0], [1, 0, 0], [-1, 0, 0]], atol=1e-12)
    assert [leg.label for leg in schedule.legs] == [None, "+x", "-x"]


def test_the_climate_starts_ramps_swings_and_settles():
    climate = Climate(start_degC=20, ramp_degC_h=3600, change_degC=5, tau_s=10)
    np.testing.assert_allclose(climate.at(np.array([0.0, 10.0])), [20, 30 + 5 * (1 - np.exp(-1))])
    assert Climate(swing_degC=2, period_s=40).at(np.array([10.0])) == pytest.approx(25)
    assert Climate(ramp_degC_h=3600).reference(100) == pytest.approx(23 + 50)
    assert Climate(ramp_degC_h=3600, reference_degC=20).reference(100) == 20
    drive = course("placing", {"action": "rest", "dwell_s": 100}, ramp_degC_h=3600).drive(
        np.array([50.0])
    )
    assert (drive.temperature[0], drive.reference_temperature) == (
        pytest.approx(73),
        pytest.approx(73),
    )


# --------------------------------------------------------------------------------------------------
# messages


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ({"action": "turn"}, "action turn needs axis, angle_deg"),
        ({"action": "turn", "axis": "outer"}, "action turn needs angle_deg"),
        (
            {"action": "oscillate", "axis": "outer"},
            "action oscillate needs amplitude_deg, frequency_hz",
        ),
        ({"action": "remount"}, "action remount needs mount"),
        (
            {"action": "move", "up": "sideways"},
            r"up = 'sideways' is no direction; write '\+x', '-z' or",
        ),
        ({"action": "move", "rate_deg_s": 0}, "greater than 0"),
        ({"action": "rest", "dwell_s": -1}, "greater than or equal to 0"),
        ({"action": "jump"}, "Input should be 'rest', 'move'"),
        ({"action": "rest", "dwel_s": 1}, "Extra inputs are not permitted"),
    ],
)
def test_a_step_that_says_too_little_or_nonsense_is_refused(step, message):
    with pytest.raises(ValidationError, match=message):
        Step(**step)


@pytest.mark.parametrize(
    ("table", "step", "message"),
    [
        (
            "placing",
            {"action": "move", "inner_deg": 5},
            r"sequence step 1 \(move\): found axis inner, need an axis of this table: outer",
        ),
        (
            "dual",
            {"action": "turn", "axis": "middle", "angle_deg": 5},
            "found axis middle, need an axis of this table: outer, inner",
        ),
        (
            "vertical",
            {"action": "oscillate", "axis": "x", "amplitude_deg": 1, "frequency_hz": 1},
            "found axis x",
        ),
        (
            "handheld",
            {"action": "move", "outer_deg": 5},
            "found options of a table, need rest, move with up, or turn",
        ),
        ("handheld", {"action": "sweep"}, r"sequence step 1 \(sweep\): found options of a table"),
        (
            "handheld",
            {"action": "turn", "axis": "outer", "angle_deg": 5},
            r"found axis outer, need x, y, z or \[ux, uy, uz\]",
        ),
        ("handheld", {"action": "turn", "axis": [0, 0, 0], "angle_deg": 5}, "need x, y, z or"),
        (
            "placing",
            {"action": "move", "outer_deg": 0},
            "sequence: found no motion and no dwell, need dwell_s or a move",
        ),
    ],
)
def test_a_step_that_does_not_fit_the_table_is_refused_by_number(table, step, message):
    with pytest.raises(TiltcalError, match=message):
        build_schedule([Step(**step)], setup_of(table).rig)


@pytest.mark.parametrize("mount", ["Rz(half)", "upside down"])
def test_a_step_with_a_mounting_that_does_not_read_is_refused(mount):
    with pytest.raises((TiltcalError, ValidationError), match="mount"):
        build_schedule([Step(action="remount", mount=mount, dwell_s=1)], setup_of("placing").rig)


def test_an_empty_sequence_is_refused():
    with pytest.raises(
        TiltcalError,
        match=r"sequence: found no steps, need at least one; add a \[\[sequence\]\] table",
    ):
        build_schedule([], setup_of("placing").rig)
